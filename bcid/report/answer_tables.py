"""Tables of how far an answer can be trusted: with other inputs of the scene, and what would tell more."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bcid.base.units import percent
from bcid.base.verdict_words import NO_EFFECTS
from bcid.report.table import TEXT, Column, Table
from bcid.report.text import listed, patches, plain


def sensitivity_table(d: dict[str, Any]) -> Table | None:
    """The answer with each input of the scene off by two standard deviations; None where that was not computed."""
    rows, exact, strong = list[list[str]](), list[list[Any]](), set[int]()
    for one in _joined(d.get("scene_sensitivity", ())):
        if one["depends"]:
            strong.add(len(rows))
        names = patches(one["anchored"])
        verdict = NO_EFFECTS.get(one["verdict"]) or listed([plain(name) for name in str(one["verdict"]).split("+")])
        answer = [verdict, percent(one["verdict_probability"]), names, percent(one["anchors_probability"])]
        rows.append([one["label"], one["off"], *answer, "yes" if one["depends"] else ""])
        names = " ".join(one["anchored"]) or "none"
        cells = [one["verdict"], one["verdict_probability"], names, one["anchors_probability"]]
        exact.append([one["label"], one["off"], *cells, "yes" if one["depends"] else "no"])
    if not rows:
        return None
    heads = ("input", "off by", "missing", "probability", "anchored", "of these", "depends")
    columns = [Column(head, TEXT) for head in heads]
    caption = (
        "The answer where one input of the scene is off by two standard deviations and all else is as it is, of the hypotheses "
        "that were fitted to all steps. It depends on an input where verdict or anchors change, or fall below 95 %. With ± the "
        "smaller probability of both signs stands."
    )
    return Table("scene-sensitivity", caption, columns, rows, exact, frozenset(strong))


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


def steps_table(d: dict[str, Any]) -> Table | None:
    """What would tell most; None where the answer is certain, or nothing helps."""
    steps = d.get("next_steps")
    if not steps:
        return None
    columns = [Column("what to do", TEXT), Column("expected (bits)")]
    rows = [[step["text"], f"{step['bits']:.2f}"] for step in steps]
    exact = [[step["text"], step["bits"]] for step in steps]
    caption = (
        f"What to do next: expected information on anchors and effects, of the {d['open_bits']:.2g} bits that are open. What "
        "a pull, a force sensor and markers would tell is estimated from the measured pulls."
    )
    return Table("next-steps", caption, columns, rows, exact, frozenset({0}))
