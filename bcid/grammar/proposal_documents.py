"""What a proposal is told as: the documents of a diagnosis, the path to the terms, and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bcid.base.options import ProposeOptions
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.grammar import proposal_text
from bcid.grammar.effect_file import made, source
from bcid.grammar.propose import Entry, Proposal, ladder, propose
from bcid.predict.predictor import Predictor
from bcid.results.common_rows import ParameterRow
from bcid.results.proposal_record import ProposalRecord, ProposedTerm, ScoredTerm, TermStep
from bcid.search.answer.diagnosis import Diagnosis
from bcid.search.answer.law_form import LawForm
from bcid.search.answer.output import documents, finite, with_posterior
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
    head = [*proposal_text.headline(found), "", *proposal_text.path(found)]
    result = documents(here, done, content, head)
    diagnosis = with_posterior(result["diagnosis.json"], found.explanation, list(predictor.whole.patches))
    if not written.files:
        diagnosis = replace(diagnosis, verdict=found.explanation.verdict)
    # Lists of what competes with a proposal are its path.
    result["diagnosis.json"] = replace(diagnosis, ambiguous_with=())
    result["proposal.json"] = proposal_record(written).converted(here.measurement.units.length)
    return result


def proposal_record(written: WrittenProposal) -> ProposalRecord:
    """The content of `proposal.json`: numbers of terms in SI units, lengths in m."""
    found = written.proposal
    form = LawForm.of(found.explanation.last.fitted)
    return ProposalRecord(
        proposed=tuple(_term(written, k, name) for k, name in enumerate(written.files)),
        complete=found.complete,
        discrepancy_probability=found.missing,
        explained_fraction=found.explained if found.path else 0.0,
        scored=found.scored,
        law_form=form.rows() if form and form.seen else None,
        path=tuple(_step(entry) for entry in found.path),
    )


def _step(entry: Entry) -> TermStep:
    candidates = tuple(
        ScoredTerm(family=one.family.name, expected_rms=one.row.expected_rms, log_evidence=finite(one.log))
        for one in entry.competed[:_COMPETED]
    )
    return TermStep(beside=entry.beside, selected=entry.family.name, rms=entry.rms, candidates=candidates)


def _term(written: WrittenProposal, number: int, name: str) -> ProposedTerm:
    found = written.proposal
    term, entry = found.terms[number], found.path[number]
    errors = found.stderr(term)
    return ProposedTerm(
        effect=name,
        family=entry.family.name,
        kind=entry.family.kind,
        about=entry.family.about,
        formula=entry.family.formula,
        place=term.place,
        parameters={
            p.name: ParameterRow(value=term.values[p.name], stderr=finite(errors.get(p.name)), unit=p.unit)
            for p in term.effect.parameters
        },
        file=written.files[name],
    )
