"""Sound inputs of every kind, small ones, that the checks of bad input start from, and readers that say how reading ended."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bcid import Measurement, Scene
from bcid.base.errors import InputError
from bcid.forms.model import check_physics
from bcid.vision.recording import Recording
from validation.reliability import MEASURED, ROOT, SLAB

_MORE = """
attach_within = "2 mm"
[explore]
displacement = "8 mm"
force = "2 N"
strain = 0.5
amplitudes = ["8 mm", "4 mm"]
steps = 4
cost = 1.5
regrasp = 0.5
directions = { out = [1, 0, 0], lift = [0, 1, 0] }
[effects.gravity]
weight = "9.81 kN/m^3"
[effects.soft_anchor]
place = "3"
stiffness = "50 kPa/m"
"""
_WIDE = """format = "bcid-mapping/1"
length_unit = "mm"
time_unit = "ms"
force_unit = "N"
file = "wide.csv"
delimiter = ";"
grasp = "II"
noise_sigma = 0.1
description = "a trial"
[frames]
first = 0
last = 3
every = 1
[columns]
time = "t"
action = "trial"
translation = ["gx", "gy", "gz"]
[fiducials]
a = ["ax", "ay", "az"]
b = ["bx", "by", "bz"]
c = ["ax", "bx", "ay"]
[align]
a = [0, 0, 0]
b = [10, 0, 0]
c = [0, 10, 0]
"""
_LONG = """format = "bcid-mapping/1"
length_unit = "mm"
time_unit = "s"
force_unit = "N"
file = "long.csv"
action = "1"
[columns]
step = "frame"
time = "t"
fiducial = "label"
position = ["x", "y", "z"]
[fiducials]
a = "A"
b = "B"
"""
_RECORDING = """format = "bcid-recording/1"
cameras = "cameras.json"
left = "left"
right = "right"
grasps = "grasps.csv"
rate = 10
length_unit = "mm"
time_unit = "s"
distance = "300 mm"
[beads]
diameter = "2 mm"
colour = "dark"
[images]
first = 0
every = 1
last = 60
[layout]
sigma = "0.1 mm"
tolerance = "3 mm"
scale = false
[seen]
"1" = [10, 20.5]
"""


def scene_text() -> str:
    """The slab with everything that a scene file may say."""
    text = SLAB.read_text(encoding="utf-8").replace("../../", f"{ROOT}/")
    more, _, tables = _MORE.strip().partition("\n")
    return text.replace('noise_sigma = "0.3 mm"', f'noise_sigma = "0.3 mm"\n{more}') + tables + "\n"


def write_inputs(folder: Path) -> dict[str, str]:
    """Write a sound input of every kind; returns the text of each file by its name."""
    files = {"scene.toml": scene_text(), "seen/measurement.toml": _text("measurement.toml")}
    files["seen/fiducials.csv"] = "\n".join(_text("fiducials.csv").splitlines()[:49]) + "\n"
    files["seen/grasps.csv"] = "\n".join(_text("grasps.csv").splitlines()[:4]) + "\n"
    files["seen/wrench.csv"] = "action,step,time,fx,fy,fz,tx,ty,tz\n1,0,0,0,0,0,0,0,0\n1,1,1,1,2,3,4,5,6\n"
    files["seen/loads.csv"] = "action,step,time,place,fx,fy,fz\n1,2,2,bottom,0,-1,0\n"
    covariance = ",\n".join(str(row) for row in (np.eye(7) * 1e-4).tolist())
    files["seen/frame.toml"] = f'format = "bcid-frame/1"\ncentre = [50, 5, 50]\ncovariance = [\n{covariance},\n]\n'
    files["wide.toml"], files["long.toml"], files["recording.toml"] = _WIDE, _LONG, _RECORDING
    rows = [f"{trial};{10 * i};{i};0;0;10;{i};0;{i};0;0" for trial in (1, 2) for i in range(5)]
    files["wide.csv"] = "\n".join(["trial;t;ax;ay;az;bx;by;bz;gx;gy;gz", *rows]) + "\n"
    rows = [f"{i},{i},{label},{i},{k},0" for i in range(4) for k, label in enumerate("AB")]
    files["long.csv"] = "\n".join(["frame,t,label,x,y,z", *rows]) + "\n"
    side = {"matrix": [[900, 0, 320], [0, 900, 240], [0, 0, 1]], "distortion": [0, 0, 0, 0, 0], "size": [640, 480]}
    cameras = {"format": "bcid-cameras/1", "length_unit": "m", "left": side, "right": side}
    cameras |= {"rotation": np.eye(3).tolist(), "translation": [-0.1, 0, 0], "reprojection_error": 0.1}
    files["cameras.json"] = json.dumps(cameras, indent=1)
    files["grasps.csv"] = _text("grasps.csv")
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return files


def _text(name: str) -> str:
    return (MEASURED / name).read_text(encoding="utf-8")


def reader(folder: Path, name: str) -> Callable[[], Any]:
    """What reads a file of `write_inputs`."""
    if name == "scene.toml":
        return lambda: Scene.read(folder / name, physics=check_physics)
    if name.startswith("seen/"):
        return lambda: Measurement.read(folder / "seen")
    if name in ("recording.toml", "cameras.json", "grasps.csv"):
        return lambda: Recording.read(folder / "recording.toml")
    return lambda: Measurement.read(folder / name.replace(".csv", ".toml"))


def refusal(read: Callable[[], Any]) -> str | None:
    """What is said of an input; None where it is accepted. Other exceptions than `InputError` are bcid's fault."""
    try:
        read()
    except InputError as error:
        return str(error)
    return None


def small_scene(folder: Path) -> Path:
    """The slab with four patches and two coarse levels, in a folder; returns the scene file."""
    lines = SLAB.read_text(encoding="utf-8").replace("../../", f"{ROOT}/").splitlines()
    kept = [line for line in lines if not line.startswith(tuple(f'"{name}" = "patch_' for name in "5678"))]
    text = "\n".join(kept)
    for size in ("7.2 mm", "3.6 mm"):
        text = text.replace(f'[[levels]]\nelement_size = "{size}"\ndegree = 2\n', "")
    (folder / "scene.toml").write_text(text + "\n", encoding="utf-8")
    return folder / "scene.toml"
