"""
Rubber that stiffens
====================

Find out from a tensile test of silicone rubber that it stiffens as it is stretched.

The measurement was published by Marechal et al., "Toward a common framework and database of materials for soft robotics"
(Soft Robotics 2020; github.com/LucMarechal/Soft-Robotics-Materials-Database, ODbL 1.0): Ecoflex 00-30, pulled to failure at
450 mm/min, engineering strain from the crosshead over 33 mm, engineering stress over 6 x 3 mm. Here a bar of that size is
pulled by the known forces, and its end is the fiducial.

::

    ./dev python examples/04_tension.py
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from bcid import Measurement, Scene
from bcid.base.units import uncertain
from bcid.comparison import diagnosis_text
from bcid.comparison.fit import Fit, fit
from bcid.comparison.predictor import Predictor
from bcid.comparison.ranking import Ranking, rank
from bcid.comparison.state import State
from bcid.forms.model import Model
from bcid.forms.simulate import recorded
from bcid.measurement import Action

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


@dataclass(frozen=True)
class Found:
    """What comes out.

    Attributes:
        plain: the stiffness fitted.
        ranking: what the law lacks.
        stiffening: strain stiffening, fitted with the stiffness.
        errors: RMS error of the stress, part of the largest stress: of both, and of the best law of Yeoh.
    """

    plain: Fit
    ranking: Ranking
    stiffening: Fit
    errors: tuple[float, float, float]


def main(curve: Sequence[tuple[float, float]] = CURVE) -> Found:
    """The whole job."""
    scene = Scene.read(HERE / "scenes/bar.toml")
    predictor = Predictor(scene, pulled(scene, curve), MPI.COMM_SELF)
    plain = fit(State.of(predictor, on_rollers(scene), frozenset()), ("young",))
    ranking = rank(plain.state)
    show("the law alone", plain, curve)
    print("\n".join(diagnosis_text.table(ranking, [], plain.state.rms, 1e-3, "mm", 4)))
    # Fibres along the pull would do the same: one pull cannot tell them apart, but the rubber was cast and has none.
    row = next(row for row in ranking.rows if row.effect == "strain_stiffening")
    print(f"as good as {row.effect}: {', '.join(row.confounded_with) or 'nothing'}")
    start = State.of(predictor, plain.state.model + row.term, frozenset(), plain.state.errors.mesh)
    stiffening = fit(start, ("young", row.term.full("c2")))
    show(f"with {row.effect}", stiffening, curve)

    best = yeoh(curve)
    print(f"at best with Yeoh's three constants: stress {100 * best:.2f} %")
    return Found(plain, ranking, stiffening, (error(plain, curve), error(stiffening, curve), best))


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
    main()
