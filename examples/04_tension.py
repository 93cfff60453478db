"""
Rubber that stiffens
====================

Find out from a tensile test of silicone rubber that it stiffens as it is stretched.

The measurement was published by Marechal et al., "Toward a common framework and database of materials for soft robotics"
(Soft Robotics 2020; github.com/LucMarechal/Soft-Robotics-Materials-Database, ODbL 1.0): Ecoflex 00-30, pulled to failure at
450 mm/min, engineering strain from the crosshead over 33 mm, engineering stress over 6 x 3 mm. Here a bar of that size is
pulled by the known forces, and its end is the fiducial. Then it is looked at the other way round: a jaw moves the end, and
feels the force, which tells how stiff the rubber is. With ``--propose`` the energy that the law lacks is looked for among all
that the grammar has without a direction (the rubber was cast), and its stress is compared with the published one.

::

    ./dev python examples/04_tension.py
    ./dev python examples/04_tension.py --propose stiffening.py
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from bcid import Measurement, ProposeOptions, Scene, propose
from bcid.api.results import ProposeResult
from bcid.base.units import uncertain
from bcid.forms.model import Model
from bcid.forms.simulate import recorded, with_wrenches
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.results.diagnosis_words import ranking_lines
from bcid.search.answer.output import ranked_effects
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.ranking import Ranking, rank
from bcid.search.fitting.state import State

HERE = Path(__file__).resolve().parent
# Engineering strain, and engineering stress, kPa.
CURVE = (
    (0.18181, 6.82),
    (0.31818, 11.16),
    (0.45455, 15.24),
    (0.59091, 19.09),
    (0.72727, 22.93),
    (0.86363, 25.96),
    (0.99999, 29.72),
    (1.13636, 32.08),
    (1.27272, 35.03),
    (1.40909, 38.55),
    (1.54545, 41.49),
    (1.68182, 44.12),
    (1.81818, 47.97),
    (1.95455, 51.23),
)
LENGTH, AREA = 0.033, 0.006 * 0.003
# Of a stretch where rubber does not stiffen yet; noise of a force (N) and a torque (N m).
SMALL, LOAD_CELL, TORQUE = 1.5, 2e-3, 1e-4


@dataclass(frozen=True)
class Found:
    """What comes out.

    Attributes:
        plain: the stiffness fitted.
        ranking: what the law lacks.
        stiffening: strain stiffening, fitted with the stiffness.
        errors: RMS error of the stress, part of the largest stress: of both, and of the best law of Yeoh.
        young: as the force on a jaw tells it up to a stretch of `SMALL`, and its standard error, Pa.
    """

    plain: Fit
    ranking: Ranking
    stiffening: Fit
    errors: tuple[float, float, float]
    young: tuple[float, float]


def main(curve: Sequence[tuple[float, float]] = CURVE) -> Found:
    """The whole job."""
    scene = Scene.read(HERE / "scenes/bar.toml")
    predictor = Predictor(scene, pulled(scene, curve), MPI.COMM_SELF)
    plain = fit(State.of(predictor, on_rollers(scene), frozenset()), ("young",))
    ranking = rank(plain.state)
    show("the law alone", plain, curve)
    rows = [row.scaled(1e3) for row in ranked_effects(ranking, [], [])]
    print("\n".join(ranking_lines(rows[:4], 1e3 * plain.state.rms)))
    # Fibres along the pull would do the same: one pull cannot tell them apart, but the rubber was cast and has none.
    row = next(row for row in ranking.rows if row.effect == "strain_stiffening")
    print(f"as good as {row.effect}: {', '.join(row.confounded_with) or 'nothing'}")
    start = State.of(predictor, plain.state.model + row.term, frozenset(), plain.state.errors.mesh)
    stiffening = fit(start, ("young", row.term.full("c2")))
    show(f"with {row.effect}", stiffening, curve)

    best = yeoh(curve)
    print(f"at best with Yeoh's three constants: stress {100 * best:.2f} %")
    young = by_jaw(scene, [point for point in curve if 1 + point[0] < SMALL])
    print(f"by the force of a jaw up to a stretch of {SMALL:g}: young = {uncertain(*young)} Pa")
    return Found(plain, ranking, stiffening, (error(plain, curve), error(stiffening, curve), best), young)


def proposed(
    curve: Sequence[tuple[float, float]] = CURVE, name: str = "stiffening"
) -> tuple[ProposeResult, NDArray[np.float64], NDArray[np.float64]]:
    """The energy that is proposed, and stress over the published one at each strain, of the law alone and with it, less one."""
    scene = Scene.read(HERE / "scenes/bar.toml")
    measurement = pulled(scene, curve)
    found = propose(
        scene, measurement, options=ProposeOptions(max_effects=1, kinds=("energy",)), model=on_rollers(scene), name=name
    )
    print(found.headline)
    plain, last = (stress_error(model, curve) for model in predicted_strains(found))
    print("strain  " + " ".join(f"{100 * strain:6.0f} %" for strain, _ in curve))
    print("alone   " + " ".join(f"{100 * part:+6.1f} %" for part in plain))
    print("with it " + " ".join(f"{100 * part:+6.1f} %" for part in last))
    return found, plain, last


def predicted_strains(found: ProposeResult) -> list[NDArray[np.float64]]:
    """Strain at each stress, of the model that was begun with and of the last."""
    seen = found.documents["residuals.nc"].sel(axis="x").isel(fiducial=0)
    return [(seen[name] - seen["rest"]).to_numpy() / LENGTH for name in ("predicted_first", "predicted")]


def stress_error(strain: NDArray[np.float64], curve: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """By what part the stress of a model misses the published one, at each of its strains.

    The model is loaded by that stress: that at a strain in between is read off the curve through what it does.
    """
    published, stress = np.vstack([(0.0, 0.0), curve]).T
    return np.asarray(PchipInterpolator(strain, stress)(published)[1:] / stress[1:] - 1)


def by_jaw(scene: Scene, curve: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Young's modulus and its standard error, Pa: the jaw moves as the strain says, and feels the force."""
    strain, stress = np.vstack([(0.0, 0.0), curve]).T
    steps, unturned = np.arange(len(strain)), np.tile([1.0, 0.0, 0.0, 0.0], (len(strain), 1))
    path = LENGTH * strain[:, None] * [1.0, 0.0, 0.0]
    action = Action("1", steps, steps, "jaw", path, unturned)
    seen = recorded(scene, [action], scene.rest + path[:, None], scene.noise_sigma or 0.0, np.random.default_rng(0))
    force = np.zeros((len(steps), 6))
    force[:, 0] = 1e3 * AREA * stress
    felt = replace(
        with_wrenches(seen, force, 0.0, np.random.default_rng(0)), wrench_sigma=LOAD_CELL, torque_sigma=TORQUE
    )
    predictor = Predictor(scene, felt, MPI.COMM_SELF)
    state = State.of(predictor, Model.of(scene), frozenset({"start"}))
    told = Fit.at(state).stiffness
    # Once more about what was found: a force is no straight line in its nuisances.
    again = State.of(predictor, state.model.with_values(told.values if told else {}), state.anchors)
    found = Fit.at(again).stiffness
    assert found is not None
    return found.values["young"], found.stderr * found.constants["young"]


def on_rollers(scene: Scene) -> Model:
    """The scene's law in a bar that is stretched evenly."""
    return replace(Model.of(scene), rollers=(("start", 0), ("bottom", 1), ("back", 2)))


def pulled(scene: Scene, curve: Sequence[tuple[float, float]]) -> Measurement:
    """The bar at rest and under each of the forces."""
    strain, stress = np.vstack([(0.0, 0.0), curve]).T
    steps = np.arange(len(strain))
    along = np.array([1.0, 0.0, 0.0])
    unturned = np.tile([1.0, 0.0, 0.0, 0.0], (len(steps), 1))
    force = {"end": 1e3 * AREA * stress[:, None] * along}
    action = Action("1", steps, steps, "", np.zeros((len(steps), 3)), unturned, force)
    positions = scene.rest + LENGTH * strain[:, None, None] * along
    # Nobody measured across.
    positions[:, :, 1:] = np.nan
    return recorded(scene, [action], positions, 0.0, np.random.default_rng(0), description="tensile test")


def terms(strain: NDArray[np.float64]) -> NDArray[np.float64]:
    """Engineering stress in tension per unit of Yeoh's c1, c2 and c3, shape (n, 3): 2 (s - s^-2) dpsi/dI1 at the stretch s."""
    stretch = 1 + strain
    excess = stretch**2 + 2 / stretch - 3
    return np.asarray(2 * (stretch - stretch**-2)[:, None] * excess[:, None] ** np.arange(3) * np.arange(1, 4))


def error(fitted: Fit, curve: Sequence[tuple[float, float]]) -> float:
    """RMS error of the stress of a fitted model, part of the largest stress."""
    numbers = fitted.state.model.constants()
    strain, measured = np.array(curve).T
    predicted = terms(strain) @ [numbers["young"] / 6, numbers.get("strain_stiffening.c2", 0.0), 0.0]
    return float(np.sqrt(np.mean((1e-3 * predicted - measured) ** 2)) / measured.max())


def yeoh(curve: Sequence[tuple[float, float]]) -> float:
    """The same of the law of Yeoh that is best for the stress."""
    strain, measured = np.array(curve).T
    left = measured - terms(strain) @ np.linalg.lstsq(terms(strain), measured, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)) / measured.max())


def show(what: str, fitted: Fit, curve: Sequence[tuple[float, float]]) -> None:
    """A fit in one line."""
    values = ", ".join(f"{n} = {uncertain(v, fitted.stderr[n])} Pa" for n, v in fitted.values.items())
    print(f"{what}: {values}; stress {100 * error(fitted, curve):.2f} %, end {1e3 * fitted.state.rms:.2f} mm off")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--propose", type=Path, metavar="FILE", help="look for the energy that the law lacks; its file")
    chosen = parser.parse_args()
    if chosen.propose is None:
        main()
    else:
        energy = proposed(name=chosen.propose.stem)[0]
        for text in energy.files.values():
            chosen.propose.write_text(text, encoding="utf-8")
