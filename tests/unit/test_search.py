"""The search on a made-up landscape, without any mesh: climbing, seeds, termination, belief, and the way up the ladder."""

import math
from collections.abc import Callable, Mapping
from types import SimpleNamespace

import numpy as np
import pytest

from bcid.base.errors import InputError, SolveError
from bcid.base.progress import Silent
from bcid.forms import effect_trial as trial
from bcid.forms.simulate import recorded
from bcid.forms.solver.status import Status
from bcid.inference.continuation import ContinuationError, truncate_to_converged
from bcid.inference.outcome import Candidate, Outcome, label
from bcid.inference.priors import PRIORS
from bcid.measurement import Action, Measurement
from bcid.search.climb import climb, neighbours
from bcid.search.evaluator import Evaluator
from bcid.search.identify_options import IdentifyOptions
from bcid.search.screening import finest, level_errors, log_odds, rejection_bound, screened
from bcid.search.seeds import above, all_candidates, maxima, perturbed, random_seeds
from bcid.search.settings import SETTINGS
from bcid.search.stage_options import StageOptions
from bcid.search.staged_search import StagedSearch, StagedSets
from bcid.search.termination import Stop, Termination

PATCHES = ["1", "2", "3", "4", "5", "6"]
TRUE = frozenset("25")
VALUES = 1000


class Landscape:
    """Stands in for a `Evaluator`: chi-square from a formula, with evaluations that stop at a bound as the real ones do."""

    def __init__(
        self,
        *levels: Callable[[Candidate], float],
        noise: float | None = 1.0,
        apart: float = 0.0,
        early: Callable[[Candidate], float] = lambda _: 0.0,
    ) -> None:
        self.levels, self.early = levels, early
        self.apart = apart
        self.patches = PATCHES
        self.misfit = SimpleNamespace(
            values=VALUES,
            curves=60,
            noise=noise,
            motion_rms=100.0,
            common=0.0,
            distance=lambda a, b: abs(a - b),
            similarity=lambda rms: 1 - rms / 100,
        )
        self.scene = SimpleNamespace(levels=levels, patches=PATCHES)
        self.outcomes: dict[tuple[int, Candidate], Outcome] = {}
        self.asked = 0

    def evaluate(
        self, level: int, bounds: Mapping[Candidate, float], rival: Candidate | None = None, last: bool = False
    ) -> dict[Candidate, Outcome]:
        for candidate, bound in bounds.items():
            if Evaluator._enough(self.outcomes.get((level, candidate)), bound):
                continue
            self.asked += 1
            chi2 = self.levels[level](candidate)
            failed = math.isinf(chi2)
            complete = not failed and chi2 <= bound
            share = 1.0 if complete else 0.5
            got = chi2 if complete or failed else bound * 1.001
            status = Status.UNSTABLE if failed else Status.CONVERGED
            self.outcomes[level, candidate] = Outcome(
                candidate,
                level,
                got,
                math.sqrt(got / VALUES),
                complete,
                share,
                status,
                "buckles" if failed else "",
                by_frame=self.by_frame(candidate, got),
            )
        return {c: self.outcomes[level, c] for c in bounds}

    def by_frame(self, candidate: Candidate, chi2: float) -> tuple[float, ...]:
        """Two frames: a set that fails may do so in the second."""
        early = self.early(candidate)
        return (early, math.nan if math.isinf(chi2) else chi2 - early)

    def refinement(self, _coarse: int, _fine: int) -> float:
        """Elements are halved from level to level."""
        return 2.0

    def evaluations(self) -> dict[int, float]:
        counts: dict[int, float] = {}
        for (level, _), outcome in self.outcomes.items():
            counts[level] = counts.get(level, 0.0) + outcome.share
        return counts

    def predict(self, level: int, candidate: Candidate) -> None:
        return None

    def positions(self, level: int, candidate: Candidate) -> float:
        """One number stands for the prediction: levels are `apart` from the finest by this."""
        return self.apart * (len(self.levels) - 1 - level)


def distance(candidate: Candidate, truth: Candidate = TRUE) -> float:
    """A smooth hill: chi-square grows with the number of wrong patches."""
    return VALUES * (1.0 + 3.0 * len(candidate ^ truth))


def search(evaluator: Landscape, options: StageOptions | None = None) -> StagedSets:
    return StagedSearch(evaluator, options or StageOptions(), Silent()).run()  # type: ignore[arg-type]


def test_climbs_end_on_the_hill_by_single_toggles() -> None:
    evaluator = Landscape(distance)
    climbs = climb(evaluator, 0, [frozenset(), frozenset(PATCHES), TRUE])  # type: ignore[arg-type]
    assert [c.top for c in climbs] == [TRUE] * 3
    assert [len(c.path) for c in climbs] == [3, 5, 1]
    for c in climbs:
        assert all(len(a ^ b) == 1 for a, b in zip(c.path, c.path[1:], strict=False))


def test_equal_climbers_share_their_work() -> None:
    evaluator = Landscape(distance)
    climb(evaluator, 0, [frozenset("1"), frozenset("1"), frozenset("1")])  # type: ignore[arg-type]
    alone = evaluator.asked
    evaluator = Landscape(distance)
    climb(evaluator, 0, [frozenset("1")])  # type: ignore[arg-type]
    assert evaluator.asked == alone


def test_a_local_maximum_holds_a_climber() -> None:
    trap = frozenset("1346")
    evaluator = Landscape(lambda c: 1.5 * VALUES if c == trap else distance(c))
    tops = {c.top for c in climb(evaluator, 0, [trap, TRUE])}  # type: ignore[arg-type]
    assert tops == {trap, TRUE}
    climbs = climb(evaluator, 0, [trap, TRUE])  # type: ignore[arg-type]
    assert maxima(climbs, evaluator, 0) == [TRUE, trap]  # type: ignore[arg-type]


def test_failed_neighbours_are_passed_by() -> None:
    evaluator = Landscape(lambda c: math.inf if c == frozenset("2") else distance(c))
    assert climb(evaluator, 0, [frozenset()])[0].top == TRUE  # type: ignore[arg-type]


def test_neighbours_and_labels() -> None:
    assert neighbours(frozenset("1"), ["1", "2"]) == [frozenset(), frozenset("12")]
    assert label(frozenset("21"), ["1", "2", "3"]) == "{1 2}"
    assert label(frozenset(), ["1"]) == "{}"


def test_seeds() -> None:
    rng = np.random.default_rng(0)
    seeds = random_seeds(PATCHES, 24, rng)
    assert len(set(seeds)) == 24
    assert seeds == random_seeds(PATCHES, 24, np.random.default_rng(0))
    assert sorted(map(sorted, random_seeds(["a", "b"], 24, rng))) == [[], ["a"], ["a", "b"], ["b"]]
    assert len(set(all_candidates(PATCHES))) == 64
    moved = perturbed([TRUE], PATCHES, 2, rng)
    assert moved[0] == TRUE
    assert len(moved[1] ^ TRUE) == 2
    assert perturbed([TRUE, TRUE], PATCHES, 0, rng) == [TRUE]


def test_good_states_above_a_threshold() -> None:
    evaluator = Landscape(distance)
    evaluator.evaluate(0, {TRUE: math.inf, frozenset("2"): math.inf, frozenset(): 2.0})
    everything = above(evaluator, 0, 0.0)  # type: ignore[arg-type]
    assert everything == [TRUE, frozenset("2")], "a stopped evaluation has no similarity"
    assert above(evaluator, 0, evaluator.misfit.similarity(1.5)) == [TRUE]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rules", "since", "said"),
    [
        (Termination(fit=1.05), 0, "residual is the noise"),
        (Termination(fit=0.5, patience=4), 4, "4 seeds in a row"),
        (Termination(fit=0.5, patience=5, budget=1), 4, "budget of 1"),
        (Termination(fit=0.5, patience=5, budget=2), 4, None),
    ],
)
def test_termination(rules: Termination, since: int, said: str | None) -> None:
    evaluator = Landscape(distance)
    best = evaluator.evaluate(0, {TRUE: math.inf})[TRUE]
    reached = rules.reached(evaluator, 0, best, since)  # type: ignore[arg-type]
    assert (said in reached) if said and reached else reached is said


def test_screening_compares_sets_by_their_likelihood() -> None:
    evaluator = Landscape(lambda c: VALUES + 4.0 * len(c ^ TRUE) if len(c) < 5 else math.inf)
    evaluator.evaluate(0, dict.fromkeys(all_candidates(PATCHES), math.inf))
    logs = screened(evaluator, TRUE, {0: 0.0})  # type: ignore[arg-type]
    assert next(iter(logs)) == TRUE
    assert list(logs.values()) == sorted(logs.values(), reverse=True)
    assert logs[frozenset(PATCHES)] == pytest.approx(math.log(PRIORS.failures)), "nothing is known of it"
    assert logs[frozenset("2")] == pytest.approx(-2.0), "chi-square 4 above is a likelihood ratio of exp(-2)"


def test_a_coarse_level_is_not_believed_beyond_its_error() -> None:
    """Where the best set misses by ten times the noise, the same ratio of misfits says far less."""
    fine, coarse = (Landscape(lambda c, s=s: s * (VALUES + 100.0 * len(c ^ TRUE))) for s in (1.0, 100.0))
    ratios = []
    for evaluator, error in ((fine, 0.0), (coarse, math.sqrt(99.0))):
        evaluator.evaluate(0, {TRUE: math.inf, frozenset("2"): math.inf})
        assert level_errors(evaluator, TRUE, [0]) == {0: pytest.approx(error)}  # type: ignore[arg-type]
        pair = evaluator.outcomes[0, frozenset("2")], evaluator.outcomes[0, TRUE]
        ratios.append(log_odds(*pair, evaluator.misfit, error))  # type: ignore[arg-type]
    assert ratios[0] == pytest.approx(-50.0)
    assert ratios[1] == pytest.approx(-10_000 / 2 / (1 + 99 * VALUES / 60))


def test_the_error_of_a_level_comes_from_the_next_and_from_the_residual() -> None:
    evaluator = Landscape(distance, distance, apart=3.0)
    for level in (0, 1):
        evaluator.evaluate(level, {TRUE: math.inf})
    assert level_errors(evaluator, TRUE, [0, 1]) == {0: 3.0, 1: 1.0}  # type: ignore[arg-type]
    evaluator = Landscape(lambda c: 5 * VALUES, lambda c: 2 * VALUES)
    for level in (0, 1):
        evaluator.evaluate(level, {TRUE: math.inf})
    assert level_errors(evaluator, TRUE, [0, 1]) == pytest.approx({0: 2.0, 1: 1.0})  # type: ignore[arg-type]


def test_an_error_of_the_measured_frame_counts_on_every_level() -> None:
    evaluator = Landscape(distance, distance, apart=3.0)
    for level in (0, 1):
        evaluator.evaluate(level, {TRUE: math.inf})
    evaluator.misfit.common = 4.0
    assert level_errors(evaluator, TRUE, [0, 1]) == pytest.approx({0: 5.0, 1: math.sqrt(17.0)})  # type: ignore[arg-type]


def test_a_best_set_that_failed_on_a_coarse_level() -> None:
    evaluator = Landscape(lambda c: math.inf if c == TRUE else distance(c), distance, distance, apart=3.0)
    found = search(evaluator)
    assert found.best.candidate == TRUE
    assert found.shares[TRUE] > 0.9
    evaluator.evaluate(2, {TRUE: math.inf})
    assert level_errors(evaluator, TRUE, [0, 1, 2]) == {0: 0.0, 1: 3.0, 2: 1.0}  # type: ignore[arg-type]


def test_a_fit_on_one_level_is_not_enough() -> None:
    """The coarsest level fits a wrong set to within the noise; the next one is asked all the same, and says so."""
    wrong = frozenset("25") ^ {"1"}
    found = search(Landscape(lambda c: distance(c, wrong), distance, distance, apart=2.0))
    assert found.levels[:2] == (0, 1)
    assert found.best.candidate == TRUE


def test_the_search_finds_and_counts() -> None:
    evaluator = Landscape(distance)
    found = search(evaluator)
    assert found.best.candidate == TRUE
    assert found.shares[TRUE] > 0.999
    assert found.evaluations == evaluator.evaluations()
    assert found.lost == {c for c in found.shares if c != TRUE}


def test_given_sets_are_climbed_from_instead_of_random_ones() -> None:
    evaluator = Landscape(distance)
    found = StagedSearch(evaluator, StageOptions(), Silent(), [TRUE, frozenset("2")]).run()  # type: ignore[arg-type]
    assert found.best.candidate == TRUE
    assert found.stages[0].startswith("level 0: 2 climbs ended on 1 maxima")
    assert len(evaluator.outcomes) == 12, "the two sets, the neighbours of each, one of them shared"


def test_patience_ends_a_stage() -> None:
    """The hill has one top: every group of four seeds after the first finds nothing better."""
    rules = Termination(fit=0.0, patience=8)
    found = search(Landscape(distance), StageOptions(termination=rules))
    assert found.stages[0] == "level 0: 12 climbs ended on 1 maxima; 8 seeds in a row led to nothing better"
    everything = search(Landscape(distance), StageOptions(termination=Termination(fit=0.0, patience=99)))
    assert everything.stages[0] == "level 0: 24 climbs ended on 1 maxima; all seeds are used"


@pytest.mark.parametrize("climbed", [1, 2])
def test_a_misleading_coarse_level_is_corrected(climbed: int) -> None:
    """The coarse level prefers a neighbour by a little; the fine one decides, and the belief follows it.

    With one climbed level the right set gets there only because the coarse level could not rule it out.
    """
    wrong = frozenset("2")

    def coarse(c: Candidate) -> float:
        return 20 * VALUES * (1 + 0.3 * len(c ^ TRUE)) if c != wrong else 19.5 * VALUES

    found = search(Landscape(coarse, distance), StageOptions(climbed=climbed))
    assert found.best.candidate == TRUE
    assert found.shares[TRUE] > 0.999
    assert found.levels == (0, 1)


def test_rivals_that_cannot_be_told_apart_share_the_belief() -> None:
    rival = frozenset("256")
    found = search(Landscape(lambda c: distance(c) if c != rival else VALUES))
    assert found.shares[TRUE] == pytest.approx(0.5, abs=1e-3)
    assert found.likely == [TRUE, rival]


def test_where_a_rival_may_stop() -> None:
    evaluator = Landscape(distance)
    best = evaluator.evaluate(0, {TRUE: math.inf})[TRUE]
    assert rejection_bound(best, evaluator.misfit, SETTINGS.odds) == pytest.approx(VALUES + 2 * math.log(1e6))  # type: ignore[arg-type]
    coarse = rejection_bound(best, evaluator.misfit, SETTINGS.odds, error=3.0)  # type: ignore[arg-type]
    assert coarse == pytest.approx(VALUES + 2 * math.log(1e6) * (1 + 9 * VALUES / 60))


def test_a_set_that_fails_on_the_finer_level_is_not_ruled_out_by_that() -> None:
    """It keeps what the coarser level says of it; nobody becomes certain because a rival could not be computed."""
    rival = frozenset("256")
    coarse = lambda c: VALUES if c in (TRUE, rival) else distance(c)  # noqa: E731
    fine = lambda c: math.inf if c == rival else distance(c)  # noqa: E731
    found = search(Landscape(coarse, fine), StageOptions(finest=1))
    assert found.best.candidate == TRUE
    assert found.shares[TRUE] == pytest.approx(0.5, abs=0.01)
    assert rival in found.likely


def test_when_nothing_can_be_solved() -> None:
    with pytest.raises(SolveError, match="failed for every anchor set tried; the first: buckles"):
        search(Landscape(lambda c: math.inf))


def test_a_level_that_cannot_be_solved_leaves_the_answer_of_the_one_before() -> None:
    found = search(Landscape(lambda c: 2 * distance(c), lambda c: math.inf))
    assert found.best.candidate == TRUE
    assert found.levels == (0,)
    assert tuple(found.errors) == (0,)
    assert found.shares[TRUE] > 0.99
    assert found.stages[-1].startswith("not used: level 1: the forward model failed")


def test_no_noise_is_needed() -> None:
    found = search(Landscape(distance, noise=None))
    assert found.best.candidate == TRUE
    assert found.shares[TRUE] > 0.99


@pytest.mark.parametrize(
    "wrong",
    [
        {"random_state": -1},
        {"climbed": 0},
        {"toggles": -1},
        {"threshold": math.nan},
        {"start": "x"},
        {"seeds": 0},
        {"finest": 3},
        {"coarsest": -1},
        {"coarsest": 1, "finest": 0},
    ],
)
def test_options_are_checked(wrong: dict[str, object]) -> None:
    scene = SimpleNamespace(levels=(1, 2), patches=PATCHES)
    IdentifyOptions(stages=StageOptions()).check(scene)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        IdentifyOptions(stages=StageOptions(**wrong)).check(scene)  # type: ignore[arg-type]


def test_what_is_certified_is_checked() -> None:
    scene = SimpleNamespace(levels=(1, 2), patches=PATCHES)
    for wrong in ({"certify": "x"}, {"level": 2}, {"level": -1}):
        with pytest.raises(InputError):
            IdentifyOptions(**wrong).check(scene)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="use certify no"):
        IdentifyOptions(certify="yes").check(SimpleNamespace(levels=(1,), patches=range(17)))  # type: ignore[arg-type]


def test_finest_outcomes() -> None:
    evaluator = Landscape(distance, distance)
    evaluator.evaluate(0, {TRUE: math.inf, frozenset(): math.inf})
    evaluator.evaluate(1, {TRUE: math.inf})
    assert {c: o.level for c, o in finest(evaluator, 1).items()} == {TRUE: 1, frozenset(): 0}  # type: ignore[arg-type]
    assert finest(evaluator, 0)[TRUE].level == 0  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("stop", "apart", "levels", "said"),
    [
        ("same", 0.0, (0, 1), "the set is that of the level before"),
        ("similarity 0.9", 0.0, (0,), "the similarity is 0.99, at least 0.9"),
        ("similarity 0.995", 0.0, (0, 1, 2), ""),
        ("refinement 0.5 mm", 0.4e-3, (0,), "changes by 0.4 mm on the next level, by less than 0.5 mm"),
        ("refinement 0.3 mm", 0.4e-3, (0, 1, 2), ""),
    ],
)
def test_the_stages_end_as_the_paper_has_it(stop: str, apart: float, levels: tuple[int, ...], said: str) -> None:
    """Section 3.5; with noise of one the best set has a residual of 1, and so a similarity of 0.99."""
    options = StageOptions(stop=Stop.parse(stop))
    found = search(Landscape(distance, distance, distance, apart=apart), options)
    assert found.levels == levels
    assert found.best.candidate == TRUE
    assert any(text.endswith(said) and "is the last" in text for text in found.stages) == bool(said)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("sane", "did you mean 'same'"),
        ("same 3", "'same' stands alone"),
        ("similarity", "expected as 'similarity 0.95'"),
        ("similarity 2", "must be above 0 and below 1"),
        ("refinement 0.5", "expected as 'refinement 0.5 mm'"),
        ("refinement 0 mm", "must be above 0"),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused(text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        Stop.parse(text)


def test_a_measurement_is_looked_at_as_far_as_it_can_be_followed() -> None:
    """Nothing is reported of frames to which no set comes; where nothing is left, that is told."""
    number = np.arange(4)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    scene = trial.scene()
    pulls = [
        Action(str(i + 1), 4 * i + number, number, "gripper", 1e-3 * number[:, None] * [1, 0, 0], turns) for i in (0, 1)
    ]
    whole = recorded(scene, pulls, np.tile(scene.rest, (8, 1, 1)), 1e-4, np.random.default_rng(0))
    tried: list[int] = []

    def work(seen: Measurement) -> Measurement:
        tried.append(len(seen.positions))
        came = np.array([True] * 6 + [False] * 2)[: tried[-1]]
        if tried[-1] > 6:
            raise ContinuationError("it buckles", "no anchor set can be followed", came)
        return seen

    found = truncate_to_converged(whole, work)
    assert tried == [8, 6]
    assert [len(action) for action in found.actions] == [4, 2]
    assert found.remarks[-1] == "action 2 is compared up to step 1 only: no anchor set can be followed any further"
    error = ContinuationError("it buckles", "nothing can be followed", np.array([True, *[False] * 3, *[True] * 4]))
    assert [action.name for action in error.before(whole).actions] == ["2"]
    with pytest.raises(ContinuationError, match="it buckles"):
        ContinuationError("it buckles", "", np.array([True, *[False] * 7])).before(whole)


def test_where_every_set_fails_it_is_told_how_far_they_came() -> None:
    evaluator = Landscape(lambda _: math.inf)
    with pytest.raises(ContinuationError) as caught:
        search(evaluator)
    assert caught.value.frames.tolist() == [True, False]
