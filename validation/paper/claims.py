"""What the paper says, and whether it holds here."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bcid.inference.hypotheses import label
from validation.paper.cells import Row, mean_calls, rounds, time_range, wrong_answers
from validation.paper.condition import named, written
from validation.paper.study_file import StudyFile
from validation.synthetic.wilson import wilson
from validation.text_table import TextTable

HOLDS, FAILS, TOLD = "holds", "does not hold", "-"


@dataclass(frozen=True)
class Claim:
    """Something that the paper says.

    Attributes:
        about: of which trials, in words; "" for all.
        paper, here: what it says, and what was found.
        verdict: `HOLDS`, `FAILS`, or `TOLD` where the two only stand beside each other.
    """

    about: str
    paper: str
    here: str
    verdict: str

    def to_json(self) -> dict[str, str]:
        """As JSON."""
        return {"about": self.about, "paper": self.paper, "here": self.here, "verdict": self.verdict}


def claims(study: StudyFile, rows: Sequence[Row], costs: Mapping[str, float]) -> list[Claim]:
    """What the paper says of a study; of cells that a reduced study leaves out nothing can be said."""
    found = []
    for entry in study.paper:
        where = entry["where"]
        mine = [row for row in rows if _there(row, where)]
        about = ", ".join(f"{named(name)} {written(name, value)}" for name, value in where.items())
        if "says" in entry:
            found.append(Claim(about, entry["says"], entry.get("here", ""), TOLD))
        for key, judge in _JUDGES.items():
            if key in entry and mine:
                paper, here, verdict = judge(entry[key], mine, costs, study)
                found.append(Claim(about, entry.get("reads", paper), here, verdict))
    return found


def verdicts(said: Iterable[tuple[str, Claim]]) -> TextTable:
    """All that can hold or not, with the titles of the studies, in one table."""
    judged = [(title, claim) for title, claim in said if claim.verdict in (HOLDS, FAILS)]
    held = sum(claim.verdict == HOLDS for _, claim in judged)
    rows = tuple((title, c.about or "all", c.paper, c.here, c.verdict) for title, c in judged)
    title = f"{held} of {len(judged)} statements of the paper that can be judged hold here:"
    return TextTable(title, ("study", "of which trials", "the paper", "here", ""), rows)


def _there(row: Row, where: Mapping[str, Any]) -> bool:
    """Whether a trial is meant; sets that take turns are asked for one by one."""
    return all(
        tuple(row["anchors"]) in {tuple(sorted(a)) for a in value} if name == "anchors" else row[name] == value
        for name, value in where.items()
    )


Judged = tuple[str, str, str]


def _right(paper: float, rows: Sequence[Row], _costs: Mapping[str, float], _study: StudyFile) -> Judged:
    """Holds where the paper's rate is reached, or lies within the interval of ours."""
    hits = sum(bool(row["right"]) for row in rows)
    high = wilson(hits, len(rows))[1]
    reached = hits / len(rows) >= paper or (paper < 1 and high >= paper)
    return f"{100 * paper:.4g} % right", f"{100 * hits / len(rows):.4g} %, {hits} of {len(rows)}", _holds(reached)


def _wrong(paper: Sequence[Sequence[str]], rows: Sequence[Row], _costs: Mapping[str, float], _s: StudyFile) -> Judged:
    """Holds where each of the paper's wrong answers is among ours."""
    ours = {frozenset(answer.found): answer.count for answer in wrong_answers(rows)}
    told = [f"{label(sorted(a), sorted(a))} {ours.get(frozenset(a), 0)} times" for a in paper]
    listed = ", ".join(label(sorted(a), sorted(a)) for a in paper)
    among = all(frozenset(a) in ours for a in paper)
    return f"wrong answers {listed}", f"{', '.join(told)}, of {sum(ours.values())} wrong ones", _holds(among)


def _calls(paper: Sequence[float], rows: Sequence[Row], _costs: Mapping[str, float], _study: StudyFile) -> Judged:
    here = " + ".join(f"{count:.3g}" for count in mean_calls(rows).values())
    return f"{' + '.join(f'{c:g}' for c in paper)} calls by level", here, TOLD


def _seconds(paper: Sequence[float], rows: Sequence[Row], costs: Mapping[str, float], _study: StudyFile) -> Judged:
    mean, least, most = paper
    found = time_range(rows, costs)
    here = f"{found[0]:.3g} CPU s ({found[1]:.3g} to {found[2]:.3g})" if found else "not known"
    return f"{mean:g} s ({least:g} to {most:g}) on 8 threads", here, TOLD


def _more_right_than(paper: int, rows: Sequence[Row], _costs: Mapping[str, float], _study: StudyFile) -> Judged:
    """Holds where the median round is right in more cells than the paper says."""
    each, count = rounds(rows), len({row["cell"] for row in rows})
    here = f"{np.median(each):g} of {count} (median of {len(each)} rounds, {min(each)} to {max(each)})"
    return f"at most {paper} of 18 right", here, _holds(bool(np.median(each) / count > paper / 18))


def _holds(value: bool) -> str:
    return HOLDS if value else FAILS


_JUDGES: dict[str, Callable[[Any, Sequence[Row], Mapping[str, float], StudyFile], Judged]] = {
    "right": _right,
    "wrong": _wrong,
    "calls": _calls,
    "seconds": _seconds,
    "more_right_than": _more_right_than,
}
