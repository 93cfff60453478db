"""Make docs/paper.md of a finished `bcid-validate paper`: its tables, its pictures, and what the paper says beside what was found;
COMMIT is that of the code that ran it.

./dev python docs/_make/paper.py RUN COMMIT
"""

import json
import math
import shutil
import sys
from pathlib import Path

from bcid.base.run_folder import RunFolder
from validation.engine.work import read_result
from validation.exploration.exploration_page import page as exploration_page
from validation.exploration.exploration_page import shown
from validation.exploration.exploration_study import call_cost, results
from validation.exploration.exploration_trials import ExplorationExtent
from validation.paper.claims import verdicts
from validation.paper.paper_study import in_order
from validation.paper.study import Summary
from validation.paper.study_file import StudyFile
from validation.paper.study_page import study_page
from validation.plots import is_curve, progression, success
from validation.sections import PICTURE

DOCS = Path(__file__).resolve().parents[1]
STUDIES, PICTURES = DOCS.parent / "validation/paper", DOCS / "paper"
COMMAND = "bcid-validate paper -o paper"


def made(run: Path) -> dict[str, tuple[Summary, str]]:
    """What every study of a run tells, and its section."""
    found = {}
    for file in sorted(STUDIES.glob("*.toml")):
        study = StudyFile.read(file)
        costs = json.loads((run / study.name / "study.json").read_text(encoding="utf-8"))["costs"]
        told = Summary.of(study, run / study.name / "results", costs)
        drawn = is_curve(study)
        if drawn:
            success(PICTURES / f"{study.name}.png", study, told.cells)
        found[study.name] = told, study_page(study, told.tables, told.rows, drawn)
    return found


def made_extent(run: Path) -> ExplorationExtent:
    """How much of the exploration a run has made."""
    stated = RunFolder.open(run).record["inputs"]["extent"]
    grasps = tuple(tuple(names) for names in stated["grasps"])
    return ExplorationExtent(
        **{k: tuple(v) if isinstance(v, list) else v for k, v in stated.items()} | {"grasps": grasps}
    )


def hours(run: Path) -> float:
    """What all predictions and trials of a run took."""
    files = (file for part in ("precomputed", "results") for file in run.glob(f"*/{part}/*.json"))
    return sum(read_result(file)["seconds"] for file in files) / 3600


def main(run: Path, commit: str) -> None:
    """Write the page and copy the pictures beside it."""
    record = RunFolder.open(run).record
    about = f"{record['started'][:10]}, commit {commit}, {hours(run):.1f} CPU hours"
    shutil.rmtree(PICTURES, ignore_errors=True)
    PICTURES.mkdir()
    found = made(run)
    texts = {name: text for name, (_, text) in found.items()}
    explored = run / "exploration"
    cost = call_cost(explored)
    assert math.isfinite(cost)
    extent = made_extent(explored)
    trials = results(explored, extent)
    progression(PICTURES / "exploration.png", [trial for trial in trials if shown(trial)])
    texts["exploration"] = exploration_page(trials, cost, True)
    sections = [texts[name].replace(f"]({PICTURE})", f"](paper/{name}.png)") for name in in_order(texts)]
    head = (DOCS / "_make/paper_head.md").read_text(encoding="utf-8").replace("COMMAND", COMMAND).replace("MADE", about)
    ordered = [found[name][0] for name in in_order(texts) if name in found]
    judged = verdicts((told.study.title, claim) for told in ordered for claim in told.claims)
    page = "\n".join([f"{head}{judged.markdown()}\n", *sections])
    (DOCS / "paper.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
