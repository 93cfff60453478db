"""The exploration study beside sections 7 and 8 of Boonvisut & Cavusoglu (2014): Tables 8 to 10, Figures 13 and 14. Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import mean
from typing import Any

from bcid.base.units import percent
from bcid.exploration.loop import DECIDED
from bcid.inference.hypotheses import label
from validation.exploration.exploration_trials import ANCHORS, GRASPS, NOISES, STRATEGIES
from validation.sections import PICTURE, section
from validation.text_table import TextTable

Trial = Mapping[str, Any]
# The back projection error of the paper's cameras, m, and how the paper chooses.
LABORATORY, PAPER = 0.3e-3, "entropy"
# Noise with which one pull does not decide, m.
_MORE = 1e-3
_CODE = ("bcid/exploration/choice.py", "bcid/exploration/pull_posterior.py", "validation/exploration")

_TOLD = {
    "In the paper": """
        Algorithm 2 chooses the grasp and the direction that leave the least expected entropy, of three grasps 30 mm apart and
        six directions, with the single-stage search. Without noise all three sets are found (7.1, Table 8, Figure 13); with
        noise of the markers the rate falls gracefully (7.2, Table 9). In the laboratory (8, Table 10, Figure 14), with 8 mm
        and back to rest, one grasp and three find the set.""",
    "Here": """
        The same grasps and directions, 8 mm and back, chosen by the paper's expected entropy and by the expected information
        of `bcid explore`; the truth is computed with cubic elements on a mesh of its own. A trial ends when a set has 95 %,
        when no pull can tell more, or after a budget of 20. The laboratory is its noise, 0.3 mm, and nothing else.""",
    "Left open by the paper": "When it ends, and the amplitude in section 7: 8 mm as in section 8.",
    "Beyond the paper": """
        Every set is believed in or not, instead of those that a search met: an iteration asks for each pull with all 256
        sets. Whether answers at 95 % are right in 95 %; sets that no pull tells apart are named (`bcid-validate exploration`
        has the rest).""",
}


def page(trials: Sequence[Trial], cost: float, drawn: bool) -> str:
    """The section of a run; `cost` are the CPU seconds of one prediction of a pull with a set, NaN where not known."""
    main = [t for t in trials if not t["hidden"] and not t["felt"] and tuple(t["anchors"]) in ANCHORS]
    body = [table.markdown() for table in (_pulls(main), _noises(main, cost), *_laboratory(main, cost)) if table.rows]
    if drawn:
        body.append(f"![Belief in the candidate sets after each pull]({PICTURE})")
    return section("7 and 8, Tables 8 to 10, Figures 13 and 14", "Active exploration", _TOLD, _CODE, body)


def shown(trial: Trial) -> bool:
    """Whether a trial's beliefs are drawn: as in Figure 13 (no noise, all grasps) and 14 (the laboratory), and with more noise."""
    plain = not trial["hidden"] and not trial["felt"]
    first = trial["number"] == 0 and trial["strategy"] == PAPER and plain and trial["beliefs"]
    drawn = trial["noise"] in (LABORATORY, _MORE) or (trial["noise"] == 0 and len(trial["grasps"]) > 1)
    return bool(first and tuple(trial["anchors"]) in ANCHORS and drawn)


def _pulls(trials: Sequence[Trial]) -> TextTable:
    """Table 8: the pulls without noise, with all grasps."""
    rows = []
    for trial in trials:
        if trial["noise"] == 0 and len(trial["grasps"]) > 1 and trial["number"] == 0 and trial["strategy"] != "fixed":
            steps = zip(trial["moves"], trial["beliefs"], strict=True)
            told = "; ".join(f"{move}: {_likeliest(belief)}" for move, belief in steps)
            rows.append((label(trial["anchors"], trial["anchors"]), trial["strategy"], told, _ended(trial)))
    title = "Table 8: pulls without noise, and the set with the highest belief after each"
    return TextTable(title, ("anchored", "chosen by", "pulls", "ended"), tuple(rows))


def _ended(trial: Trial) -> str:
    right = "right" if trial["right"] else f"{label(trial['found'], trial['found'])}, wrong"
    return f"{right}, {trial['reason']}"


def _likeliest(belief: Mapping[str, float]) -> str:
    name, p = max(belief.items(), key=lambda item: item[1])
    return f"{name} {percent(p)}"


def _noises(trials: Sequence[Trial], cost: float) -> TextTable:
    """Table 9: rates, pulls, calls and times of an iteration by noise, with all grasps and with one."""
    rows = []
    for grasps in GRASPS:
        for strategy in STRATEGIES:
            for noise in NOISES:
                key = grasps, strategy, noise
                mine = [t for t in trials if (tuple(t["grasps"]), t["strategy"], t["noise"]) == key]
                if mine:
                    rows.append((str(len(grasps)), strategy, f"{noise * 1e3:g}", *_noise(mine, cost)))
    title = "Table 9: the exploration with noise of the markers. Calls and times of an iteration are means"
    head = (
        "grasps",
        "chosen by",
        "noise, mm",
        "trials",
        "right",
        "at 95 %",
        "of these wrong",
        "pulls",
        "calls",
        "CPU s",
    )
    return TextTable(title, head, tuple(rows))


def _noise(trials: Sequence[Trial], cost: float) -> tuple[str, ...]:
    decided = [t for t in trials if t["reason"] == DECIDED]
    right = sum(t["right"] for t in trials)
    pulls = mean(t["pulls"] for t in trials)
    each = [t["calls"] / t["pulls"] for t in trials if t["pulls"]]
    calls = mean(each) if each else math.nan
    wrong = sum(not t["right"] for t in decided)
    counted = (str(len(trials)), f"{100 * right / len(trials):.0f} %", str(len(decided)), str(wrong))
    return (*counted, f"{pulls:.1f}", f"{calls:.0f}", _time(calls, cost))


def _laboratory(trials: Sequence[Trial], cost: float) -> list[TextTable]:
    """Table 10: one trial with the laboratory's noise, iteration by iteration, with one grasp and with three."""
    made = []
    for part, grasps in zip("ab", GRASPS, strict=True):
        rows = []
        for trial in trials:
            if tuple(trial["grasps"]) == grasps and shown(trial) and trial["noise"] == LABORATORY:
                asked = [0, *trial["asked"]]
                for k, (move, belief) in enumerate(zip(trial["moves"], trial["beliefs"], strict=True)):
                    calls = asked[k + 1] - asked[k]
                    name = label(trial["anchors"], trial["anchors"]) if k == 0 else ""
                    rows.append((name, str(k + 1), move, str(calls), _time(calls, cost), _likeliest(belief)))
        grasped = f"{len(grasps)} grasp{'s' if len(grasps) > 1 else ''}"
        title = f"Table 10({part}): the laboratory's noise, {grasped}, chosen by {PAPER}"
        made.append(TextTable(title, ("anchored", "pull", "", "calls", "CPU s", "highest belief"), tuple(rows)))
    return made


def _time(calls: float, cost: float) -> str:
    return f"{calls * cost:.3g}" if math.isfinite(calls * cost) else "-"
