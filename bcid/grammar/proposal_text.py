"""What was proposed, in sentences: for the summary, and for the file of the effect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcid.base.units import WIDE, falls, for_people, percent, uncertain
from bcid.forms.model import Model, Term
from bcid.grammar.effect_file import wrapped
from bcid.grammar.propose import Entry, Proposal
from bcid.inference.hypotheses import label
from bcid.inference.stiffness import StiffnessScale
from bcid.search.answer.explanation import ModelStep
from bcid.search.answer.law_form import LawForm

# So many competitors are told; a square of an error beyond noise that is more than this part of what it was has not fallen.
_COMPETED, _FALLEN = 6, 0.8


def docstring(proposal: Proposal, term: Term, entry: Entry) -> list[str]:
    """Lines for the file of a term: what was found, where, and what it explains."""
    last, first = proposal.explanation.last, proposal.explanation.rungs[0]
    lines = ["Found by bcid propose.", ""]
    lines += _interval_lines(proposal, term)
    place = f"It acts on the surface '{term.place}'. " if term.place else ""
    held = f"The body is held at {_anchors(last)} ({percent(proposal.explanation.held_by)})."
    lines += [
        "",
        *wrapped(place + held + _law_beside(proposal)),
        "",
        *wrapped(f"{_falls(proposal, first, last)} {_rest(proposal)}"),
    ]
    if entry.family.polyconvex:
        lines += ["", *wrapped(f"Polyconvexity: {entry.family.polyconvex}.")]
    if others := _not_ruled_out(proposal):
        lines += ["", *wrapped(others)]
    return lines


def _anchors(model: ModelStep) -> str:
    """An anchor set: "{1 2}"."""
    return label(model.state.anchors, model.state.predictor.whole.patches)


def _not_ruled_out(proposal: Proposal) -> str:
    """What else may be the answer; "" where nothing may."""
    told = [(name, p) for name, p in proposal.explanation.odds.verdicts.items() if name not in _told(proposal)]
    names = [f"{name} ({percent(p)})" for name, p in told if p > 0.01]
    return f"These data do not rule out: {', '.join(names[:_COMPETED])}." if names else ""


def _told(proposal: Proposal) -> set[str]:
    """Names of verdicts of which something is said elsewhere; of something unknown as what is missing besides."""
    return {proposal.explanation.verdict, "+".join(term.effect.name for term in proposal.terms), "unknown"}


def _interval_lines(proposal: Proposal, term: Term) -> list[str]:
    errors = proposal.stderr(term)
    lines = []
    for p in term.effect.parameters:
        value, error, unit = for_people(term.values[p.name], errors.get(p.name), p.unit)
        lines.append(f"    {p.name} = {uncertain(value, None if error is None else WIDE * error, unit)} (95 %)")
    return [line.replace("−", "-") for line in lines]


def _falls(proposal: Proposal, first: ModelStep, last: ModelStep) -> str:
    apart = "" if last.held_out is None else f"; actions predicted from the others {1e3 * last.held_out:.3g} mm"
    how = falls(1e3 * first.state.rms, 1e3 * last.state.rms, 1e3 * last.state.noise, "mm")
    return (
        f"With {'it' if len(proposal.terms) == 1 else 'the terms proposed'} the error {how} "
        f"(noise {1e3 * last.state.noise:.3g}{apart}): {percent(np.clip(proposal.explained, 0, 1))} "
        "of what is beyond noise, mesh and what the scene may have slightly wrong."
    )


def _law_beside(proposal: Proposal) -> str:
    """The constants of the law that were fitted with it, which it stands beside."""
    fitted = proposal.explanation.last.fitted
    model, stderr, told = fitted.state.model, fitted.stderr, list[str]()
    scale = StiffnessScale.of(fitted.state.predictor.whole)
    times = " x thickness" if scale.per_thickness else ""
    for name in sorted(set(fitted.values) & set(model.stiffnesses)):
        first = Model.of(fitted.state.predictor.whole).stiffnesses[name] * scale.factor
        value, wide = fitted.values[name] * scale.factor, WIDE * stderr[name] * scale.factor
        found = (
            f"{uncertain(value, wide, scale.unit)} (95 %"
            if wide < value
            else f"{value:.3g} {scale.unit} (these data do not tell it"
        )
        told.append(f"{name}{times} = {found}; the scene has {first:.6g})")
    return f" The law beside it: {', '.join(told)}.".replace("−", "-") if told else ""


def _law_form(proposal: Proposal) -> str:
    """How the law differs beside what is proposed, as far as the scene allows for it; "" where nothing of that is seen."""
    form = LawForm.of(proposal.explanation.last.fitted)
    return f" {form.text}" if form and form.seen else ""


def _rest(proposal: Proposal) -> str:
    """What is left, and whether the term explains more than what is allowed for in the scene."""
    first, last = (rung.state for rung in (proposal.explanation.rungs[0], proposal.explanation.last))
    before, after = (state.rms**2 - state.noise**2 for state in (first, last))
    if after > _FALLEN * max(before, 0.0):
        return (
            "The error itself does not fall: the term takes over what the scene may have slightly wrong, and says nothing beyond "
            f"these data. {_left(proposal)}"
        )
    return _left(proposal)


def _left(proposal: Proposal) -> str:
    if not proposal.complete:
        return f"With {percent(proposal.missing)} something else is missing besides, which no term of the grammar explains."
    if not proposal.explanation.last.adequacy.adequate:
        return "Nothing else is seen to be missing, but what is left is more than noise."
    return "Nothing else is seen to be missing."


def headline(proposal: Proposal) -> list[str]:
    """The answer in a few sentences, and the path to it."""
    found = proposal.explanation
    held = f"Anchored: {_anchors(found.last)} ({percent(found.held_by)})."
    if not proposal.path:
        if found.verdict == "none":
            text = f"Nothing is missing that these data could show ({percent(found.odds.verdicts['none'])}): no term is proposed."
        else:
            text = f"Nothing in the grammar explains it: {proposal.scored} terms were scored."
        return [f"{text} {held}{_law_form(proposal)}"]
    first, last = found.rungs[0], found.last
    names = " and ".join(entry.family.name for entry in proposal.path)
    sure = percent(found.odds.acting("+".join(term.effect.name for term in proposal.terms)))
    law = f"{_law_beside(proposal)}{_law_form(proposal)}"
    lines = [f"Proposed: {names} ({sure}). {_falls(proposal, first, last)} {held}{law} {_rest(proposal)}"]
    for term, entry in zip(proposal.terms, proposal.path, strict=True):
        place = f" on '{term.place}'" if term.place else ""
        lines += [
            f"  {entry.family.name}{place}: {entry.family.about}: {entry.family.formula}",
            *_interval_lines(proposal, term),
        ]
    return [*lines, *filter(None, [_not_ruled_out(proposal)])]


def path(proposal: Proposal) -> list[str]:
    """Which term entered when, what it explained, and what competed."""
    lines = [f"The path ({proposal.scored} terms scored at each step):"]
    for number, entry in enumerate(proposal.path, 1):
        reached = "" if entry.rms is None else f", error then {1e3 * entry.rms:.3g} mm"
        lines.append(f"  {number}. beside {entry.beside}: {entry.family.name}{reached}")
        lines += [f"       {text}" for text in _competitors(entry)]
    return lines if proposal.path else []


def _competitors(entry: Entry) -> Sequence[str]:
    first = entry.competed[0].log if entry.competed else 0.0
    return [
        f"{one.family.name:32s} expected {1e3 * one.row.expected_rms:.3g} mm, log-evidence {one.log - first:+.1f}"
        for one in entry.competed[:_COMPETED]
        if np.isfinite(one.log)
    ]
