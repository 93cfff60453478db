"""Which tables a run has: how far the answer holds, missing effects, the ladder of models, tests, anchor sets, pulls, residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from bcid.base.units import WIDE, for_people, p_value, percent, significance, uncertain
from bcid.base.verdict_words import NO_EFFECTS
from bcid.report import gallery
from bcid.report.found import Found
from bcid.report.ladder import asked_rung, place_name
from bcid.report.residual import Residual, residuals_of
from bcid.report.table import Table, number, rounded, text
from bcid.report.text import amount, listed, model_name, patches, plain

# Numbers of an effect that a cell holds.
_AMOUNTS = 3
# Above this, nothing of an effect is seen.
_SEEN = 0.01
_SETS = 8


@dataclass(frozen=True)
class Listing:
    """A table of a run that can be made.

    Attributes:
        name: of its files.
        part: of the report that it belongs to.
        make: makes it, or None where there is nothing to show; raises whatever damaged files make it raise.
    """

    name: str
    part: str
    make: Callable[[], Table | None]


def listings(found: Found) -> list[Listing]:
    """All tables that a run may hold the data of, in the order of the report."""
    documents = found.documents
    made: list[Listing] = []

    def add(document: str, part: str, **tables: Callable[[dict[str, Any]], Table | None]) -> None:
        if document in documents:
            content = documents[document]
            for name, make in tables.items():
                made.append(Listing(name.replace("_", "-"), part, lambda make=make: make(content)))  # type: ignore[misc]

    add("diagnosis", gallery.ANSWER, scene_sensitivity=sensitivity_table, next_steps=steps_table)
    if documents.get("proposal", {}).get("proposed"):
        add("proposal", gallery.PROPOSAL, proposal=proposal_table, path=path_table)
    if found.positions is not None and ("diagnosis" in documents or "identification" in documents):
        for by in ("action", "step", "fiducial"):
            make = lambda by=by: residual_table(residuals_of(found), by)  # noqa: E731
            made.append(Listing(f"residual-{by}", gallery.RESIDUALS, make))
    add("diagnosis", gallery.RANKING, ranking=ranking_table)
    add("diagnosis", gallery.LADDER, ladder=ladder_table, tests=tests_table)
    add("identification", gallery.BELIEF, sets=sets_table)
    add("exploration", gallery.BELIEF, pulls=pulls_table)
    return made


# -- how far an answer can be trusted


def sensitivity_table(d: dict[str, Any]) -> Table | None:
    """The answer with each input of the scene off by two standard deviations; None where that was not computed."""
    joined = _joined(d.get("scene_sensitivity", ()))
    columns = [text("input"), text("off by"), text("missing", _verdict), text("probability", percent)]
    columns += [text("anchored", patches), text("of these", percent), text("depends", _only_yes)]
    keys = ("label", "off", "verdict", "verdict_probability", "anchored", "anchors_probability", "depends")
    caption = (
        "The answer where one input of the scene is off by two standard deviations and all else is as it is, of the hypotheses "
        "that were fitted to all steps. It depends on an input where verdict or anchors change, or fall below 95 %. With ± the "
        "smaller probability of both signs stands."
    )
    rows = [[one[key] for key in keys] for one in joined]
    strong = {i for i, one in enumerate(joined) if one["depends"]}
    return Table(caption, columns, rows, strong) if rows else None


def _joined(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows with both signs of an input in one, with the smaller probabilities, where the answer depends on neither."""
    found: list[dict[str, Any]] = []
    for one in rows:
        last = found[-1] if found else None
        if last is None or last["label"] != one["label"] or last["depends"] or one["depends"]:
            found.append(one)
            continue
        least = {key: min(last[key], one[key]) for key in ("verdict_probability", "anchors_probability")}
        found[-1] = last | least | {"off": f"±{one['off'][1:]}"}
    return found


def _verdict(verdict: str) -> str:
    return NO_EFFECTS.get(verdict) or listed([plain(name) for name in verdict.split("+")])


def steps_table(d: dict[str, Any]) -> Table | None:
    """What would tell most; None where the answer is certain, or nothing helps."""
    columns = [text("what to do"), number("expected (bits)", "{:.2f}".format)]
    rows = [[step["text"], step["bits"]] for step in d.get("next_steps") or ()]
    if not rows:
        return None
    caption = (
        f"What to do next: expected information on anchors and effects, of the {d['open_bits']:.2g} bits that are open. What "
        "a pull, a force sensor and markers would tell is estimated from the measured pulls."
    )
    return Table(caption, columns, rows, {0})


# -- models


def ranking_table(d: dict[str, Any]) -> Table | None:
    """The ranked effects; None where none were ranked."""
    if not d["ranking"]:
        return None
    asked, unit = asked_rung(d), d["length_unit"]
    columns = [text("effect"), number(f"now ({unit})", less=True), number(f"expected ({unit})")]
    columns += [number(f"fitted ({unit})"), number(f"held out ({unit})", less=True)]
    columns += [number("score", "{:.0f}".format, less=True), number("p", significance, less=True)]
    columns += [number("power", "{:.2f}".format, less=True), text("what it would be")]
    keys = ("expected_rms", "fitted_rms", "held_out_rms", "score", "p_value", "power")
    rows = [[place_name(row), asked["rms"], *(row[key] for key in keys), _amounts(row)] for row in d["ranking"]]
    adopted = {one["effect"] for one in d["adopted"]} | set(str(d["verdict"]).split("+"))
    caption = (
        f"Effects that {model_name(asked['model'])} may lack, the best first: error now, expected with the effect, "
        "and after fitting it (RMS per coordinate). Power is the chance that these data would show a notable amount of it."
    )
    strong = {i for i, row in enumerate(d["ranking"]) if row["effect"] in adopted}
    return Table(caption, columns, rows, strong)


def _amounts(row: dict[str, Any]) -> str | tuple[str, str]:
    """What an effect would be: the first of its numbers, and all of them."""
    if not row["identifiable"] and row["fitted_rms"] is None:
        return "cannot be told from these data"
    if row["p_value"] > _SEEN and row["fitted_rms"] is None:
        return "nothing of it is seen"
    parts = [amount(name, number) for name, number in row["parameters"].items()]
    more = f" and {len(parts) - _AMOUNTS} more" if len(parts) > _AMOUNTS else ""
    like = f"; like {listed([plain(name) for name in row['confounded_with']])}" if row["confounded_with"] else ""
    return ", ".join(parts[:_AMOUNTS]) + more + like, ", ".join(parts) + like


def ladder_table(d: dict[str, Any]) -> Table:
    """The models, the plain one first."""
    unit = d["length_unit"]
    columns = [text("model", model_name), text("anchored", _names), number(f"error ({unit})")]
    columns += [number(f"held out ({unit})"), number("p", significance, less=True), text("adequate", _adequate)]
    keys = ("model", "anchored", "rms", "held_out_rms", "p_value", "adequate")
    rows = [[rung[key] for key in keys] for rung in d["ladder"]]
    caption = f"The models in turn (RMS residual per coordinate; noise {d['noise_rms']:.3g} {unit})."
    return Table(caption, columns, rows, {len(rows) - 1})


def _adequate(adequate: bool | None) -> str:
    return {True: "yes", False: "no", None: "not known"}[adequate]


def tests_table(d: dict[str, Any]) -> Table:
    """The tests of the last model's adequacy."""
    columns = [text("test"), number("p", significance), text("decides", _only_yes, less=True), text("finding")]
    rows = [[test[key] for key in ("name", "p_value", "decides", "text")] for test in d["tests"]]
    caption = f"Is {model_name(d['model'])} adequate? Together {p_value(d['p_value'])}."
    return Table(caption, columns, rows)


# -- terms beyond the catalogue


def proposal_table(proposal: dict[str, Any]) -> Table:
    """Each proposed term, with its numbers and intervals that hold them with 95 %."""
    columns = [text("term"), text("formula"), text("number"), text("value (95 %)"), number("standard error", less=True)]
    rows = []
    for term in proposal["proposed"]:
        name = plain(term["family"]) + (f" on {term['place']}" if term["place"] else "")
        for k, (parameter, found) in enumerate(term["parameters"].items()):
            value, error, unit = for_people(found["value"], found["stderr"], found["unit"])
            told = uncertain(value, None if error is None else WIDE * error, unit)
            first = [(name if k == 0 else "", name), (term["formula"] if k == 0 else "", term["formula"])]
            rows.append([*first, parameter, (told, found["value"]), (rounded(error), found["stderr"])])
    share = percent(min(max(proposal["explained"], 0.0), 1.0))
    besides = f"with {percent(proposal['missing'])} " if proposal.get("missing") else ""
    rest = (
        "nothing else is seen to be missing" if proposal["complete"] else f"{besides}something else is missing besides"
    )
    caption = (
        f"What is proposed, of {proposal['scored']} terms that were scored: it explains {share} of what is beyond noise, mesh and "
        f"what the scene may have slightly wrong; {rest}."
    )
    return Table(caption, columns, rows)


def path_table(proposal: dict[str, Any]) -> Table:
    """Which term entered when, and what competed."""
    unit = proposal["length_unit"]
    columns = [
        text("beside"),
        text("term", plain),
        number(f"expected ({unit})"),
        number("log-evidence"),
        text("entered"),
    ]
    rows: list[list[Any]] = []
    strong = set()
    for step in proposal["path"]:
        best = next((c["log_evidence"] for c in step["competed"] if c["log_evidence"] is not None), 0.0)
        for k, one in enumerate(step["competed"][:_SETS]):
            entered = one["family"] == step["entered"]
            if entered:
                strong.add(len(rows))
            beside = (model_name(step["beside"]) if k == 0 else "", step["beside"])
            evidence = "" if one["log_evidence"] is None else f"{one['log_evidence'] - best:+.1f}".replace("-", "−")
            reached = "yes" if step["rms"] is None else f"{step['rms']:.3g} {unit} when fitted"
            rows.append([beside, one["family"], one["expected_rms"], (evidence, one["log_evidence"])])
            rows[-1].append((reached if entered else "", entered))
    caption = (
        "The path: what the likeliest terms promised beside each model before any fit, their log-evidence against the best of "
        "them, and the one that proved best when they were fitted."
    )
    return Table(caption, columns, rows, strong)


# -- anchors


def sets_table(d: dict[str, Any]) -> Table:
    """The likeliest anchor sets of an identification."""
    unit = d["length_unit"]
    columns = [text("anchored"), text("probability", percent), number(f"residual ({unit})")]
    columns += [number(f"reported set there ({unit})"), number("level", _whole)]
    rows = [
        [_set(one["anchored"]), one["probability"], one["rms"], one.get("best_rms"), one.get("level")]
        for one in (d, *d["alternatives"][:_SETS])
    ]
    caption = "The reported set and the next best: what they miss in the frames in which both are known."
    return Table(caption, columns, rows, {0})


def pulls_table(d: dict[str, Any]) -> Table:
    """The pulls of an exploration."""
    columns = [number("pull", _whole), text("grasp"), text("direction"), number("amplitude (mm)", "{:.3g}".format)]
    columns += [number(f"{what} (bits)", _bits) for what in ("expected", "gained")]
    columns += [text("likeliest set"), text("probability", percent)]
    rows = []
    for step in d["steps"]:
        top: dict[str, Any] = (
            step["belief"][0] if step["belief"] else {"anchored": [], "effect": "", "probability": 0.0}
        )
        likely = _set(top["anchored"]) + (f" + {plain(top['effect'])}" if top["effect"] else "")
        keys = ("number", "grasp", "direction", "amplitude", "expected_bits", "gained_bits")
        rows.append([*(step[key] for key in keys), likely, top["probability"]])
    return Table("The pulls in turn, and what was believed after each.", columns, rows)


def residual_table(residual: Residual, by: str) -> Table:
    """RMS residual by "action", "step" or "fiducial", of each model."""
    columns = [text(by), *(number(f"{model} ({residual.unit})") for model in residual.models)]
    groups = [residual.by(by, model) for model in residual.models]
    rows = [[name, *(values[name] for values in groups)] for name in groups[0]]
    return Table(f"RMS residual per coordinate by {by}.", columns, rows)


def _only_yes(value: bool) -> str:
    return "yes" if value else ""


def _names(names: Sequence[str]) -> str:
    return " ".join(names) or "none"


def _whole(value: int | None) -> str:
    return "" if value is None else str(value)


def _bits(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _set(names: Sequence[str]) -> str:
    return "{" + " ".join(map(str, names)) + "}"
