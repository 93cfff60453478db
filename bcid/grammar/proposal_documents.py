"""What a proposal is told as: the documents of a diagnosis, the path to the terms, and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bcid.base.options import ProposeOptions
from bcid.base.units import unit_factor
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.grammar import proposal_text
from bcid.grammar.effect_file import made, source
from bcid.grammar.propose import Proposal, ladder, propose
from bcid.predict.predictor import Predictor
from bcid.search.answer.diagnosis import Diagnosis
from bcid.search.answer.law_form import LawForm
from bcid.search.answer.output import beliefs, documents, finite
from bcid.search.answer.source import Source
from bcid.search.answer.where import missing_force

_COMPETED = 12


@dataclass(frozen=True)
class WrittenProposal:
    """A proposal with its files.

    Attributes:
        proposal: what was found.
        files: text of each file, by the name of its effect.
        effects: what the files define.
    """

    proposal: Proposal
    files: dict[str, str]
    effects: tuple[Effect, ...]


def searched(
    predictor: Predictor, begun: Model, options: ProposeOptions, names: Sequence[str]
) -> tuple[WrittenProposal, Diagnosis]:
    """Search, write the files, and compare with what they define; collective.

    Args:
        predictor: of the measurement.
        begun: the model that terms are added to.
        options: how far to go.
        names: of effects, at least as many as terms may be proposed.
    """
    found = propose(predictor, begun, options)
    files = {
        name: source(entry.family, name, term.values, term.place, proposal_text.docstring(found, term, entry))
        for name, term, entry in zip(names, found.terms, found.path, strict=False)
    }
    effects = tuple(made(text) for text in files.values())
    rungs = ladder(found, effects)
    done = rungs[-1].adequacy.adequate and not effects
    return WrittenProposal(found, files, effects), Diagnosis(rungs, None if done else missing_force(rungs[0].state))


def proposal_documents(
    written: WrittenProposal, here: Source, predictor: Predictor, done: Diagnosis, content: dict[str, Any]
) -> dict[str, Any]:
    """What a run folder holds of it, by file name; `content` is what `bcid.search.answer.output.collect` gave."""
    found = written.proposal
    paths = [Path(f"{name}.py") for name in written.files]
    here = replace(here, files=(*here.files, *paths), own=(*here.own, *written.effects))
    result = documents(here, done, content)
    result["diagnosis.json"] |= beliefs(found.explanation, list(predictor.whole.patches))
    if not written.files:
        result["diagnosis.json"]["verdict"] = found.explanation.verdict
    result["proposal.json"] = _json(written, here.measurement.units.length)
    lines = [*proposal_text.headline(found), "", *proposal_text.path(found), ""]
    result["summary.txt"] = "\n".join(lines) + "\n" + result["summary.txt"]
    return result


def _json(written: WrittenProposal, length: str) -> dict[str, Any]:
    """The content of `proposal.json`: numbers of terms in SI units, residuals in a unit of length."""
    unit, found = unit_factor(length, "m"), written.proposal
    form = LawForm.of(found.explanation.last.fitted)
    return {
        "length_unit": length,
        "proposed": [_term(written, k, name) for k, name in enumerate(written.files)],
        "complete": found.complete,
        "missing": found.missing,
        "explained": found.explained if found.path else 0.0,
        "scored": found.scored,
        "law_form": form.to_json() if form and form.seen else None,
        "path": [
            {
                "beside": entry.beside,
                "entered": entry.family.name,
                "rms": None if entry.rms is None else entry.rms / unit,
                "competed": [
                    {
                        "family": one.family.name,
                        "expected_rms": one.row.expected_rms / unit,
                        "log_evidence": finite(one.log),
                    }
                    for one in entry.competed[:_COMPETED]
                ],
            }
            for entry in found.path
        ],
    }


def _term(written: WrittenProposal, number: int, name: str) -> dict[str, Any]:
    found = written.proposal
    term, entry = found.terms[number], found.path[number]
    errors = found.stderr(term)
    return {
        "effect": name,
        "family": entry.family.name,
        "kind": entry.family.kind,
        "about": entry.family.about,
        "formula": entry.family.formula,
        "place": term.place,
        "parameters": {
            p.name: {"value": term.values[p.name], "stderr": finite(errors.get(p.name)), "unit": p.unit}
            for p in term.effect.parameters
        },
        "file": written.files[name],
    }
