"""`bcid identify` as a job: read, check, search, and write everything into a run folder."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bcid.base.collective import Comm, on_root
from bcid.base.options import IdentifyOptions
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from bcid.base.units import percent
from bcid.forms.driving import driven_by_points
from bcid.forms.forward import check_geometry
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.body_mesh import among
from bcid.forms.mesh.check import measures
from bcid.forms.mesh.patches import divided, first_level
from bcid.forms.mesh.shares import share
from bcid.forms.model import Model, check_physics
from bcid.inference import nuisance_text
from bcid.inference.continuation import truncate_to_converged
from bcid.inference.hypotheses import label
from bcid.measurement import AXES, WRENCH, Measurement
from bcid.measurement.compared import LeftOut, in_plane, pooled, thinned
from bcid.predict.levels import pair
from bcid.predict.store import CHECKPOINT, PredictionStore
from bcid.results.common_rows import LeftOutRow, StiffnessRecord
from bcid.results.run_documents import write_documents
from bcid.scene import Scene
from bcid.search.answer.association import MARK
from bcid.search.answer.identification import Identification
from bcid.search.answer.refine import Refinement, check_rounds, identify_refined
from bcid.search.answer.surface_rounds import settled

MAKES = ("identification.json", "prediction.nc", "body.nc", "summary.txt", "picture.png", "paraview/", f"{CHECKPOINT}/")


def run_identification(
    scene_file: Path,
    measurement_file: Path,
    folder: Path,
    options: IdentifyOptions,
    comm: Comm,
    progress: Progress | None = None,
    overwrite: bool = False,
    refine: int = 0,
) -> Path:
    """Identify the anchored patches and write the run folder; collective on `comm`. Returns the folder.

    Everything is validated before the folder is touched. A run that was interrupted goes on where it was. `refine` is how
    many times patches that leave a doubt are halved (see `bcid.search.answer.refine`).

    Raises:
        BcidError: see `bcid.search.identify.identify`, `Scene.read`, `Measurement.read` and `RunFolder.start`.
    """
    progress = progress or Silent()
    scene, measurement = read_inputs(scene_file, measurement_file, comm)
    options.check(scene)
    check_rounds(scene, refine)
    check_geometry(scene, first_level(scene, 0, len(scene.levels) - 1, comm)[0], comm)
    inputs = fingerprints(scene, measurement) | {"options": asdict(options), "refine": refine}
    names = {"scene": str(scene_file), "measurement": str(measurement_file)}
    with running(comm, folder, "identify", inputs, MAKES, overwrite) as run:
        store = PredictionStore.of_run(folder, comm, inputs, progress)

        def work(seen: Measurement) -> None:
            done, seen = identified(scene, seen, comm, options, refine, None, progress, store)
            mesh = working_mesh(done, comm)
            on_root(comm, lambda: _write(run, seen, done, mesh, names, comm.size))

        truncate_to_converged(measurement, work)
        store.clear()
    return folder


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


def read_inputs(scene_file: Path, measurement_file: Path, comm: Comm) -> tuple[Scene, Measurement]:
    """A scene, with its divided patches replaced by their pieces, and a measurement that fits it, with what is odd about it.

    Collective on `comm`.

    Raises:
        InputError: one of them cannot be read, or they do not belong together; see also `bcid.forms.mesh.patches.divided`.
    """
    scene = on_root(comm, lambda: Scene.read(scene_file, physics=check_physics))
    measurement = on_root(comm, lambda: Measurement.read(measurement_file))
    return fitting(scene, measurement, comm)


def fitting(scene: Scene, measurement: Measurement, comm: Comm) -> tuple[Scene, Measurement]:
    """Both as they are compared: checked against each other, driven places with their points, dense points pooled, long actions
    thinned, divided patches as their pieces; collective.

    Raises:
        InputError: they do not belong together; see also `bcid.forms.mesh.patches.divided`.
    """
    measurement.check_names(scene)
    scene, measurement = driven_by_points(scene, in_plane(scene, measurement), comm)
    scene, measurement = pooled(scene, measurement)
    checked = replace(measurement, remarks=tuple(measurement.check(scene)))
    return divided(scene, comm), thinned(checked)


def fingerprints(scene: Scene, measurement: Measurement) -> dict[str, Any]:
    """Fingerprints of scene and measurement, as run folders hold them."""
    return {"scene": scene.fingerprint(), "measurement": measurement.fingerprint()}


def documents(measurement: Measurement, done: Refinement, mesh: BodyMesh) -> dict[str, Any]:
    """What a run folder holds of an identification, by file name: JSON objects, datasets and texts."""
    scene, found = done.scene, done.found
    left_out = LeftOut.of(scene, measurement.without(found.outliers), found.prediction.positions)
    record = replace(done.record(), remarks=measurement.remarks, left_out=left_out_row(left_out))
    tested = [f"{left_out}."] if left_out else []
    lines = [summary(scene, measurement, found, done.log), *tested, *inputs_in_words(scene, measurement, mesh)]
    return {
        "identification.json": record.converted(measurement.units.length),
        "prediction.nc": prediction_dataset(scene, measurement, found),
        "body.nc": body_dataset(scene, mesh, found),
        "summary.txt": "\n".join(lines) + "\n",
    }


def left_out_row(found: LeftOut | None) -> LeftOutRow | None:
    """As results hold it."""
    return None if found is None else LeftOutRow(frames=found.frames, rms=found.rms, compared_rms=found.compared)


def _write(
    run: RunFolder | None, measurement: Measurement, done: Refinement, mesh: BodyMesh, names: dict[str, str], ranks: int
) -> None:
    assert run is not None
    found = documents(measurement, done, mesh)
    write_documents(run, found)
    result: Identification = found["identification.json"]
    stages = run.record["inputs"]["options"]["stages"] or {}
    run.record |= {"names": names, "ranks": ranks, "seed": stages.get("seed")}
    run.record |= {
        "evaluations": {str(level): count for level, count in result.evaluations.items()},
        "search_seconds": round(done.seconds, 3),
        "mesh": mesh.fingerprint(),
    }
    told = result.to_json()
    run.finish({key: told[key] for key in ("anchored", "probability", "rms", "noise_rms", "certified")})


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


def summary(scene: Scene, measurement: Measurement, found: Identification, rounds: Sequence[str] = ()) -> str:
    """The result in plain sentences, what is doubtful first; lengths in mm. `rounds` says how the patches were refined."""
    length, unit = "mm", 1e-3
    names = label(found.anchored, scene.patches)
    frames, rows = measurement.positions.shape[:2]
    fiducials = rows - len(scene.surface)
    points = sum(len(members) for members in scene.members.values())
    pooling = f" (means of {points} points)" if points else ""
    noise = f"the stated noise is {found.noise_rms / unit:.3g} {length}" if found.noise_rms else "no noise is stated"
    mesh = "Nothing is known of the error of the mesh."
    if found.discretisation_rms is not None:
        mesh = f"What may be left of the error of the mesh is {found.discretisation_rms / unit:.2g} {length}."
    lines = [
        *odd(measurement.remarks),
        *_warning(found),
        f"Anchored patches of {scene.name}: {names}  (probability {percent(found.probability)})"
        if scene.patches
        else f"{scene.name}: no patch is a candidate; what is held is known.",
        "",
        f"The model misses the measurement by {found.rms / unit:.3g} {length} per coordinate (RMS); {noise}.",
        mesh,
        *_besides(found),
        *stiffness_in_words(found.stiffness),
        f"Compared: {len(measurement.action_names)} action(s), {frames} frames, {fiducials} fiducials{pooling}.",
        *_of_surface(scene, measurement),
        *_of_patches(scene, found),
    ]
    for other in found.alternatives[:3]:
        misses = f"misses by {other.rms / unit:.3g} {length} where {names} misses by {other.reported_rms / unit:.3g}"
        where = f" (in {other.frames} of {frames} frames)" if other.frames < frames else ""
        text = f"{label(other.anchored, scene.patches)} {misses}{where}, probability {percent(other.probability)}"
        lines.append(f"  {text}{'; it could not be followed further' if other.failure else ''}")
    if found.patches and not found.alternatives:
        lines.append("  none was evaluated")
    lines += ["", "How it was found:", *(f"  {stage}" for stage in found.stages)]
    counts = found.evaluated
    proof = (
        f"of all {2 ** len(scene.patches)} sets {counts['in full']} were followed to the end, "
        f"{counts['stopped']} until they had lost, {counts['failed']} failed, {counts['not']} were not followed"
    )
    lines.append(f"  {'Certified' if found.certified else 'Not certified'}: {proof}.")
    lines += _confused(scene, found)
    if found.failures:
        lines.append(
            f"  For {len(found.failures)} set(s) the model found no acceptable equilibrium: {'; '.join(list(found.failures)[:6])}."
        )
    if rounds:
        lines += ["", "How the patches were refined, before the search above:", *(f"  {text}" for text in rounds)]
    return "\n".join(lines) + "\n"


def _of_patches(scene: Scene, found: Identification) -> list[str]:
    """The candidates, each with its probability; nothing where the scene has none."""
    if not found.patches:
        return []
    each = (
        f"  {name:>6}  {percent(p):>9}  {_state(scene, name, name in found.anchored)}"
        for name, p in found.patches.items()
    )
    return ["", "Probability that a patch is anchored:", *each, "", "Next best sets:"]


def _state(scene: Scene, patch: str, anchored: bool) -> str:
    """What a patch does, and along which axes where that is not along all."""
    along = f" along {scene.held_in_words(patch)}" if len(scene.held_along(patch)) < len(AXES) else ""
    return f"{'anchored' if anchored else 'free'}{along}"


def _of_surface(scene: Scene, measurement: Measurement) -> list[str]:
    """What was seen of the surface."""
    cloud = measurement.cloud
    if cloud is None or cloud.noise is None or cloud.counted is None:
        return []
    points = f"{len(cloud.points)} points with a noise of {cloud.noise * 1e3:.2g} mm"
    return [
        f"Surface: {len(scene.surface)} marks from {points}; {percent(cloud.counted)} of them are of the body and near a mark."
    ]


def _besides(found: Identification) -> list[str]:
    """What was allowed for besides noise and mesh, and whether that is all."""
    if found.discrepancy_probability is None:
        return []
    p = percent(found.discrepancy_probability)
    missing = f"Something is missing in the model besides, or it is wrong there: probability {p}."
    return [*nuisance_text.allowed(found.input_uncertainties), missing]


def stiffness_in_words(found: StiffnessRecord | None) -> list[str]:
    """How stiff the body is, by known forces."""
    return [f"Stiffness by known forces: {found.text}."] if found else []


def _confused(scene: Scene, found: Identification) -> list[str]:
    """Other sets that these data cannot tell from the reported one."""
    others = next((members[1:] for members in found.classes if found.anchored in members), ())
    if not others:
        return []
    return [f"  These data cannot tell it from: {', '.join(label(names, scene.patches) for names in others)}."]


def inputs_in_words(scene: Scene, measurement: Measurement, mesh: BodyMesh) -> list[str]:
    """Sizes of the body and its places, and how well the measurement was brought into its frame, as summaries end."""
    lines = measures(scene, mesh)
    if measurement.aligned is not None:
        lines.append(f"Frame: [align] misses its markers by {measurement.aligned * 1e3:.3g} mm (RMS distance).")
    return lines


def odd(remarks: Iterable[str]) -> list[str]:
    """What is odd about a measurement, as a summary says it before anything else."""
    return [f"LOOK AT THIS FIRST: {text}." for text in remarks]


def _warning(found: Identification) -> list[str]:
    """What must stand above the result: that the model does not explain the data, or that this cannot be told."""
    return [*_outliers(found), *_open(found), *_unexplained(found), *nuisance_text.warnings(found.input_uncertainties)]


def _outliers(found: Identification) -> list[str]:
    """That some fiducials were left out."""
    if not found.outliers:
        return []
    kind = "surface mark(s)" if all(name.startswith(MARK) for name in found.outliers) else "fiducial(s)"
    return [
        f"WARNING: {kind} {', '.join(found.outliers)} do not go with the body, whatever set holds it and whatever smooth "
        "force acts: swapped, or misplaced? They are left out."
    ]


def _open(found: Identification) -> list[str]:
    """That a set which could not be followed to the end may be the one."""
    rivals = [one for one in found.alternatives if one.anchored in found.not_converged]
    if not rivals:
        return []
    first, more = rivals[0], len(rivals) - 1
    others = f" and {more} other set(s)" if more else ""
    return [
        f"WARNING: {{{' '.join(first.anchored)}}}{others} could not be followed to the end ({first.failure}). On the frames before "
        f"it has probability {percent(first.probability)}: the answer below is the best of the sets that could be followed, and "
        "it may be wrong.",
    ]


def _unexplained(found: Identification) -> list[str]:
    if found.noise_rms is None:
        return [
            "WARNING: no noise is known: whether a set explains this measurement cannot be told; the best misses it by "
            f"{found.rms * 1e3:.3g} mm. State noise_sigma.",
        ]
    if found.adequate:
        return []
    which, best = ("no set explains", "the best") if found.patches else ("the model does not explain", "it")
    compared = "Probabilities compare the sets with each other only" if found.patches else ""
    beside = ", with an unknown smooth force in place of what is missing" if found.discrepancy_probability else ""
    return [
        f"WARNING: {which} this measurement: {best} misses it by {found.rms / found.noise_rms:.1f} times the noise.",
        "The mesh is too coarse, a physical effect is missing (bcid explain), or units, frames, grasp or material are not what",
        f"the scene says. {compared}{beside}." if compared else "the scene says.",
    ]
