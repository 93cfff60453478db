"""What was found, in sentences and tables that a lab uses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bcid.base.units import (
    UNTOLD,
    falls,
    for_people,
    force_unit,
    hardly_falls,
    limited,
    p_value,
    percent,
    significance,
    uncertain,
)
from bcid.forms.course import Course, course_of
from bcid.forms.model import Term
from bcid.forms.parameter import Parameter
from bcid.inference import nuisance_text
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, label
from bcid.inference.thresholds import THRESHOLDS
from bcid.results.common_rows import unknown_thickness
from bcid.results.diagnosis_record import SeparatingPull, TimeHistory
from bcid.results.words import NO_EFFECTS, not_adequate_either, pull_text
from bcid.search.answer.adequacy import BREAKING, Adequacy, groups
from bcid.search.answer.evidence_split import PARTS, EvidenceSplit, no_better_fit
from bcid.search.answer.explanation import Explanation, ModelStep
from bcid.search.answer.where import MissingForce
from bcid.search.fitting import curvature
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.ranking import Ranking, Row
from bcid.search.fitting.state import State

# A hypothesis with a smaller probability is not told.
_LITTLE = 0.005
# A force that explains a smaller share of what is beyond noise is none.
_NOTHING = 0.1
# A pull separates two explanations when their predictions are so many times the noise apart.
_SEPARATE = 5.0


def anchors(state: State) -> str:
    """An anchor set: "{1 2}"."""
    return label(state.anchors, state.predictor.whole.patches)


def term(one: Term, errors: Mapping[str, float], limits: Mapping[str, float] | None = None) -> str:
    """An effect with its numbers: "gravity: weight = 305 ± 4 N/m^3"; a course by its least and its largest value.

    Of a number that ended at a bound its limit: "stiffness at least 2.1e6 Pa/m (95 %)".
    """
    course = course_of(one.effect)
    parts = [] if course is None else [_ends(one, course, p, errors) for p in course.effect.amounts]
    for p in one.effect.parameters if course is None else one.effect.shapes:
        value, error, unit = for_people(one.values[p.name], errors.get(p.name), p.unit)
        limit = (limits or {}).get(p.name)
        if limit is None:
            parts.append(f"{p.name} = {uncertain(value, error, unit)}")
        else:
            parts.append(f"{p.name} {limited(one.values[p.name], limit, p.unit)}")
    return f"{one.label}: {', '.join(parts)}"


def law(fitted: Fit) -> list[str]:
    """Fitted constants of the law: "young = 2.64e+05 Pa (95 %: 2.4e+05 to 2.9e+05)"."""
    lines, constants = [], fitted.law
    for name, one in constants.items():
        unit = "" if one.unit == "1" else f" {one.unit}"
        if one.interval is None:
            lines.append(f"  {name} is not identifiable from these data")
        else:
            low, high = one.interval
            lines.append(f"  {name}{one.times} = {one.value:.4g}{unit} (95 %: {low:.3g} to {high:.3g})")
    return [f"Fitted constants of the law{unknown_thickness(constants.values())}:", *lines] if lines else []


def own(fitted: Fit, one: Term, of: Mapping[str, float]) -> dict[str, float]:
    """What a fit has of the numbers of one of its effects, by parameter."""
    return {name: of[one.full(name)] for name in one.values if one.full(name) in of}


def _ends(one: Term, course: Course, amount: Parameter, errors: Mapping[str, float]) -> str:
    """Least and largest value of an amount in time: "amplitude from −310 ± 9 Pa (at 10 s) to 290 ± 11 Pa (at 20 s)"."""
    names, told = course.names(amount.name), []
    values = [one.values[name] for name in names]
    if all(errors.get(name, 0.0) > UNTOLD for name in names):
        return f"{amount.name} cannot be told"
    for k in (values.index(min(values)), values.index(max(values))):
        value, error, unit = for_people(values[k], errors.get(names[k]), amount.unit)
        told.append(f"{uncertain(value, error, unit)} (at {course.times[k]:.4g} s)")
    return f"{amount.name} from {told[0]} to {told[1]}"


def in_time(row: TimeHistory) -> str:
    """A time history in a sentence: "active_stress: amplitude swings between −310 and 290 Pa"."""
    at = f" at {row.place}" if row.place else ""
    p, who = row.p_constant, f"{row.effect}{at}: {row.amount}"
    if p is None:
        return f"{who}: whether it changes with time is not told."
    if p > THRESHOLDS.surprise:
        return f"{who} may as well be constant ({p_value(p)})."
    (low, _, unit), (high, _, _) = (for_people(end, None, row.unit) for end in (min(row.values), max(row.values)))
    return (
        f"{who} swings between {uncertain(low)} and {uncertain(high, None, unit)} ({p_value(p)} that it is constant)."
    )


def warning(rung: ModelStep) -> list[str]:
    """What must stand above the result: that the model leaves far more than noise, or that this cannot be told."""
    state, lines = rung.state, []
    if not state.predictor.data.stated:
        lines.append(
            f"WARNING: no noise is known: {1e3 * state.noise:.3g} mm is only estimated from the measurement itself, "
            "so that no model can be called adequate. State noise_sigma."
        )
    if state.rms > THRESHOLDS.residual * state.noise and not rung.adequacy.adequate:
        lines.append(
            f"WARNING: the model misses the measurement by {state.rms / state.noise:.1f} times the noise "
            f"({1e3 * state.rms:.3g} mm where it is {1e3 * state.noise:.3g} mm)."
        )
    return lines + nuisance_text.warnings(nuisance_text.rows(state.told))


def noise_doubt(found: Explanation) -> str:
    """Why the noise that is stated is not believed; "" where it is, or where none is stated."""
    if found.noise is None or not found.last.state.predictor.data.stated:
        return ""
    share = found.noise.factor
    rest = "; the rest of it is taken for errors that persist along trajectories" if share < 1 else ""
    return (
        f"the noise is stated as {found.noise.sigma / share * 1e3:.3g} mm, but what is left of it, smooth parts aside, "
        f"is {share:.2g} times as large ({found.noise.sigma * 1e3:.3g} mm), which is taken instead{rest}"
    )


def beliefs(found: Explanation) -> list[str]:
    """Probabilities of verdicts, sets and hypotheses."""
    names = list(found.last.state.predictor.whole.patches)
    told = {_called(found.odds, name): p for name, p in found.odds.verdicts.items() if p > _LITTLE}
    effects = ", ".join(f"{name}{_alone(name, told)} {percent(p)}" for name, p in told.items())
    lines = [f"How probable: {effects}."]
    likely = [(h, p) for h, p in found.odds.probabilities.items() if p > _LITTLE][:6]
    lines += [f"  {_hypothesis(h, names)}: {percent(p)}" for h, p in likely]
    lines += [
        f"  {_hypothesis(r.hypothesis, names)} counts as the set without the patch: its springs may have no stiffness."
        for r in found.slack
    ]
    if found.neglected > _LITTLE:
        lines.append(
            f"  {percent(found.neglected)} of the probability is of hypotheses that were not fitted to all steps."
        )
    return lines + _split(found.splits, names)


def _hypothesis(h: Hypothesis, names: Iterable[str]) -> str:
    return h.label(names) + (" and something unknown" if h.unknown else "")


def _split(splits: Sequence[EvidenceSplit], names: Sequence[str]) -> list[str]:
    """Why the first of some hypotheses is more probable than the others."""
    if len(splits) < 2:
        return []
    called = [_hypothesis(one.hypothesis, names) for one in splits]
    wide = max(len(name) for name in called)
    heads = ("misfit", "volume", "Occam", "discrepancy", "prior", "sum")
    lines = [
        f"Why this and not that (log evidence, against the first):\n  {'':{wide}s}{''.join(f'{h:>13s}' for h in heads)}"
    ]
    for name, one in zip(called, splits, strict=True):
        parts = (*(getattr(one, part) for part in PARTS), one.total)
        lines.append(f"  {name:{wide}s}{''.join(f'{part:+13.1f}' for part in parts)}")
    if alike := no_better_fit(splits):
        first, other = (_hypothesis(each.hypothesis, names) for each in (splits[0], alike))
        lines.append(f"  {first} fits no better than {other}: the rest of the table makes it more probable.")
    return lines


def _called(odds: HypothesisOdds, verdict: str) -> str:
    """What a verdict is called where probabilities are told: something unknown with the effects that it most likely acts beside."""
    if verdict != "unknown":
        return verdict
    beside = next(h.effect for h in odds.probabilities if h.unknown)
    return f"something unknown, most likely beside {beside}," if beside else "something unknown"


def _alone(name: str, told: Iterable[str]) -> str:
    """What is said of effects where the same ones with others are told too."""
    return " alone" if any(set(name.split("+")) < set(other.split("+")) for other in told) else ""


def verdict(state: State, adequacy: Adequacy, unit: float, name: str) -> list[str]:
    """Whether a model is adequate, and what the tests say."""
    errors = state.errors
    known = f"{errors.mesh_rms / unit:.2g} {name}" if errors.mesh.known else "not known"
    believed = state.predictor.data.stated and state.predictor.noise is None
    stated = "stated" if believed else "estimated from the measurement"
    known_so = adequacy.told is not None
    is_so = "is" if known_so else "has"
    untold = "" if known_so else "; whether it is adequate cannot be told without a stated noise"
    lines = [
        f"{state.model.name} with anchors {anchors(state)} {is_so} {adequacy.word.upper()} ({p_value(adequacy.p_value)}{untold}).",
        f"  It misses the measurement by {state.rms / unit:.3g} {name} per coordinate (RMS), {state.rough / unit:.3g} of it like "
        f"noise; noise {state.noise / unit:.3g} {name} ({stated}), error of the mesh {known}.",
        *(f"  {line}" for line in nuisance_text.allowed(nuisance_text.rows(state.told))),
        *(
            f"  In action {action} that moves the body otherwise than to first order, as near an instability: "
            f"{missed / unit:.2g} {name} (RMS) are allowed for."
            for action, missed in curvature.allowed(state).items()
        ),
    ]
    for finding in adequacy.findings:
        mark = "decides" if finding.decides else "       "
        lines.append(f"  {mark}  {finding.name:22s} {p_value(finding.p_value):12s} {finding.text}")
    return lines


def worst(state: State) -> list[str]:
    """Where the residual is largest."""
    found = groups(state)
    lines = ["Where it fails (RMS residual in units of noise):"]
    for what in ("action", "fiducial", "axis"):
        ordered = sorted(found[what].items(), key=lambda item: -item[1])[:6]
        lines.append(f"  by {what:9s}" + ",  ".join(f"{name}: {value:.2f}" for name, value in ordered))
    steps = list(found["step"].items())
    chosen = steps if len(steps) <= 8 else [steps[i] for i in np.linspace(0, len(steps) - 1, 8).astype(int)]
    lines.append("  by step     " + ",  ".join(f"{name}: {value:.2f}" for name, value in chosen))
    return lines


def force(found: MissingForce, unit: float, name: str) -> list[str]:
    """The force that would explain the residual."""
    if found.explained < _NOTHING:
        return ["No missing force can be told from these data."]
    lines = [
        f"A smooth force on the body would explain {percent(found.explained)} of what is beyond noise "
        f"(residual then {found.rms / unit:.3g} {name}). If the stiffness is right it is, to first order, with its largest parts:"
    ]
    parts = [("in all frames", place) for place in found.steady.regions]
    for action, growing in found.growing.items():
        parts += [(f"action {action}, growing", place) for place in growing.regions]
    parts.sort(key=lambda pair: -float(np.linalg.norm(pair[1].force)))
    shown = [("together", "in all frames", found.steady.together)]
    for when, place in parts[:6]:
        shown.append((f"at ({' '.join(f'{v / unit:.0f}' for v in place.position)}) {name}", when, place))
    per_newton, newtons = force_unit(max(float(np.linalg.norm(place.force)) for *_, place in shown))
    for what, when, place in shown:
        push = " ".join(f"{per_newton * v:+.2f}" for v in place.force)
        lines.append(f"  {what}: ({push}) {newtons} ± {per_newton * place.stderr:.2f}, {when}")
    return lines


def table(
    ranking: Ranking, rivals: Sequence[FittedHypothesis], now: float, unit: float, name: str, most: int = 12
) -> list[str]:
    """The ranked effects: error now, expected, and fitted."""
    fitted: dict[str, FittedHypothesis] = {}
    for rival in rivals:
        fitted.setdefault(rival.effect, rival)
    lines = [
        f"  {'effect':20s} {'error now':>9s} → {'expected':>8s} → {'fitted':>7s} {name}   "
        f"{'score':>8s} {'p':>8s} {'power':>6s}  what"
    ]
    for row in ordered(ranking, rivals)[:most]:
        own = fitted.get(row.effect)
        reached = f"{own.fitted.state.rms / unit:.3g}" if own else ""
        lines.append(
            f"  {row.effect:20s} {now / unit:9.3g} → {row.expected_rms / unit:8.3g} → {reached:>7s} {'':{len(name)}s}   "
            f"{row.score:8.0f} {significance(row.p_value):>8s} {row.power:6.2f}  {_what(row, own)}"
        )
    if ranking.excluded:
        lines.append("  not applicable: " + "; ".join(f"{n} ({why})" for n, why in ranking.excluded.items()))
    lines.append(f"  ({ranking.tried} variants were tried; p counts them all)")
    return lines


def ordered(ranking: Ranking, rivals: Sequence[FittedHypothesis]) -> list[Row]:
    """Rows with the refitted effects first, the best of them on top."""
    place: dict[str, int] = {}
    for i, rival in enumerate(rivals):
        place.setdefault(rival.effect, i)
    return sorted(ranking.rows, key=lambda row: place.get(row.effect, len(place)))


def _what(row: Row, rival: FittedHypothesis | None) -> str:
    if not row.identifiable and rival is None:
        return "not identifiable from these data"
    if row.p_value > 0.01 and rival is None:
        return "nothing of it is seen"
    one = rival.term if rival else row.term
    fitted = rival.fitted if rival else None
    errors = own(fitted, one, fitted.stderr) if fitted else row.stderr
    limits = own(fitted, one, fitted.limits) if fitted else {}
    same = f"  (like {', '.join(row.confounded_with)})" if row.confounded_with else ""
    return term(one, errors, limits).split(": ", 1)[1] + (f" at {one.place}" if one.place else "") + same


def ladder(rungs: Sequence[ModelStep], unit: float, name: str) -> list[str]:
    """The falling error."""
    lines = []
    for rung in rungs:
        apart = (
            "" if rung.held_out is None else f", actions predicted from the others {rung.held_out / unit:.3g} {name}"
        )
        word = rung.adequacy.word
        noise = f"noise {rung.state.noise / unit:.3g}"
        lines.append(f"  {rung.name:44s}  {rung.state.rms / unit:.3g} {name} ({noise}{apart}): {word}")
    return lines


def conclusion(found: Explanation, unit: float, name: str, pulls: Sequence[SeparatingPull] = ()) -> list[str]:
    """The verdict in one to three sentences."""
    first, last = found.rungs[0], found.last
    held = anchors(last.state)
    if found.verdict == "none":
        return [
            f"Nothing is missing that these data could show ({percent(found.probability)}). The plain model misses the measurement "
            f"by {last.state.rms / unit:.3g} {name}; noise ({last.state.noise / unit:.3g}), the mesh and what the scene may have "
            f"slightly wrong {'explain that' if last.adequacy.adequate else 'do not quite explain that'}.{_held(found, held)}",
            *_open(found, pulls),
        ]
    if found.verdict == "unknown":
        best = last.name if len(found.rungs) > 1 else "none of them"
        return [
            f"None of the known effects explains this measurement: {last.state.rms / unit:.3g} {name} are left where the noise is "
            f"{last.state.noise / unit:.3g} (the closest: {best}).",
            *(_begins(found) or _breaks(last)),
            f"{_look(found)}Values below are those of a model that fails.{_held(found, held)}",
            *_open(found, pulls),
        ]
    noise = last.state.noise / unit
    lines = [
        f"Missing in the plain model: {' and '.join(found.verdict.split('+'))} ({percent(found.probability)}). The error "
        f"{falls(first.state.rms / unit, last.state.rms / unit, noise, name)} (noise {noise:.3g}){_beyond(first, last)}."
        f"{_held(found, held)}",
        *([not_adequate_either(last.adequacy.p_value)] if last.adequacy.told is False else []),
    ]
    if first.state.anchors != last.state.anchors:
        same = [
            r
            for r in found.rungs
            if not r.state.model.added(first.state.model) and r.state.anchors == last.state.anchors
        ]
        alone = f"; with {held} it leaves {same[0].state.rms / unit:.3g} {name}" if same else ""
        lines.append(
            f"  Alone, the plain model does best with {anchors(first.state)}{alone}: the rest is the effect's."
        )
    for one in last.state.model.terms:
        if known := own(last.fitted, one, last.fitted.stderr):
            lines.append("  " + term(one, known, own(last.fitted, one, last.fitted.limits)))
    lines += [f"  Note: {text}" for text in last.fitted.warnings]
    return lines + _open(found, pulls)


def _beyond(first: ModelStep, last: ModelStep) -> str:
    """What of an error falls that hardly does: most of it is what the scene may have slightly wrong."""
    if not hardly_falls(first.state.rms, last.state.rms, last.state.noise):
        return ""
    before, after = (math.sqrt(rung.state.chi2 / len(rung.state.predictor.data)) for rung in (first, last))
    return f"; in units of what noise, mesh and scene explain it falls from {before:.3g} to {after:.3g}"


def _look(found: Explanation) -> str:
    """What else may tell; a force that is there all the time does not explain what begins."""
    return "" if found.change_point else "Look where the force that would explain it acts. "


def _begins(found: Explanation) -> list[str]:
    """By when what is unknown has begun, as where something tears, sticks or lets go."""
    if (onset := found.change_point) is None:
        return []
    return [
        f"It is not there from the start ({percent(onset.probability)}, if it is unknown), and shows by step {onset.step} of "
        f"action {onset.action}: something may have torn, stuck or come off then or, unseen, before."
    ]


def _breaks(rung: ModelStep) -> list[str]:
    """From when on the model fails, where it fits before: something came off, slipped or jumped."""
    found = [f for f in rung.adequacy.findings if f.name == BREAKING]
    return [
        f"It fits at first and fails later: {one.text}. Something may have come off, slipped or jumped then."
        for one in found
    ]


def _held(found: Explanation, held: str) -> str:
    """Which candidates are anchored, as a further sentence; nothing where the scene has none."""
    if not found.last.state.predictor.scene.patches:
        return ""
    return f" Anchored: {held} ({percent(found.held_by)})."


def _open(found: Explanation, pulls: Sequence[SeparatingPull]) -> list[str]:
    """What these data leave open, and the pull that would tell."""
    if not found.open:
        return []
    lines = []
    if found.ambiguous:
        others = [NO_EFFECTS.get(name, name) for name in found.ambiguous]
        lines.append(
            f"These data cannot tell {NO_EFFECTS.get(found.verdict, found.verdict)} from: {', '.join(others)}."
        )
    if found.held_by < THRESHOLDS.credible:
        lines.append("These data do not tell for certain which patches hold the body.")
    if pulls and pulls[0].sigmas >= _SEPARATE:
        best = f"{pull_text(pulls[0])} ({pulls[0].sigmas:.0f} sigma apart)"
        lines.append(f"The pull that would separate the two likeliest models best: {best}.")
    elif pulls:
        lines.append("No pull along an axis would separate them: they do the same, or need another kind of experiment.")
    return lines
