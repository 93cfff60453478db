"""What a comparison starts from: scene and measurement, or an earlier run with its model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bcid.collective import on_root
from bcid.errors import InputError, nearest
from bcid.fingerprint import file_fingerprint, fingerprint
from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import check_geometry
from bcid.forms.model import Dose, Model, check_physics
from bcid.forms.patches import divided
from bcid.measurement import Measurement
from bcid.run import Run
from bcid.scene import Scene
from bcid.search.job import scene_content


@dataclass(frozen=True)
class Source:
    """What a comparison starts from.

    Attributes:
        scene_file, measurement_file: as the user gave them.
        model: with effects and values.
        anchors: the anchored patches; None where they are to be found.
        free: fitted numbers.
        files: effect files of the user.
    """

    scene_file: Path
    measurement_file: Path
    scene: Scene
    measurement: Measurement
    model: Model
    anchors: frozenset[str] | None
    free: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    @property
    def own(self) -> list[Effect]:
        """The user's effects."""
        return [effects.load(path) for path in self.files]

    def inputs(self, options: Any) -> dict[str, Any]:
        """Fingerprints of what a result depends on."""
        return {
            "scene": fingerprint(
                {"scene": scene_content(self.scene), "geometry": file_fingerprint(self.scene.geometry)}
            ),
            "measurement": self.measurement.fingerprint(),
            "model": self.model.constants() | {"name": self.model.name},
            "anchors": None if self.anchors is None else sorted(self.anchors),
            "effects": [file_fingerprint(path) for path in self.files],
            "options": options,
        }


def from_files(scene_file: Path, measurement_file: Path, files: Sequence[Path], comm: Any) -> Source:
    """A scene and a measurement, with the anchors to be found; collective."""
    scene = on_root(comm, lambda: Scene.read(scene_file, physics=check_physics))
    measurement = on_root(comm, lambda: Measurement.read(measurement_file))
    measurement.check(scene)
    scene = divided(scene, comm)
    check_geometry(scene, 0, comm)
    source = Source(scene_file, measurement_file, scene, measurement, Model.of(scene), None, (), tuple(files))
    on_root(comm, lambda: [effect.name for effect in source.own] and None)
    return source


def from_run(folder: Path, files: Sequence[Path], comm: Any) -> Source:
    """What an earlier run (identify, compare, diagnose, fit or explain) ended with; collective.

    Raises:
        InputError: the folder is not a finished run, or scene or measurement have changed since.
    """
    run = on_root(comm, lambda: Run.open(folder))
    if run.record["state"] != "finished":
        raise InputError(f"{folder}: the run is {run.record['state']}; finish it first, with the command that began it")
    names = run.record.get("names", {})
    if not {"scene", "measurement"} <= set(names):
        raise InputError(f"{folder}: holds a run of '{run.record['command']}', which names no scene and measurement")
    stored = on_root(comm, lambda: run.read_json("model.json") if (folder / "model.json").is_file() else None)
    own = tuple(Path(name) for name in (stored or {}).get("files", []))
    source = from_files(
        Path(names["scene"]), Path(names["measurement"]), (*own, *(f for f in files if f not in own)), comm
    )
    for what in ("scene", "measurement"):
        if source.inputs(None)[what] != run.record["inputs"].get(what):
            raise InputError(f"{folder}: the {what} {names[what]} has changed since; repeat the run")
    if stored is None:
        anchored = on_root(comm, lambda: run.read_json("identification.json"))["anchored"]
        return replace(source, anchors=frozenset(str(name) for name in anchored))
    return replace(source, **_stored_model(source, stored, folder))


def _stored_model(source: Source, stored: Any, folder: Path) -> dict[str, Any]:
    try:
        model = replace(source.model, doses=(), values={k: float(v) for k, v in stored["law"].items()})
        for entry in stored["effects"]:
            values = {k: float(v) for k, v in entry["values"].items()}
            model = model + Dose(find_effect(entry["effect"], source.own), values, place=entry["place"])
        return {
            "model": model,
            "anchors": frozenset(str(name) for name in stored["anchored"]),
            "free": tuple(str(name) for name in stored["free"]),
        }
    except InputError as error:
        raise InputError(f"{folder / 'model.json'}: is damaged ({error}); repeat the run") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder / 'model.json'}: is damaged ({error!r}); repeat the run") from None


def find_effect(name: str, own: Iterable[Effect]) -> Effect:
    """An effect of the user's files or of the catalogue."""
    mine = {effect.name: effect for effect in own}
    if name in mine:
        return mine[name]
    if name not in effects.names():
        raise InputError(f"unknown effect '{name}'; {nearest(name, [*effects.names(), *mine])}")
    return effects.effect(name)
