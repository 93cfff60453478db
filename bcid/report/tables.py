"""Which tables a run has: how far the answer holds, missing effects, the ladder of models, tests, anchor sets, pulls, residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from bcid.base.units import WIDE, for_people, p_value, percent, significance, uncertain
from bcid.report import gallery
from bcid.report.found import Found
from bcid.report.models_chart import place_name
from bcid.report.residual import residuals_of
from bcid.report.table import Cell, Column, Table, rounded, text
from bcid.report.text import amount, listed, patches
from bcid.results.common_rows import set_label
from bcid.results.diagnosis_record import DiagnosisRecord, RankedEffect, SensitivityRow
from bcid.results.exploration_record import ExplorationRecord, ExplorationStep
from bcid.results.identification_record import IdentificationRecord
from bcid.results.proposal_record import ProposalRecord
from bcid.results.words import NO_EFFECTS, model_name, plain

# Numbers of an effect that a cell holds.
_AMOUNTS = 3
# Above this, nothing of an effect is seen.
_SEEN = 0.01
_SETS = 8


# -- how far an answer can be trusted


def sensitivity_table(d: DiagnosisRecord) -> Table | None:
    """The answer with each input of the scene off by two standard deviations; None where that was not computed."""
    columns = [text("input", "label"), text("off by", "shift"), text("missing", "verdict", _verdict)]
    columns += [text("probability", "verdict_probability", percent), text("anchored", show=patches)]
    columns += [text("of these", "anchors_probability", percent), text("depends", show=_only_yes)]
    caption = (
        "The answer where one input of the scene is off by two standard deviations and all else is as it is, of the hypotheses "
        "that were fitted to all steps. It depends on an input where verdict or anchors change, or fall below 95 %. With ± the "
        "smaller probability of both signs stands."
    )
    rows = _joined(d.scene_sensitivity)
    return Table(caption, columns, rows, lambda row: row.depends) if rows else None


def _joined(rows: Sequence[SensitivityRow]) -> list[SensitivityRow]:
    """Rows with both signs of an input in one, with the smaller probabilities, where the answer depends on neither."""
    found: list[SensitivityRow] = []
    for one in rows:
        last = found[-1] if found else None
        if last is None or last.label != one.label or last.depends or one.depends:
            found.append(one)
            continue
        found[-1] = replace(
            last,
            shift=f"±{one.shift[1:]}",
            verdict_probability=min(last.verdict_probability, one.verdict_probability),
            anchors_probability=min(last.anchors_probability, one.anchors_probability),
        )
    return found


def _verdict(verdict: str) -> str:
    return NO_EFFECTS.get(verdict) or listed([plain(name) for name in verdict.split("+")])


def steps_table(d: DiagnosisRecord) -> Table | None:
    """What would tell most; None where the answer is certain, or nothing helps."""
    if not d.next_steps or d.entropy is None:
        return None
    caption = (
        f"What to do next: expected information on anchors and effects, of the {d.entropy:.2g} bits that are open. What "
        "a pull, a force sensor and markers would tell is estimated from the measured pulls."
    )
    rows = d.next_steps
    columns = [text("what to do", "text"), Column("expected (bits)", "expected_bits", _bits)]
    return Table(caption, columns, rows, lambda row: row is rows[0])


# -- models


def ranking_table(d: DiagnosisRecord) -> Table | None:
    """The ranked effects; None where none were ranked."""
    if not d.ranking:
        return None
    asked = d.first_inadequate
    columns = [text("effect", place_name), Column("now (mm)", lambda _: asked.rms, less=True)]
    columns += [Column("expected (mm)", "expected_rms"), Column("fitted (mm)", "fitted_rms")]
    columns += [
        Column("held out (mm)", "held_out_rms", less=True),
        Column("score", show="{:.0f}".format, less=True),
    ]
    columns += [Column("p", "p_value", significance, less=True), Column("power", show=_bits, less=True)]
    columns.append(text("what it would be", _amounts))
    adopted = {one.effect for one in d.selected_effects} | set(str(d.verdict).split("+"))
    caption = (
        f"Effects that {model_name(asked.model)} may lack, the best first: error now, expected with the effect, "
        "and after fitting it (RMS per coordinate). Power is the chance that these data would show a notable amount of it."
    )
    return Table(caption, columns, d.ranking, lambda row: row.effect in adopted)


def _amounts(row: RankedEffect) -> str | Cell:
    """What an effect would be: the first of its numbers, and all of them."""
    if not row.identifiable and row.fitted_rms is None:
        return "cannot be told from these data"
    if row.p_value > _SEEN and row.fitted_rms is None:
        return "nothing of it is seen"
    parts = [amount(name, number) for name, number in row.parameters.items()]
    more = f" and {len(parts) - _AMOUNTS} more" if len(parts) > _AMOUNTS else ""
    like = f"; like {listed([plain(name) for name in row.confounded_with])}" if row.confounded_with else ""
    return Cell(", ".join(parts[:_AMOUNTS]) + more + like, ", ".join(parts) + like)


def models_table(d: DiagnosisRecord) -> Table:
    """The models, the plain one first."""
    rungs = d.model_sequence
    columns = [text("model", show=model_name), text("anchored", show=lambda names: " ".join(names) or "none")]
    columns += [Column("error (mm)", "rms"), Column("held out (mm)", "held_out_rms")]
    columns.append(Column("p", "p_value", significance, less=True))
    columns.append(
        text("adequate", show=lambda adequate: "not known" if adequate is None else "yes" if adequate else "no")
    )
    caption = f"The models in turn (RMS residual per coordinate; noise {d.noise_rms:.3g} mm)."
    return Table(caption, columns, rungs, lambda rung: rung is rungs[-1])


def tests_table(d: DiagnosisRecord) -> Table:
    """The tests of the last model's adequacy."""
    columns = [text("test", "name"), Column("p", "p_value", significance), text("decides", show=_only_yes, less=True)]
    caption = f"Is {model_name(d.model)} adequate? Together {p_value(d.p_value)}."
    return Table(caption, [*columns, text("finding", "text")], d.tests)


# -- terms beyond the catalogue


def proposal_table(proposal: ProposalRecord) -> Table | None:
    """Each proposed term, with its numbers and intervals that hold them with 95 %; None where nothing is proposed."""
    columns = [text("term"), text("formula"), text("number"), text("value (95 %)", "value")]
    columns.append(Column("standard error", "stderr", less=True))
    rows = []
    for term in proposal.proposed:
        first = [plain(term.family) + (f" on {term.place}" if term.place else ""), term.formula]
        for k, (name, found) in enumerate(term.parameters.items()):
            assert found.value is not None
            value, error, unit = for_people(found.value, found.stderr, found.unit)
            told = uncertain(value, None if error is None else WIDE * error, unit)
            cells = {
                head: Cell(cell if k == 0 else "", cell) for head, cell in zip(("term", "formula"), first, strict=True)
            }
            stderr = Cell(rounded(error), found.stderr)
            rows.append(cells | {"number": name, "value": Cell(told, found.value), "stderr": stderr})
    share = percent(min(max(proposal.explained_fraction, 0.0), 1.0))
    besides = f"with {percent(proposal.discrepancy_probability)} " if proposal.discrepancy_probability else ""
    rest = "nothing else is seen to be missing" if proposal.complete else f"{besides}something else is missing besides"
    caption = (
        f"What is proposed, of {proposal.scored} terms that were scored: it explains {share} of what is beyond noise, mesh and "
        f"what the scene may have slightly wrong; {rest}."
    )
    return Table(caption, columns, rows) if rows else None


def path_table(proposal: ProposalRecord) -> Table | None:
    """Which term entered when, and what competed; None where nothing is proposed."""
    columns = [text("beside"), text("term", "family", plain), Column("expected (mm)", "expected_rms")]
    columns += [Column("log-evidence", "log_evidence"), text("entered")]
    rows = []
    for step in proposal.path:
        best = next((c.log_evidence for c in step.candidates if c.log_evidence is not None), 0.0)
        reached = "yes" if step.rms is None else f"{step.rms:.3g} mm when fitted"
        for k, one in enumerate(step.candidates[:_SETS]):
            log, entered = one.log_evidence, one.family == step.selected
            evidence = "" if log is None else f"{log - best:+.1f}".replace("-", "−")
            beside = Cell(model_name(step.beside) if k == 0 else "", step.beside)
            cells = {
                "beside": beside,
                "log_evidence": Cell(evidence, log),
                "entered": Cell(reached if entered else "", entered),
            }
            rows.append(cells | {"family": one.family, "expected_rms": one.expected_rms})
    caption = (
        "The path: what the likeliest terms promised beside each model before any fit, their log-evidence against the best of "
        "them, and the one that proved best when they were fitted."
    )
    return Table(caption, columns, rows, lambda row: bool(row["entered"].exact)) if proposal.proposed else None


# -- anchors


def sets_table(d: IdentificationRecord) -> Table:
    """The likeliest anchor sets of an identification."""
    columns = [text("anchored", show=set_label), text("probability", show=percent), Column("residual (mm)", "rms")]
    columns.append(Column("reported set there (mm)", lambda one: None if one is d else one.reported_rms))
    columns.append(Column("level", lambda one: "" if one is d else one.level, str))
    caption = "The reported set and the next best: what they miss in the frames in which both are known."
    return Table(caption, columns, [d, *d.alternatives[:_SETS]], lambda one: one is d)


def pulls_table(d: ExplorationRecord) -> Table:
    """The pulls of an exploration."""
    columns = [Column("pull", "number", str), text("grasp"), text("direction")]
    columns.append(Column("amplitude (mm)", "amplitude", "{:.3g}".format))
    columns += [Column("expected (bits)", "expected_bits", _bits), Column("gained (bits)", "gained_bits", _bits)]
    columns += [text("likeliest set", _likeliest)]
    columns += [text("probability", lambda step: step.posterior[0].probability if step.posterior else 0.0, percent)]
    return Table("The pulls in turn, and the posterior after each.", columns, d.steps)


def _likeliest(step: ExplorationStep) -> str:
    if not step.posterior:
        return set_label(())
    first = step.posterior[0]
    return set_label(first.anchored) + (f" + {plain(first.effect)}" if first.effect else "")


def residual_table(found: Found, by: str) -> Table:
    """RMS residual by "action", "step" or "fiducial", of each model."""
    residual = residuals_of(found)
    groups = {model: residual.by(by, model) for model in residual.models}
    columns = [text(by), *(Column(f"{model} (mm)", model) for model in groups)]
    rows = [{model: values[name] for model, values in groups.items()} | {by: name} for name in groups[residual.last]]
    return Table(f"RMS residual per coordinate by {by}.", columns, rows)


def _only_yes(value: bool) -> str:
    return "yes" if value else ""


def _bits(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


_TABLES: tuple[tuple[str, str, str, Callable[[Any], Table | None]], ...] = (
    ("scene-sensitivity", gallery.ANSWER, "diagnosis", sensitivity_table),
    ("next-steps", gallery.ANSWER, "diagnosis", steps_table),
    ("proposal", gallery.PROPOSAL, "proposal", proposal_table),
    ("path", gallery.PROPOSAL, "proposal", path_table),
    ("ranking", gallery.RANKING, "diagnosis", ranking_table),
    ("models", gallery.MODELS, "diagnosis", models_table),
    ("tests", gallery.MODELS, "diagnosis", tests_table),
    ("sets", gallery.POSTERIOR, "identification", sets_table),
    ("pulls", gallery.POSTERIOR, "exploration", pulls_table),
)


def tables(found: Found) -> list[tuple[str, str, Callable[[], Table | None]]]:
    """All tables that a run may hold the data of: the name of their files, the part of the report, and what makes them.

    What makes a table gives None where there is nothing to show, and raises whatever damaged files make it raise.
    """
    made: list[tuple[str, str, Callable[[], Table | None]]] = []
    for name, part, document, make in _TABLES:
        if (record := getattr(found, document)) is not None:
            made.append((name, part, partial(make, record)))
    if found.positions is not None and (found.diagnosis or found.identification):
        for by in ("action", "step", "fiducial"):
            made.append((f"residual-{by}", gallery.RESIDUALS, partial(residual_table, found, by)))
    return made
