"""`proposal.json`: terms beyond the catalogue, and how they were found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bcid.results.common_rows import ParameterRow
from bcid.results.record import FileRecord, Record, length


@dataclass(frozen=True, kw_only=True)
class ProposedTerm(Record):
    """A term.

    Attributes:
        effect: its name as an effect.
        family, kind, about, formula: of the grammar.
        place: "" for none.
        parameters: its numbers.
        file: text of the Python file that defines the effect.
    """

    effect: str
    family: str
    kind: str
    about: str
    formula: str
    place: str
    parameters: dict[str, ParameterRow]
    file: str


@dataclass(frozen=True, kw_only=True)
class ScoredTerm(Record):
    """A family beside a model.

    Attributes:
        family: its name.
        expected_rms: RMS residual that its score test predicts.
        log_evidence: None where it cannot act.
    """

    family: str
    expected_rms: float = length()
    log_evidence: float | None


@dataclass(frozen=True, kw_only=True)
class TermStep(Record):
    """How a term was selected.

    Attributes:
        beside: the model that it was added to.
        selected: its family.
        rms: RMS residual with it; None where it was only fitted together with the next.
        candidates: the families with the highest log evidence, best first.
    """

    beside: str
    selected: str
    rms: float | None = length()
    candidates: tuple[ScoredTerm, ...]


@dataclass(frozen=True, kw_only=True)
class CoefficientRow(Record):
    """A coefficient of a constitutive model's energy.

    Attributes:
        value, stderr: the estimate and its standard error.
        allowed: standard deviation that the input uncertainty "law" allows for.
    """

    value: float
    stderr: float
    allowed: float


@dataclass(frozen=True, kw_only=True)
class ProposalRecord(FileRecord):
    """The content of `proposal.json`.

    Attributes:
        proposed: the terms; () where none is proposed.
        complete: whether an unmodelled discrepancy besides them has at most 5 %.
        discrepancy_probability: posterior probability of an unmodelled discrepancy besides.
        explained_fraction: of the residual beyond the errors, that the terms explain.
        scored: how many terms were scored at each step.
        law_form: coefficients by which the constitutive model differs, or None.
        path: how each term was selected.
    """

    file: ClassVar[str] = "proposal.json"

    proposed: tuple[ProposedTerm, ...]
    complete: bool
    discrepancy_probability: float
    explained_fraction: float
    scored: int
    law_form: dict[str, CoefficientRow] | None
    path: tuple[TermStep, ...]
