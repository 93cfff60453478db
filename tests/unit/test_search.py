"""Hill climbing and its stages on a made-up landscape, without any mesh, and residuals of sets on a small body."""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.base.options import IdentifyOptions, StageOptions, Stop
from bcid.forms import effect_trial as trial
from bcid.forms.simulate import recorded
from bcid.inference.continuation import ContinuationError, truncate_to_converged
from bcid.inference.hypotheses import label
from bcid.measurement import Action, Measurement
from bcid.search.hill_climbing import Candidate, all_candidates, climb, neighbours, perturbed, random_seeds
from bcid.search.stages import in_stages

PATCHES = ["1", "2", "3", "4", "5", "6"]
TRUE = frozenset("25")
LAST = StageOptions(stop=Stop("last"))


class Landscape:
    """A model whose residual is a formula (m), and whose prediction changes by a given amount from level to level.

    As of a real one, an evaluation ends where it is worse than its bound.
    """

    def __init__(self, misfit: Callable[[int, Candidate], float], *changes: float) -> None:
        self.misfit, self.changes, self.patches = misfit, changes, PATCHES
        self.asked: dict[int, set[Candidate]] = {}

    def misfits(self, level: int, bounds: Mapping[Candidate, float]) -> dict[Candidate, float]:
        self.asked.setdefault(level, set()).update(bounds)
        found = {candidate: self.misfit(level, candidate) for candidate in bounds}
        return {c: misfit if misfit <= bounds[c] else math.inf for c, misfit in found.items()}

    def similarity(self, rms: float) -> float:
        return 1.0 - rms / 10.0

    def change(self, level: int, candidate: Candidate) -> float:
        self.misfits(level + 1, {candidate: math.inf})
        return self.changes[level]

    @property
    def calls(self) -> dict[int, int]:
        return {level: len(sets) for level, sets in sorted(self.asked.items())}


def distance(_level: int, candidate: Candidate) -> float:
    """A smooth hill: the residual grows with the number of wrong patches."""
    return float(len(candidate ^ TRUE))


def test_climb_moves_by_single_toggles_to_the_best_set() -> None:
    model, seed = Landscape(distance), frozenset("134")
    tops, found = climb(model, 0, [seed])
    assert tops == [TRUE]
    assert found[TRUE] == 0.0
    # Five toggles away: from each set on the path all six neighbours, and in the end those of the best.
    path = [seed]
    while path[-1] != TRUE:
        path.append(min(neighbours(path[-1], PATCHES), key=lambda c: (len(c ^ TRUE), len(c), sorted(c))))
    assert all(len(a ^ b) == 1 for a, b in pairwise(path))
    assert model.asked[0] == {c ^ {p} for c in path for p in PATCHES} | {seed}


def test_climb_where_bounds_stop_evaluations_goes_the_same_way() -> None:
    """Against the plain algorithm, on a landscape without any order."""
    rng = np.random.default_rng(0)
    heights = {c: float(rng.random()) for c in all_candidates(PATCHES)}
    for seed in all_candidates(PATCHES):
        here = seed
        while True:
            best = min(neighbours(here, PATCHES), key=heights.__getitem__)
            if heights[best] >= heights[here]:
                break
            here = best
        assert climb(Landscape(lambda _, c: heights[c]), 0, [seed])[0] == [here]
    tops, _ = climb(Landscape(lambda _, c: heights[c]), 0, all_candidates(PATCHES))
    low = {c for c in heights if heights[c] < min(heights[n] for n in neighbours(c, PATCHES))}
    assert set(tops) == low
    assert tops == sorted(low, key=heights.__getitem__)


def test_climb_with_equal_seeds_asks_once() -> None:
    one, three = Landscape(distance), Landscape(distance)
    climb(one, 0, [frozenset("1")])
    climb(three, 0, [frozenset("1")] * 3)
    assert one.calls == three.calls


def test_climb_passes_by_sets_without_a_solution() -> None:
    model = Landscape(lambda level, c: math.inf if c == frozenset("2") else distance(level, c))
    assert climb(model, 0, [frozenset()])[0] == [TRUE]


def test_stages_end_on_another_maximum_than_the_best_of_all() -> None:
    deep, broad = frozenset(PATCHES), frozenset[str]()
    model = Landscape(lambda _, c: -1.0 if c == deep else float(len(c ^ broad)))
    assert in_stages(model, LAST, 0, [frozenset("12")])[-1].anchors == broad


def test_stages_begin_where_the_coarser_level_ended() -> None:
    """The coarse level prefers a neighbour; the finer one asks for it, and for its neighbours, and goes on."""
    wrong = frozenset("2")
    model = Landscape(lambda level, c: float(len(c ^ (TRUE if level else wrong))))
    found = in_stages(model, LAST, 1, [frozenset("134")])
    assert [stage.anchors for stage in found] == [wrong, TRUE]
    assert [stage.evaluated for stage in found] == list(model.calls.values())
    assert model.calls[1] == 7 + 5
    (single,) = in_stages(Landscape(distance), StageOptions(coarsest=1, stop=Stop("last")), 1, [wrong])
    assert (single.level, single.anchors) == (1, TRUE)


@pytest.mark.parametrize(
    ("stop", "changes", "calls", "said"),
    [
        # Climbing on the second mesh asks for the best set's neighbours again, looking at the next mesh for the best alone.
        ("same", (), {0: None, 1: 7}, "the set is that of the level before"),
        ("similarity 0.9", (), {0: None}, "the similarity is 1, at least 0.9"),
        (
            "refinement 500 mm",
            (2.0, 0.1),
            {0: None, 1: 7, 2: 1},
            "changes by 100 mm on the next level, by less than 500 mm",
        ),
        ("refinement 500 mm", (0.1,), {0: None, 1: 1}, "by less than 500 mm"),
        ("refinement 500 mm", (2.0, 2.0, 2.0), {0: None, 1: 7, 2: 7, 3: 7}, ""),
        ("last", (), {0: None, 1: 7, 2: 7, 3: 7}, ""),
    ],
)
def test_stages_end_by_the_rules_of_the_paper(
    stop: str, changes: tuple[float, ...], calls: dict[int, int | None], said: str
) -> None:
    """Section 3.5."""
    model, words = Landscape(distance, *changes), list[str]()
    found = in_stages(model, StageOptions(stop=Stop.parse(stop)), 3, [frozenset("134"), frozenset("6")], words.append)
    assert found[-1].anchors == TRUE
    assert {level: count if level else None for level, count in model.calls.items()} == calls
    assert any(text.endswith(said) and "is the last" in text for text in words) == bool(said)


def test_stages_may_begin_with_all_good_sets() -> None:
    model = Landscape(lambda level, c: 1.0 + distance(level, c))
    options = StageOptions(start="threshold", threshold=0.85, stop=Stop("last"))
    in_stages(model, options, 1, [frozenset("134")])
    # Similarities above 0.85 * 0.9: the best and its neighbours; theirs are at a distance of two.
    assert model.calls[1] == 1 + 6 + 15


def test_stages_without_any_solution_are_none() -> None:
    words: list[str] = []
    assert in_stages(Landscape(lambda *_: math.inf), StageOptions(), 1, (), words.append) == []
    assert "no solution" in words[-1]


def test_stages_keep_the_answer_of_the_level_before_where_the_next_has_no_solution() -> None:
    found = in_stages(Landscape(lambda level, c: math.inf if level else distance(level, c)), LAST, 2)
    assert [(stage.level, stage.anchors) for stage in found] == [(0, TRUE)]


def test_neighbours_and_labels() -> None:
    assert neighbours(frozenset("1"), ["1", "2"]) == [frozenset(), frozenset("12")]
    assert label(frozenset("21"), ["1", "2", "3"]) == "{1 2}"
    assert label(frozenset(), ["1"]) == "{}"


def test_seeds_are_different_and_repeatable() -> None:
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


@pytest.mark.parametrize(
    "wrong",
    [
        {"seed": -1},
        {"perturb": -1},
        {"threshold": math.nan},
        {"threshold": 1.0},
        {"start": "x"},
        {"seeds": 0},
        {"finest": 3},
        {"coarsest": -1},
        {"coarsest": 1, "finest": 0},
        {"stop": Stop("similarity", least=2.0)},
    ],
)
def test_stage_options_are_checked(wrong: dict[str, object]) -> None:
    scene = SimpleNamespace(levels=(1, 2), patches=PATCHES)
    IdentifyOptions(stages=StageOptions()).check(scene)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        IdentifyOptions(stages=StageOptions(**wrong)).check(scene)  # type: ignore[arg-type]


def test_what_is_certified_is_checked() -> None:
    scene = SimpleNamespace(levels=(1, 2), patches=PATCHES)
    for wrong in ({"exhaustive": "x"}, {"level": 2}, {"level": -1}):
        with pytest.raises(InputError):
            IdentifyOptions(**wrong).check(scene)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="use exhaustive no"):
        IdentifyOptions(exhaustive="yes").check(SimpleNamespace(levels=(1,), patches=range(17)))  # type: ignore[arg-type]


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
def test_stop_that_makes_no_sense_is_refused(text: str, told: str) -> None:
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
