"""What is believed most is fitted, and so is the same without each of its effects: an effect is believed against that."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bcid.forms.model import Term
from bcid.inference.change_point import ChangePoint
from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, log_prior
from bcid.inference.priors import PRIORS
from bcid.search.answer.explanation import Explanation
from bcid.search.fitting import fitted_hypothesis
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.hypothesis_table import HypothesisTable, TangentEvidence


def rival(
    names: tuple[str, ...],
    anchors: str,
    evidence: float,
    terms: tuple[Term, ...] = (),
    mesh: float = 0.0,
    stderr: float = 0.0,
) -> FittedHypothesis:
    """A hypothesis that was compared with all steps, with so much evidence and error of the mesh."""
    errors = SimpleNamespace(mesh_rms=mesh)
    model = SimpleNamespace(terms=terms)
    predictor = SimpleNamespace(data=SimpleNamespace(stated=False))
    state = SimpleNamespace(anchors=frozenset(anchors), noise=1.0, errors=errors, model=model, predictor=predictor)
    errors_of = {term.full(name): stderr for term in terms for name in term.values}
    fitted = SimpleNamespace(state=state, coordinates=names, stderr=errors_of)
    return FittedHypothesis(names, cast("Any", fitted), Evidence(evidence, evidence - 50, 1.0), 20)


def stage(rough: list[FittedHypothesis], tangents: dict[Hypothesis, TangentEvidence] | None = None) -> HypothesisTable:
    """What was evaluated in a few steps."""
    return HypothesisTable(own=rough, full=rough, tangents=tangents or {})


SOFT = (Term("soft_anchor", {"stiffness": 5e4}, place="1"),)


def less(anchors: str, effect: str = "") -> Hypothesis:
    return Hypothesis(frozenset(anchors), effect)


@pytest.mark.parametrize(
    ("full", "wanted"),
    [
        ([rival(("gravity",), "1", 100), rival((), "2", 80)], less("1")),
        ([rival(("gravity",), "1", 100), rival((), "1", 80)], None),
        ([rival(("gravity", "fibres"), "1", 100), rival((), "1", 80)], less("1", "gravity")),
        ([rival(("gravity", "fibres"), "1", 100), rival(("gravity",), "1", 80)], less("1", "fibres")),
        ([rival((), "1", 100), rival(("gravity",), "2", 80)], None),
        ([rival(("soft_anchor",), "12", 100, SOFT), rival((), "2", 80)], less("12")),
        ([rival(("soft_anchor",), "12", 100, SOFT), rival((), "12", 80)], less("2")),
        ([rival(("soft_anchor",), "12", 100, SOFT), rival((), "12", 80), rival((), "2", 80)], None),
    ],
)
def test_an_effect_is_weighed_against_the_same_anchors_without_it(
    full: list[FittedHypothesis], wanted: Hypothesis | None
) -> None:
    assert HypothesisTable(own=full, full=full).unopposed() == wanted


def test_the_best_is_weighed_against_sets_that_lack_one_of_its_patches() -> None:
    """As far as a few steps show them to be as likely, whatever the tangent shows; and about itself, not about another."""
    best, other = rival(("gravity",), "12", 100), rival(("gravity",), "34", 80)
    full = [best, other, rival((), "12", 50)]
    compared = HypothesisTable(own=full, full=full, reduced={best.hypothesis: [frozenset("1")]})
    assert compared.unopposed() == less("1", "gravity")
    assert replace(compared, reduced={other.hypothesis: [frozenset("1")]}).unopposed() is None
    fitted = [*full, rival(("gravity",), "1", 90)]
    assert replace(compared, own=fitted, full=fitted).unopposed() is None


@pytest.mark.parametrize(
    ("stderr", "rigid", "held"),
    [(1e3, 20.0, {"12": 1.0}), (1e5, 20.0, {"2": 1.0}), (1e5, 95.0, {"12": 1.0})],
)
def test_a_patch_whose_springs_may_have_no_stiffness_is_free(
    stderr: float, rigid: float, held: dict[str, float]
) -> None:
    """What holds by 50,000 +- 100,000 Pa/m is not attached, unless it may as well be infinitely stiff."""
    soft = rival(("soft_anchor",), "12", 120, SOFT, stderr=stderr)
    full = [soft, rival((), "2", 90), rival((), "12", rigid)]
    table = HypothesisTable(own=full, full=full)
    assert {s: round(table.odds.held_by(frozenset(s)), 6) for s in held} == held
    assert sum(table.odds.probabilities.values()) == pytest.approx(1.0)
    assert table.best() is (full[1] if "2" in held else soft)


def test_a_set_that_cannot_be_followed_in_a_few_steps_has_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Near an instability large steps fail where small ones do not: what such an action shows is not counted."""
    at = np.zeros((3, 1, 3))
    found = {frozenset("1"): (np.full_like(at, np.nan), "inside out"), frozenset("2"): (at + 1.0, "")}
    thin = SimpleNamespace(
        actions=[SimpleNamespace(frames=np.arange(3))],
        predict=lambda _model, anchors, **_: SimpleNamespace(positions=found[anchors][0], failure=found[anchors][1]),
    )
    best, shown = rival(("gravity",), "12", 100), dict[frozenset[str], float]()
    predictor = SimpleNamespace(thinned=lambda *_: (thin, np.arange(3)), data=SimpleNamespace(mask=at > 0))
    state: Any = best.fitted.state
    state.predictor, state.predicted, state.prediction = predictor, at, SimpleNamespace(positions=at)

    def odds(_: FittedHypothesis, moves: dict[frozenset[str], Any], *__: Any) -> dict[frozenset[str], float]:
        shown.update({s: float(moved.max()) for s, moved in moves.items()})
        return dict.fromkeys(moves, 0.0)

    monkeypatch.setattr(FittedHypothesis, "_shown", odds)
    nothing: Any = None
    sets = [frozenset("1"), frozenset("2"), frozenset("3")]
    assert best.without_a_patch(sets, 2, nothing, nothing) == [frozenset("1"), frozenset("2")]
    assert shown == {frozenset("1"): 0.0, frozenset("2"): 1.0}


def test_changes_uncertain_hypothesis_is_worth_an_evaluation() -> None:
    """As much as whether it is true varies; one where it is the most probable; none where it was refused."""
    full = [rival((), "1", 100), rival((), "2", 98)]
    rough = [rival((), "1", 40), rival(("gravity",), "1", 43), rival(("fibres",), "1", -400)]
    table = HypothesisTable(own=full, full=full, coarse=[stage(rough)])
    found = table.changes()
    assert set(found) == {less("1", "gravity"), less("1", "fibres")}
    assert found[less("1", "fibres")] < 1e-3 < found[less("1", "gravity")] < 0.25
    rough[1] = rival(("gravity",), "1", 60)
    likely = HypothesisTable(own=full, full=full, coarse=[stage(rough)])
    assert likely.changes()[less("1", "gravity")] == 1.0
    likely.refuse(less("1", "gravity"))
    assert less("1", "gravity") not in likely.changes()


def test_sets_below_the_best_by_its_tangent_are_nearly_excluded() -> None:
    """Thirty of them, each thirty below: known from one tangent, they share its errors."""
    best = rival((), "1", 100)
    others = [frozenset(f"3{name}") for name in "456789abcdefghijklmnopqrstuvwxyz"]
    sets = {best.anchors: Evidence(100.0, 50.0, 1.0), **dict.fromkeys(others, Evidence(70.0, 20.0, 1.0))}
    table = HypothesisTable(own=[best], full=[best])
    table.add_sets(best, sets)
    assert 0.95 < table.odds.held_by(frozenset("1")) < 0.9999
    assert table.neglected == pytest.approx(1 - table.odds.held_by(frozenset("1")))
    # Of what was compared with all steps, and fell short of its tangent, the table knows by how much.
    (other, *_) = others
    fitted = [best, rival((), "".join(other), -300)]
    known = HypothesisTable(own=fitted, full=fitted, tangents=table.tangents).posterior()
    assert [pair.high for pair in known.pairs] == [-400.0]
    assert known.evaluations[Hypothesis(other)].toggles == ()


def test_hypotheses_of_a_few_steps_keep_their_distance_from_the_nearest_of_all_steps() -> None:
    """What a tangent of these says of others as well, about the hypothesis whose tangent it is."""
    base, rough = rival((), "1", 100), [rival((), "1", 40), rival((), "12", 37), rival(("gravity",), "1", 38)]
    tangents = {less("12"): TangentEvidence(effects={"gravity": 39.0}, known=20)}
    table = HypothesisTable(own=[base], full=[base], coarse=[stage(rough, tangents)])
    found, steady = table.posterior().evaluations, less("12", "gravity")
    assert {h.label("12"): round(one.log, 3) for h, one in found.items() if not h.unknown} == {
        "{1}": 100.0,
        "{1 2}": 97.0,
        "{1} + gravity": 98.0,
        "{1 2} + gravity": 99.0,
    }
    # The error of the tangent is one of the few steps, and that of these one of both.
    assert [(round(one.low, 3), round(one.high, 3)) for one in found[steady].steps] == [(37.0, 37.0), (40.0, 100.0)]
    assert (found[steady].about, len(found[steady].toggles)) == (less("12"), 3)
    # That a hypothesis cannot be followed to the end says little against it, and nothing for it.
    before = found[less("12")]
    table.refuse(less("12"))
    refused = table.posterior().evaluations[less("12")]
    assert refused.log == before.log
    assert refused.log_prior == pytest.approx(before.log_prior + math.log((PRIORS.failures + 1) / 3))
    assert less("12") not in table.changes()
    likely = {less("12"): TangentEvidence(effects={"gravity": 400.0}, known=20)}
    table = HypothesisTable(own=[base], full=[base], coarse=[stage(rough, likely)])
    assert table.posterior().evaluations[steady].log == pytest.approx(460.0)
    table.refuse(steady)
    assert table.posterior().evaluations[steady].log == pytest.approx(100.0)


def test_the_tangent_of_a_hypothesis_says_nothing_of_other_effects() -> None:
    """A set that fits better without an effect may fit worse with it."""
    full = [rival(("gravity",), "1", 100), rival((), "1", 10)]
    table = HypothesisTable(own=full, full=full)
    table.add_sets(full[1], {frozenset("1"): Evidence(10.0, 5.0, 1.0), frozenset("2"): Evidence(40.0, 5.0, 1.0)})
    assert less("2") in table.posterior().evaluations
    assert less("2", "gravity") not in table.posterior().evaluations
    # What gives or comes off is known about the same hypothesis.
    table.add_springs(full[1], {less("2", "soft_anchor"): 30.0})
    found = table.posterior().evaluations[less("2", "soft_anchor")]
    assert (found.log, found.about) == (30.0, less("1"))
    assert found.log_prior == log_prior(1, False, 20)


def test_what_a_tangent_missed_tells_how_much_others_are_worth() -> None:
    base, rough = rival((), "1", 100), [rival((), "1", 40), rival((), "12", 40), rival((), "13", 40)]
    tangents = {less(s): TangentEvidence(effects={"fibres": 70.0}, known=20) for s in ("12", "13")}
    full = [base, rival((), "12", 100), rival(("fibres",), "12", 98)]
    before, after = (HypothesisTable(own=some, full=some, coarse=[stage(rough, tangents)]) for some in (full[:2], full))
    assert (30.0, -2.0) in [(pair.low, pair.high) for pair in after.posterior().pairs]
    assert before.odds.acting("fibres") > 0.9 > after.odds.acting("fibres")


def test_what_a_few_steps_missed_of_a_set_says_nothing_of_an_effect_on_another() -> None:
    """An effect that neither its tangent nor a fit to all steps shows was not missed by the tangent."""
    base, rough = rival((), "1", 100), [rival((), "1", 40), rival((), "2", 39)]
    tangents = {less("1"): TangentEvidence(effects={"fibres": 38.0}, known=20)}
    full = [base, rival((), "2", 10), rival(("fibres",), "1", 99.5)]
    pairs = HypothesisTable(own=full, full=full, coarse=[stage(rough, tangents)]).posterior().pairs
    assert [(pair.low, round(pair.high, 3)) for pair in pairs] == [(-1.0, -90.0), (-2.0, -0.5)]


def test_odds_follow_whatever_comes_to_be_known() -> None:
    base = rival((), "1", 100)
    table = HypothesisTable(own=[base], full=[base])
    seen = [table.odds.probabilities]
    table.add_stage(stage([rival((), "1", 40), rival((), "12", 39)]))
    seen.append(table.odds.probabilities)
    table.add_sets(base, {base.anchors: Evidence(100.0, 50.0, 1.0), frozenset("13"): Evidence(99.0, 50.0, 1.0)})
    seen.append(table.odds.probabilities)
    table.refuse(less("13"))
    seen.append(table.odds.probabilities)
    assert all(before != after for before, after in pairwise(seen))
    assert table.odds is table.odds


def test_of_an_effect_it_is_told_how_probable_it_is_whatever_else_acts() -> None:
    names = {"gravity": 0.6, "gravity+fibres": 0.3, "": 0.1}
    odds = HypothesisOdds.of({less("1", name): math.log(share) for name, share in names.items()})
    nothing: Any = None
    found = Explanation("gravity", odds, (), nothing, (), nothing, {}, 0.0)
    assert found.probability == pytest.approx(0.9)
    assert found.ambiguous == ("gravity+fibres", "none")
    assert Explanation("none", odds, (), nothing, (), nothing, {}, 0.0).probability == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("verdict", "by", "sudden", "words"),
    [
        ("unknown", 2, 0.9, "step 2 of action a"),
        ("unknown", 4, 0.9, "step 1 of action b"),
        ("unknown", 2, 0.4, ""),
        ("none", 2, 0.9, ""),
    ],
)
def test_by_when_something_unknown_has_begun_is_told_where_that_is_the_likeliest(
    verdict: str, by: int, sudden: float, words: str
) -> None:
    best = rival((), "1", 100)
    evidence = Evidence(100.0, 150.0, 1.0, begins=ChangePoint(by, 60.0), sudden=sudden)
    state: Any = best.fitted.state
    frames = {"action": list("aaabbb"), "step": [0, 1, 2] * 2}
    data = {name: SimpleNamespace(values=np.array(values)) for name, values in frames.items()}
    state.predictor = SimpleNamespace(measurement=SimpleNamespace(data=data))
    nothing: Any = None
    rung: Any = SimpleNamespace(state=state)
    odds = HypothesisOdds.of({less("1"): 0.0})
    found = Explanation(verdict, odds, (rung,), nothing, (replace(best, evidence=evidence),), nothing, {}, 0.0)
    change = found.change_point
    assert (change is not None) == bool(words)
    assert change is None or words == f"step {change.step} of action {change.action}"


PLAIN: Any = SimpleNamespace(terms=(), added=lambda _: [])


def test_what_is_weighed_once_is_not_weighed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless another error of the mesh is the largest: then all are."""
    asked = []

    def allowing(self: FittedHypothesis, left: Any, begun: Any) -> FittedHypothesis:
        asked.append("".join(self.anchors))
        return self

    monkeypatch.setattr(FittedHypothesis, "allowing", allowing)
    compared, begun = HypothesisTable(), cast("Any", None)
    first, second, third = (rival((), name, 100.0, mesh=mesh) for name, mesh in (("1", 1.0), ("2", 0.5), ("3", 2.0)))
    for one in (first, second, third):
        one.fitted.state.errors.mesh = SimpleNamespace(left=np.ones(3))
    compared.add([first], begun)
    compared.add([second], begun)
    assert asked == ["1", "2"]
    compared.add([third], begun)
    assert sorted(asked[2:]) == ["1", "2", "3"]
    assert {r.anchors for r in compared.full} == {frozenset(name) for name in "123"}


def test_what_cannot_be_followed_is_not_asked_for_again() -> None:
    full = [rival(("gravity",), "1", 100), rival((), "2", 80)]
    compared = HypothesisTable(own=full, full=full)
    compared.refuse(less("1"))
    assert compared.unopposed() is None


def test_all_hypotheses_are_compared_with_one_error_of_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether that makes one likelier or less likely; and so is what it lacks."""

    @dataclass
    class Mesh:
        left: Any

    errors = SimpleNamespace(mesh=Mesh(0.0), whiten=np.array, unwhiten=np.array)
    data = np.zeros(4)
    wide: Any = SimpleNamespace(errors=errors)
    one = rival(("gravity",), "1", 100.0)
    state: Any = one.fitted.state
    state.errors, state.predictor = errors, SimpleNamespace(data=data)
    state.with_errors = lambda mesh: wide if mesh.left == 1.0 else None
    cast("Any", one.fitted).jacobian = np.ones((4, 1))
    monkeypatch.setattr(
        fitted_hypothesis, "weighed", lambda found, *_: Evidence(400.0, 20.0, 1.0) if found is wide else None
    )
    found = one.allowing(cast("Any", 1.0), PLAIN)
    assert (found.evidence.plain, found.evidence.forced) == (400.0, 20.0)
    assert found.judged is wide


@pytest.mark.parametrize(("gain", "asked"), [(48.5, True), (5.0, False)], ids=["counts", "hopeless"])
def test_a_known_effect_that_counts_is_fitted_before_something_unknown_is_said_to_be_missing(
    gain: float, asked: bool
) -> None:
    """What a tangent promises of it where much is to be explained is no measure of what it explains."""
    best = replace(rival((), "1", 100), evidence=Evidence(100.0, 160.0, 1.0))
    tangents = {best.hypothesis: TangentEvidence(effects={"gravity": 100.0 + gain}, known=1)}
    known = HypothesisTable(own=[best], full=[best], tangents=tangents)
    assert known.odds.best.unknown
    assert known.doubtful() == (less("1", "gravity") if asked else None)
    plain = HypothesisTable(own=[rival((), "1", 100)], full=[rival((), "1", 100)], tangents=tangents)
    assert plain.doubtful() is None
