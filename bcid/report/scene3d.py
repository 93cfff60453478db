"""The body in three dimensions: rest outline, deformed surface, anchored patches, gripper, trajectories, arrows."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.off_screen import off_screen
from bcid.report.figure import COLOURS, MAP, PLACES, Image, completed, round_length
from bcid.report.labels import LETTER, Label, Viewpoint, beside_arrows, drawn

if TYPE_CHECKING:
    import pyvista as pv

# The surface is drawn smooth where it turns by less than this, degrees; elsewhere there is an edge.
_SHARP = 60.0

Array = NDArray[np.float64]
# Marks that are named in a picture; of more their names hide the body.
_NAMED = 60


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


class BodyPicture:
    """A picture of a body, seen from above at the side of the gripper, to which things are added; lengths in mm.

    The projection is parallel, so that a length in the plane of the picture is the same everywhere.

    Args:
        body: as a run's `body.nc`.
        frame: which frame to show; the rest shape if None.
        size: width and height in pixels.
        behind: seen from the opposite side, and from below.
    """

    def __init__(self, body: xr.Dataset, frame: int | None, size: tuple[int, int], behind: bool = False) -> None:
        self.body, self.frame = body, frame
        self.plotter = off_screen(size, "three lights")
        self.plotter.set_background("white")
        self.plotter.enable_anti_aliasing("ssaa")
        self.plotter.enable_depth_peeling(10)
        self.up = np.array([float(v) for v in str(body.attrs.get("up", "0 1 0")).split()])
        self.view = self._aim(behind)
        self._labels: list[Label] = []

    def _aim(self, behind: bool) -> Viewpoint:
        """Look from where neither gripper nor body hides the trajectories."""
        points = self.body["points"].values * 1e3
        centre = (points.min(axis=0) + points.max(axis=0)) / 2
        across = np.cross(self.up, np.array([1.0, 0.0, 0.0]))
        if np.linalg.norm(across) < 0.1:
            across = np.cross(self.up, np.array([0.0, 1.0, 0.0]))
        across /= np.linalg.norm(across)
        ahead = np.cross(across, self.up)
        away = 0.62 * ahead - 0.62 * across + 0.75 * self.up
        away /= np.linalg.norm(away) * (-1 if behind else 1)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self.plotter.camera_position = [tuple(centre + 3.0 * size * away), tuple(centre), tuple(self.up)]
        self.plotter.enable_parallel_projection()
        right = np.cross(self.up, away)
        right /= np.linalg.norm(right)
        return Viewpoint(right, np.cross(away, right), away, size)

    def image(self) -> Image:
        """The picture, shape (height, width, 3), with axes, scale bar and labels; nothing can be added after it."""
        self._add_key()
        self.plotter.reset_camera()
        self.plotter.camera.zoom(0.97)
        for label in self._labels:
            self.plotter.renderer.AddViewProp(drawn(label))
        image = self.plotter.screenshot(return_img=True)
        self.plotter.close()
        return np.asarray(image)

    def add_body(self, anchored: Collection[str], grasp: str, opacity: float = 0.3) -> None:
        """The body, with the outline of its rest shape and names of its patches.

        Args:
            anchored: names of the anchored patches.
            grasp: name of the grasp to colour, or "".
            opacity: of what is neither anchored nor held.
        """
        rest, moved = surface(self.body), surface(self.body, self.frame)
        edges = {"boundary_edges": False, "non_manifold_edges": False, "manifold_edges": False}
        for mesh, line, width in ((rest, COLOURS.outline, 3), (moved, COLOURS.edge, 2)):
            sharp = mesh.extract_feature_edges(_SHARP, **edges)
            if sharp.n_cells:
                self.plotter.add_mesh(sharp, color=line, line_width=width)
        # A round body has no edges: its outline is.
        self.plotter.add_silhouette(rest, color=COLOURS.outline, line_width=3)
        light = {"ambient": 0.45, "diffuse": 0.6, "specular": 0.05}
        # Flat triangles of the far side would show through as shards.
        smooth = {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": _SHARP}
        for kind, name, part in self._parts(moved):
            if kind == "patch":
                colour = COLOURS.anchored if name in anchored else COLOURS.free
                middle = np.asarray(part.cell_centers().points.mean(axis=0))
                dark = COLOURS.anchored if name in anchored else COLOURS.named
                self._labels.append(Label(middle, name, dark))
            elif kind == "grasp" and name != grasp:
                colour = COLOURS.tissue
            else:
                colour = PLACES.get(kind, COLOURS.tissue)
            # The tissue lets the trajectories inside and below show through; what is anchored is solid.
            solid = colour in (COLOURS.anchored, COLOURS.grasp, COLOURS.held)
            self.plotter.add_mesh(part, color=colour, opacity=1.0 if solid else opacity, **light, **smooth)

    def _parts(self, mesh: pv.PolyData) -> Iterator[tuple[str, str, pv.PolyData]]:
        """Kind and name of each place, and its part of a surface."""
        for number, full in enumerate(self.body["place_name"].values):
            cells = np.flatnonzero(mesh.cell_data["place"] == number)
            if len(cells):
                kind, _, name = str(full).partition(" ")
                yield kind, name, mesh.extract_cells(cells).extract_surface(algorithm="dataset_surface")

    def add_arrows(self, starts: Array, arrows: Array, texts: Sequence[str] = ()) -> None:
        """Arrows of one thickness, so that short ones stay visible; a ball marks where each begins.

        Args:
            starts, arrows: where arrows begin and what is drawn, shape (arrows, 3).
            texts: written at the tips of the arrows; none where they are empty.
        """
        import pyvista as pv

        thick = 0.005 * surface(self.body).length
        for start, arrow in zip(starts, arrows, strict=True):
            self._add_ball(start, 1.2 * thick)
            length = float(np.linalg.norm(arrow))
            if length < thick:
                continue
            tip = min(6 * thick / length, 0.7)
            shape = {"tip_length": tip, "tip_radius": 0.4 * tip, "shaft_radius": min(thick / length, 0.16)}
            mesh = pv.Arrow(start=start, direction=arrow, scale=length, **shape)
            self.plotter.add_mesh(mesh, color=COLOURS.predicted, ambient=0.75, diffuse=0.25)
        self._labels += beside_arrows(starts, arrows, texts, COLOURS.measured, self._labels, self.view)

    def _add_ball(self, centre: Array, radius: float) -> None:
        import pyvista as pv

        self.plotter.add_mesh(pv.Sphere(radius=radius, center=centre), color=COLOURS.measured, ambient=0.4)

    def add_field(self, places: Array, values: Array, most: float) -> None:
        """The surface in the colours of `MAP`, by a number that is known at many places.

        Args:
            places: where it is known, shape (places, 3).
            values: the number there, shape (places,); colours go from 0 to `most`.
        """
        field = coloured(surface(self.body, self.frame), places, values)
        # In front of the body's own colour.
        field.points += 0.002 * self.view.size * self.view.away
        colours = {"scalars": "value", "cmap": MAP, "clim": (0.0, most), "nan_opacity": 0.0, "show_scalar_bar": False}
        self.plotter.add_mesh(field, ambient=0.6, diffuse=0.45, **colours)

    def add_trajectories(self, prediction: xr.Dataset) -> None:
        """Predicted paths as tubes and measured positions as dots, of the action that the frame belongs to."""
        import pyvista as pv

        action = prediction["action"].values == prediction["action"].values[self.frame]
        measured, predicted = (prediction[name].values[action] * 1e3 for name in ("measured", "predicted"))
        thick = 0.0022 * float(np.linalg.norm(np.ptp(prediction["rest"].values, axis=0))) * 1e3
        for i in range(measured.shape[1]):
            path = predicted[:, i][np.isfinite(predicted[:, i]).all(axis=1)]
            if len(path) > 1:
                tube = pv.lines_from_points(path).tube(radius=thick)
                self.plotter.add_mesh(tube, color=COLOURS.predicted, lighting=False)
        shown = completed(measured, predicted).reshape(-1, 3)
        dots = shown[np.isfinite(shown).all(axis=1)]
        if len(dots):
            balls = pv.PolyData(dots).glyph(geom=pv.Sphere(radius=1.7 * thick), scale=False, orient=False)
            self.plotter.add_mesh(balls, color=COLOURS.measured, ambient=0.4)

    def add_places(self, colours: Mapping[str, str]) -> None:
        """The surface at rest with its edges, each place in its colour, by names as "patch 1"; names of those that are seen."""
        light = {"ambient": 0.5, "diffuse": 0.4, "specular": 0.05}
        lines = {"show_edges": True, "edge_color": COLOURS.edge, "line_width": 0.6, "edge_opacity": 0.35}
        for kind, name, part in self._parts(surface(self.body)):
            self.plotter.add_mesh(part, color=colours.get(f"{kind} {name}", COLOURS.tissue), **light, **lines)
            towards = _normals(part) @ self.view.away > 0.15
            if name and towards.mean() > 0.3:
                middles = part.cell_centers().points[towards]
                nearest = middles[np.linalg.norm(middles - middles.mean(axis=0), axis=1).argmin()]
                self._labels.append(Label(np.asarray(nearest), name, COLOURS.measured, round(0.8 * LETTER)))

    def add_marks(self, points: Mapping[str, Array]) -> None:
        """A whole ball for each mark, shape (3,), on the side that is seen, just above the surface; names, if they are few."""
        named = len(points) <= _NAMED
        radius = (0.009 if named else 0.004) * self.view.size
        rest = surface(self.body)
        towards = _normals(rest) @ self.view.away
        for name, place in points.items():
            if towards[rest.find_closest_cell(place)] < 0.1:
                continue
            self._add_ball(place + radius * self.view.away, radius)
            if named:
                above = place + 2.4 * radius * self.view.high
                self._labels.append(Label(above, name, COLOURS.measured, round(0.55 * LETTER)))

    def _add_key(self) -> None:
        """Axes, the direction of gravity (g) and a scale bar in the lower corners."""
        import pyvista as pv

        view, rest = self.view, self.body["points"].values
        moved = rest if self.frame is None else rest + np.nan_to_num(self.body["displacement"].values[self.frame])
        points = np.vstack([rest, moved]) * 1e3
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
        arrows = [(origin, axis, name, COLOURS.named) for axis, name in zip(np.eye(3), "xyz", strict=True)]
        gravity = -self.up / (np.linalg.norm(self.up) or 1.0)
        arrows.append((place(along.min() + 3.0 * long, low + 0.5 * long), gravity, "g", COLOURS.measured))
        shape = {"tip_length": 0.3, "tip_radius": 2.4 * thick / long, "shaft_radius": thick / long}
        for begin, way, name, colour in arrows:
            arrow = pv.Arrow(start=begin, direction=way, scale=long, **shape)
            self.plotter.add_mesh(arrow, color=colour, lighting=False)
            self._labels.append(Label(begin + (-0.4 if name == "g" else 1.35) * long * way, name, colour))
        right, left = place(along.max(), low), place(along.max() - bar, low)
        tube = pv.Tube(pointa=left, pointb=right, radius=1.4 * thick)
        self.plotter.add_mesh(tube, color=COLOURS.measured, lighting=False)
        self._labels.append(Label((left + right) / 2 - 0.5 * long * view.high, f"{bar:g} mm", COLOURS.measured))


def _normals(mesh: pv.PolyData) -> Array:
    """Of its cells, outwards, shape (cells, 3)."""
    found = mesh.compute_normals(cell_normals=True, point_normals=False, auto_orient_normals=False)
    return np.asarray(found.cell_data["Normals"])


def coloured(moved: pv.PolyData, places: Array, values: Array) -> pv.PolyData:
    """A surface with the "value" at its nodes: means of places nearby, NaN where there is none, in smaller triangles than it has.

    A place counts by a Gaussian of its distance, as wide as places are apart.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(places)
    apart = float(np.median(tree.query(places, k=2)[0][:, 1]))
    edge = float(np.sqrt(moved.area / max(moved.n_cells, 1)))
    fine = moved.triangulate()
    for _ in range(max(0, min(3, round(np.log2(max(2 * edge / max(apart, 1e-9), 1.0)))))):
        fine = fine.subdivide(1, "linear")
    distance, near = tree.query(fine.points, k=min(8, len(places)), distance_upper_bound=2 * apart)
    weights = np.where(np.isfinite(distance), np.exp(-0.5 * (distance / apart) ** 2), 0.0)
    known = np.append(values, 0.0)[near]
    total = weights.sum(axis=1)
    fine.point_data["value"] = np.where(total > 0, (weights * known).sum(axis=1) / np.maximum(total, 1e-300), np.nan)
    return fine
