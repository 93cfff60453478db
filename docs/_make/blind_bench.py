"""Put the tables and the picture of a `bcid-validate synthetic` into docs/results.md; COMMIT is that of the code that ran it.

./dev python docs/_make/blind_bench.py RUN COMMIT
"""

import json
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bcid.base.run_folder import RunFolder
from validation.synthetic.judge import QUESTIONS
from validation.synthetic.score import CALIBRATED, GOALS, LARGEST, MEDIAN, SURE_AND_WRONG

DOCS = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- made by docs/_make/blind_bench.py -->\n", "<!-- made until here -->\n"
# What the groups of cases are called, in their order.
GROUPS = {False: "everything as the scene states it", True: "everything but the noise slightly wrong", None: "all"}
# What is told by body and mesh: what does not depend on how the noise is stated.
SPLIT = ("named", "first two", "parameters", "intervals", "anchors", "settled", "no false name")

Json = Mapping[str, Any]


def goal(least: float | None, most: float) -> str:
    """A goal in per cent."""
    if least is None:
        return ""
    return f"{100 * least:.0f}" if most == 1 else f"{100 * least:.0f} to {100 * most:.0f}"


def reached(rate: Json) -> str:
    """A rate as two cells: of how many, and the interval."""
    return f"{rate['met']} of {rate['count']} | {100 * rate['low']:.0f} to {100 * rate['high']:.0f}"


def goals(found: Json) -> Iterator[str]:
    """A row for each question that was asked, those of the same cases together."""
    yield "| question | right | 95 % interval, % | goal, % |"
    yield "|---|---|---|---|"
    for nuisances, name in GROUPS.items():
        yield f"| **{name}** | | | |"
        for key, asked in GOALS.items():
            rate = found["rates"][key]
            if asked.nuisances is not nuisances or not rate["count"]:
                continue
            wanted = goal(asked.least, asked.most) + (", missed" if asked.least and rate["rate"] < asked.least else "")
            yield f"| {QUESTIONS[asked.question]} | {reached(rate)} | {wanted} |"
    answers, sure = found["calibration"], found["calibration"]["sure_and_wrong"]
    most = f"at most {100 * SURE_AND_WRONG:.0f}{', missed' if sure['rate'] > SURE_AND_WRONG else ''}"
    yield f"| verdicts and sets told with 95 % or more that are wrong | {reached(sure)} | {most} |"
    most = f"at most {CALIBRATED:g}{', missed' if answers['expected_error'] > CALIBRATED else ''}"
    error = f"{answers['expected_error']:.3f} (by chance {answers['by_chance']:.3f})"
    yield f"| calibration error of {answers['count']} told probabilities | {error} | | {most} |"


def told(found: Json) -> Iterator[str]:
    """How often answers were right that were told with some probability."""
    bins = [b for b in found["calibration"]["bins"] if b["count"]]
    yield "| told | " + " | ".join(f"{100 * b['from']:.0f} to {100 * b['to']:.0f} %" for b in bins) + " |"
    yield "|---|" + "---|" * len(bins)
    yield "| on average | " + " | ".join(f"{100 * b['told']:.1f} %" for b in bins) + " |"
    yield "| right | " + " | ".join(f"{b['met']} of {b['count']}" for b in bins) + " |"


def split(found: Json) -> Iterator[str]:
    """A column for each body, and for coarse and fine meshes, whatever else is wrong."""
    groups = found["by_body"] | {f"{name} meshes": rates for name, rates in found["by_mesh"].items()}
    yield "| | " + " | ".join(groups) + " |"
    yield "|---|" + "---|" * len(groups)
    for question in SPLIT:
        rates = [group.get(question) for group in groups.values()]
        if any(rates):
            yield f"| {question} | " + " | ".join(f"{r['met']} of {r['count']}" if r else "" for r in rates) + " |"


def page(run: Path, commit: str) -> str:
    """The part of the page that is made."""
    found: Json = json.loads((run / "hidden.json").read_text(encoding="utf-8"))
    inputs, cpu = RunFolder.open(run).record["inputs"], found["cpu_seconds"]
    asked = " ".join(f"--{name} {inputs[name]:g}" for name in ("cases", "seed", "least", "limit"))
    states = ", ".join(f"{count} {name}" for name, count in sorted(found["states"].items()))
    largest = f"{found['states']['timeout']} out of time" if cpu["largest"] is None else f"{cpu['largest']:.0f} at most"
    lines = [
        f"`bcid-validate synthetic {asked} -o study` at commit {commit}: {found['cases']} of {found['asked']} cases ({states}). "
        f"CPU seconds of a diagnosis: {cpu['median']:.0f} in the median, {largest} (goals {MEDIAN:.0f} and {LARGEST:.0f}).",
        "",
        "![Rates beside their goals, and told probabilities beside how often they were right](blind_bench.png)",
        "",
        *goals(found),
        "",
        "Told probabilities of verdicts and of anchored sets, of effects of all sizes:",
        "",
        *told(found),
        "",
        "By body and mesh:",
        "",
        *split(found),
    ]
    return "\n".join(lines) + "\n"


def main(run: Path, commit: str) -> None:
    """Replace what was made before."""
    file = DOCS / "results.md"
    before, rest = file.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    file.write_text(f"{before}{BEGIN}\n{page(run, commit)}\n{END}{after}", encoding="utf-8")
    shutil.copyfile(run / "goals.png", DOCS / "blind_bench.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
