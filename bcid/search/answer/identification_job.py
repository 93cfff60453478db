"""`bcid identify` as a job: read, check, search, and what a run folder holds of it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bcid.base.collective import Comm
from bcid.base.options import IdentifyOptions
from bcid.base.progress import Progress, Silent
from bcid.base.units import percent
from bcid.forms.forward import check_geometry
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.body_mesh import among
from bcid.forms.mesh.check import measures
from bcid.forms.mesh.patches import first_level
from bcid.forms.mesh.shares import share
from bcid.forms.model import Model
from bcid.inference.continuation import truncate_to_converged
from bcid.measurement import AXES, WRENCH, Measurement
from bcid.measurement.compared import LeftOut
from bcid.predict.levels import pair
from bcid.predict.store import CHECKPOINT, PredictionStore
from bcid.results.common_rows import ComparedRow, LeftOutRow
from bcid.results.summary import identification_summary
from bcid.scene import Scene
from bcid.search.answer.identification import Identification
from bcid.search.answer.job import Job, Made
from bcid.search.answer.refine import Refinement, check_rounds, identify_refined
from bcid.search.answer.source import fingerprints, read_inputs
from bcid.search.answer.surface_rounds import settled


@dataclass(frozen=True)
class IdentificationJob(Job):
    """Which patches are anchored.

    Attributes:
        scene, measurement: as they are compared, see `fitting`.
        options: how to search.
        refine: how many times patches that leave a doubt are halved (see `bcid.search.answer.refine`).
        model: the scene's by default.
        names: the files of scene and measurement.
    """

    scene: Scene
    measurement: Measurement
    options: IdentifyOptions | None = None
    refine: int = 0
    model: Model | None = None
    names: tuple[str, str] = ("", "")

    command = "identify"
    makes = (
        "identification.json",
        "prediction.nc",
        "body.nc",
        "summary.txt",
        "picture.png",
        "paraview/",
        f"{CHECKPOINT}/",
    )
    main, told = "identification.json", ("anchored", "probability", "rms", "noise_rms", "certified")

    @classmethod
    def of_files(
        cls, scene_file: Path, measurement_file: Path, options: IdentifyOptions, comm: Comm, refine: int = 0
    ) -> IdentificationJob:
        """Of files, with everything validated; collective on `comm`.

        Raises:
            InputError: a file cannot be used, or options do not fit; see `Scene.read`, `Measurement.read`.
        """
        scene, measurement = read_inputs(scene_file, measurement_file, comm)
        options.check(scene)
        check_rounds(scene, refine)
        check_geometry(scene, first_level(scene, 0, len(scene.levels) - 1, comm)[0], comm)
        return cls(scene, measurement, options, refine, names=(str(scene_file), str(measurement_file)))

    @property
    def inputs(self) -> dict[str, Any]:
        """Fingerprints and options."""
        return fingerprints(self.scene, self.measurement) | {
            "options": asdict(self.options or IdentifyOptions()),
            "refine": self.refine,
        }

    def made(self, comm: Comm, progress: Progress | None = None, store: PredictionStore | None = None) -> Made:
        """The anchored patches; collective on `comm`."""

        def work(seen: Measurement) -> Made:
            done, seen = identified(self.scene, seen, comm, self.options, self.refine, self.model, progress, store)
            mesh = working_mesh(done, comm)
            stages = self.options.stages if self.options else None
            notes = {
                "names": dict(zip(("scene", "measurement"), self.names, strict=True)),
                "ranks": comm.size,
                "seed": stages.seed if stages else None,
                "evaluations": {str(level): round(count, 3) for level, count in done.evaluations.items()},
                "search_seconds": round(done.seconds, 3),
                "mesh": mesh.fingerprint(),
            }
            return Made(documents(seen, done, mesh), notes)

        return truncate_to_converged(self.measurement, work)


def identified(
    scene: Scene,
    measurement: Measurement,
    comm: Comm,
    options: IdentifyOptions | None = None,
    refine: int = 0,
    model: Model | None = None,
    progress: Progress | None = None,
    store: PredictionStore | None = None,
) -> tuple[Refinement, Measurement]:
    """The anchored patches, and the measurement with surface marks where points of the surface were seen; collective on `comm`.

    See `bcid.search.answer.refine.identify_refined`.
    """

    def search(body: Scene, seen: Measurement) -> Refinement:
        return identify_refined(body, seen, comm, options, refine, model, progress=progress, store=store)

    begun = model or Model.of(scene)
    return settled(
        scene,
        measurement,
        comm,
        progress or Silent(),
        begun,
        None,
        search,
        lambda done: (done.scene, begun, frozenset(done.found.anchored)),
    )


def working_mesh(done: Refinement, comm: Comm) -> BodyMesh:
    """The mesh that an identification was made on; collective."""
    return level_mesh(done.scene, pair(done.scene, done.found.levels[-1], comm)[0], comm)


def documents(measurement: Measurement, done: Refinement, mesh: BodyMesh) -> dict[str, Any]:
    """What a run folder holds of an identification, by file name: JSON objects, datasets and texts."""
    scene, found = done.scene, done.found
    left_out = LeftOut.of(scene, measurement.without(found.outliers), found.prediction.positions)
    record = replace(
        done.record(),
        remarks=measurement.remarks,
        left_out=left_out_row(left_out),
        scene=scene.name,
        compared=compared_row(scene, measurement),
        partly_held={
            name: scene.held_in_words(name) for name in scene.patches if len(scene.held_along(name)) < len(AXES)
        },
        body=tuple(inputs_in_words(scene, measurement, mesh)),
    )
    return {
        "identification.json": record.converted(measurement.units.length),
        "prediction.nc": prediction_dataset(scene, measurement, found),
        "body.nc": body_dataset(scene, mesh, found),
        "summary.txt": identification_summary(record),
    }


def left_out_row(found: LeftOut | None) -> LeftOutRow | None:
    """As results hold it."""
    return None if found is None else LeftOutRow(frames=found.frames, rms=found.rms, compared_rms=found.compared)


def prediction_dataset(scene: Scene, measurement: Measurement, found: Identification) -> xr.Dataset:
    """Measured and predicted fiducial positions (m) and the gripper's wrench (N, N m), by frame."""
    data = measurement.data[["position", "grasp"]].rename(position="measured")
    columns = [scene.fiducial_names.index(name) for name in measurement.fiducial_names]
    data["predicted"] = (("frame", "fiducial", "axis"), found.prediction.positions[:, columns])
    data["rest"] = (("fiducial", "axis"), scene.rest[columns])
    data = data.assign_coords(component=WRENCH)
    data["wrench"] = (("frame", "component"), found.prediction.wrench)
    if np.isfinite(measurement.wrenches).any():
        data["wrench_measured"] = (("frame", "component"), measurement.wrenches)
    return data


def body_dataset(scene: Scene, mesh: BodyMesh, found: Identification) -> xr.Dataset:
    """Mesh, boundary triangles with the places they belong to, and of every frame displacement (m) and strain energy density."""
    return body_parts(scene, mesh, found.prediction.displacement, found.prediction.energy, found.anchored)


def body_parts(
    scene: Scene, mesh: BodyMesh, displacement: Any, energy: Any, anchored: Collection[str] = ()
) -> xr.Dataset:
    """As `body_dataset`, with displacement (frames, nodes, 3), m, and strain energy density (frames, nodes), J/m^3.

    Where patches share triangles, they are those of one that is anchored.
    """
    boundary = mesh.boundary
    places = {f"patch {name}": region for name, region in scene.patches.items()}
    places |= {f"grasp {name}": grasp.region for name, grasp in scene.grasps.items()}
    places |= {f"held {name}": scene.places[name] for name, axes in scene.held.items() if len(axes) == len(AXES)}
    places |= {f"driven {name}": scene.places[name] for name in scene.driven if name in scene.places}
    number = np.zeros(len(boundary), dtype=np.int32)
    for i, (name, region) in enumerate(scene.regions.items(), start=1 + len(places)):
        number[share(mesh, region, name)[mesh.behind] > 0.5] = i
    chosen = {f"patch {name}" for name in anchored}
    for i, (name, place) in sorted(enumerate(places.items(), start=1), key=lambda one: one[1][0] in chosen):
        number[among(boundary, mesh.select(place, name))] = i
    places_and_regions = [*places, *(f"region {name}" for name in scene.regions)]
    return xr.Dataset(
        {
            "points": (("node", "axis"), mesh.points),
            "cells": (("cell", "corner"), mesh.cells.astype(np.int32)),
            "triangles": (("triangle", "vertex"), boundary.astype(np.int32)),
            "place": ("triangle", number),
            "place_name": ("place_number", ["", *places_and_regions]),
            "displacement": (("frame", "node", "axis"), displacement),
            "energy": (("frame", "node"), np.asarray(energy, dtype=np.float32)),
        },
        coords={"axis": AXES},
        attrs={"scene": scene.name, "up": " ".join(str(-v) for v in scene.down)},
    )


def compared_row(scene: Scene, measurement: Measurement) -> ComparedRow:
    """What was compared, as results hold it."""
    frames, rows = measurement.positions.shape[:2]
    return ComparedRow(
        actions=len(measurement.action_names),
        frames=frames,
        markers=rows - len(scene.surface),
        points=sum(len(members) for members in scene.members.values()),
        surface=_of_surface(scene, measurement),
    )


def _of_surface(scene: Scene, measurement: Measurement) -> str:
    """What was seen of the surface."""
    cloud = measurement.cloud
    if cloud is None or cloud.noise is None or cloud.counted is None:
        return ""
    points = f"{len(cloud.points)} points with a noise of {cloud.noise * 1e3:.2g} mm"
    shown = percent(cloud.counted)
    return f"Surface: {len(scene.surface)} marks from {points}; {shown} of them are of the body and near a mark."


def inputs_in_words(scene: Scene, measurement: Measurement, mesh: BodyMesh) -> list[str]:
    """Sizes of the body and its places, and how well the measurement was brought into its frame, as summaries end."""
    lines = measures(scene, mesh)
    if measurement.aligned is not None:
        lines.append(f"Frame: [align] misses its markers by {measurement.aligned * 1e3:.3g} mm (RMS distance).")
    return lines
