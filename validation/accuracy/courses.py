"""Effects whose amounts change with time, hidden in measurements of a finer mesh: fitted with constant amounts, and in time.

./dev python -m validation.accuracy.courses        (three effects; half a minute)

A slab is pulled twice by 6 mm in 16 frames, a second apart, with a noise of 0.2 mm. It is measured on a mesh of 12 mm and compared
on one of 75 mm, which 25 mm say the error of.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from bcid import Measurement, Scene
from bcid.forms import effects
from bcid.forms.course import course_of, in_time
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.simulate import simulate
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.results.words import ADEQUACY
from bcid.scene import Level
from bcid.scene.uncertainty import Uncertainty
from bcid.search.answer.diagnosis import Diagnosis, refitted
from bcid.search.answer.source import Source
from bcid.search.fitting.courses import knots
from bcid.search.fitting.variants import neutral_values

Array = NDArray[np.float64]
SCENE = Path(__file__).resolve().parents[2] / "examples/scenes/slab.toml"
FRAMES, NOISE, ANCHORS, KNOTS = 16, 2e-4, frozenset("13"), 6
_NONE = (0.0,) * KNOTS
# Amounts at six knots, and shapes.
HIDDEN: dict[str, tuple[dict[str, tuple[float, ...]], dict[str, float]]] = {
    "active_stress": ({"amplitude": (0.0, 300.0, 200.0, -300.0, -250.0, 100.0)}, {"angle": 30.0}),
    "grasp_slip": ({"lag": (0.0, 0.12, 0.24, 0.36, 0.48, 0.6)}, {}),
    "camera_offset": (
        {"tx": tuple(1e-3 * t for t in (0.0, 0.4, 0.8, 1.2, 1.6, 2.0)), "ry": (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)}
        | dict.fromkeys(("rx", "rz", "ty", "tz"), _NONE)
        | {"scale": (1.0,) * KNOTS},
        {},
    ),
}


@dataclass(frozen=True)
class Case:
    """A hidden course, and what was measured.

    Attributes:
        scene, measurement: as they are given to whoever looks for it.
        effect: with constant amounts.
        values: the true ones, by parameter of the effect in time.
    """

    scene: Scene
    measurement: Measurement
    effect: Effect
    values: dict[str, float]

    @classmethod
    def of(cls, name: str) -> Case:
        """One of `HIDDEN`."""
        scene = Scene.read(SCENE, physics=check_physics)
        levels = (Level(2, 0.05), Level(2, 0.025), Level(2, 0.012))
        scene = replace(scene, levels=levels, noise_sigma=NOISE, uncertainty=Uncertainty.none())
        amounts, shapes = HIDDEN[name]
        effect = effects.effect(name)
        values = shapes | {f"{key}_{k + 1}": v for key, row in amounts.items() for k, v in enumerate(row)}
        true = Term(in_time(effect, [float(frame) for frame in np.linspace(0, FRAMES - 1, KNOTS)]), values)
        measurement = simulate(scene, ANCHORS, [twice()], model=Model.of(scene) + true, random_state=1)
        return cls(scene, measurement, effect, values)

    def fitted(self, effect: Effect) -> Diagnosis:
        """The plain model with an effect, begun with nothing of it."""
        model = Model.of(self.scene)
        source = Source(SCENE, Path("hidden"), self.scene, self.measurement, model, ANCHORS)
        predictor = Predictor(self.scene, self.measurement, MPI.COMM_SELF, level=1)
        try:
            return refitted(predictor, source, [Term(effect, neutral_values(model, effect))])
        finally:
            predictor.destroy()

    def in_time(self) -> Effect:
        """The effect with a course over the measurement."""
        return in_time(self.effect, knots(self.measurement, KNOTS))


def twice() -> Action:
    """There, back and there again."""
    steps = np.arange(FRAMES)
    part = np.sin(2.5 * np.pi * steps / (FRAMES - 1)) ** 2
    way = 0.006 * part[:, None] * np.array([1.0, 0.3, 0.0])
    return Action("1", steps, steps, "I", way, np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1)))


def missed(case: Case, done: Diagnosis) -> Array:
    """By how many standard errors each fitted value of an effect in time misses the true one."""
    last = done.rungs[-1].fitted
    prefix = f"{last.state.model.terms[-1].label}."
    names = [name for name in last.values if name.startswith(prefix)]
    true = np.array([case.values[name.removeprefix(prefix)] for name in names])
    return (np.array([last.values[n] for n in names]) - true) / np.array([last.stderr[n] for n in names])


def rows() -> Iterator[str]:
    """Lines of the table."""
    yield f"{'effect':16s} {'amounts':10s} {'numbers':>7s} {'residual':>9s} {'p':>8s}  {'adequate':12s} misses (standard errors)"
    for name in HIDDEN:
        case = Case.of(name)
        for effect in (case.effect, case.in_time()):
            done = case.fitted(effect)
            last = done.rungs[-1]
            kind = "in time" if course_of(effect) else "constant"
            off = np.abs(missed(case, done)) if course_of(effect) else np.array([])
            told = f"most {off.max():.1f}, RMS {np.sqrt(np.mean(off**2)):.1f}" if len(off) else ""
            yield (
                f"{name:16s} {kind:10s} {len(last.fitted.coordinates):7d} {1e3 * last.state.rms:6.3f} mm "
                f"{last.adequacy.p_value:8.2g}  {ADEQUACY[last.adequacy.told]:12s} {told}"
            )


if __name__ == "__main__":
    for row in rows():
        print(row, flush=True)
