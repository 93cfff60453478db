"""On what an answer depends, and what to do next, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.base.units import percent
from bcid.inference.hypotheses import label
from bcid.results.words import NO_EFFECTS
from bcid.search.answer.next_steps import NextSteps
from bcid.search.answer.scene_sensitivity import AnswerAt
from bcid.search.settings import SETTINGS

# Steps that are named.
_STEPS = 6


def sensitivity(rows: Sequence[AnswerAt], patches: Sequence[str]) -> list[str]:
    """Whether the answer survives the scene, and on which inputs it depends; nothing where that was not computed."""
    if not rows:
        return []
    depends = [row for row in rows if row.depends]
    names = dict.fromkeys(row.input.name.replace("_", " ") for row in rows)
    if not depends:
        return [f"The answer is the same for {', '.join(names)} at ±2 standard deviations.", ""]
    lines = ["The answer depends on the scene (each input at two standard deviations, all else as it is):"]
    for row in depends:
        verdict = NO_EFFECTS.get(row.answer.verdict, row.answer.verdict)
        lines.append(
            f"  {row.input.label} {row.shifted}: {verdict} ({percent(row.answer.probability)}), "
            f"anchored {label(row.answer.anchors, patches)} ({percent(row.answer.held_by)})"
        )
    return [*lines, ""]


def next_steps(found: NextSteps | None) -> list[str]:
    """What would tell most; nothing where the answer is certain."""
    if found is None:
        return []
    if found.open < SETTINGS.helping:
        return [
            "What to do next: anchors and effects are decided among the hypotheses that were fitted to all steps. Open is only "
            "what was not fitted to them, or whether something unknown acts besides.",
            "",
        ]
    if not found.steps:
        return [
            f"What to do next: nothing that is computed here gives {SETTINGS.helping:g} bits of the {found.open:.2g} that are open "
            "about anchors and effects, among the hypotheses that were fitted to all steps.",
            "",
        ]
    lines = [f"What to do next (expected, of the {found.open:.2g} bits that are open about anchors and effects):"]
    return [*lines, *(f"  {step.expected_bits:.2f} bits: {step.text}" for step in found.steps[:_STEPS]), ""]
