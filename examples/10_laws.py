"""
Which law is it?
================

A plate with a hole, and five strain energies that may be its own: which explains the rim of the hole and the two reactions best,
and with which constants?

The plates were simulated by Flaschel, Martonova, Veil & Kuhl ("Material fingerprinting", 2025, arXiv 2508.07831; MIT): three come
with bcid, all twelve (four laws, three levels of noise) are in the folder of data of others. The laws are theirs and Yeoh's, with
the volumetric energy of the scene, K/2 (J - 1)^2; the constants begin far from those of the plates. Of laws that are equally
probable at first the evidence says how probable each is now.

::

    ./dev python examples/10_laws.py
    ./dev python examples/10_laws.py FOLDER

FOLDER holds folders as NeoHooke_0.001: measurements in which the third coordinate is made up, and left out here.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.base.units import percent, uncertain
from bcid.forms.materials.law import Law
from bcid.forms.model import Model
from bcid.predict.predictor import Predictor
from bcid.scene import Material
from bcid.search.answer.adequacy import judge
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.fitted_hypothesis import weighed
from bcid.search.fitting.state import State

HERE = Path(__file__).resolve().parent
SHIPPED = ("neo-hooke", "mooney-rivlin", "blatz-ko")
NOISES = ("0.0", "0.001", "0.01")
# Laws by what they are made of: name, constants to begin with, those that are fitted.
LAWS: dict[str, tuple[str, dict[str, Any], tuple[str, ...]]] = {
    "I1": ("yeoh", {"c1": "20 kPa"}, ("c1",)),
    "I2": ("mooney_rivlin", {"c10": "0 kPa", "c01": "20 kPa"}, ("c01",)),
    "I1 and I2": ("mooney_rivlin", {"c10": "20 kPa", "c01": "20 kPa"}, ("c10", "c01")),
    "exponential": ("demiray", {"mu": "40 kPa", "b": 1.0}, ("mu", "b")),
    "cubic": ("yeoh", {"c1": "20 kPa", "c2": "1 kPa", "c3": "1 kPa"}, ("c1", "c2", "c3")),
}


# Moduli begin at these multiples of those, one after the other, until a fit settles.
STARTS = (1.0, 4.0, 0.25)


@dataclass(frozen=True)
class Candidate:
    """A law that was fitted to a measurement.

    Attributes:
        law: with its constants.
        fitted: the fit.
        log_evidence: of the law.
        adequate: whether nothing is left but noise.
        shear: initial shear modulus, Pa, and its standard error.
        poisson: Poisson's ratio and its standard error.
    """

    law: Law
    fitted: Fit
    log_evidence: float
    adequate: bool
    shear: tuple[float, float]
    poisson: tuple[float, float]


def answer(scene: Scene, measured: Measurement) -> tuple[dict[str, Candidate], dict[str, float]]:
    """Every law fitted to a measurement, and its probability, by what it is made of."""
    found = {name: candidate(scene, measured, *law) for name, law in LAWS.items()}
    logs = np.array([one.log_evidence for one in found.values()])
    weights = np.exp(logs - logs.max())
    return found, dict(zip(found, map(float, weights / weights.sum()), strict=True))


def candidate(
    scene: Scene, measured: Measurement, name: str, values: dict[str, Any], constants: tuple[str, ...]
) -> Candidate:
    """A law fitted to a measurement, with default uncertainties of all else; begun elsewhere where a fit does not settle."""
    for factor in STARTS:
        begun = {key: scaled(value, factor) for key, value in values.items()}
        material = Material(name, {**begun, "poisson": 0.2}, volumetric=scene.material.volumetric)
        predictor = Predictor(replace(scene, material=material), measured, MPI.COMM_SELF)
        found = settled(predictor, (*constants, "poisson"))
        if found.settled or factor == STARTS[-1]:
            break
        predictor.destroy()
    # Forces are compared in lengths, whose unit depends on the law: of data in units of their noise all laws speak alike.
    log = weighed(found.state, Model.of(predictor.scene), found.jacobian).plain + float(
        np.log(predictor.data.sigma).sum()
    )
    adequate, law = judge(found.state).adequate, found.state.model.law
    predictor.destroy()
    shear = float(law.shear(law.complete(found.state.model.values)))
    poisson = found.values["poisson"], found.stderr["poisson"]
    return Candidate(law, found, log, adequate, (shear, shear_error(law, found)), poisson)


def scaled(value: Any, factor: float) -> Any:
    """A modulus times a factor; other constants as they are."""
    number, *unit = str(value).split()
    return f"{factor * float(number):g} {unit[0]}" if unit else value


def settled(predictor: Predictor, free: tuple[str, ...]) -> Fit:
    """The constants of a law, and the error of the mesh that goes with them."""
    found = fit(State.of(predictor, Model.of(predictor.scene), frozenset()), free)
    return fit(found.state.with_own_errors(anew=True), free, like=found)


def shear_error(law: Law, found: Fit) -> float:
    """Standard error of the initial shear modulus, which constants make up together, Pa."""
    numbers = law.complete(found.state.model.values)
    slopes = []
    for name in found.state.free:
        step = 1e-4 * (abs(numbers[name]) or 1.0)
        high, low = ({**numbers, name: numbers[name] + sign * step} for sign in (1, -1))
        slopes.append((law.shear(high) - law.shear(low)) / (2 * step))
    return float(np.sqrt(np.array(slopes) @ found.covariance @ np.array(slopes)))


def plates(folder: Path | None) -> Iterator[tuple[str, Measurement]]:
    """Names and measurements: those that come with bcid, or all of a folder."""
    if folder is None:
        yield from ((name, Measurement.read(HERE / f"measurements/plate-{name}")) for name in SHIPPED)
        return
    for law in ("NeoHooke", "MooneyRivlin", "Blatz", "Demiray"):
        for noise in NOISES:
            yield f"{law}_{noise}", in_plane(Measurement.read(folder / f"{law}_{noise}"))


def in_plane(measured: Measurement) -> Measurement:
    """Without what was not seen: the third coordinate, and all but the two reactions."""
    data = measured.data.copy(deep=True)
    data["position"][{"axis": 2}] = np.nan
    data["wrench"][{"component": slice(2, None)}] = np.nan
    return replace(measured, data=data)


def main(folder: Path | None = None) -> dict[str, dict[str, float]]:
    """Names the law of every plate; returns the probabilities of the laws."""
    scene, odds = Scene.read(HERE / "scenes/plate.toml"), {}
    for name, measured in plates(folder):
        found, odds[name] = answer(scene, measured)
        best, *others = sorted(odds[name], key=lambda law: -odds[name][law])
        shear, poisson = (
            uncertain(value, 1.96 * error) for value, error in (np.array(found[best].shear) * 1e-3, found[best].poisson)
        )
        rest = ", ".join(f"{law} {percent(odds[name][law])}" for law in others if odds[name][law] > 0.005)
        print(f"{name}: {best} ({percent(odds[name][best])}; {rest or 'no other'})")
        print(f"  shear modulus {shear} kPa, Poisson's ratio {poisson}")
    return odds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Name the law of plates with a hole.")
    parser.add_argument("folder", nargs="?", type=Path, metavar="FOLDER", help="with the plates (those of bcid)")
    main(parser.parse_args().folder)
