"""Measurements made by others: what bcid answers, beside what their authors say."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from bcid.base.errors import InputError
from bcid.base.progress import Progress
from bcid.base.run_folder import write_whole
from bcid.base.units import percent, uncertain
from validation.text_table import TextTable

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
Row = Mapping[str, str]
_HEAD = ("measurement", "guess", "found", "published", "not known")
# Of the plates: what their energy is made of, shear modulus, kPa, and Poisson's ratio.
_PLATES = {
    "NeoHooke": ("I1", 20.0, 0.286),
    "MooneyRivlin": ("I1 and I2", 100.0, -0.182),
    "Blatz": ("I2", 100.0, -0.654),
    "Demiray": ("exponential", 160.0, -0.763),
}
_FOLDERS = ("human_skin", "fingerprint_plates", "duodic_rubber")
# Of the beam, kPa: parameters.json of its data.
_BEAM = 263.8


def run(folder: Path, output: Path, progress: Progress) -> list[Row]:
    """Answer every measurement and write a table into a folder; returns its rows.

    Args:
        folder: with the data of others, in folders `human_skin`, `fingerprint_plates` and `duodic_rubber`.
        output: takes scene files and the table.
        progress: told which one is answered.

    Raises:
        InputError: data are missing.
    """
    missing = [name for name in _FOLDERS if not (folder / name).is_dir()]
    if missing:
        raise InputError(
            f"{folder}: has no folder {' and no folder '.join(missing)}; name the folder with the data of others"
        )
    output.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    parts: tuple[Callable[[Path, Path], Iterator[Row]], ...] = (_skin, _plates, _beam, _strip, _tension)
    for part in parts:
        progress.say(f"answering: {part.__name__.strip('_')}")
        rows += part(folder, output)
    write_whole(output / "table.txt", table(rows).text() + "\n")
    return rows


def table(rows: list[Row]) -> TextTable:
    """A row for each measurement and guess."""
    return TextTable("Measurements made by others", _HEAD, tuple(tuple(row[name] for name in _HEAD) for row in rows))


def _row(*values: str) -> Row:
    return dict(zip(_HEAD, values, strict=True))


def _skin(folder: Path, output: Path) -> Iterator[Row]:
    example = _example("11_skin")
    for specimen, (low, high) in example.PUBLISHED.items():
        unknown = "thickness, Poisson's ratio" + (", the outline of the scar" if specimen == "keloid" else "")
        for thickness in example.THICKNESSES:
            for poisson in example.POISSONS:
                one = example.answer(folder / "human_skin", specimen, thickness, poisson, output / "skin")
                value, least, most = one.product
                found = (
                    f"rim held {percent(one.rim)}, E t {value:.3f} ({least:.3f} to {most:.3f}) N/mm, something missing "
                )
                yield _row(
                    f"skin, {specimen}",
                    f"t = {thickness:g} mm, ν = {poisson:g}",
                    found + percent(one.missing),
                    f"rim free, E t {low:g} to {high:g} N/mm",
                    unknown,
                )


def _plates(folder: Path, _output: Path) -> Iterator[Row]:
    example = _example("10_laws")
    scene = example.Scene.read(EXAMPLES / "scenes/plate.toml")
    for name, measured in example.plates(folder / "fingerprint_plates"):
        made, noise = name.split("_")
        law, shear, poisson = _PLATES[made]
        found, odds = example.answer(scene, measured)
        likely = sorted(odds, key=lambda one: -odds[one])
        best = found[likely[0]]
        text = ", ".join(f"{one} {percent(odds[one])}" for one in likely if odds[one] > 0.05)
        (shear_found, shear_error), (ratio, ratio_error) = best.shear, best.poisson
        text += f"; shear modulus {uncertain(1e-3 * shear_found, 1.96e-3 * shear_error)} kPa"
        text += f", ν {uncertain(ratio, 1.96 * ratio_error)}"
        stated = f"{law}, shear modulus {shear:g} kPa, ν {poisson:g}"
        yield _row(f"plate, {made}, noise {100 * float(noise):g} %", "", text, stated, "")


def _beam(_folder: Path, _output: Path) -> Iterator[Row]:
    from mpi4py import MPI

    from bcid import Scene
    from bcid.forms.model import Model
    from bcid.predict.predictor import Predictor
    from bcid.scene.uncertainty import Uncertainty
    from bcid.search.fitting.fit import fit
    from bcid.search.fitting.state import State

    example = _example("03_beam")
    scene = replace(Scene.read(EXAMPLES / "scenes/beam.toml"), uncertainty=Uncertainty())
    measured, _ = example.states_of_rest(replace(scene, effects={}))
    predictor = Predictor(scene, measured, MPI.COMM_SELF)
    found = fit(State.of(predictor, Model.of(scene), example.CLAMPED), ("young",))
    predictor.destroy()
    value, width = 1e-3 * found.values["young"], 1.96e-3 * found.stderr["young"]
    yield _row("beam", "", f"E {value:.0f} ± {width:.0f} kPa", f"E {_BEAM:g} kPa", "how the clamp gives")


def _strip(folder: Path, _output: Path) -> Iterator[Row]:
    found = _example("07_strip").main(folder / "duodic_rubber")
    measured, plain, fitted = found.width
    ratio, width = found.fitted.values["poisson"], 1.96 * found.fitted.stderr["poisson"]
    text = f"width {measured:.3f} of that at rest (incompressible {plain:.3f}, fitted {fitted:.3f}), ν {ratio:.3f} ± {width:.3f}"
    yield _row("strip", "", text, "", "thickness, rubber, grips")


def _tension(_folder: Path, _output: Path) -> Iterator[Row]:
    plain, stiffening, best = (100 * error for error in _example("04_tension").main().errors)
    text = f"stress missed by {plain:.1f} % by neo-Hooke, {stiffening:.1f} % with strain stiffening"
    yield _row("tension test", "", text, f"at best {best:.1f} %, by Yeoh's three constants", "")


def _example(name: str) -> ModuleType:
    """A script of the examples as a module."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = found
    spec.loader.exec_module(found)
    return found
