"""Which tables a run has: missing effects, the ladder of models, tests, anchor sets, pulls, residuals."""

from __future__ import annotations

import math
from typing import Any

from bcid.base.units import WIDE, for_people, p_value, percent, significance, uncertain
from bcid.report.answer_tables import sensitivity_table, steps_table
from bcid.report.found import Found
from bcid.report.gallery import residuals_of
from bcid.report.ladder import asked_rung, place_name
from bcid.report.residual import Residual
from bcid.report.table import TEXT, Column, Table
from bcid.report.text import amount, listed, model_name, plain

# Numbers of an effect that a cell holds.
_AMOUNTS = 3
# Above this, nothing of an effect is seen.
_SEEN = 0.01
_SETS = 8


def ranking_table(d: dict[str, Any]) -> Table | None:
    """The ranked effects; None where none were ranked."""
    if not d["ranking"]:
        return None
    now, unit = asked_rung(d)["rms"], d["length_unit"]
    columns = [
        Column("effect", TEXT),
        Column(f"now ({unit})", less=True),
        Column(f"expected ({unit})"),
        Column(f"fitted ({unit})"),
        Column(f"held out ({unit})", less=True),
        Column("score", less=True),
        Column("p", less=True),
        Column("power", less=True),
        Column("what it would be", TEXT),
    ]
    rows, exact = [], []
    for row in d["ranking"]:
        errors = [row["expected_rms"], row["fitted_rms"], row["held_out_rms"]]
        numbers = [f"{row['score']:.0f}", significance(row["p_value"]), f"{row['power']:.2f}"]
        rows.append([place_name(row), _number(now), *map(_number, errors), *numbers, _what(row)])
        exact.append([place_name(row), now, *errors, row["score"], row["p_value"], row["power"], _what(row, 99)])
    adopted = {one["effect"] for one in d["adopted"]} | set(str(d["verdict"]).split("+"))
    strong = frozenset(i for i, row in enumerate(d["ranking"]) if row["effect"] in adopted)
    caption = (
        f"Effects that {model_name(asked_rung(d)['model'])} may lack, the best first: error now, expected with the effect, "
        "and after fitting it (RMS per coordinate). Power is the chance that these data would show a notable amount of it."
    )
    return Table("ranking", caption, columns, rows, exact, strong)


def proposal_table(proposal: dict[str, Any]) -> Table:
    """Each proposed term, with its numbers and intervals that hold them with 95 %."""
    columns = [Column(name, TEXT) for name in ("term", "formula", "number", "value (95 %)")]
    columns.append(Column("standard error", less=True))
    rows, exact = [], []
    for term in proposal["proposed"]:
        on = f" on {term['place']}" if term["place"] else ""
        for k, (name, number) in enumerate(term["parameters"].items()):
            value, error, unit = for_people(number["value"], number["stderr"], number["unit"])
            told = uncertain(value, None if error is None else WIDE * error, unit)
            first = [f"{plain(term['family'])}{on}", term["formula"]] if k == 0 else ["", ""]
            rows.append([*first, name, told, _number(error)])
            exact.append([term["family"], term["formula"], name, number["value"], number["stderr"]])
    share = percent(min(max(proposal["explained"], 0.0), 1.0))
    besides = f"with {percent(proposal['missing'])} " if proposal.get("missing") else ""
    rest = (
        "nothing else is seen to be missing" if proposal["complete"] else f"{besides}something else is missing besides"
    )
    caption = (
        f"What is proposed, of {proposal['scored']} terms that were scored: it explains {share} of what is beyond noise, mesh and "
        f"what the scene may have slightly wrong; {rest}."
    )
    return Table("proposal", caption, columns, rows, exact)


def path_table(proposal: dict[str, Any]) -> Table:
    """Which term entered when, and what competed."""
    unit = proposal["length_unit"]
    columns = [
        Column("beside", TEXT),
        Column("term", TEXT),
        Column(f"expected ({unit})"),
        Column("log-evidence"),
        Column("entered", TEXT),
    ]
    rows: list[list[str]] = []
    exact: list[list[Any]] = []
    strong: set[int] = set()
    for step in proposal["path"]:
        best = next((c["log_evidence"] for c in step["competed"] if c["log_evidence"] is not None), 0.0)
        for k, one in enumerate(step["competed"][:_SETS]):
            entered = one["family"] == step["entered"]
            told = "" if one["log_evidence"] is None else f"{one['log_evidence'] - best:+.1f}".replace("-", "−")
            reached = f"{step['rms']:.3g} {unit} when fitted" if entered and step["rms"] is not None else ""
            beside = model_name(step["beside"]) if k == 0 else ""
            if entered:
                strong.add(len(rows))
            rows.append(
                [
                    beside,
                    plain(one["family"]),
                    _number(one["expected_rms"]),
                    told,
                    reached or ("yes" if entered else ""),
                ]
            )
            exact.append([step["beside"], one["family"], one["expected_rms"], one["log_evidence"], entered])
    caption = (
        "The path: what the likeliest terms promised beside each model before any fit, their log-evidence against the best of "
        "them, and the one that proved best when they were fitted."
    )
    return Table("path", caption, columns, rows, exact, frozenset(strong))


def _what(row: dict[str, Any], most: int = _AMOUNTS) -> str:
    if not row["identifiable"] and row["fitted_rms"] is None:
        return "cannot be told from these data"
    if row["p_value"] > _SEEN and row["fitted_rms"] is None:
        return "nothing of it is seen"
    parts = [amount(name, number) for name, number in row["parameters"].items()]
    more = f" and {len(parts) - most} more" if len(parts) > most else ""
    like = f"; like {listed([plain(name) for name in row['confounded_with']])}" if row["confounded_with"] else ""
    return ", ".join(parts[:most]) + more + like


def ladder_table(d: dict[str, Any]) -> Table:
    """The models, the plain one first."""
    unit = d["length_unit"]
    columns = [
        Column("model", TEXT),
        Column("anchored", TEXT),
        Column(f"error ({unit})"),
        Column(f"held out ({unit})"),
        Column("p", less=True),
        Column("adequate", TEXT),
    ]
    rows, exact = [], []
    for rung in d["ladder"]:
        names = " ".join(rung["anchored"]) or "none"
        adequate = {True: "yes", False: "no", None: "not known"}[rung["adequate"]]
        numbers = [_number(rung["rms"]), _number(rung["held_out_rms"]), significance(rung["p_value"])]
        rows.append([model_name(rung["model"]), names, *numbers, adequate])
        exact.append([rung["model"], names, rung["rms"], rung["held_out_rms"], rung["p_value"], adequate])
    caption = f"The models in turn (RMS residual per coordinate; noise {d['noise_rms']:.3g} {unit})."
    return Table("ladder", caption, columns, rows, exact, frozenset({len(rows) - 1}))


def tests_table(d: dict[str, Any]) -> Table:
    """The tests of the last model's adequacy."""
    columns = [Column("test", TEXT), Column("p"), Column("decides", TEXT, less=True), Column("finding", TEXT)]
    rows = [[t["name"], significance(t["p_value"]), "yes" if t["decides"] else "", t["text"]] for t in d["tests"]]
    exact = [[t["name"], t["p_value"], "yes" if t["decides"] else "no", t["text"]] for t in d["tests"]]
    caption = f"Is {model_name(d['model'])} adequate? Together {p_value(d['p_value'])}."
    return Table("tests", caption, columns, rows, exact)


def sets_table(d: dict[str, Any]) -> Table:
    """The likeliest anchor sets of an identification."""
    unit = d["length_unit"]
    columns = [Column("anchored", TEXT), Column("probability", TEXT), Column(f"residual ({unit})")]
    columns += [Column(f"reported set there ({unit})"), Column("level")]
    rows = [[_set(d["anchored"]), percent(d["probability"]), _number(d["rms"]), "", ""]]
    exact: list[list[object]] = [[_set(d["anchored"]), d["probability"], d["rms"], None, None]]
    for other in d["alternatives"][:_SETS]:
        cells = [_set(other["anchored"]), percent(other["probability"]), _number(other["rms"])]
        rows.append([*cells, _number(other.get("best_rms")), str(other.get("level", ""))])
        exact.append(
            [_set(other["anchored"]), other["probability"], other["rms"], other.get("best_rms"), other.get("level")]
        )
    caption = "The reported set and the next best: what they miss in the frames in which both are known."
    return Table("sets", caption, columns, rows, exact, frozenset({0}))


def pulls_table(d: dict[str, Any]) -> Table:
    """The pulls of an exploration."""
    columns = [
        Column("pull"),
        Column("grasp", TEXT),
        Column("direction", TEXT),
        Column("amplitude (mm)"),
        Column("expected (bits)"),
        Column("gained (bits)"),
        Column("likeliest set", TEXT),
        Column("probability", TEXT),
    ]
    rows, exact = [], []
    for step in d["steps"]:
        nothing: dict[str, Any] = {"anchored": [], "effect": "", "probability": 0.0}
        top = step["belief"][0] if step["belief"] else nothing
        likely = _set(top["anchored"]) + (f" + {plain(top['effect'])}" if top["effect"] else "")
        bits = ["" if v is None else f"{v:.2f}" for v in (step["expected_bits"], step["gained_bits"])]
        pull = [step["grasp"], step["direction"], f"{step['amplitude']:.3g}"]
        rows.append([str(step["number"]), *pull, *bits, likely, percent(top["probability"])])
        numbers = [step["amplitude"], step["expected_bits"], step["gained_bits"]]
        exact.append([step["number"], *pull[:2], *numbers, likely, top["probability"]])
    return Table("pulls", "The pulls in turn, and what was believed after each.", columns, rows, exact)


def residual_tables(residual: Residual) -> list[Table]:
    """RMS residual by action, step and fiducial, of each model."""
    steps, _ = residual.by_step(residual.last)
    groups: dict[str, tuple[list[str], list[list[float]]]] = {
        "action": (residual.action_names, [residual.by_action(model) for model in residual.models]),
        "step": ([str(step) for step in steps], [residual.by_step(model)[1] for model in residual.models]),
        "fiducial": (residual.fiducials, [residual.by_fiducial(model) for model in residual.models]),
    }
    tables = []
    for what, (names, values) in groups.items():
        columns = [Column(what, TEXT), *(Column(f"{model} ({residual.unit})") for model in residual.models)]
        exact = [[name, *numbers] for name, *numbers in zip(names, *values, strict=True)]
        rows = [[name, *map(_number, numbers)] for name, *numbers in zip(names, *values, strict=True)]
        tables.append(Table(f"residual-{what}", f"RMS residual per coordinate by {what}.", columns, rows, exact))
    return tables


def tables(found: Found) -> list[Table]:
    """All tables that a run holds the data of."""
    made: list[Table | None] = []
    residual = residuals_of(found)
    if residual is not None:
        made += residual_tables(residual)
    if "diagnosis" in found.documents:
        diagnosis = found.documents["diagnosis"]
        made += [sensitivity_table(diagnosis), steps_table(diagnosis)]
        made += [ranking_table(diagnosis), ladder_table(diagnosis), tests_table(diagnosis)]
    if "identification" in found.documents:
        made.append(sets_table(found.documents["identification"]))
    if "exploration" in found.documents:
        made.append(pulls_table(found.documents["exploration"]))
    return [table for table in made if table is not None]


def _number(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:#.3g}".rstrip(".")


def _set(names: list[str]) -> str:
    return "{" + " ".join(map(str, names)) + "}"
