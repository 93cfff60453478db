"""The order of the queue: the most probable hypothesis, its tangents, what is uncertain, and the same less a patch or an effect."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import Hypothesis
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, best_first
from bcid.search.fitting.ranking import Ranking
from bcid.search.fitting.state import State
from bcid.search.full_search import FullSearch
from bcid.search.hypothesis_table import HypothesisTable
from bcid.search.settings import SETTINGS
from tests.unit.test_hypothesis_table import less, rival

Known = Mapping[Hypothesis, float | None]


class PlainTable(HypothesisTable):
    """Of hypotheses whose evidence is given: no error of the mesh is common to them."""

    def add(self, rivals: Iterable[FittedHypothesis], begun: Model) -> None:
        known = {one.hypothesis: one for one in (*self.own, *rivals)}
        self.own = self.full = best_first(known.values())
        self.reconsider()


class Simulated(FullSearch):
    """A queue whose evaluations are given: log evidence in all steps by hypothesis, None where it cannot be followed."""

    def __init__(self, truth: Known, coarse: list[FittedHypothesis], tangent: Known | None = None) -> None:
        quiet = SimpleNamespace(step=lambda *_: None, say=lambda *_: None)
        base: Any = SimpleNamespace(model=None, predictor=SimpleNamespace(progress=quiet))
        candidates: Any = SimpleNamespace(alike=False)
        super().__init__(base, candidates, (), 1, 5, 28)
        self.table = PlainTable()
        self.truth, self.coarse, self.tangent, self.done = truth, coarse, tangent or {}, list[tuple[str, Hypothesis]]()

    def extend(self, base: State, sets: int) -> None:
        plain = next(one for one in self.coarse if not one.names)
        first = self.evaluated(plain.hypothesis)
        assert first is not None
        self.table.add([first], self.model)
        self.table.add_stage(PlainTable(own=self.coarse, full=self.coarse))

    def evaluate(self, wanted: Sequence[Hypothesis]) -> None:
        self.done += [("fit", h) for h in wanted]
        super().evaluate(wanted)

    def evaluated(self, wanted: Hypothesis) -> FittedHypothesis | None:
        log = self.truth[wanted]
        return None if log is None else rival(wanted.names, "".join(sorted(wanted.anchors)), log)

    def say_fitted(self, rival: FittedHypothesis) -> None:
        """Nothing: these have no residual."""

    def ask_sets(self, rival: FittedHypothesis) -> None:
        self.done.append(("sets", rival.hypothesis))
        about = {rival.anchors: rival.evidence.plain}
        about |= {
            h.anchors: log for h, log in self.tangent.items() if log is not None and h.effect == rival.hypothesis.effect
        }
        self.table.add_sets(rival, {s: Evidence(log, log - 50, 1.0) for s, log in about.items()})

    def missing(self, plain: FittedHypothesis) -> Ranking:
        self.rankings[plain.hypothesis] = Ranking(())
        return self.rankings[plain.hypothesis]

    def reduce(self, rival: FittedHypothesis) -> None:
        self.table.reduced[rival.hypothesis] = []
        self.done.append(("reduce", rival.hypothesis))


def test_run_most_probable_is_fitted_before_its_tangent_is_asked() -> None:
    queue = Simulated({less("1"): 0.0, less("1", "gravity"): 40.0}, [rival((), "1", 0), rival(("gravity",), "1", 40)])
    best = queue.run().best()
    assert best.hypothesis == less("1", "gravity")
    assert queue.done == [("fit", best.hypothesis), ("sets", best.hypothesis), ("reduce", best.hypothesis)]


def test_run_set_that_a_tangent_shows_to_be_as_likely_is_fitted() -> None:
    """And where it is more probable then, its own tangent is asked; each once."""
    truth = {less("1"): 0.0, less("2"): 6.0, less("3"): -500.0}
    queue = Simulated(truth, [rival((), "1", 0)], {less("1"): 0.0, less("2"): 0.5, less("3"): -500.0})
    assert queue.run().best().hypothesis == less("2")
    kinds = [one for one in queue.done if one[0] != "reduce"]
    assert kinds == [("sets", less("1")), ("fit", less("2")), ("sets", less("2"))]
    assert queue.table.neglected < 1e-3


def test_run_what_cannot_be_followed_is_tried_once() -> None:
    queue = Simulated({less("1"): 0.0, less("1", "gravity"): None}, [rival((), "1", 0), rival(("gravity",), "1", 8.0)])
    assert queue.run().best().hypothesis == less("1")
    assert [one for one in queue.done if one[0] == "fit"] == [("fit", less("1", "gravity"))]


def test_run_effect_is_compared_with_the_same_anchors_without_it() -> None:
    truth = {less("2"): 0.0, less("1", "gravity"): 60.0, less("1"): 5.0}
    queue = Simulated(truth, [rival((), "2", 0), rival(("gravity",), "1", 60), rival((), "1", -90)])
    queue.run()
    assert ("fit", less("1")) in queue.done


def test_run_what_cannot_be_followed_takes_no_fit_from_others() -> None:
    sets = [chr(ord("A") + k) for k in range(2 * SETTINGS.fits)]
    truth: dict[Hypothesis, float | None] = {less(s): None if k % 2 else 2.0 for k, s in enumerate(sets)}
    queue = Simulated(truth, [rival((), "A", 0)], {h: 3.0 for h in truth if h != less("A")})
    queue.run()
    fitted = [h for kind, h in queue.done if kind == "fit" and truth[h] is not None]
    assert len(fitted) == SETTINGS.fits - 1


@pytest.mark.parametrize("count", [3, 30])
def test_run_ends_with_its_budget(count: int) -> None:
    """Of thirty sets that a tangent shows as likelier than they are some are fitted; the table says that others are neglected."""
    sets = [chr(ord("A") + k) for k in range(count)]
    truth = {less(s): float(-k) / 100 for k, s in enumerate(sets)}
    queue = Simulated(truth, [rival((), "A", 0)], {h: log + 3.0 for h, log in truth.items() if h != less("A")})
    queue.run()
    fits = [one for one in queue.done if one[0] == "fit"]
    assert len(fits) == min(count - 1, SETTINGS.fits)
    assert (queue.table.neglected > 0.1) == (count > SETTINGS.fits + 1)
