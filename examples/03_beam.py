"""
A silicone beam and its weight
==============================

Find out that a real silicone beam has a weight, how large it is, and what the model lacks besides.

The measurement was published by Dubied, Michelis, Spielberg & Katzschmann, "Sim-to-real for soft robots using
differentiable FEM" (RA-L 2022; github.com/srl-ethz/diffPD_sim2real, MIT): a beam of Dragon Skin 10, clamped at one end, is
released from its support and comes to rest, alone or with 0.51012 N on its upper edge. Only the states of rest under
gravity are used, so that each load case is an action of a single step.

::

    ./dev python examples/03_beam.py
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.base.units import p_value, uncertain
from bcid.forms import effects
from bcid.forms.model import Model, Term
from bcid.forms.simulate import recorded
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.results.diagnosis_words import ranking_lines
from bcid.results.words import ADEQUACY
from bcid.search.answer.adequacy import Adequacy, judge
from bcid.search.answer.output import ranked_effects
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, fitted_beside
from bcid.search.fitting.ranking import Ranking, Row, rank
from bcid.search.fitting.state import State

HERE = Path(__file__).resolve().parent
CLAMPED = frozenset({"clamp"})
# Displacement of the markers tip1, tip2, tip3 from the release to rest, mm, in two runs of each load case.
RUNS = {
    "gravity": (
        ((1.612, -0.353, -6.501), (0.501, -0.371, -6.508), (-0.821, -0.437, -6.37)),
        ((1.584, 0.062, -6.707), (0.609, 0.007, -6.634), (-0.828, -0.058, -6.607)),
    ),
    "load52": (
        ((3.603, 0.571, -17.148), (1.161, 0.69, -17.282), (-3.644, 0.953, -16.466)),
        ((3.621, -0.29, -17.269), (0.672, -0.271, -17.119), (-3.638, -0.195, -16.872)),
    ),
}
LOADS = {"gravity": 0.0, "load52": 0.51012}


@dataclass(frozen=True)
class Found:
    """What comes out.

    Attributes:
        plain: the model without gravity.
        verdict: on it.
        ranking: what it lacks.
        rivals: the most promising of that, fitted.
        weight: the weight fitted, with the published stiffness.
        young: the stiffness fitted, with the known weight.
        clamp: a clamp that gives, fitted beside the weight.
        repeatability: standard deviation of the mean of two runs, m.
        strict: the verdict on the fitted weight when the runs' repeatability is taken for the noise.
        stand: what explains the rest then: a marker that stands above the body.
        stood: it is fitted too.
    """

    plain: State
    verdict: Adequacy
    ranking: Ranking
    rivals: list[FittedHypothesis]
    weight: Fit
    young: Fit
    clamp: Fit
    repeatability: float
    strict: Adequacy
    stand: Row
    stood: Fit


def main() -> Found:
    """The whole job."""
    weighing = Scene.read(HERE / "scenes/beam.toml")
    scene = replace(weighing, effects={})
    measurement, repeatability = states_of_rest(scene)
    predictor = Predictor(scene, measurement, MPI.COMM_SELF)

    plain = State.of(predictor, Model.of(scene), CLAMPED)
    verdict, ranking = judge(plain), rank(plain)
    rivals = fitted_beside(plain, effects.catalogue(), 3)
    show(judged(plain, verdict))
    rows = [row.scaled(1e3) for row in ranked_effects(ranking, rivals, list(scene.patches))]
    show(["", "What it lacks:", *ranking_lines(rows[:6], 1e3 * plain.rms)])
    for rival in rivals:
        apart = 1e3 * (rival.held_out or math.nan)
        print(f"  {rival.effect}: a load case predicted from the other is missed by {apart:.2f} mm")

    # The error of the mesh is that of the plain model, in which the beam is straight, until it is asked again.
    weight = again(again(rivals[0].fitted))
    known = Model.of(weighing)
    young = fit(State.of(predictor, known, CLAMPED), ("young",))
    soft = weight.state.model + Term(effects.effect("soft_anchor"), {"stiffness": 1e8})
    clamp = fit(
        State.of(predictor, soft, CLAMPED, weight.state.errors.mesh), ("gravity.weight", "soft_anchor.stiffness")
    )
    print()
    for name, fitted in (("weight", weight), ("stiffness", young), ("weight and clamp", clamp)):
        values = ", ".join(f"{n} = {uncertain(v, fitted.stderr[n])}" for n, v in fitted.values.items())
        print(f"{name} fitted: {fitted.state.rms * 1e3:.2f} mm, {values}")
        show([f"  {text}" for text in fitted.warnings])

    strict, stand, stood = what_is_left(weight, repeatability)
    return Found(plain, verdict, ranking, rivals, weight, young, clamp, repeatability, strict, stand, stood)


def states_of_rest(scene: Scene) -> tuple[Measurement, float]:
    """The mean of the two runs of each load case, and its standard deviation as their difference tells, m."""
    runs = 1e-3 * np.array(list(RUNS.values()))
    unturned = np.array([[1.0, 0.0, 0.0, 0.0]])
    actions = []
    for number, (name, load) in enumerate(LOADS.items()):
        hung = {"tip_edge": np.array([[0.0, 0.0, -load]])} if load else {}
        actions.append(Action(name, np.array([number]), np.array([0]), "", np.zeros((1, 3)), unturned, hung))
    rng = np.random.default_rng(0)
    measured = recorded(scene, actions, scene.rest + runs.mean(axis=1), 0.0, rng, description="static deflections")
    measured.check(scene)
    return measured, float(np.sqrt(np.mean((runs[:, 0] - runs[:, 1]) ** 2)) / 2)


def again(fitted: Fit) -> Fit:
    """The fit once more with the error of the mesh of the fitted model."""
    state = fitted.state
    return fit(State.of(state.predictor, state.model, CLAMPED), state.free)


def what_is_left(weight: Fit, repeatability: float) -> tuple[Adequacy, Row, Fit]:
    """The two runs agree better than the markers' places are known: judged by that, what is still missing?"""
    state = weight.state
    predictor = Predictor(
        state.predictor.whole, replace(state.predictor.measurement, noise_sigma=repeatability), MPI.COMM_SELF
    )
    strict = fit(State.of(predictor, state.model, CLAMPED), state.free)
    verdict = judge(strict.state)
    print(f"\nJudged by the repeatability of {repeatability * 1e3:.2f} mm:")
    show(judged(strict.state, verdict))
    show(residuals(strict.state))

    own = effects.load(HERE / "effects/marker_stand.py")
    ranking = rank(strict.state, effects.catalogue(own=[own]))
    rows = [row.scaled(1e3) for row in ranked_effects(ranking, [], list(predictor.whole.patches))]
    show(ranking_lines(rows[:4], 1e3 * strict.state.rms))
    stand = next(row for row in ranking.rows if row.effect == own.name)
    model = strict.state.model + stand.term
    free = (*state.free, stand.term.full("height"))
    stood = fit(State.of(predictor, model, CLAMPED, strict.state.errors.mesh), free)
    values = ", ".join(f"{n} = {uncertain(v, stood.stderr[n])}" for n, v in stood.values.items())
    print(f"with {stand.term.label}: {stood.state.rms * 1e3:.2f} mm, {values}")
    show(residuals(stood.state))
    return verdict, stand, stood


def judged(state: State, verdict: Adequacy) -> list[str]:
    """Whether a model is adequate, and by which tests."""
    name, misses = state.model.name, f"misses by {1e3 * state.rms:.3g} mm, noise {1e3 * state.noise:.3g} mm"
    lines = [f"{name}: {ADEQUACY[verdict.told]} ({p_value(verdict.p_value)}); {misses}"]
    return [*lines, *(f"  {one.name:22s} {p_value(one.p_value):12s} {one.text}" for one in verdict.findings)]


def residuals(state: State) -> list[str]:
    """Measured minus predicted, mm."""
    data = state.predictor.data
    table = 1e3 * data.spread(state.residual)
    lines = ["  left, mm:" + "".join(f"{name:>18s}" for name in data.scene.fiducial_names)]
    for action, row in zip(data.actions, table, strict=True):
        lines.append(f"  {action:9s}" + "".join("   " + " ".join(f"{v:+.2f}" for v in marker) for marker in row))
    return lines


def show(lines: list[str]) -> None:
    """Print lines."""
    print("\n".join(lines)) if lines else None


if __name__ == "__main__":
    main()
