"""What is believed most is fitted, and so is the same without each of its effects: an effect is believed against that."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bcid.base.progress import Silent
from bcid.comparison import contest, hypothesis_search, rivals
from bcid.comparison.contest import Contest, _in_turn, _with_own_mesh, refitted
from bcid.comparison.diagnosis_text import _alone, _begins, _called, _look
from bcid.comparison.explanation import Explanation
from bcid.comparison.hypothesis_search import HypothesisSearch, Look, Promised
from bcid.comparison.hypothesis_table import HypothesisTable
from bcid.comparison.loosened import Loosened
from bcid.comparison.ranking import Ranking
from bcid.comparison.rivals import Rival
from bcid.forms import effects
from bcid.forms.model import Term
from bcid.inference.criteria import FAILS_FOR_THE_TRUE
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, log_prior
from bcid.inference.sudden_force import Beginning
from bcid.inference.unknown_force import Evidence


def rival(
    names: tuple[str, ...],
    anchors: str,
    evidence: float,
    terms: tuple[Term, ...] = (),
    mesh: float = 0.0,
    stderr: float = 0.0,
) -> Rival:
    """A hypothesis that was compared with all steps, with so much evidence and error of the mesh."""
    errors = SimpleNamespace(mesh_rms=mesh)
    model = SimpleNamespace(terms=terms)
    predictor = SimpleNamespace(data=SimpleNamespace(stated=False))
    state = SimpleNamespace(anchors=frozenset(anchors), noise=1.0, errors=errors, model=model, predictor=predictor)
    errors_of = {term.full(name): stderr for term in terms for name in term.values}
    fitted = SimpleNamespace(state=state, coordinates=names, stderr=errors_of)
    return Rival(names, cast("Any", fitted), Evidence(evidence, evidence - 50, 1.0), 20)


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
def test_an_effect_is_weighed_against_the_same_anchors_without_it(full: list[Rival], wanted: Hypothesis | None) -> None:
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

    def odds(_: Rival, moves: dict[frozenset[str], Any], *__: Any) -> dict[frozenset[str], float]:
        shown.update({s: float(moved.max()) for s, moved in moves.items()})
        return dict.fromkeys(moves, 0.0)

    monkeypatch.setattr(Rival, "_shown", odds)
    nothing: Any = None
    sets = [frozenset("1"), frozenset("2"), frozenset("3")]
    assert best.without_a_patch(sets, 2, nothing, nothing) == [frozenset("1"), frozenset("2")]
    assert shown == {frozenset("1"): 0.0, frozenset("2"): 1.0}


def test_changes_uncertain_hypothesis_is_worth_an_evaluation() -> None:
    """As much as whether it is true varies; one where it is the most probable; none where it was refused."""
    full = [rival((), "1", 100), rival((), "2", 98)]
    rough = [rival((), "1", 40), rival(("gravity",), "1", 43), rival(("fibres",), "1", -400)]
    table = HypothesisTable(own=full, full=full, coarse=[Contest(rough, {})])
    found = table.changes()
    assert set(found) == {less("1", "gravity"), less("1", "fibres")}
    assert 1e-3 < found[less("1", "gravity")] < 0.25
    assert found[less("1", "fibres")] < 1e-4
    rough[1] = rival(("gravity",), "1", 60)
    likely = HypothesisTable(own=full, full=full, coarse=[Contest(rough, {})])
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
    base, rough = rival((), "1", 100), [rival((), "1", 40), rival((), "12", 37), rival(("gravity",), "1", 38)]
    promised = Promised(less("12", "gravity"), less("12"), 39.0, log_prior(1, False, 20))
    table = HypothesisTable(own=[base], full=[base], coarse=[Contest(rough, {promised.hypothesis: promised})])
    found = table.posterior().evaluations
    assert {h.label("12"): round(one.gain, 3) for h, one in found.items() if not h.unknown} == {
        "{1}": 0.0,
        "{1 2}": -3.0,
        "{1} + gravity": -2.0,
        "{1 2} + gravity": -1.0,
    }
    assert {one.base for one in found.values() if one.toggles} == {100.0}
    assert len(found[promised.hypothesis].toggles) == 2
    # That a hypothesis cannot be followed to the end says little against it, and nothing for it.
    before = found[less("12")]
    table.refuse(less("12"))
    refused = table.posterior().evaluations[less("12")]
    assert refused.gain == before.gain
    assert refused.log_prior == pytest.approx(before.log_prior + math.log((FAILS_FOR_THE_TRUE + 1) / 3))
    assert less("12") not in table.changes()
    table.refuse(promised.hypothesis)
    table.coarse = [Contest(rough, {promised.hypothesis: replace(promised, log=400.0)})]
    assert table.posterior().evaluations[promised.hypothesis].gain == 0.0


def test_odds_follow_whatever_comes_to_be_known() -> None:
    base = rival((), "1", 100)
    table = HypothesisTable(own=[base], full=[base])
    seen = [table.odds.probabilities]
    table.add_stage(Contest([rival((), "1", 40), rival((), "12", 39)], {}))
    seen.append(table.odds.probabilities)
    table.add_sets(base, {base.anchors: Evidence(100.0, 50.0, 1.0), frozenset("13"): Evidence(99.0, 50.0, 1.0)})
    seen.append(table.odds.probabilities)
    table.refuse(less("13"))
    seen.append(table.odds.probabilities)
    assert all(before != after for before, after in pairwise(seen))
    assert table.odds is table.odds


def test_promises_that_were_fitted_tell_how_much_others_are_worth() -> None:
    base, rough = rival((), "1", 100), [rival((), "1", 40), rival((), "12", 40), rival((), "13", 40)]
    promised = [
        Promised(less(anchors, "fibres"), less(anchors), 70.0, log_prior(1, False, 20)) for anchors in ("12", "13")
    ]
    stage = Contest(rough, {one.hypothesis: one for one in promised})
    full = [base, rival(("fibres",), "12", 98)]
    before, after = (HypothesisTable(own=some, full=some, coarse=[stage]) for some in ([base], full))
    assert [(pair.low, pair.high) for pair in after.posterior().pairs] == [(30.0, -2.0)]
    assert before.odds.acting("fibres") > 0.9 > after.odds.acting("fibres")


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
        ("unknown", 2, 0.9, "shows by step 2 of action a:"),
        ("unknown", 4, 0.9, "shows by step 1 of action b:"),
        ("unknown", 2, 0.4, ""),
        ("none", 2, 0.9, ""),
    ],
)
def test_by_when_something_unknown_has_begun_is_told_where_that_is_the_likeliest(
    verdict: str, by: int, sudden: float, words: str
) -> None:
    best = rival((), "1", 100)
    evidence = Evidence(100.0, 150.0, 1.0, begins=Beginning(by, 60.0), sudden=sudden)
    state: Any = best.fitted.state
    frames = {"action": list("aaabbb"), "step": [0, 1, 2] * 2}
    data = {name: SimpleNamespace(values=np.array(values)) for name, values in frames.items()}
    state.predictor = SimpleNamespace(measurement=SimpleNamespace(data=data))
    nothing: Any = None
    rung: Any = SimpleNamespace(state=state)
    odds = HypothesisOdds.of({less("1"): 0.0})
    found = Explanation(verdict, odds, (rung,), nothing, (replace(best, evidence=evidence),), nothing, {}, 0.0)
    lines = _begins(found)
    assert [words in line for line in lines] == [True] * bool(words)
    assert (found.begins is not None) == bool(words)
    assert bool(_look(found)) == (not words)


PLAIN: Any = SimpleNamespace(terms=(), added=lambda _: [])


def promise(anchors: str, effect: str, log: float, gain: float = 0.0, forced: float = 0.0) -> Any:
    """What sensitivities promise of an effect with a set; of the set alone without an effect."""
    evidence = SimpleNamespace(plain=0.0, forced=forced)
    row = SimpleNamespace(effect=effect, gain=gain, term=Term("gravity", {"weight": 1.0})) if effect else None
    predictor = SimpleNamespace(progress=Silent(), data=())
    state = SimpleNamespace(anchors=frozenset(anchors), predictor=predictor, model=PLAIN)
    state.with_own_errors = lambda: state
    look = SimpleNamespace(evidence=evidence, state=state)
    return SimpleNamespace(anchors=frozenset(anchors), row=row, log=log, look=look, evidence=log, log_prior=0.0)


@pytest.mark.parametrize(("forced", "second"), [(200.0, ("346", "foundation")), (-5.0, ("123568", "fibres"))])
def test_what_explains_most_on_the_likeliest_set_is_fitted_second(forced: float, second: tuple[str, str]) -> None:
    """Where something unknown acts with that: other sets may promise more that only seem to hold the body."""
    promises = [
        promise("123568", "release", 400.0, 300.0),
        promise("123568", "fibres", 300.0, 90.0),
        promise("346", "", 200.0, forced=forced),
        promise("346", "fibres", 70.0, 60.0),
        promise("346", "foundation", 69.0, 80.0),
        promise("123568", "", 60.0),
        promise("123568", "foundation", 50.0, 8.0),
    ]
    turns = [("".join(sorted(p.anchors)), p.row.effect) for p in _in_turn(promises, {}) if p.row]
    assert turns[:2] == [("123568", "release"), second]
    # What promises most anyway keeps the set with which it does.
    promises.insert(0, promise("123568", "foundation", 500.0, 8.0))
    turns = [("".join(sorted(p.anchors)), p.row.effect) for p in _in_turn(promises, {}) if p.row]
    assert turns[:2] == [("123568", "foundation"), ("123568", "release")]


def refits(
    monkeypatch: pytest.MonkeyPatch, fits: dict[tuple[str, str], float], unlikely: float
) -> list[tuple[str, str]]:
    """What is refitted from here on, in order: sets and effects that have these evidences then."""
    asked: list[tuple[str, str]] = []

    def fitted(state: Any, row: Any, *_: object) -> list[Rival]:
        asked.append(("".join(sorted(state.anchors)), row.effect))
        return [rival((row.effect,), asked[-1][0], fits[asked[-1]])]

    monkeypatch.setattr(contest, "refit", fitted)
    monkeypatch.setattr(contest, "moved", lambda *_: [])
    monkeypatch.setattr(contest, "_unlikely", lambda _: unlikely)
    monkeypatch.setattr(contest, "_with_own_mesh", lambda rivals, _: rivals)
    return asked


def test_an_effect_that_loses_is_tried_on_the_set_that_it_loses_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its sensitivities may promise most of it where it does not act."""
    fits = {
        ("147", "inclusion"): 310.0,
        ("127", "gradient"): 200.0,
        ("147", "gradient"): 320.0,
        ("147", "fibres"): 100.0,
    }
    asked = refits(monkeypatch, fits, 400.0)
    promises = [
        promise("147", "inclusion", 300.0, 90.0),
        promise("127", "gradient", 190.0, 80.0),
        promise("147", "fibres", 110.0, 70.0),
        promise("127", "fibres", 90.0, 60.0),
        promise("147", "gradient", 80.0, 50.0),
        promise("147", "", 0.0, forced=-5.0),
    ]
    found = refitted(promises, PLAIN, 3, 5)
    assert asked == [("147", "inclusion"), ("127", "gradient"), ("147", "gradient"), ("147", "fibres")]
    assert (found.rivals[0].names, found.rivals[0].anchors) == (("gradient",), frozenset("147"))


def test_what_is_weighed_once_is_not_weighed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless another error of the mesh is the largest: then all are."""
    asked = []

    def allowing(self: Rival, left: Any, begun: Any) -> Rival:
        asked.append("".join(self.anchors))
        return self

    monkeypatch.setattr(Rival, "allowing", allowing)
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


def test_what_promised_as_much_may_do_better_than_it_promised_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """What promises less than the best did by more than it was off is not fitted."""
    fits = {("7", "compressibility"): 320.0, ("7", "viscosity"): 330.0}
    asked = refits(monkeypatch, fits, 3.0)
    promises = [
        promise("7", "compressibility", 300.0, 33.0),
        promise("7", "viscosity", 298.0, 31.0),
        promise("7", "fibres", 260.0, 3.0),
        promise("7", "", 0.0, forced=-5.0),
    ]
    found = refitted(promises, PLAIN, 3, 5)
    assert asked == [("7", "compressibility"), ("7", "viscosity")]
    assert found.rivals[0].names == ("viscosity",)


@pytest.mark.parametrize(("forced", "last"), [(20.0, ["swelling", "gravity"]), (-20.0, [])])
def test_where_nothing_fitted_explains_all_others_are_tried_in_part(
    monkeypatch: pytest.MonkeyPatch, forced: float, last: list[str]
) -> None:
    """What is likelier than the best then is fitted, the likeliest first; nothing where something fitted explains all."""
    fits = {("7", name): 90.0 for name in ("release", "swelling", "gravity")}
    in_part = {"swelling": 150.0, "gravity": 140.0, "fibres": 100.0}
    asked = refits(monkeypatch, fits, 3.0)
    monkeypatch.setattr(contest, "_log_in_part", lambda promise, *_: in_part[promise.row.effect])
    best = replace(rival((), "7", 110.0), evidence=Evidence(110.0, 110.0 + forced, 1.0))
    monkeypatch.setattr(contest, "best_first", lambda _: [best])
    promises = [
        promise("7", "release", 300.0, 250.0),
        promise("7", "gravity", 60.0, 10.0),
        promise("7", "swelling", 50.0, 5.0),
        promise("7", "fibres", 49.0, 4.0),
        promise("7", "tether", -math.inf, -math.inf),
        promise("7", "", 100.0, forced=forced),
        promise("8", "swelling", 40.0, 3.0),
    ]
    refitted(promises, PLAIN, 5, 1)
    assert asked == [("7", name) for name in ["release", *last]]


def test_effects_are_compared_with_the_error_of_the_mesh_that_each_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a coarse mesh that of the plain model may make a wrong one fit best."""
    gains, asked = {"inclusion": 40.0, "gradient": 70.0, "fibres": 5.0, "swelling": 500.0}, []

    def own(one: Rival, _: object) -> Rival:
        asked.append(one.effect)
        return one.gaining(gains[one.effect], gains[one.effect])

    monkeypatch.setattr(contest, "with_own_mesh", own)
    rivals = [
        rival((), "12", 150, mesh=0.6),
        rival(("inclusion",), "1", 200, mesh=0.6),
        rival(("inclusion",), "2", 198, mesh=0.6),
        rival(("gradient",), "1", 185, mesh=0.6),
        rival(("fibres",), "1", 175, mesh=0.6),
        rival(("swelling",), "1", 174, mesh=0.6),
    ]
    found = {(r.names[-1:], "".join(sorted(r.anchors))): r.evidence.plain for r in _with_own_mesh(rivals, PLAIN)}
    # Beside one that does not catch up the others are not asked: they were less likely before.
    assert asked == ["inclusion", "gradient", "fibres"]
    assert found == {
        ((), "12"): 150,
        (("inclusion",), "1"): 240,
        (("inclusion",), "2"): 238,
        (("gradient",), "1"): 255,
        (("fibres",), "1"): 180,
        (("swelling",), "1"): 174,
    }
    # What loses by it is not compared with others that were not asked.
    gains |= {"inclusion": -30.0, "gradient": -20.0}
    asked.clear()
    _with_own_mesh(rivals, PLAIN)
    assert asked == ["inclusion", "gradient", "fibres", "swelling"]
    # What is alone is not asked, nor where the mesh leaves little.
    asked.clear()
    _with_own_mesh(rivals[:3], PLAIN)
    _with_own_mesh([rival((name,), "1", 100, mesh=0.4) for name in ("inclusion", "gradient")], PLAIN)
    assert asked == []


def test_what_cannot_be_followed_is_not_asked_for_again() -> None:
    full = [rival(("gravity",), "1", 100), rival((), "2", 80)]
    compared = HypothesisTable(own=full, full=full)
    compared.refuse(less("1"))
    assert compared.unopposed() is None


def test_an_effect_is_told_to_act_alone_where_others_may_act_with_it() -> None:
    told = ["gravity", "gravity+swelling", "unknown", "none"]
    assert [name + _alone(name, told) for name in told] == ["gravity alone", *told[1:]]


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
    monkeypatch.setattr(rivals, "weighed", lambda found, *_: Evidence(400.0, 20.0, 1.0) if found is wide else None)
    found = one.allowing(cast("Any", 1.0), PLAIN)
    assert (found.evidence.plain, found.evidence.forced) == (400.0, 20.0)
    assert found.judged is wide


def test_every_set_that_may_give_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not only those that fit best: a patch that hardly holds may be any of several."""
    soft, about = effects.effect("soft_anchor"), frozenset("1")
    ways = {"12": [-1.0, -1.0], "13": [-2.0], "14": [-3.0], "15": [-9.0]}
    loose = [
        Loosened(frozenset(s), Term(soft, {"stiffness": 4e4}, place=s[1]), np.zeros(0), -gain, gain)
        for s, gains in ways.items()
        for gain in gains
    ]
    monkeypatch.setattr(hypothesis_search, "loosened", lambda *_: loose)
    predictor = SimpleNamespace(scene=SimpleNamespace(patches=dict.fromkeys("12345")), thin=True)
    state: Any = SimpleNamespace(anchors=about, predictor=predictor, model=PLAIN)
    search = HypothesisSearch(state, PLAIN, [soft], 5, among=20)
    search.looks[about] = Look(state, Evidence(50.0, 40.0, 1.0), Ranking(()))
    monkeypatch.setattr(search, "_look", lambda s: search.looks.setdefault(s, None))
    search._loosen(about)
    expected = {less(s, "soft_anchor"): 50 + math.log(sum(map(math.exp, gains))) for s, gains in ways.items()}
    found = search.giving()
    assert {h: one.log for h, one in found.items()} == pytest.approx(expected)
    assert {one.log_prior for one in found.values()} == {log_prior(1, False, 20)}
    # They are told beside what was fitted, unless that is how anchors give.
    monkeypatch.setattr(contest, "at_a_glance", lambda base, work: work(base))
    monkeypatch.setattr(contest, "HypothesisSearch", lambda *_, **__: search)
    monkeypatch.setattr(search, "run", lambda _: [])
    gravity = Promised(less("1", "gravity"), less("1"), 1.0, 0.0)
    for name, wanted in (("fibres", set(expected)), ("soft_anchor", set())):
        told = Contest([rival((name,), "12", 60.0)], {gravity.hypothesis: gravity})
        monkeypatch.setattr(contest, "refitted", lambda *_, told=told, **__: told)
        promised = contest.contest(state, PLAIN, [soft], [], 5, 5).promised
        assert set(promised) == wanted | {less("1", "gravity")}


def test_something_unknown_is_told_beside_the_effects_that_it_acts_with() -> None:
    """A verdict that names an effect, and something unknown as probable: both, if the unknown acts beside it."""
    odds = HypothesisOdds(
        {Hypothesis(frozenset("3"), "obstacle", True): 0.7, Hypothesis(frozenset("3"), "", True): 0.3}
    )
    assert _called(odds, "unknown") == "something unknown, most likely beside obstacle,"
    assert _called(HypothesisOdds({Hypothesis(frozenset("3"), "", True): 1.0}), "unknown") == "something unknown"
    assert _called(odds, "gravity") == "gravity"
