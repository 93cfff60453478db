"""The page of the validation, from the results of its experiments that the repository keeps."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from validation import ablation, calibration, numbers, public
from validation.golden import run as golden
from validation.golden import score as golden_score
from validation.outside import score as outside_score
from validation.stored_results import RESULTS, kept
from validation.text_table import TextTable

HEAD = """# Validation

Are the probabilities that bcid reports right? Five experiments answer that with data whose truth is known, and a sixth
stands beside what others say of their measurements. Each is one command in a checkout; `--keep` puts its result into
`validation/results`, from which this page is made. The score of an answer is the logarithm to base 2 of the probability
that it gives to the truth, 0 at best: -1 for a probability of one half. The truth is what an ideal observer cannot
separate: patches that move the markers by less than the noise, and effects of less than three noises, may be either way.
*Certain* is a probability above 95 %.
"""
GOLDEN = """## Golden cases

    ./dev bcid-validate golden -o golden

Measurements of the blinded study (`hidden`), of effects that are in no catalogue (`beyond`), of the laboratory and
with awkward inputs. Their answers were frozen before the statistical method was replaced; each is explained again. Forward
trajectories count whether or not a store (`--store`) held them, CPU seconds do not.
"""
CALIBRATION = """## Calibration

    ./dev bcid-validate calibration -o calibration

Hypotheses and amounts are drawn from the prior, and data from the [observation model](../theory.md), linearised about
a golden case; the functions that explain a measurement give the posterior. Of the answers with probability p a part p
should be right. The noise is raised by a factor, so that hypotheses can be confused. *Error* is the expected
difference of the stated probability and the part that is right; the last column tests whether the ranks of the true
hypothesis are uniform.

![Part of the answers that is right, over the stated probability, for verdict and anchors](calibration.png)
"""
OUTSIDE = """## Worlds outside the family of models

    ./dev bcid-validate outside -o outside

Measurements that no model of bcid describes, computed by FElupe on quadratic hexahedra; what is wrong in each kind,
and which answers are right, is in [results](../results.md). An answer that is certain and wrong is worse than one
that leaves the question open, and an answer that leaves all open is of no use: the goals are in the last lines.
"""
PUBLIC = """## Measurements made by others

    ./dev bcid-validate public FOLDER -o public

FOLDER holds the data of others, which are not part of bcid. Errors and intervals are those of 95 %. How each is described
is on the page on [test rigs](../rigs.md) and in the examples.
"""
ABLATION = """## Ablation

    ./dev bcid-validate ablation -o ablation

Golden cases without one term of the posterior after the other: what the score loses without a term is what the term is worth.
"""
NUMBERS = """## The numbers that decide something

    ./dev bcid-validate numbers -o numbers

Whatever was chosen by hand and moves an answer is a field of `Priors` (what is believed before the data are seen),
`Thresholds` (from where on something is reported) or `SearchSettings` (how far the search goes), described where it is defined.
The table shows what half and double of each does to the mean score of a few golden cases.
"""


def write_validation(made: Path) -> None:
    """Write the page and its picture into a folder: a section for each experiment whose result is kept."""
    sections = {
        "golden": _golden,
        "calibration": _calibration,
        "outside": _outside,
        "public": _public,
        "ablation": _ablation,
        "numbers": _numbers,
    }
    parts = [HEAD]
    for experiment, section in sections.items():
        if (RESULTS / f"{experiment}.json").is_file():
            parts += section(kept(experiment), made)
    text = "\n".join(part + "\n" for part in parts)
    target = made / "validation.md"
    if not target.is_file() or target.read_text(encoding="utf-8") != text:
        target.write_text(text, encoding="utf-8")


def _golden(found: Any, _: Path) -> list[str]:
    frozen = golden.frozen()
    return [GOLDEN, _list(golden_score.summary(frozen, found)), _bare(golden_score.table(frozen, found))]


def _calibration(found: Any, made: Path) -> list[str]:
    draws = {float(noise): some for noise, some in found.items()}
    calibration.picture(draws, made / "calibration.png")
    return [CALIBRATION, _bare(calibration.table(draws))]


def _outside(found: Any, _: Path) -> list[str]:
    return [OUTSIDE, _bare(outside_score.table(found)), _list(outside_score.summary(found))]


def _public(found: Any, _: Path) -> list[str]:
    return [PUBLIC, _bare(public.table(found))]


def _ablation(found: Any, _: Path) -> list[str]:
    return [ABLATION, ablation.table(found).markdown()]


def _numbers(found: Any, _: Path) -> list[str]:
    return [NUMBERS, numbers.table(found).markdown()]


def _list(lines: list[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _bare(table: TextTable) -> str:
    """A table without its title: the section has one."""
    return replace(table, title="").markdown()
