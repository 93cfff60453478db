"""Stand-ins for making and diagnosing a case, as `validation.synthetic.case` calls them: quick, and faulty on demand."""

import json
import os
import time
from pathlib import Path
from typing import Any

from bcid.base.run_folder import RunFolder, write_whole
from validation.synthetic.drawing import CaseChoice

# What the stand-ins have done, one line each.
CALLS = "FAKE_STUDY_CALLS"
# Seconds that a diagnosis takes.
SLEEP = "FAKE_STUDY_SLEEP"


def make(folder: Path, index: int, choice: CaseChoice) -> None:
    truth = {"index": index, "kind": "none", "anchored": ["1"], "noise": 2e-4, "size": 0.0, "effects": []}
    about = {
        "body": choice.bodies[0],
        "not_asked": [],
        "conditions": {"noise": "right", "nuisances": False, "mesh": "fine"},
    }
    write_whole(folder / "truth.json", json.dumps(truth | about))
    write_whole(folder / "scene.toml", "")
    (folder / "measurement").mkdir(exist_ok=True)


def diagnose(
    scene: Path, measurement: Path, folder: Path, options: Any, comm: Any, progress: Any, overwrite: bool
) -> Path:
    """Case 1 raises, case 3 dies, case 5 hangs, case 6 computes for ever."""
    assert measurement.is_dir()
    assert scene == measurement.parent / "scene.toml"
    assert scene.is_file()
    assert not list(measurement.iterdir())
    index = int(measurement.parent.name)
    with open(os.environ[CALLS], "a", encoding="utf-8") as calls:
        calls.write(f"{index} {os.getpid()}\n")
    if index == 1:
        raise ValueError("no such thing")
    if index == 3:
        os.abort()
    while index == 6:
        pass
    time.sleep(600.0 if index == 5 else float(os.environ.get(SLEEP, "0")))
    answer = {"adequate": True, "verdict": "none", "anchored": ["1"], "ranking": [], "noise_rms": 0.2}
    run = RunFolder.start(folder, "explain", {}, overwrite)
    run.write_json("diagnosis.json", answer | {"held_out_rms": 0.2})
    run.finish({})
    return folder
