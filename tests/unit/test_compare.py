"""The parts of a comparison, on made-up residuals and on models that are linear in their numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from bcid.base.progress import Progress, Silent
from bcid.forms import effect_trial as trial
from bcid.forms import effects
from bcid.forms.effects.effect import BodyEffect
from bcid.forms.model import Model, Term
from bcid.forms.probes import Sensitivities, SensitivityRequest
from bcid.forms.scene_errors import law_form_term
from bcid.forms.simulate import recorded
from bcid.inference.data import Data, estimate_noise, frame_times
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.mesh_error import MeshError
from bcid.inference.nuisances import NuisanceModes, Nuisances, placed, replaced
from bcid.inference.priors import PRIORS
from bcid.measurement import Action, Measurement
from bcid.measurement.frame_error import FrameError
from bcid.predict.kept_predictions import MeasurementPrediction
from bcid.report.text import amount
from bcid.results.common_rows import ParameterRow
from bcid.scene import Scene
from bcid.scene.uncertainty import Uncertainty
from bcid.search.answer.adequacy import breaking, judge
from bcid.search.answer.explanation import explains
from bcid.search.answer.law_form import LawForm
from bcid.search.fitting.fit import Coordinate, Fit, _covariance, _loose, fit
from bcid.search.fitting.held_out import held_out
from bcid.search.fitting.parameter_priors import _width, of_state
from bcid.search.fitting.ranking import _bounded, rank
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant, _harmonics, _large

Array = NDArray[np.float64]
SCENE = trial.scene()
SIGMA = 0.2e-3
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


def actions(count: int = 3, steps: int = 8) -> list[Action]:
    """Straight pulls."""
    number = np.arange(steps)
    ways = np.eye(3)[np.arange(count) % 3] * 1e-3
    turns = np.tile(UNTURNED, (steps, 1))
    return [
        Action(str(i + 1), i * steps + number, number, "gripper", number[:, None] * way, turns)
        for i, way in enumerate(ways)
    ]


def rest(made: list[Action]) -> Array:
    """Fiducials that do not move."""
    return np.tile(SCENE.rest, (sum(map(len, made)), 1, 1))


def data_of(positions: Array, made: list[Action], sigma: float | None = SIGMA) -> Data:
    measurement = recorded(SCENE, made, positions, 0.0, np.random.default_rng(0))
    return Data(SCENE, replace(measurement, noise_sigma=sigma))


def mesh_error(made: list[Action], at_rest: float = 0.0) -> MeshError:
    """An error of the mesh that grows along every action, from one at rest."""
    rng = np.random.default_rng(5)
    left = np.concatenate([np.linspace(0, 1, len(a))[:, None, None] * rng.normal(size=(1, 4, 3)) for a in made])
    return MeshError(np.zeros_like(left), 0.5e-3 * left + at_rest * rng.normal(size=(4, 3)), True)


def explicit(errors: ErrorCovariance) -> Array:
    """The covariance of a residual, as a full matrix."""
    left = errors.mesh.left
    before = errors.data.vector(np.broadcast_to(left[0], left.shape))
    parts = errors.data.vector(left) - before, before
    single = np.zeros((len(errors.data), len(errors.data)))
    for rows, columns in errors._of_fiducials(*parts):
        single[np.ix_(rows, rows)] = columns @ columns.T
    common = np.hstack([errors._of_actions(*parts), errors._of_frame(), errors.nuisances.common])
    return np.asarray(np.diag(errors.sigma**2) + single + common @ common.T)


def modes(data: Data) -> NuisanceModes:
    """Markers that are 0.4 mm off, and two other nuisances."""
    rng = np.random.default_rng(8)
    markers, common = (0.4e-3 * rng.normal(size=(len(data), count)) for count in (3, 3))
    return NuisanceModes(
        markers, common, ("grip", "grip", "poisson"), {"markers": 0.4e-3, "grip": 0.3e-3, "poisson": 0.03}
    )


# -- data
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at_rest", [0.0, 1e-3])
def test_whitening_is_a_root_of_the_inverse_covariance(at_rest: float) -> None:
    made = actions()
    data = data_of(rest(made), made)
    data.measurement = replace(data.measurement, frame_error=FrameError(SCENE.rest.mean(axis=0), 1e-6 * np.eye(7)))
    sigma = np.random.default_rng(1).uniform(0.5, 2.0, len(data)) * SIGMA
    errors = ErrorCovariance(data, sigma, mesh_error(made, at_rest), modes(data))
    covariance = explicit(errors) / np.outer(sigma, sigma)
    root = errors.whiten(np.diag(sigma))
    assert root.T @ root == pytest.approx(np.linalg.inv(covariance), abs=1e-8)
    some = np.random.default_rng(2).normal(size=len(data)) * SIGMA
    assert errors.whiten(some) == pytest.approx(root @ (some / sigma), abs=1e-9)
    assert errors.unwhiten(errors.whiten(some)) == pytest.approx(some, rel=1e-6)
    assert errors.log_volume == pytest.approx(np.log(sigma).sum() + np.linalg.slogdet(covariance)[1] / 2)
    drawn = multivariate_normal(cov=explicit(errors), allow_singular=False).logpdf(some)
    assert errors.log_likelihood(some) == pytest.approx(drawn + len(data) / 2 * math.log(2 * math.pi), rel=1e-6)


def test_nuisances_are_told_from_what_they_do() -> None:
    """The means given the data are those of the full Gaussian algebra, and a large one is seen."""
    made = actions()
    data = data_of(rest(made), made)
    found = modes(data)
    errors = ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape), found)
    noise = np.random.default_rng(9).normal(0, SIGMA, len(data))
    residual = noise + 5.0 * found.common[:, 2]
    means = found.common.T @ np.linalg.solve(explicit(errors), residual)
    told = {one.name: one for one in errors.told(residual)}
    assert told["poisson"].found == pytest.approx(0.03 * abs(means[2]))
    assert told["poisson"].most == pytest.approx(5.0, rel=0.1)
    assert told["grip"].found == pytest.approx(0.3e-3 * math.sqrt(float(np.mean(means[:2] ** 2))))
    assert told["markers"].count == 3 * len(SCENE.fiducials)
    # What no nuisance explains is noise.
    assert np.sqrt(np.mean(errors.rough(residual) ** 2)) == pytest.approx(SIGMA, rel=0.2)


def test_what_is_fitted_is_not_integrated_over() -> None:
    made = actions()
    data = data_of(rest(made), made)
    errors = ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape), modes(data))
    less = errors.without(("poisson", "gravity.weight"))
    assert less.nuisances.names == ("grip", "grip")
    assert set(less.nuisances.sizes) == {"markers", "grip"}
    assert less.log_volume < errors.log_volume
    assert errors.without(("gravity.weight",)) is errors


def test_a_camera_may_be_turned_where_only_one_axis_is_seen() -> None:
    """The rest of a position is where the body is at rest; nothing turns out as no number."""
    made = actions()
    positions = rest(made)
    positions[:, :, 1:] = np.nan
    data = data_of(positions, made)
    assert data.about[..., 1:] == pytest.approx(np.broadcast_to(SCENE.rest, positions.shape)[..., 1:])
    turned = ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape), camera_modes(data))
    assert turned.nuisances.names == ("camera",) * turned.nuisances.common.shape[1]
    away = SCENE.rest - data.about.reshape(-1, 3).mean(axis=0)
    # To first order x changes by z times the turn about y, and by y times the one about z.
    moved = np.radians(0.2) * np.linalg.norm(away[data.fiducial][:, 1:], axis=1)
    assert np.linalg.norm(turned.nuisances.common, axis=1) == pytest.approx(moved, rel=1e-6)


def camera_modes(data: Data) -> NuisanceModes:
    """Those of a scene in which only the camera's directions are not known."""
    nuisances = Nuisances(replace(SCENE, uncertainty=replace(Uncertainty.none(), camera=None)), trial.box())
    return nuisances.modes(data, Sensitivities([], {}), SensitivityRequest())


def test_where_a_fiducial_sits_is_known_where_an_effect_says_it() -> None:
    """A fault of all frames and another place on the body could cancel at rest, and the rest would pass for strain."""
    made = actions()
    data = data_of(rest(made), made)
    name = SCENE.fiducial_names[1]
    offset = {"x": 1e-3, "y": 0.0, "z": 0.0}
    always = Model.of(SCENE) + Term("marker_fault", offset | {"onset": 0.0}, place=name)
    later = Model.of(SCENE) + Term("marker_fault", offset | {"onset": 5.0}, place=name)
    assert placed(always) == {name}
    assert not placed(later)
    errors = ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape), modes(data)).without(
        (), placed(always)
    )
    known = data.fiducial == 1
    assert not errors.nuisances.markers[known].any()
    assert errors.nuisances.markers[~known].all()


def test_without_an_error_of_the_mesh_only_the_noise_scales() -> None:
    made = actions()
    data = data_of(rest(made), made)
    errors = ErrorCovariance(data, np.full(len(data), SIGMA), MeshError.unknown(data.mask.shape))
    assert errors.whiten(np.full(len(data), SIGMA)) == pytest.approx(np.ones(len(data)))


def test_at_rest_the_mesh_has_the_same_wrong_in_all_actions() -> None:
    """As where a weight acts: it is uncertain once for each fiducial, and not anew with every pull."""
    made = actions(2)
    data = data_of(rest(made), made)
    left = np.broadcast_to(1e-3 * np.ones(3), data.mask.shape)
    errors = ErrorCovariance(data, data.sigma, MeshError(np.zeros(data.mask.shape), left, True))
    same = np.where((data.fiducial == 1) & (data.axis == 0), 1e-3, 0.0)
    other = np.where(data.action == 0, same, -same)
    assert np.sum(errors.whiten(same) ** 2) < 1
    assert errors.whiten(other) == pytest.approx(other / data.sigma, rel=1e-6)
    assert errors.mesh_rms == pytest.approx(1e-3)


def test_of_the_error_of_the_mesh_counts_what_is_compared() -> None:
    """Where a body buckles, and nothing is compared, two meshes may go apart by any distance."""
    made = actions()
    positions = rest(made)
    positions[5:8] = np.nan
    data, mesh = data_of(positions, made), mesh_error(made)
    left = mesh.left.copy()
    left[5:8] = 1.0
    sigma = np.full(len(data), SIGMA)
    known, apart = (ErrorCovariance(data, sigma, replace(mesh, left=some)) for some in (mesh.left, left))
    assert apart.mesh_rms == known.mesh_rms < 1e-3


def test_an_error_of_the_measured_frame_is_shared_by_all_positions() -> None:
    """A residual that is a turn of the frame of one standard deviation is one surprise, not one for each value."""
    made = actions()
    spread = np.zeros((7, 7))
    spread[1, 1] = 0.05**2
    error = FrameError(SCENE.rest.mean(axis=0), spread)
    measurement = replace(recorded(SCENE, made, rest(made), 0.0, np.random.default_rng(0)), noise_sigma=SIGMA)
    data = Data(SCENE, replace(measurement, frame_error=error))
    errors = ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape))
    turn = error.modes(rest(made))[..., 0][data.mask]
    assert np.abs(turn).max() > 3 * SIGMA
    assert np.sum(errors.whiten(turn) ** 2) == pytest.approx(1.0, abs=0.02)
    assert np.sum((turn / SIGMA) ** 2) > 50
    # What is not a turn costs as much as ever.
    other = np.where(data.axis == 1, SIGMA, 0.0)
    assert np.sum(errors.whiten(other) ** 2) == pytest.approx(np.sum(data.axis == 1), rel=1e-6)
    scaled = np.diag(np.ones(len(data))) + np.outer(turn, turn) / SIGMA**2
    assert errors.log_volume == pytest.approx(len(data) * np.log(SIGMA) + np.linalg.slogdet(scaled)[1] / 2)


def test_noise_is_seen_under_a_smooth_residual() -> None:
    made = actions(steps=40)
    data = data_of(rest(made), made, None)
    smooth = 2e-3 * np.sin(data.step / 15 + data.trajectory)
    noise = np.random.default_rng(3).normal(0, SIGMA, len(data))
    assert estimate_noise(data, smooth + noise) == pytest.approx(SIGMA, rel=0.05)
    # Two steps say nothing of what is smooth.
    short = actions(steps=2)
    two = data_of(rest(short), short, None)
    assert estimate_noise(two, np.full(len(two), 1e-3)) == pytest.approx(1e-3)


def test_two_meshes_of_second_order_tell_the_limit() -> None:
    limit, slope = np.random.default_rng(4).normal(size=(2, 5, 4, 3))
    coarse, fine = (limit + slope * size**2 for size in (0.2, 0.1))
    error = MeshError.between(coarse, fine, 3.0)
    assert coarse + error.correction == pytest.approx(limit)
    # What may be left after it is as large as the error of the finer mesh.
    assert np.abs(error.left) == pytest.approx(np.abs(fine - limit))
    assert error.known


# -- adequacy
# ------------------------------------------------------------------------------------------------------------------


@dataclass
class Toy:
    """Stands for a predictor: what is seen is rest plus each number times a shape."""

    data: Data
    actions: list[Action]
    shapes: Mapping[str, Array]
    left_out: tuple[str, ...] = ()
    progress: Progress = field(default_factory=Silent)
    fails: str = ""
    power: float = 1.0

    def skip(self, text: str) -> None:
        raise AssertionError(f"nothing fails here: {text}")

    @property
    def scene(self) -> Scene:
        return SCENE

    whole = scene

    @property
    def measurement(self) -> Measurement:
        return self.data.measurement

    @property
    def times(self) -> Array:
        return frame_times(self.actions, len(self.data.mask))

    def numbers(self, model: Model) -> dict[str, float]:
        values = model.constants()
        return {k: 1 / values[k] if k.endswith("stiffness") else values[k] ** self.power for k in self.shapes}

    def predict(
        self,
        model: Model,
        _anchors: Iterable[str],
        actions: Iterable[Action] | None = None,
        keep: bool = False,
    ) -> MeasurementPrediction:
        positions = rest(self.actions) + sum(n * self.shapes[k] for k, n in self.numbers(model).items())
        seen = np.full_like(positions, np.nan)
        for action in self.actions if actions is None else actions:
            seen[action.frames] = positions[action.frames]
        failed = self.fails in [action.name for action in actions or self.actions]
        return MeasurementPrediction(seen, {}, "it buckles" if failed else "")

    def sensitivities(
        self, model: Model, _anchors: object, _reply: MeasurementPrediction, wanted: SensitivityRequest
    ) -> Sensitivities:
        slopes = {**self.shapes}
        if self.power != 1.0:
            slopes = {k: s * self.power * model.constants()[k] ** (self.power - 1) for k, s in self.shapes.items()}
        return Sensitivities([{n: slopes[p.term.full(n)] for n in p.wanted} for p in wanted.probes], {})


def state_of(toy: Toy, model: Model, mesh: MeshError | None = None) -> State:
    errors = ErrorCovariance(toy.data, toy.data.sigma, mesh or MeshError.unknown(toy.data.mask.shape))
    whole: Any = toy
    return State(
        whole,
        model,
        frozenset({"left"}),
        toy.predict(model, ()),
        errors,
        np.zeros((len(toy.data), 1)),
        np.zeros((len(toy.data), 0, 3)),
    )


@pytest.mark.parametrize("coarse", [False, True])
def test_few_adequate_models_are_called_inadequate(coarse: bool) -> None:
    made = actions()
    mesh = mesh_error(made) if coarse else None
    data = data_of(rest(made), made)
    state = state_of(Toy(data, made, {}), Model.of(SCENE), mesh)
    root = np.linalg.cholesky(explicit(state.errors))
    rng = np.random.default_rng(6)
    alarms = 0
    for _ in range(200):
        data.values = data.vector(rest(made)) + root @ rng.normal(size=len(data))
        alarms += not judge(replace(state)).adequate
    # Three tests together may raise 5 %; as they overlap, it is a little less.
    assert 0.02 <= alarms / 200 <= 0.08


def test_what_a_fiducial_misses_in_all_actions_is_an_alarm() -> None:
    made = actions()
    data = data_of(rest(made), made)
    state = state_of(Toy(data, made, {}), Model.of(SCENE))
    noise = np.random.default_rng(7).normal(0, SIGMA, len(data))
    data.values = data.vector(rest(made)) + noise + np.where((data.fiducial == 1) & (data.axis == 2), SIGMA, 0.0)
    adequacy = judge(state)
    assert not adequacy.adequate
    assert min(adequacy.findings[:3], key=lambda f: f.p_value).name == "bias"


@pytest.mark.parametrize("first", [None, 13])
def test_the_frame_from_which_on_nothing_fits_is_found(first: int | None) -> None:
    made = actions()
    data = data_of(rest(made), made)
    state = state_of(Toy(data, made, {}), Model.of(SCENE))
    data.values = data.vector(rest(made)) + np.random.default_rng(13).normal(0, SIGMA, len(data))
    if first is not None:
        data.values += np.where(data.frame >= first, 2 * SIGMA, 0.0)
    found = breaking(state)
    assert (found is None) == (first is None)
    if found is not None and first is not None:
        action, step = divmod(first, len(made[0]))
        assert f"from step {step} of action {action + 1} on" in found.text


# -- ranking
# ------------------------------------------------------------------------------------------------------------------


def test_trigonometric_interpolation_is_exact() -> None:
    given, grid = np.array([0.0, 36.0, 72.0, 108.0, 144.0]), np.arange(0.0, 180.0, 7.0)

    def polynomial(degrees: Array) -> Array:
        twice = 2 * np.deg2rad(degrees)
        return np.asarray(0.3 - np.cos(twice) + 2 * np.sin(twice) * np.cos(twice) + 0.7 * np.cos(twice) ** 2)

    weights = _harmonics(grid, 180.0, 2) @ np.linalg.pinv(_harmonics(given, 180.0, 2))
    assert weights @ polynomial(given) == pytest.approx(polynomial(grid))


def variant(name: str, columns: Array, **values: float) -> Variant:
    one = Term(effects.effect(name), values)
    scales = [Coordinate(one.full(p.name), p, 1 / p.scale if p.reciprocal else p.scale) for p in one.effect.amounts]
    return Variant(one, tuple(scales), columns)


def test_amounts_stay_within_their_bounds() -> None:
    rng = np.random.default_rng(8)
    column, other = rng.normal(size=(2, 50, 1))
    gravity = variant("gravity", column, weight=0.0)
    step, gain = _bounded(gravity, column, 3.0 * column[:, 0])
    assert step == pytest.approx([3.0])
    assert gain == pytest.approx(9 * float(column[:, 0] @ column[:, 0]))
    # A body is not lighter than nothing, and a spring not stiffer than rigid.
    for limited in (gravity, variant("soft_anchor", column, stiffness=math.inf)):
        step, gain = _bounded(limited, column, -3.0 * column[:, 0])
        assert step == pytest.approx([0.0], abs=1e-9)
        assert gain == pytest.approx(0.0, abs=1e-9)
    # Where one amount is at its bound the others are fitted without it.
    both = np.hstack([column, other, np.zeros_like(column)])
    stretched = variant("prestrain", 100 * both, sx=1.0, sy=1.0, sz=1.0)
    upper = next(p.upper for p in stretched.term.effect.parameters if p.name == "sx")
    step, _ = _bounded(stretched, 100 * both, 100 * (5.0 * column + 0.01 * other)[:, 0])
    assert step[0] == pytest.approx(upper - 1.0)
    left = 100 * (5.0 * column + 0.01 * other)[:, 0] - 100 * column[:, 0] * step[0]
    free = float(other[:, 0] @ left / (100 * other[:, 0] @ other[:, 0]))
    bound = next(p for p in stretched.term.effect.parameters if p.name == "sy")
    assert step[1] == pytest.approx(np.clip(free, bound.lower - 1, bound.upper - 1))


# -- fit
# ------------------------------------------------------------------------------------------------------------------


def test_a_direction_that_the_data_do_not_tell_is_infinitely_uncertain() -> None:
    column = np.random.default_rng(9).normal(size=40)
    jacobian = np.column_stack([column, 2 * column, np.roll(column, 7)])
    covariance = _covariance(jacobian, np.array([1.0, 0.5, 1.0]))
    assert covariance[0, 0] > 1e100
    assert covariance[1, 1] > 1e100
    assert covariance[2, 2] < 1
    whole = _covariance(jacobian[:, [0, 2]], np.array([3.0, 0.1]))
    assert whole == pytest.approx(np.linalg.inv(jacobian[:, [0, 2]].T @ jacobian[:, [0, 2]]))


def test_a_large_amount_is_told_though_it_may_be_off_by_more_than_is_notable() -> None:
    """A spring of 25 notable ones, give or take 3.3, is there; one of 5 may be none, and of what is no amount that says nothing."""
    found = _loose(np.array([25.0, 5.0, 5.0, np.nan]), np.array([3.3, 3.3, 2.9, 3.3]))
    assert found.tolist() == [False, True, False, True]


def toy(model: Model, names: tuple[str, ...], sizes: tuple[float, ...]) -> Toy:
    """A linear measurement of these numbers with noise."""
    made = actions()
    rng = np.random.default_rng(10)
    shape = rest(made).shape
    shapes = {name: size * rng.normal(size=shape) for name, size in zip(names, sizes, strict=True)}
    whole = Toy(data_of(rest(made), made), made, shapes)
    positions = whole.predict(model, ()).positions + rng.normal(0, SIGMA, shape)
    return Toy(data_of(positions, made), made, shapes)


def test_a_linear_model_is_fitted_and_predicts_what_it_was_not_fitted_to() -> None:
    model = Model.of(SCENE) + Term(effects.effect("gravity"), {"weight": 6000.0})
    model = model + Term(
        effects.effect("camera_offset"), dict.fromkeys(("rx", "ry", "rz", "tx", "ty", "tz"), 0.0) | {"scale": 1.1}
    )
    names = ("gravity.weight", "camera_offset.scale")
    made = toy(model, names, (1e-7, 5e-3))
    fitted = fit(state_of(made, model.with_values({"gravity.weight": 1000.0, "camera_offset.scale": 1.0})), names)
    table = np.column_stack([made.data.vector(made.shapes[name]) for name in names])
    away = made.data.values - made.data.vector(rest(made.actions))
    assert list(fitted.values.values()) == pytest.approx(np.linalg.lstsq(table, away, rcond=None)[0], rel=1e-3)
    parameters = [next(p for p in term.effect.parameters if term.full(p.name) in names) for term in model.terms]
    pull = np.diag([1 / (PRIORS.widest * p.scale) for p in parameters])
    right = np.append(away / SIGMA, pull @ [p.neutral for p in parameters])
    best = np.linalg.lstsq(np.vstack([table / SIGMA, pull]), right, rcond=None)[0]
    assert list(fitted.values.values()) == pytest.approx(best, rel=1e-7)
    assert list(fitted.stderr.values()) == pytest.approx(
        SIGMA * np.sqrt(np.diag(np.linalg.inv(table.T @ table))), rel=1e-6
    )
    squares = 0.0
    for number in range(3):
        own = made.data.action == number
        without = np.linalg.lstsq(table[~own], away[~own], rcond=None)[0]
        squares += float(np.sum((away - table @ without)[own] ** 2))
    assert held_out(fitted) == pytest.approx(np.sqrt(squares / len(away)), rel=1e-4)
    # What cannot be predicted from the others is not known: the fit to all is no substitute.
    failing = replace(made, fails="2")
    assert held_out(replace(fitted, state=replace(fitted.state, predictor=failing))) is None


def test_an_action_is_fitted_without_in_full_where_a_step_is_not_enough() -> None:
    name, model = "gravity.weight", Model.of(SCENE) + Term(effects.effect("gravity"), {"weight": 6000.0})
    made = toy(model, (name,), (1e-3,))
    # What is seen goes with a high power of the number, of which the first pull tells the most.
    shape = made.shapes[name] * np.where(np.arange(24) < 8, 3.0, 0.05)[:, None, None] / 6000.0**8
    noise = np.random.default_rng(4).normal(0, SIGMA, shape.shape)
    made = Toy(
        data_of(rest(made.actions) + 6000.0**8 * shape + noise, made.actions), made.actions, {name: shape}, power=8.0
    )
    fitted = fit(state_of(made, model), (name,))
    squares, away, column = 0.0, made.data.values - made.data.vector(rest(made.actions)), made.data.vector(shape)
    for number in range(3):
        own = made.data.action == number
        amount = float(column[~own] @ away[~own] / (column[~own] @ column[~own]))
        squares += float(np.sum((away - amount * column)[own] ** 2))
    assert held_out(fitted) == pytest.approx(np.sqrt(squares / len(away)), rel=2e-2)


def law_state(amounts: tuple[float, float]) -> State:
    """A law whose form is off by so many standard deviations, of which two nuisances tell."""
    made = actions()
    data = data_of(rest(made), made)
    common = 1e-3 * np.random.default_rng(12).normal(size=(len(data), 3))
    nuisances = NuisanceModes(np.zeros((len(data), 3)), common, ("law", "law", "grip"), {"law": 0.05, "grip": 1e-3})
    noise = np.random.default_rng(2).normal(0, SIGMA, len(data))
    data.values = data.vector(rest(made)) + common @ [*amounts, 0.7] + noise
    state = state_of(Toy(data, made, {}), Model.of(SCENE))
    return state.with_errors(state.errors.mesh, nuisances)


def test_the_form_of_the_law_is_told_where_it_is_off() -> None:
    form = LawForm.of(Fit.at(law_state((0.0, 1.5))))
    assert form is not None
    assert form.seen
    assert np.abs(form.values / 0.05 - [0.0, 1.5]).max() < 4 * form.stderr.max() / 0.05
    assert form.stderr.max() < 0.05 * 0.03
    second = form.rows()["second_invariant"].to_json()
    assert second["value"] == pytest.approx(0.3, abs=0.01)
    assert second["allowed"] == pytest.approx(0.2)
    assert "The law has another form: 30" in form.text
    assert form.beside(Model.of(SCENE)).terms[-1].values["second"] == form.values[1]
    assert not LawForm(0.0 * form.values, form.stderr, 0.05).seen
    # Where a model says it itself, or the scene is sure of it, nothing is told.
    state = law_state((0.0, 1.5))
    assert LawForm.of(Fit.at(replace(state, errors=state.errors.without(["law"])))) is None


def test_stiffening_takes_the_place_of_the_part_of_the_law_that_it_is() -> None:
    """Of the part that goes with the second invariant it says nothing; and errors of another state leave it so."""
    numbers = (*((law_form_term(), name) for name in ("part", "second")), None)
    known = replace(law_state((0.0, 1.5)).errors.nuisances, numbers=numbers)
    stiffer = Model.of(SCENE) + Term("strain_stiffening", {"c2": 100.0})
    state = law_state((0.0, 1.5))
    state = replace(state, model=stiffer, modes=None).with_errors(state.errors.mesh, known)
    assert np.array_equal(state.replaced, known.common[:, :1])
    again = state.with_errors(state.errors.mesh)
    for one in (state, again, state.with_errors(state.errors.mesh, replace(known, common=2 * known.common))):
        assert one.errors.nuisances.names == ("law", "grip")
        assert set(one.errors.nuisances.sizes) == {"law", "grip"}
        assert one.replaced.shape[1] == 1
    assert np.array_equal(one.replaced, 2 * state.replaced)
    # Without it there are both again.
    plain = replace(again, model=Model.of(SCENE)).with_errors(state.errors.mesh)
    assert plain.errors.nuisances.names == ("law", "law", "grip")
    assert not plain.replaced.size


def test_values_of_nuisances_are_those_given_the_data() -> None:
    """By the covariance of all values, written out; so weak that what was believed before counts."""
    state = law_state((0.0, 1.5))
    nuisances = state.errors.nuisances
    weak = replace(nuisances, common=1e-2 * nuisances.common)
    errors = state.with_errors(state.errors.mesh, weak).errors
    covariance = explicit(errors)
    for name, columns in (("law", weak.common[:, :2]), ("grip", weak.common[:, 2:])):
        means, spread = errors.values(state.residual, name)
        weighed = np.linalg.solve(covariance, columns)
        assert means == pytest.approx(weighed.T @ state.residual, rel=1e-6)
        assert spread == pytest.approx(np.eye(columns.shape[1]) - weighed.T @ columns, rel=1e-6)
    alone = errors.estimate(state.residual, "grip")
    assert alone == pytest.approx((1e-3 * means[0], 1e-3 * math.sqrt(spread[0, 0])))


@pytest.mark.parametrize("coarse", [False, True])
def test_what_others_tell_of_the_scene_is_held_when_an_action_is_predicted(coarse: bool) -> None:
    made = actions()
    data = data_of(rest(made), made)
    state = state_of(Toy(data, made, {}), Model.of(SCENE), mesh_error(made) if coarse else None)
    state = state.with_errors(state.errors.mesh, modes(data))
    covariance = explicit(state.errors)
    data.values = data.vector(rest(made)) + np.random.default_rng(11).multivariate_normal(
        np.zeros(len(data)), covariance
    )
    squares, residual = 0.0, state.residual
    for number in range(3):
        own = data.action == number
        told = covariance[np.ix_(own, ~own)] @ np.linalg.solve(covariance[np.ix_(~own, ~own)], residual[~own])
        squares += float(np.sum((residual[own] - told) ** 2))
    found = held_out(Fit.at(state))
    assert found == pytest.approx(np.sqrt(squares / len(data)), rel=1e-4)
    assert found is not None
    assert found < 0.8 * state.rms


@pytest.mark.parametrize("stiffness", [1e5, 1e8])
def test_a_stiffness_is_fitted_whatever_its_size(stiffness: float) -> None:
    model = Model.of(SCENE) + Term(effects.effect("soft_anchor"), {"stiffness": stiffness})
    made = toy(model, ("soft_anchor.stiffness",), (1e-2 * stiffness,))
    begun = model.with_values({"soft_anchor.stiffness": 0.2 * stiffness})
    fitted = fit(state_of(made, begun), ("soft_anchor.stiffness",))
    assert fitted.values["soft_anchor.stiffness"] == pytest.approx(stiffness, rel=0.01)


class Halving(Toy):
    """Some trajectories take a step in halves, and end a little elsewhere."""

    def numbers(self, model: Model) -> dict[str, float]:
        found = super().numbers(model)
        halved = round(13 * sum(found.values())) % 2
        return {name: value + 0.5 * halved for name, value in found.items()}


def test_what_acts_by_the_step_is_found_though_trajectories_jump_where_one_is_halved() -> None:
    by_step = replace(cast(BodyEffect, effects.effect("support_friction")), uses_past=True)
    model = Model.of(SCENE) + Term(by_step, {"shear_stress": 200.0})
    plain = toy(model, ("support_friction.shear_stress",), (0.3 * SIGMA,))
    jumping = Halving(plain.data, plain.actions, plain.shapes)
    for start in (20.0, 34.0, 60.0):
        begun = model.with_values({"support_friction.shear_stress": start})
        fitted = fit(state_of(jumping, begun), ("support_friction.shear_stress",), most=8)
        assert fitted.values["support_friction.shear_stress"] == pytest.approx(200.0, rel=0.05)


class Ending(Toy):
    """It cannot be followed with more than this weight, N/m^3."""

    most = 3000.0

    def predict(self, model: Model, *more: Any, **named: Any) -> MeasurementPrediction:
        found = super().predict(model, *more, **named)
        return replace(found, failure="it inverts") if model.constants()["gravity.weight"] > self.most else found


def test_a_fit_that_ends_where_nothing_can_be_followed_is_as_uncertain_as_that() -> None:
    model = Model.of(SCENE) + Term(effects.effect("gravity"), {"weight": 6000.0})
    made = toy(model, ("gravity.weight",), (1e-7,))
    free = fit(state_of(made, model.with_values({"gravity.weight": 1000.0})), ("gravity.weight",))
    assert not free.warnings
    assert free.stderr["gravity.weight"] < 1000.0
    ending = Ending(made.data, made.actions, made.shapes)
    found = fit(state_of(ending, model.with_values({"gravity.weight": 1000.0})), ("gravity.weight",))
    assert found.values["gravity.weight"] <= Ending.most
    assert abs(found.values["gravity.weight"] - 6000.0) < 1.1 * found.stderr["gravity.weight"]
    assert found.warnings == ("the fit ended where the model cannot be followed any further",)


@pytest.mark.parametrize("true", [-0.004, -0.0005, -0.03])
def test_a_number_at_a_bound_is_told_by_a_limit(true: float) -> None:
    """Against the density on this side of the bound, summed up."""
    model, name = Model.of(SCENE) + Term("grasp_slip", {"lag": 0.02}), "grasp_slip.lag"
    made = toy(model, (name,), (2e-3,))
    away = made.data.vector(made.shapes[name])
    made.data.values = made.data.values + (true - 0.02) * away
    # What the noise happens to say of it is taken out.
    residual = made.data.values - made.data.vector(rest(made.actions))
    made.data.values = made.data.values + (true - float(away @ residual) / float(away @ away)) * away
    found = fit(state_of(made, model), (name,))
    assert found.values[name] == pytest.approx(0.0, abs=5e-4)
    lags = np.linspace(0.0, 0.1, 100_001)
    residual = made.data.values - made.data.vector(rest(made.actions))
    chi2 = (float(residual @ residual) - 2 * lags * float(away @ residual) + lags**2 * float(away @ away)) / SIGMA**2
    share = np.cumsum(np.exp(-0.5 * (chi2 - chi2.min())))
    assert found.limits[name] == pytest.approx(lags[np.searchsorted(share, 0.95 * share[-1])], rel=0.02, abs=1e-4)
    assert amount("lag", ParameterRow(value=0.0, stderr=0.1, limit=0.25, unit="1")) == "lag at most 0.25 (95 %)"
    assert not fit(state_of(toy(model, (name,), (2e-3,)), model), (name,)).limits
    # A weight of which nothing is seen has no limit either.
    weightless, weight = Model.of(SCENE) + Term("gravity", {"weight": 0.0}), "gravity.weight"
    assert not fit(state_of(toy(weightless, (weight,), (0.0,)), weightless), (weight,)).limits


def test_an_inclusion_stays_in_the_body() -> None:
    """A ball beyond it whose rim reaches in is no inclusion, whatever explains the data best."""
    values = {"ratio": 3.0, "cx": 0.05, "cy": 0.005, "cz": 0.05, "radius": 0.02}
    model = Model.of(SCENE) + Term("inclusion", values)
    names = tuple(f"inclusion.{name}" for name in ("ratio", "cx", "radius"))
    made = toy(model, names, (1e-3, 1e-1, 1e-1))
    away = {"inclusion.ratio": 3.0, "inclusion.cx": -0.06, "inclusion.radius": 0.11}
    made.data.values = made.data.vector(made.predict(model.with_values(away), ()).positions)
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.01, 0.1]])
    mesh = SimpleNamespace(mesh=SimpleNamespace(points=corners))
    whole: Any = made
    whole.forward = lambda _model: mesh
    found = fit(state_of(made, model), names)
    assert 0.0 <= found.values["inclusion.cx"] < 1e-3
    assert found.values["inclusion.radius"] <= np.linalg.norm(corners[1]) / 2
    known = of_state(found.state, Model.of(SCENE), found.jacobian)
    assert known is not None
    assert known.widths[0, 1:] == pytest.approx([0.1 / math.sqrt(12), np.linalg.norm(corners[1]) / 2 / math.sqrt(12)])


class Relaxing(Toy):
    """Of a viscosity it shows the square."""

    def predict(self, model: Model, *more: Any, **named: Any) -> MeasurementPrediction:
        found = super().predict(model, *more, **named)
        fraction = model.constants().get("viscosity.fraction", 0.0)
        return replace(found, positions=found.positions + 0.01 * fraction**2)


@pytest.mark.parametrize(("shown", "tried"), [(0.01, True), (1.0, False)])
def test_large_amounts_are_tried_where_small_ones_show_nothing(shown: float, tried: bool) -> None:
    """What they do is far from linear: it counts by their size."""
    made = toy(Model.of(SCENE), (), ())
    state = state_of(Relaxing(made.data, made.actions, made.shapes), Model.of(SCENE))
    effect = effects.effect("viscosity")
    amount = Coordinate.of_parameter("viscosity.fraction", effect.amounts[0])
    term = Term(effect, {"fraction": 0.0, "relaxation_time": 3.0})
    sensitivity = np.full((len(made.data), 1), shown / math.sqrt(len(made.data)) / amount.scale)
    found = _large(state, Variant(term, (amount,), sensitivity))
    assert len(found) == tried
    for one in found:
        assert one.term.values == term.values
        by_size = state.errors.whiten(np.full(len(made.data), 0.01 * 0.9))
        assert one.sensitivity[:, 0] == pytest.approx(by_size, rel=1e-9)


def test_differences_of_whole_trajectories_serve_near_by() -> None:
    """A model that remembers is fitted again beside another error of the mesh with the derivatives that are known."""

    @dataclass
    class Counting(Toy):
        asked: list[dict[str, float]] = field(default_factory=list)

        def predict(
            self,
            model: Model,
            anchors: Iterable[str],
            actions: Iterable[Action] | None = None,
            keep: bool = False,
        ) -> MeasurementPrediction:
            self.asked.append(self.numbers(model))
            return super().predict(model, anchors, actions, keep)

    name = "support_friction.shear_stress"
    by_step = replace(cast(BodyEffect, effects.effect("support_friction")), uses_past=True)
    friction = Term(by_step, {"shear_stress": 80.0})
    model = Model.of(SCENE) + friction
    assert model.remembers
    made = toy(model, (name,), (1e-5,))
    counting = Counting(made.data, made.actions, made.shapes, power=1.2)
    first = fit(state_of(counting, model), (name,))
    counting.asked.clear()
    again = fit(first.state, (name,), like=first)
    known = len(counting.asked)
    counting.asked.clear()
    assert fit(first.state, (name,)).values[name] == pytest.approx(again.values[name], rel=1e-3)
    assert known < len(counting.asked)
    assert again.stderr[name] == pytest.approx(first.stderr[name], rel=0.05)
    # Far from there they are computed anew.
    counting.asked.clear()
    far = fit(state_of(counting, model.with_values({name: 10.0})), (name,), like=first)
    assert far.values[name] == pytest.approx(first.values[name], rel=1e-2)
    assert sum(abs(value[name] - (10.0 + 3.0) ** 1.2) < 0.2 for value in counting.asked) == 1


def test_a_number_is_as_uncertain_as_what_it_takes_the_place_of() -> None:
    """Where a marker sits cannot be told from its fault, nor how the camera is turned from how well that is known."""
    name = SCENE.fiducial_names[1]
    model = Model.of(SCENE) + Term("marker_fault", {"x": 3e-3, "y": 0.0, "z": 0.0, "onset": 0.0}, place=name)
    number = f"{model.terms[-1].label}.x"
    made, shape = toy(model, (number,), (1.0,)), np.zeros((24, 4, 3))
    shape[:, 1, 0] = 1.0
    made = replace(made, shapes={number: shape})
    data = made.data
    markers = np.tile(0.4e-3 * np.eye(3), (len(data) // 3, 1))
    known = NuisanceModes(markers, modes(data).common, ("camera", "camera", "poisson"), {"markers": 0.4e-3})
    state = state_of(made, model)
    exact = fit(state, (number,)).stderr[number]
    assert exact == pytest.approx(SIGMA / math.sqrt(24), rel=0.01)
    marked = replace(known, common=known.common[:, :0], names=())
    found = fit(state.with_errors(state.errors.mesh, marked), (number,)).stderr[number]
    assert found == pytest.approx(math.hypot(exact, 0.4e-3), rel=1e-6)
    # What a camera's frame is turned by holds what it is known to; of a Poisson's ratio there is but one.
    turned = Model.of(SCENE) + Term(
        "camera_offset", dict.fromkeys(("rx", "ry", "rz", "tx", "ty", "tz"), 0.0) | {"scale": 1.0}
    )
    assert np.array_equal(replaced(known, data, turned), known.common[:, :2])
    assert not replaced(known, data, Model.of(SCENE) + Term("compressibility", {"poisson": 0.3})).size


def test_an_effect_that_comes_and_goes_shows_its_period() -> None:
    effect, plain = effects.effect("active_stress"), Model.of(SCENE)
    made = toy(plain, (), ())
    shape = 1e-6 * np.random.default_rng(12).normal(size=rest(made.actions).shape)
    clock = np.concatenate([action.clock for action in made.actions])
    period = 3.0
    share = np.array([effect.at(t, {"amplitude": 1.0, "period": period})["amplitude"] for t in clock])
    made.data.values = made.data.values + made.data.vector(800.0 * share[:, None, None] * shape)
    seeing = Toy(made.data, made.actions, {"active_stress.amplitude": shape})
    whole: Any = seeing
    state = replace(state_of(Toy(made.data, made.actions, {}), plain), predictor=whole)
    (row,) = rank(state, [effect]).rows
    assert row.term.values["period"] == pytest.approx(period, rel=0.05)
    assert row.term.values["amplitude"] == pytest.approx(800.0, rel=0.1)


def test_a_period_may_be_any_of_those_that_are_tried() -> None:
    """As probable about one as about another that has as many cycles more or less, and one of seven cycles in all."""
    state: Any = SimpleNamespace(predictor=SimpleNamespace(times=np.linspace(0.0, 130.0, 14)))
    period = next(p for p in effects.effect("active_stress").parameters if p.off is not None)
    number = Coordinate.of_parameter("active_stress.period", period)
    for cycles in (1.5, 2.6, 7.0):
        there, a_little_more = 130.0 / cycles, 130.0 / (cycles + 1e-6)
        width = _width(number, there, state)
        assert (there - a_little_more) / width == pytest.approx(1e-6 / (7.0 / math.sqrt(12)), rel=1e-4)


# -- the verdict
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("unexplained", "named"), [(0.0, True), (0.1, True), (0.5, False)])
def test_an_effect_may_be_named_when_it_explains_nearly_all(unexplained: float, named: bool) -> None:
    """With 0.1 of what the weight does left over, the model is not adequate, but 0.99 of the excess is explained."""
    plain = Model.of(SCENE)
    heavy = plain + Term(effects.effect("gravity"), {"weight": 6000.0})
    made = toy(heavy, ("gravity.weight",), (5e-7,))
    made.data.values = made.data.values + 3e-3 * unexplained * np.random.default_rng(11).normal(size=len(made.data))
    light, full = (
        fit(state_of(stand_in, model), ())
        for stand_in, model in ((Toy(made.data, made.actions, {}), plain), (made, heavy))
    )
    assert judge(full.state).adequate == (unexplained == 0.0)
    assert explains(light, full) == named
    assert not explains(light, light)
