"""The body in three dimensions: rest outline, deformed surface, anchored patches, gripper, trajectories, arrows."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyvista as pv

# VTK writes warnings about a missing display before it falls back to drawing in memory.
os.environ.setdefault("VTK_LOGGING_LEVEL", "ERROR")

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Palette:
    """Colours that stay apart in print and for colour-blind readers (Okabe & Ito)."""

    tissue: str = "#f3d9cd"
    anchored: str = "#0072b2"
    free: str = "#b9bec6"
    grasp: str = "#e69f00"
    measured: str = "#222222"
    predicted: str = "#d55e00"
    weak: str = "#7a828c"
    outline: str = "#9aa0a6"
    edge: str = "#6b5a52"


COLOURS = Palette()


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
    _add_body(plotter, body, anchored, frame, str(prediction["grasp"].values[frame]))
    _add_trajectories(plotter, prediction, frame)
    return _image(plotter, body)


def arrows_picture(
    body: xr.Dataset,
    anchored: list[str],
    frame: int | None,
    grasp: str,
    starts: Array,
    arrows: Array,
    strong: NDArray[np.bool_],
    size: tuple[int, int],
) -> Image:
    """Image (height, width, 3) of the body with its anchors and with arrows.

    Args:
        body: the run's `body.nc`.
        anchored: names of the anchored patches.
        frame: which frame to show; the rest shape if None.
        grasp: name of the grasp to colour, or "".
        starts, arrows: where arrows begin and what is drawn, shape (arrows, 3), mm.
        strong: which arrows are drawn in colour; the others are grey and thinner.
        size: width and height in pixels.
    """
    plotter = _plotter(size)
    _add_body(plotter, body, anchored, frame, grasp, 0.3)
    _add_arrows(plotter, starts, arrows, strong, 0.005 * surface(body).length)
    return _image(plotter, body)


def _plotter(size: tuple[int, int]) -> pv.Plotter:
    import pyvista as pv

    plotter = pv.Plotter(off_screen=True, window_size=list(size), lighting="three lights")
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    plotter.enable_depth_peeling(10)
    return plotter


def _image(plotter: pv.Plotter, body: xr.Dataset) -> Image:
    _aim(plotter, body)
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return np.asarray(image)


def _add_arrows(plotter: pv.Plotter, starts: Array, arrows: Array, strong: NDArray[np.bool_], thickness: float) -> None:
    """Arrows of one thickness, so that short ones stay visible; a ball marks where each begins."""
    import pyvista as pv

    for start, arrow, is_strong in zip(starts, arrows, strong, strict=True):
        colour, thick = (COLOURS.predicted, thickness) if is_strong else (COLOURS.weak, 0.6 * thickness)
        plotter.add_mesh(pv.Sphere(radius=1.2 * thick, center=start), color=COLOURS.measured, ambient=0.4)
        length = float(np.linalg.norm(arrow))
        if length < thick:
            continue
        tip = min(6 * thick / length, 0.7)
        shape = {"tip_length": tip, "tip_radius": 0.4 * tip, "shaft_radius": min(thick / length, 0.16)}
        arrow_mesh = pv.Arrow(start=start, direction=arrow, scale=length, **shape)
        plotter.add_mesh(arrow_mesh, color=colour, ambient=0.75, diffuse=0.25)


def _add_body(
    plotter: pv.Plotter, body: xr.Dataset, anchored: list[str], frame: int | None, grasp: str, opacity: float = 0.5
) -> None:
    rest, moved = surface(body), surface(body, frame)
    edges = {"boundary_edges": False, "non_manifold_edges": False, "manifold_edges": False}
    plotter.add_mesh(rest.extract_feature_edges(40, **edges), color=COLOURS.outline, line_width=3)
    plotter.add_mesh(moved.extract_feature_edges(40, **edges), color=COLOURS.edge, line_width=2)
    light = {"ambient": 0.45, "diffuse": 0.6, "specular": 0.05}
    names = [str(name) for name in body["place_name"].values]
    for number, colour in enumerate(_place_colours(body, anchored, grasp)):
        cells = np.flatnonzero(moved.cell_data["place"] == number)
        if len(cells) == 0:
            continue
        part = moved.extract_cells(cells).extract_surface(algorithm="dataset_surface")
        # The tissue lets the trajectories inside and below show through; what is anchored is solid.
        solid = colour in (COLOURS.anchored, COLOURS.grasp)
        plotter.add_mesh(part, color=colour or COLOURS.tissue, opacity=1.0 if solid else opacity, **light)
        if names[number].startswith("patch "):
            _label(plotter, part, moved, names[number].removeprefix("patch "), colour == COLOURS.anchored)


def _label(plotter: pv.Plotter, part: pv.PolyData, whole: pv.PolyData, text: str, strong: bool) -> None:
    """The name of a patch, beside its middle."""
    normals = part.compute_normals(point_normals=False, auto_orient_normals=False, consistent_normals=False).cell_data[
        "Normals"
    ]
    outward = normals.mean(axis=0) / (np.linalg.norm(normals.mean(axis=0)) or 1.0)
    place = np.asarray(part.center) + 0.06 * whole.length * outward
    options = {"font_size": 40, "bold": strong, "shape": None, "always_visible": True, "show_points": False}
    plotter.add_point_labels([place], [text], text_color=COLOURS.anchored if strong else "#6f757d", **options)


def _place_colours(body: xr.Dataset, anchored: list[str], grasp: str) -> list[str | None]:
    """Colour of every place number; None for the plain tissue and for grasps that are not in use."""
    colours: list[str | None] = []
    for name in body["place_name"].values:
        kind, _, which = str(name).partition(" ")
        if kind == "patch":
            colours.append(COLOURS.anchored if which in anchored else COLOURS.free)
        else:
            colours.append(COLOURS.grasp if kind == "grasp" and which == grasp else None)
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
    dots = measured.reshape(-1, 3)
    dots = dots[np.isfinite(dots).all(axis=1)]
    if len(dots):
        spheres = pv.PolyData(dots).glyph(geom=pv.Sphere(radius=1.7 * thick), scale=False, orient=False)
        plotter.add_mesh(spheres, color=COLOURS.measured, ambient=0.4)


def _aim(plotter: pv.Plotter, body: xr.Dataset) -> None:
    """Look from above at the side of the gripper, from where neither hides the trajectories."""
    up = np.array([float(v) for v in str(body.attrs.get("up", "0 1 0")).split()])
    points = body["points"].values * 1e3
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    across = np.cross(up, np.array([1.0, 0.0, 0.0]))
    if np.linalg.norm(across) < 0.1:
        across = np.cross(up, np.array([0.0, 1.0, 0.0]))
    across /= np.linalg.norm(across)
    ahead = np.cross(across, up)
    view = 0.62 * ahead - 0.62 * across + 0.75 * up
    distance = 3.0 * np.linalg.norm(np.ptp(points, axis=0))
    plotter.camera_position = [tuple(centre + distance * view / np.linalg.norm(view)), tuple(centre), tuple(up)]
    plotter.reset_camera()
    plotter.camera.zoom(1.05)
