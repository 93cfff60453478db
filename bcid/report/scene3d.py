"""The body in three dimensions: rest outline, deformed surface, anchored patches, gripper, trajectories, arrows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.off_screen import off_screen
from bcid.report.labels import LETTER, Label, Viewpoint, beside_arrows, drawn
from bcid.report.lengths import round_length
from bcid.report.measured_points import completed
from bcid.report.surface_field import coloured

if TYPE_CHECKING:
    import pyvista as pv

# The surface is drawn smooth where it turns by less than this, degrees; elsewhere there is an edge.
_SHARP = 60.0

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
# Marks that are named in a picture; of more their names hide the body.
_NAMED = 60


@dataclass(frozen=True)
class Palette:
    """Colours that stay apart in print and for colour-blind readers (Okabe & Ito)."""

    tissue: str = "#f3d9cd"
    anchored: str = "#0072b2"
    free: str = "#b9bec6"
    grasp: str = "#e69f00"
    held: str = "#4d5661"
    driven: str = "#7b5ea7"
    region: str = "#b98b7d"
    measured: str = "#222222"
    predicted: str = "#d55e00"
    named: str = "#565c64"
    outline: str = "#9aa0a6"
    edge: str = "#6b5a52"


COLOURS = Palette()
# Of what is drawn as a field.
MAP = "cividis"


def surface(body: xr.Dataset, frame: int | None = None) -> pv.PolyData:
    """Boundary of the body as PyVista mesh in mm, at rest or in a frame; cell data "place" numbers the named places."""
    import pyvista as pv

    points = body["points"].values.copy()
    if frame is not None:
        points += body["displacement"].values[frame]
    triangles = body["triangles"].values
    faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
    mesh = pv.PolyData(points * 1e3, faces)
    mesh.cell_data["place"] = body["place"].values
    return mesh


def picture(body: xr.Dataset, prediction: xr.Dataset, anchored: list[str], frame: int, size: tuple[int, int]) -> Image:
    """Image (height, width, 3) of the body in a frame with its anchors and the trajectories of that frame's action.

    Args:
        body, prediction: the run's `body.nc` and `prediction.nc`.
        anchored: names of the anchored patches.
        frame: which frame to show.
        size: width and height in pixels.
    """
    plotter = _plotter(size)
    labels = _add_body(plotter, body, anchored, frame, str(prediction["grasp"].values[frame]))
    _add_trajectories(plotter, prediction, frame)
    return _image(plotter, body, frame, labels)


def arrows_picture(
    body: xr.Dataset,
    anchored: list[str],
    frame: int | None,
    grasp: str,
    starts: Array,
    arrows: Array,
    size: tuple[int, int],
    texts: Sequence[str] = (),
) -> Image:
    """Image (height, width, 3) of the body with its anchors and with arrows.

    Args:
        body: the run's `body.nc`.
        anchored: names of the anchored patches.
        frame: which frame to show; the rest shape if None.
        grasp: name of the grasp to colour, or "".
        starts, arrows: where arrows begin and what is drawn, shape (arrows, 3), mm.
        size: width and height in pixels.
        texts: written at the tips of the arrows; none where they are empty.
    """
    plotter = _plotter(size)
    labels = _add_body(plotter, body, anchored, frame, grasp, 0.3)
    _add_arrows(plotter, starts, arrows, 0.005 * surface(body).length)
    labels += beside_arrows(starts, arrows, texts, COLOURS.measured, labels, _aim(plotter, body))
    return _image(plotter, body, frame, labels)


def map_picture(
    body: xr.Dataset,
    anchored: list[str],
    frame: int,
    grasp: str,
    places: Array,
    values: Array,
    most: float,
    size: tuple[int, int],
) -> Image:
    """Image (height, width, 3) of the body with its anchors, coloured by a number that is known at many places of its surface.

    Args:
        body: the run's `body.nc`.
        anchored: names of the anchored patches.
        frame: which frame to show.
        grasp: name of the grasp to colour, or "".
        places: where the number is known, shape (places, 3), mm.
        values: the number there, shape (places,); colours of `MAP` go from 0 to `most`.
        size: width and height in pixels.
    """
    plotter = _plotter(size)
    labels = _add_body(plotter, body, anchored, frame, grasp, 0.3)
    field = coloured(surface(body, frame), places, values)
    # In front of the body's own colour.
    view = _aim(plotter, body)
    field.points += 0.002 * view.size * view.away
    plotter.add_mesh(
        field,
        scalars="value",
        cmap=MAP,
        clim=(0.0, most),
        nan_opacity=0.0,
        show_scalar_bar=False,
        ambient=0.6,
        diffuse=0.45,
    )
    return _image(plotter, body, frame, labels)


def places_picture(
    body: xr.Dataset, colours: Mapping[str, str], points: Mapping[str, Array], behind: bool, size: tuple[int, int]
) -> Image:
    """Image (height, width, 3) of the body at rest with its mesh, its places in colour and named, and marked points.

    Args:
        body: as a run's `body.nc`.
        colours: of the places, by their names in `body`.
        points: places of marks by name, shape (3,), mm.
        behind: seen from the opposite side, and from below.
        size: width and height in pixels.
    """
    plotter = _plotter(size)
    rest = surface(body)
    view = _aim(plotter, body, behind)
    labels = _add_places(plotter, rest, [str(name) for name in body["place_name"].values], colours, view)
    labels += _add_marks(plotter, rest, points, view)
    return _image(plotter, body, None, labels, behind)


def _add_places(
    plotter: pv.Plotter, rest: pv.PolyData, names: Sequence[str], colours: Mapping[str, str], view: Viewpoint
) -> list[Label]:
    """The surface with its edges, each place in its colour; returns the names of those that are seen."""
    labels = []
    light = {"ambient": 0.5, "diffuse": 0.4, "specular": 0.05}
    lines = {"show_edges": True, "edge_color": COLOURS.edge, "line_width": 0.6, "edge_opacity": 0.35}
    for number, name in enumerate(names):
        cells = np.flatnonzero(rest.cell_data["place"] == number)
        if len(cells) == 0:
            continue
        part = rest.extract_cells(cells).extract_surface(algorithm="dataset_surface")
        plotter.add_mesh(part, color=colours.get(name, COLOURS.tissue), **light, **lines)
        middles = part.cell_centers().points
        seen = part.compute_normals(cell_normals=True, point_normals=False, auto_orient_normals=False)
        towards = np.asarray(seen.cell_data["Normals"]) @ view.away > 0.15
        if name and towards.mean() > 0.3:
            middle = middles[towards].mean(axis=0)
            nearest = middles[towards][np.linalg.norm(middles[towards] - middle, axis=1).argmin()]
            labels.append(Label(np.asarray(nearest), name.partition(" ")[2], COLOURS.measured, round(0.8 * LETTER)))
    return labels


def _add_marks(plotter: pv.Plotter, rest: pv.PolyData, points: Mapping[str, Array], view: Viewpoint) -> list[Label]:
    """A whole ball for each mark on the side that is seen, just above the surface; returns their names, if they are few."""
    import pyvista as pv

    named = len(points) <= _NAMED
    radius = (0.009 if named else 0.004) * view.size
    labels = []
    normals = rest.compute_normals(cell_normals=True, point_normals=False, auto_orient_normals=False)
    for name, place in points.items():
        facet = normals.find_closest_cell(place)
        if normals.cell_data["Normals"][facet] @ view.away < 0.1:
            continue
        plotter.add_mesh(
            pv.Sphere(radius=radius, center=place + radius * view.away), color=COLOURS.measured, ambient=0.4
        )
        if named:
            labels.append(Label(place + 2.4 * radius * view.high, name, COLOURS.measured, round(0.55 * LETTER)))
    return labels


def _plotter(size: tuple[int, int]) -> pv.Plotter:
    plotter = off_screen(size, "three lights")
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    plotter.enable_depth_peeling(10)
    return plotter


def _image(
    plotter: pv.Plotter, body: xr.Dataset, frame: int | None, labels: Sequence[Label], behind: bool = False
) -> Image:
    """The picture, seen from where it is aimed at, with axes, scale bar and labels."""
    view = _aim(plotter, body, behind)
    labels = [*labels, *_add_key(plotter, view, _seen_points(body, frame), str(body.attrs.get("up", "0 1 0")))]
    plotter.reset_camera()
    plotter.camera.zoom(0.97)
    for label in labels:
        plotter.renderer.AddViewProp(drawn(label))
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return np.asarray(image)


def _add_arrows(plotter: pv.Plotter, starts: Array, arrows: Array, thick: float) -> None:
    """Arrows of one thickness, so that short ones stay visible; a ball marks where each begins."""
    import pyvista as pv

    for start, arrow in zip(starts, arrows, strict=True):
        plotter.add_mesh(pv.Sphere(radius=1.2 * thick, center=start), color=COLOURS.measured, ambient=0.4)
        length = float(np.linalg.norm(arrow))
        if length < thick:
            continue
        tip = min(6 * thick / length, 0.7)
        shape = {"tip_length": tip, "tip_radius": 0.4 * tip, "shaft_radius": min(thick / length, 0.16)}
        arrow_mesh = pv.Arrow(start=start, direction=arrow, scale=length, **shape)
        plotter.add_mesh(arrow_mesh, color=COLOURS.predicted, ambient=0.75, diffuse=0.25)


def _add_body(
    plotter: pv.Plotter, body: xr.Dataset, anchored: list[str], frame: int | None, grasp: str, opacity: float = 0.5
) -> list[Label]:
    """The body, with the outline of its rest shape; returns the names of its patches."""
    rest, moved = surface(body), surface(body, frame)
    edges = {"boundary_edges": False, "non_manifold_edges": False, "manifold_edges": False}
    for mesh, line, width in ((rest, COLOURS.outline, 3), (moved, COLOURS.edge, 2)):
        sharp = mesh.extract_feature_edges(_SHARP, **edges)
        if sharp.n_cells:
            plotter.add_mesh(sharp, color=line, line_width=width)
    # A round body has no edges: its outline is.
    plotter.add_silhouette(rest, color=COLOURS.outline, line_width=3)
    light = {"ambient": 0.45, "diffuse": 0.6, "specular": 0.05}
    # Flat triangles of the far side would show through as shards.
    smooth = {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": _SHARP}
    names = [str(name) for name in body["place_name"].values]
    labels: list[Label] = []
    for number, colour in enumerate(_place_colours(body, anchored, grasp)):
        cells = np.flatnonzero(moved.cell_data["place"] == number)
        if len(cells) == 0:
            continue
        part = moved.extract_cells(cells).extract_surface(algorithm="dataset_surface")
        # The tissue lets the trajectories inside and below show through; what is anchored is solid.
        solid = colour in (COLOURS.anchored, COLOURS.grasp, COLOURS.held)
        plotter.add_mesh(part, color=colour or COLOURS.tissue, opacity=1.0 if solid else opacity, **light, **smooth)
        if names[number].startswith("patch "):
            middle = part.cell_centers().points.mean(axis=0)
            dark = COLOURS.anchored if colour == COLOURS.anchored else COLOURS.named
            labels.append(Label(np.asarray(middle), names[number].removeprefix("patch "), dark))
    return labels


def kinds(body: xr.Dataset) -> set[str]:
    """Of the places that a body has: "patch", "grasp", "held" where one is known to be, "driven", and "region" of a part."""
    return {str(name).partition(" ")[0] for name in body["place_name"].values if name}


def _place_colours(body: xr.Dataset, anchored: list[str], grasp: str) -> list[str | None]:
    """Colour of every place number; None for the plain tissue and for grasps that are not in use."""
    colours: list[str | None] = []
    for name in body["place_name"].values:
        kind, _, which = str(name).partition(" ")
        if kind == "patch":
            colours.append(COLOURS.anchored if which in anchored else COLOURS.free)
        else:
            used = {"grasp": COLOURS.grasp if which == grasp else None, "held": COLOURS.held, "region": COLOURS.region}
            used["driven"] = COLOURS.driven
            colours.append(used.get(kind))
    return colours


def _add_trajectories(plotter: pv.Plotter, prediction: xr.Dataset, frame: int) -> None:
    """Predicted paths as tubes and measured positions as dots, of the action that `frame` belongs to."""
    import pyvista as pv

    action = prediction["action"].values == prediction["action"].values[frame]
    measured, predicted = (prediction[name].values[action] * 1e3 for name in ("measured", "predicted"))
    thick = 0.0022 * float(np.linalg.norm(np.ptp(prediction["rest"].values, axis=0))) * 1e3
    for i in range(measured.shape[1]):
        path = predicted[:, i][np.isfinite(predicted[:, i]).all(axis=1)]
        if len(path) > 1:
            plotter.add_mesh(pv.lines_from_points(path).tube(radius=thick), color=COLOURS.predicted, lighting=False)
    shown = completed(measured, predicted).reshape(-1, 3)
    dots = shown[np.isfinite(shown).all(axis=1)]
    if len(dots):
        spheres = pv.PolyData(dots).glyph(geom=pv.Sphere(radius=1.7 * thick), scale=False, orient=False)
        plotter.add_mesh(spheres, color=COLOURS.measured, ambient=0.4)


def _aim(plotter: pv.Plotter, body: xr.Dataset, behind: bool = False) -> Viewpoint:
    """Look from above at the side of the gripper, from where neither hides the trajectories; or from behind and below.

    The projection is parallel, so that a length in the plane of the picture is the same everywhere.
    """
    up = np.array([float(v) for v in str(body.attrs.get("up", "0 1 0")).split()])
    points = body["points"].values * 1e3
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    across = np.cross(up, np.array([1.0, 0.0, 0.0]))
    if np.linalg.norm(across) < 0.1:
        across = np.cross(up, np.array([0.0, 1.0, 0.0]))
    across /= np.linalg.norm(across)
    ahead = np.cross(across, up)
    away = 0.62 * ahead - 0.62 * across + 0.75 * up
    away /= np.linalg.norm(away) * (-1 if behind else 1)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    plotter.camera_position = [tuple(centre + 3.0 * size * away), tuple(centre), tuple(up)]
    plotter.enable_parallel_projection()
    right = np.cross(up, away)
    right /= np.linalg.norm(right)
    return Viewpoint(right, np.cross(away, right), away, size)


def _seen_points(body: xr.Dataset, frame: int | None) -> Array:
    """Points of the body at rest and in a frame, mm."""
    rest = body["points"].values
    moved = rest if frame is None else rest + np.nan_to_num(body["displacement"].values[frame])
    return np.vstack([rest, moved]) * 1e3


def _add_key(plotter: pv.Plotter, view: Viewpoint, points: Array, up: str) -> list[Label]:
    """Axes, the direction of gravity (g) and a scale bar in the lower corners; returns their names."""
    import pyvista as pv

    along, high = points @ view.right, points @ view.high
    depth = float((points @ view.away).mean())
    long, thick = 0.085 * view.size, 0.0028 * view.size

    def place(x: float, y: float) -> Array:
        return x * view.right + y * view.high + depth * view.away

    bar = round_length(0.2 * view.size)
    # Below what of the body is in its way, and not lower than need be.
    corners = (along < along.min() + 4.2 * long) | (along > along.max() - bar - long)
    low = min(high.min() + 0.6 * long, high[corners].min() - 2.3 * long)
    origin = place(along.min() + 1.2 * long, low)
    labels = []
    gravity = -np.array([float(v) for v in up.split()])
    arrows = [(origin, axis, name, COLOURS.named) for axis, name in zip(np.eye(3), "xyz", strict=True)]
    gravity /= np.linalg.norm(gravity) or 1.0
    arrows.append((place(along.min() + 3.0 * long, low + 0.5 * long), gravity, "g", COLOURS.measured))
    shape = {"tip_length": 0.3, "tip_radius": 2.4 * thick / long, "shaft_radius": thick / long}
    for begin, way, name, colour in arrows:
        plotter.add_mesh(pv.Arrow(start=begin, direction=way, scale=long, **shape), color=colour, lighting=False)
        labels.append(Label(begin + (-0.4 if name == "g" else 1.35) * long * way, name, colour))
    right, left = place(along.max(), low), place(along.max() - bar, low)
    plotter.add_mesh(pv.Tube(pointa=left, pointb=right, radius=1.4 * thick), color=COLOURS.measured, lighting=False)
    labels.append(Label((left + right) / 2 - 0.5 * long * view.high, f"{bar:g} mm", COLOURS.measured))
    return labels
