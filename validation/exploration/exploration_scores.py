"""The scores of the exploration study, and its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from statistics import median
from typing import Any

from bcid.exploration.loop import DECIDED, INSEPARABLE
from bcid.inference.hypotheses import label
from validation.exploration.exploration_trials import (
    ANCHORS,
    BESIDE,
    BUDGET,
    GRASPS,
    HIDDEN,
    NOISES,
    RIVALS,
    SEEN,
    STIFFER,
    STRATEGIES,
)
from validation.synthetic.amounts import HALF
from validation.synthetic.wilson import wilson

_FELT = {"without": False, "with": True}
# Of answers given at 95 %, so many shall be right.
CALIBRATED = 0.93


def scores(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """By grasps, noise and strategy: decided, right, pulls; the calibration; and the other parts."""
    held = [r for r in results if not r["hidden"] and tuple(r["anchors"]) in ANCHORS]
    main = [r for r in held if not r["felt"]]
    rows = []
    for grasps, noise, strategy in product(GRASPS, NOISES, STRATEGIES):
        mine = [r for r in main if (tuple(r["grasps"]), r["noise"], r["strategy"]) == (grasps, noise, strategy)]
        if mine:
            rows.append({"grasps": len(grasps), "noise": noise * 1e3, "strategy": strategy} | _row(mine))
    answers = [r["right"] for r in main if r["reason"] == DECIDED and r["strategy"] in ("information", "entropy")]
    low, high = wilson(sum(answers), len(answers))
    calibration = {"right": sum(answers), "answers": len(answers), "low": low, "high": high, "wanted": CALIBRATED}
    wrong = [
        f"{label(r['anchors'], r['anchors'])} taken for {label(r['found'], r['found'])}" for r in main if not r["right"]
    ]
    enclosed = [r for r in results if not r["hidden"] and tuple(r["anchors"]) not in ANCHORS]
    return {
        "trials": len(results),
        "rows": rows,
        "by_anchors": _by_anchors(main),
        "calibration": calibration,
        "wrong": {w: wrong.count(w) for w in sorted(set(wrong))},
        "forces": _forces(held),
        "hidden": [_hidden_row(name, [r for r in results if r["hidden"] == name]) for name in HIDDEN],
        "enclosed": {
            "anchors": enclosed[0]["anchors"] if enclosed else [],
            "trials": len(enclosed),
            "inseparable": sum(r["reason"] == INSEPARABLE for r in enclosed),
            "truth_named": sum(sorted(r["anchors"]) in r["named"] for r in enclosed),
            "sets_named": median(len(r["named"]) for r in enclosed) if enclosed else 0,
            "pulls": median(r["pulls"] for r in enclosed) if enclosed else 0,
        },
    }


def _forces(results: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """With and without force of the gripper in the settings in which it was felt, by noise and set."""
    rows = []
    for noise, anchors in product(NOISES, ANCHORS):
        key = GRASPS[0], STRATEGIES[0], noise, anchors
        mine = [r for r in results if (tuple(r["grasps"]), r["strategy"], r["noise"], tuple(r["anchors"])) == key]
        if any(r["felt"] for r in mine):
            of = {"noise": noise * 1e3, "anchors": list(anchors)}
            parts = {name: [r for r in mine if bool(r["felt"]) == felt] for name, felt in _FELT.items()}
            rows.append(of | {name: _felt_row(part) for name, part in parts.items() if part})
    return rows


def _felt_row(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    decided = [r for r in results if r["reason"] == DECIDED]
    bits = [r["expected"][0] for r in results if r["expected"]]
    stiff = [c for r in results if r["stiffness"] for c in r["stiffness"]["constants"].values()]
    return {
        "trials": len(results),
        "right": sum(r["right"] for r in results),
        "decided": len(decided),
        "falsely_certain": sum(not r["right"] for r in decided),
        "pulls": sum(r["pulls"] for r in results) / len(results),
        "bits": bits[0] if bits else None,
        "stiffness": median(c["value"] / c["scene"] for c in stiff) if stiff else None,
        "stderr": median(c["stderr"] / c["scene"] for c in stiff) if stiff else None,
        "within": sum(abs(c["value"] - STIFFER * c["scene"]) <= HALF * c["stderr"] for c in stiff),
    }


def _by_anchors(results: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Median number of pulls of every strategy, set by set: some are known after one pull, whichever it is."""
    rows = []
    for grasps, noise, anchors in product(GRASPS, NOISES, ANCHORS):
        pulls = {}
        for strategy in STRATEGIES:
            key = grasps, noise, anchors, strategy
            mine = [r for r in results if (tuple(r["grasps"]), r["noise"], tuple(r["anchors"]), r["strategy"]) == key]
            if mine:
                pulls[strategy] = _pulls(mine)
        if pulls:
            rows.append({"grasps": len(grasps), "noise": noise * 1e3, "anchors": list(anchors), "pulls": pulls})
    return rows


def _pulls(results: Sequence[Mapping[str, Any]]) -> float:
    """Median number; who does not decide has used all that was allowed, and would need more."""
    return float(median(r["pulls"] if r["reason"] == DECIDED else BUDGET for r in results))


def _hidden_row(name: str, results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What was found when something was hidden."""
    told = [r["told_by"] for r in results if r["told_by"]]
    return {
        "hidden": name,
        "trials": len(results),
        "right": sum(r["right"] for r in results),
        "decided": sum(r["reason"] == DECIDED for r in results),
        "probability": min((r["probability"] for r in results), default=0.0),
        "pulls": median(r["pulls"] for r in results) if results else 0,
        "told_by": median(told) if told else None,
        "seconds": median(r["seconds"] for r in results) if results else 0.0,
    }


def _row(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    decided = [r for r in results if r["reason"] == DECIDED]
    return {
        "trials": len(results),
        "decided": len(decided),
        "right": sum(r["right"] for r in results),
        "falsely_certain": sum(not r["right"] for r in decided),
        "pulls": _pulls(results),
        "calls": median(r["calls"] for r in results),
        "seconds": median(r["seconds"] for r in results),
    }


def table(found: Mapping[str, Any]) -> str:
    """The scores as text."""
    lines = [f"Exploration study: {found['trials']} trials, anchors {{1 2}}, {{3 4}}, {{1 2 3 4}}", ""]
    head = f"{'grasps':>6}{'noise':>8}  {'strategy':12}{'trials':>7}{'right':>7}{'decided':>9}{'falsely':>9}"
    lines.append(f"{head}{'pulls':>7}{'random needs':>14}{'calls':>8}{'seconds':>9}")
    for row in found["rows"]:
        random = [
            r["pulls"]
            for r in found["rows"]
            if (r["grasps"], r["noise"], r["strategy"]) == (row["grasps"], row["noise"], "random")
        ]
        ratio = f"{random[0] / row['pulls']:.2g} times" if random and row["strategy"] != "random" else "-"
        lines.append(
            f"{row['grasps']:>6}{row['noise']:>6.1f}mm  {row['strategy']:12}{row['trials']:>7}"
            f"{row['right'] / row['trials']:>7.0%}{row['decided']:>9}{row['falsely_certain']:>9}"
            f"{row['pulls']:>7g}{ratio:>14}{row['calls']:>8g}{row['seconds']:>9.2f}"
        )
    lines += ["", f"{'grasps':>6}{'noise':>8}  {'pulls by anchors':18}" + "".join(f"{s:>14}" for s in STRATEGIES)]
    for row in found["by_anchors"]:
        pulls = "".join(f"{row['pulls'][s]:>14g}" if s in row["pulls"] else f"{'-':>14}" for s in STRATEGIES)
        lines.append(f"{row['grasps']:>6}{row['noise']:>6.1f}mm  {label(row['anchors'], row['anchors']):18}{pulls}")
    c = found["calibration"]
    if c["answers"]:
        lines += [
            "",
            f"Of {c['answers']} answers at 95 % (information, entropy) {c['right'] / c['answers']:.1%} are right "
            f"({c['low']:.1%} to {c['high']:.1%}; wanted {c['wanted']:.0%})",
        ]
    if found["wrong"]:
        lines += ["", "Wrong, decided or not:", *(f"  {text}: {count}" for text, count in found["wrong"].items())]
    lines += [
        "",
        "right: the likeliest set at the end; decided: with 95 %; falsely: of these, wrong; pulls: median to the decision,",
        f"{BUDGET:g} where there was none; random needs: pulls of random choice over those of the strategy; calls: predictions",
        "of a pull with a set that a trial asks for (median); seconds: of a trial, which looks these up (median).",
        *_forces_table(found["forces"]),
        *_hidden_table([row for row in found["hidden"] if row["trials"]]),
        *_enclosed_lines(found["enclosed"]),
    ]
    return "\n".join(lines) + "\n"


def _forces_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    if not rows:
        return []
    head = f"{'noise':>8}  {'anchors':12}{'force':>9}{'trials':>8}{'right':>7}{'decided':>9}{'falsely':>9}{'pulls':>7}{'bits':>7}"
    lines = [
        "",
        f"Grasp II, by information, without and with force of a body {STIFFER:g} times as stiff as its scene:",
        "",
    ]
    lines.append(f"{head}   stiffness found (within 95 %)")
    for row in rows:
        for name in (name for name in _FELT if name in row):
            r = row[name]
            stiff = (
                f"{r['stiffness']:.3f} +- {r['stderr']:.3f} ({r['within']} of {r['trials']})" if r["stiffness"] else "-"
            )
            bits = "-" if r["bits"] is None else f"{r['bits']:.2f}"
            lines.append(
                f"{row['noise']:>6.1f}mm  {label(row['anchors'], row['anchors']):12}{name:>9}{r['trials']:>8}{r['right']:>7}"
                f"{r['decided']:>9}{r['falsely_certain']:>9}{r['pulls']:>7.1f}{bits:>7}   {stiff}"
            )
    return [
        *lines,
        "",
        "pulls: mean number; bits: expected of the first pull; stiffness: median, in units of the scene's.",
    ]


def _hidden_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    if not rows:
        return []
    head = f"{'hidden':14}{'trials':>7}{'right':>7}{'decided':>9}{'least probability':>19}"
    head += f"{'pulls':>7}{'told by pull':>14}{'seconds':>9}"
    lines = [
        "",
        f"With {label(BESIDE, BESIDE)}, noise {SEEN * 1e3:g} mm, rivals {', '.join(RIVALS)} and none:",
        "",
        head,
    ]
    for row in rows:
        told = "-" if row["told_by"] is None else f"{row['told_by']:g}"
        lines.append(
            f"{row['hidden']:14}{row['trials']:>7}{row['right'] / row['trials']:>7.0%}{row['decided']:>9}"
            f"{row['probability']:>19.2%}{row['pulls']:>7g}{told:>14}{row['seconds']:>9.0f}"
        )
    return lines


def _enclosed_lines(found: Mapping[str, Any]) -> list[str]:
    if not found["trials"]:
        return []
    return [
        "",
        f"{label(found['anchors'], found['anchors'])}, in which patches are enclosed by others, noise {SEEN * 1e3:g} mm: "
        f'{found["inseparable"]} of {found["trials"]} ended with "inseparable",',
        f"after {found['pulls']:g} pulls, naming {found['sets_named']:g} sets, the true one in {found['truth_named']}.",
    ]
