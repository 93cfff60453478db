"""A diagnosis in sentences, lengths in mm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bcid.base.units import UNTOLD, falls, for_people, hardly_falls, p_value, percent, significance, uncertain
from bcid.results.common_rows import set_label
from bcid.results.diagnosis_record import (
    BREAKING,
    DiagnosisRecord,
    HypothesisRow,
    ModelRow,
    RankedEffect,
    SelectedEffect,
    TimeHistory,
)
from bcid.results.words import (
    NO_EFFECTS,
    exceeding,
    model_name,
    not_adequate_either,
    parameter_text,
    plain,
    pull_text,
)

# A pull separates two explanations when their predictions are so many times the noise apart.
_SEPARATE = 5.0
# Above this p-value nothing of an effect is seen.
_SEEN = 0.01
# Log evidence by which a hypothesis is noticeably better than another: odds of three.
_NOTICEABLE = 1.1


def warnings(d: DiagnosisRecord) -> list[str]:
    """What must stand above the result: no noise is known, or the model leaves far more than the noise."""
    lines = []
    if not d.noise_stated:
        lines.append(
            f"no noise is known: {d.noise_rms:.3g} mm is only estimated from the measurement itself, so that no model can be "
            "called adequate. State noise_sigma."
        )
    if d.far_above_noise:
        lines.append(
            f"the model misses the measurement by {d.rms / d.noise_rms:.1f} times the noise ({d.rms:.3g} mm where it is "
            f"{d.noise_rms:.3g} mm)."
        )
    lines += [f"{text}." for text in exceeding(d.input_uncertainties)]
    return [*lines, f"{d.noise_warning}."] if d.noise_warning else lines


def conclusion(d: DiagnosisRecord) -> list[str]:
    """The verdict in one to three sentences."""
    last = d.model_sequence[-1]
    sure = "" if d.verdict_probability is None else f" ({percent(d.verdict_probability)})"
    if d.verdict == "none":
        explain = "do not quite explain that" if d.adequate is False else "explain that"
        return [
            f"Nothing is missing that these data could show{sure}. The {_named(last)} model misses the measurement by "
            f"{last.rms:.3g} mm; noise ({d.noise_rms:.3g} mm), the mesh and what the scene may have slightly wrong "
            f"{explain}.{_held(d)}"
        ]
    if d.verdict == "unknown" and not (d.ranking or d.posterior):
        return [
            f"The {model_name(last.model)} model is not adequate: it misses the measurement by {last.rms:.3g} mm, where the noise "
            f"is {d.noise_rms:.3g} mm.{_held(d)}"
        ]
    if d.verdict == "unknown":
        best = model_name(last.model) if len(d.model_sequence) > 1 else "none of them"
        look = "" if d.change_point else "Look where the force that would explain it acts. "
        return [
            f"None of the known effects explains this measurement: {last.rms:.3g} mm are left where the noise is "
            f"{d.noise_rms:.3g} mm (the closest: {best}).",
            *_change(d),
            f"{look}Values below are those of a model that fails.{_held(d)}",
        ]
    return _missing(d, sure)


def _named(row: ModelRow) -> str:
    return model_name(row.model) if " + " in row.model or "(" in row.model else "plain"


def _missing(d: DiagnosisRecord, sure: str) -> list[str]:
    """That effects are missing, and what they do to the error."""
    first, last = d.model_sequence[0], d.model_sequence[-1]
    fitted = next((row.fitted_rms for row in d.ranking if row.effect == d.verdict and row.fitted_rms is not None), None)
    after = last.rms if len(d.model_sequence) > 1 or fitted is None else fitted
    error = falls(first.rms, after, d.noise_rms, "mm")
    lines = [
        f"Missing in the {_named(first)} model: {' and '.join(map(plain, d.verdict.split('+')))}{sure}. The error {error} (noise "
        f"{d.noise_rms:.3g} mm){_beyond(first, last, d.noise_rms)}.{_held(d)}"
    ]
    selected = {one.effect for one in d.selected_effects}
    if d.adequate is False and set(d.verdict.split("+")) <= selected:
        lines.append(not_adequate_either(d.p_value))
    if first.anchored != last.anchored:
        same = [row for row in d.model_sequence if (row.model, row.anchored) == (first.model, last.anchored)]
        alone = f"; with {set_label(last.anchored)} it leaves {same[0].rms:.3g} mm" if same else ""
        lines.append(
            f"  Alone, the plain model does best with {set_label(first.anchored)}{alone}: the rest is the effect's."
        )
    return lines


def _beyond(first: ModelRow, last: ModelRow, noise: float) -> str:
    """What of an error falls that hardly does: most of it is what the scene may have slightly wrong."""
    if not hardly_falls(first.rms, last.rms, noise) or first.normalised_rms is None or last.normalised_rms is None:
        return ""
    units = "in units of what noise, mesh and scene explain it falls"
    return f"; {units} from {first.normalised_rms:.3g} to {last.normalised_rms:.3g}"


def _change(d: DiagnosisRecord) -> list[str]:
    """When an unmodelled discrepancy begins, or from where on the model fails: something tears, sticks or lets go."""
    if (change := d.change_point) is not None:
        return [
            f"It is not there from the start ({percent(change.probability)}, if it is unknown), and shows by step {change.step} of "
            f"action {change.action}: something may have torn, stuck or come off then or, unseen, before."
        ]
    return [
        f"It fits at first and fails later: {one.text}. Something may have come off, slipped or jumped then."
        for one in d.tests
        if one.name == BREAKING
    ]


def _held(d: DiagnosisRecord) -> str:
    """Which candidates are anchored, as a further sentence; nothing where the scene has none."""
    if d.posterior is None or not d.posterior.patches or d.anchors_probability is None:
        return ""
    return f" Anchored: {set_label(d.anchored)} ({percent(d.anchors_probability)})."


def open_questions(d: DiagnosisRecord) -> list[str]:
    """What these data leave open, and the pull that would tell."""
    lines = []
    if d.ambiguous_with:
        others = ", ".join(NO_EFFECTS.get(name, name) for name in d.ambiguous_with)
        lines.append(f"These data cannot tell {NO_EFFECTS.get(d.verdict, d.verdict)} from: {others}.")
    if d.anchors_certain is False:
        lines.append("These data do not tell for certain which patches hold the body.")
    if d.separating_pulls and d.separating_pulls[0].sigmas >= _SEPARATE:
        pull = d.separating_pulls[0]
        best = f"{pull_text(pull, 1.0)} ({pull.sigmas:.0f} sigma apart)"
        lines.append(f"The pull that would separate the two likeliest models best: {best}.")
    elif d.separating_pulls:
        lines.append("No pull along an axis would separate them: they do the same, or need another kind of experiment.")
    return lines


def effect_text(one: SelectedEffect, histories: Iterable[TimeHistory]) -> str:
    """An effect with its numbers: "gravity: weight = 305 ± 4 N/m^3"; one in time by its least and its largest values."""
    effect, at = one.effect.removesuffix("_in_time"), f"({one.place})" if one.place else ""
    own = [row for row in histories if (row.effect, row.place) == (effect, one.place)]
    parts = [_ends(row) for row in own]
    for name, number in one.parameters.items():
        if not any(name.startswith(f"{row.amount}_") for row in own):
            parts.append(parameter_text(name, number))
    return f"{one.effect}{at}: {', '.join(parts)}"


def _ends(row: TimeHistory) -> str:
    """Least and largest value: "amplitude from −310 ± 9 Pa (at 10 s) to 290 ± 11 Pa (at 20 s)"."""
    if not any(error is not None for error in row.stderr):
        return f"{row.amount} cannot be told"
    texts = []
    for k in (row.values.index(min(row.values)), row.values.index(max(row.values))):
        value, error, unit = for_people(row.values[k], row.stderr[k] or UNTOLD * 10, row.unit)
        texts.append(f"{uncertain(value, error, unit)} (at {row.times[k]:.4g} s)")
    return f"{row.amount} from {texts[0]} to {texts[1]}"


def history_text(row: TimeHistory) -> str:
    """A time history in a sentence: "active_stress: amplitude swings between −310 and 290 Pa"."""
    at = f" at {row.place}" if row.place else ""
    p, who = row.p_constant, f"{row.effect}{at}: {row.amount}"
    if p is None or row.changes is None:
        return f"{who}: whether it changes with time is not told."
    if not row.changes:
        return f"{who} may as well be constant ({p_value(p)})."
    (low, _, unit), (high, _, _) = (for_people(end, None, row.unit) for end in (min(row.values), max(row.values)))
    return (
        f"{who} swings between {uncertain(low)} and {uncertain(high, None, unit)} ({p_value(p)} that it is constant)."
    )


def ranked_text(row: RankedEffect) -> str:
    """What an effect of the ranking would be."""
    if row.fitted_rms is None and not row.identifiable:
        return "not identifiable from these data"
    if row.fitted_rms is None and row.p_value > _SEEN:
        return "nothing of it is seen"
    same = f"  (like {', '.join(row.confounded_with)})" if row.confounded_with else ""
    parts = [parameter_text(name, number) for name, number in row.parameters.items()]
    return ", ".join(parts) + (f" at {row.place}" if row.place else "") + same


def ranking_lines(rows: Iterable[RankedEffect], now: float) -> list[str]:
    """Ranked effects as a table; `now` is the error without them, mm."""
    errors = f"{'error now':>9s} → {'expected':>8s} → {'fitted':>7s} mm"
    lines = [f"  {'effect':20s} {errors}   {'score':>8s} {'p':>8s} {'power':>6s}  what"]
    for row in rows:
        fitted = "" if row.fitted_rms is None else f"{row.fitted_rms:.3g}"
        lines.append(
            f"  {row.effect:20s} {now:9.3g} → {row.expected_rms:8.3g} → {fitted:>7s}      {row.score:8.0f} "
            f"{significance(row.p_value):>8s} {row.power:6.2f}  {ranked_text(row)}"
        )
    return lines


def verdict_names(d: DiagnosisRecord, least: float) -> str:
    """Verdicts with a probability of more than `least`: "gravity alone 93 %, something unknown 5 %"."""
    assert d.posterior is not None
    names = {name: p for name, p in d.posterior.effects.items() if p > least}
    texts = {name: _verdict_name(d.posterior.hypotheses, name) for name in names}
    return ", ".join(f"{texts[name]}{_alone(name, texts.values())} {percent(p)}" for name, p in names.items())


def _verdict_name(hypotheses: Sequence[HypothesisRow], verdict: str) -> str:
    """An unmodelled discrepancy with the effects that it most likely acts beside."""
    if verdict != "unknown":
        return verdict
    beside = next(("+".join(h.effects) for h in hypotheses if h.unknown), "")
    return f"something unknown, most likely beside {beside}," if beside else "something unknown"


def _alone(name: str, others: Iterable[str]) -> str:
    """What is said of effects where the same ones with others are named too."""
    return " alone" if any(set(name.split("+")) < set(other.split("+")) for other in others) else ""


def better_by_prior(d: DiagnosisRecord) -> str:
    """Another hypothesis with no more effects that fits as well as the reported one, in a sentence; "" where there is none."""
    rows = d.evidence_split
    for one in rows[1:]:
        alike = len(one.effects) <= len(rows[0].effects) and one.unknown == rows[0].unknown
        if alike and one.misfit > -_NOTICEABLE > one.total:
            return f"{rows[0].label} fits no better than {one.label}: the rest of the table makes it more probable."
    return ""
