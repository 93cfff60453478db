"""What a comparison starts from: scene and measurement, or an earlier run with its model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, agree, on_root
from bcid.base.errors import BcidError, InputError, nearest
from bcid.base.fingerprint import file_fingerprint
from bcid.base.run_folder import RunFolder
from bcid.forms import effects
from bcid.forms.course import course_of, in_time
from bcid.forms.driving import driven_by_points
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import check_geometry
from bcid.forms.mesh.patches import divided
from bcid.forms.model import Model, Term, check_physics
from bcid.measurement import Measurement
from bcid.measurement.compared import in_plane, pooled, thinned
from bcid.results.identification_record import IdentificationRecord
from bcid.results.run_documents import read_record
from bcid.scene import Scene


@dataclass(frozen=True)
class Source:
    """What a comparison starts from.

    Attributes:
        scene_file, measurement_file: as the user gave them.
        model: with effects and values.
        anchors: the anchored patches; None where they are to be found.
        free: fitted numbers.
        files: effect files of the user.
        own: the effects of these files, in their order.
    """

    scene_file: Path
    measurement_file: Path
    scene: Scene
    measurement: Measurement
    model: Model
    anchors: frozenset[str] | None
    free: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    own: tuple[Effect, ...] = ()

    def inputs(self, options: Any) -> dict[str, Any]:
        """Fingerprints of what a result depends on."""
        stored = {term.label: stored_effect(term.effect) for term in self.model.terms}
        courses = {label: one["course"] for label, one in stored.items() if "course" in one}
        return fingerprints(self.scene, self.measurement) | {
            "model": self.model.constants() | {"name": self.model.name, **courses},
            "anchors": None if self.anchors is None else sorted(self.anchors),
            "effects": [file_fingerprint(path) for path in self.files],
            "options": options,
        }


def from_files(scene_file: Path, measurement_file: Path, files: Sequence[Path], comm: Comm) -> Source:
    """A scene and a measurement, with the anchors to be found, and the user's effects; collective on `comm`.

    Raises:
        InputError: scene, measurement, geometry or an effect file cannot be used.
    """
    scene, measurement = read_inputs(scene_file, measurement_file, comm)
    check_geometry(scene, 0, comm)
    own = _loaded(files, comm)
    return Source(scene_file, measurement_file, scene, measurement, Model.of(scene), None, (), tuple(files), own)


def _loaded(files: Sequence[Path], comm: Comm) -> tuple[Effect, ...]:
    """The effects of files. Each rank runs the files itself: effects hold functions, which cannot be sent."""
    own: tuple[Effect, ...] = ()
    error = None
    try:
        own = tuple(effects.load(path) for path in files)
    except BcidError as caught:
        error = caught
    agree(comm, error)
    return own


def from_run(folder: Path, files: Sequence[Path], comm: Comm) -> Source:
    """What an earlier run (identify, compare, diagnose, fit or explain) ended with; collective.

    Raises:
        InputError: the folder is not a finished run, or scene or measurement have changed since.
    """
    run = on_root(comm, lambda: RunFolder.finished(folder))
    names = run.record.get("names", {})
    if not {"scene", "measurement"} <= set(names):
        raise InputError(f"{folder}: holds a run of '{run.record['command']}', which names no scene and measurement")
    on_root(comm, run.check)
    # An identification alone has no model but the plain one.
    stored = on_root(comm, lambda: None if run.record["command"] == "identify" else run.read_json("model.json"))
    on_root(comm, lambda: _refuse_unnamed(run, stored, files))
    source = from_files(Path(names["scene"]), Path(names["measurement"]), files, comm)
    for what, present in fingerprints(source.scene, source.measurement).items():
        if present != run.record["inputs"].get(what):
            raise InputError(f"{folder}: the {what} {names[what]} has changed since; repeat the run")
    if stored is None:
        anchored = on_root(comm, lambda: read_record(run, IdentificationRecord)).anchored
        return replace(source, anchors=frozenset(str(name) for name in anchored))
    return replace(source, **_stored_model(source, stored, folder))


def _refuse_unnamed(run: RunFolder, stored: Any, files: Sequence[Path]) -> None:
    """Refuse a model with effects of files that the user has not named: a file of effects is run, and a run folder is data.

    Files are known by their content, so that they may have been moved.
    """
    needed = [str(name) for name in (stored or {}).get("files", [])]
    known = run.record["inputs"].get("effects") or []
    given = {file_fingerprint(path) for path in files if path.is_file()}
    if len(needed) != len(known) or not given.issuperset(known):
        named = " ".join(f"--effects {name}" for name in needed)
        raise InputError(
            f"{run.path}: was made with files of effects, which are run only when you name them, as they were then: add {named}"
        )


def _stored_model(source: Source, stored: Any, folder: Path) -> dict[str, Any]:
    try:
        model = replace(source.model, terms=(), values={k: float(v) for k, v in stored["law"].items()})
        for entry in stored["effects"]:
            values = {k: float(v) for k, v in entry["values"].items()}
            model = model + Term(_stored_effect(entry, source.own), values, place=entry["place"])
        return {
            "model": model,
            "anchors": frozenset(str(name) for name in stored["anchored"]),
            "free": tuple(str(name) for name in stored["free"]),
        }
    except InputError as error:
        raise InputError(f"{folder / 'model.json'}: is damaged ({error}); repeat the run") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder / 'model.json'}: is damaged ({error!r}); repeat the run") from None


def stored_effect(effect: Effect) -> dict[str, Any]:
    """How `model.json` names an effect; one in time by the effect with constant amounts, and its course."""
    course = course_of(effect)
    if course is None or effect.name != in_time(course.effect, course.times, course.stepwise).name:
        # A file's effect may be one in time itself.
        return {"effect": effect.name}
    return {"effect": course.effect.name, "course": {"times": list(course.times), "stepwise": course.stepwise}}


def _stored_effect(entry: dict[str, Any], own: Iterable[Effect]) -> Effect:
    effect, course = find_effect(entry["effect"], own), entry.get("course")
    return effect if course is None else in_time(effect, course["times"], bool(course["stepwise"]))


def find_effect(name: str, own: Iterable[Effect]) -> Effect:
    """An effect of the user's files or of the catalogue."""
    mine = {effect.name: effect for effect in own}
    if name in mine:
        return mine[name]
    if name not in effects.names():
        raise InputError(f"unknown effect '{name}'; {nearest(name, [*effects.names(), *mine])}")
    return effects.effect(name)


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
