"""F3: every command that writes, with inputs of its own that are small, and what it leaves when it has succeeded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bcid.scene import Scene
from bcid.scene.motions import motion
from validation.reliability.inputs import small_scene
from validation.rendering.rig import stereo_rig
from validation.rendering.scene_images import moved, render_recording

# Walls of a corner that both cameras see, and the points on each, m.
_WALL = np.array([(a, b) for a in range(7, 63, 11) for b in range(7, 64, 14)]) * 1e-3
_IMAGE = "1280x1024"


@dataclass(frozen=True)
class Writer:
    """A command that writes.

    Attributes:
        words: the command, whose last argument is to be where it writes.
        end: of that place's name, as ".html"; "" for a folder.
        result: a file of the folder that is the same each time; "" where the place itself is the file.
        goes_on: whether it keeps what it has begun, and goes on there; otherwise nothing may stay.
    """

    words: tuple[object, ...]
    end: str = ""
    result: str = ""
    goes_on: bool = False

    @property
    def name(self) -> str:
        """The command in words."""
        return " ".join(str(word) for word in self.words[:2]) if self.words[0] == "scene" else str(self.words[0])

    def read(self, target: Path) -> bytes:
        """What it made."""
        return (target / self.result if self.result else target).read_bytes()


def solving(folder: Path) -> tuple[Writer, Writer]:
    """Commands that solve: simulate, and identify on `seen`, which the first has to make before."""
    scene = small_scene(folder)
    simulate = ("simulate", scene, "--anchors", "3,4", "--motion", "pull", "--level", "1", "--quiet", "-o")
    identify = (
        "identify",
        scene,
        folder / "seen",
        "--level",
        "0",
        "--exhaustive",
        "yes",
        "--quiet",
        "--no-picture",
        "-o",
    )
    return Writer(simulate, "", "fiducials.csv"), Writer(identify, "", "identification.json", True)


def calibrating(folder: Path) -> Writer:
    """A calibration from known points."""
    board, picked = _picked(folder)
    shown = ("--board", board, "--picked", picked, "--image-size", _IMAGE)
    return Writer(("calibrate", *shown, "--no-picture", "--quiet", "-o"), "", "cameras.json", True)


def others(folder: Path, run: Path, calibrated: Path) -> Iterator[Writer]:
    """Commands that solve nothing; `run` is one of identify, `calibrated` one of calibrate, the folder holds `scene.toml`."""
    scene = folder / "scene.toml"
    yield Writer(("scene", "check", scene, "-o"), ".png")
    yield Writer(("report", run, "--quiet", "-o"), ".html")
    yield Writer(("figure", calibrated, "--quiet", "-o"), "", "provenance.csv")
    yield Writer(("examples",), "", "examples/scenes/slab.toml")
    yield Writer(("import", _recorded(folder), "--no-picture", "-o"), ".toml")
    track = ("track", scene, _filmed(Scene.read(scene), folder / "filmed"), "--no-picture", "--quiet", "-o")
    yield Writer(track, "", "measurement/fiducials.csv", True)


def _picked(folder: Path) -> tuple[Path, Path]:
    """Points of three walls, and where two cameras see them in two poses."""
    cameras, _ = stereo_rig()
    points = np.vstack([np.insert(_WALL, axis, 0, axis=1) for axis in range(3)])
    names = [f"p{number}" for number in range(len(points))]
    rows = [f"{name},{x * 1e3:.6f},{y * 1e3:.6f},{z * 1e3:.6f}" for name, (x, y, z) in zip(names, points, strict=True)]
    lines = ["pose,name,u_left,v_left,u_right,v_right"]
    for number, tilt in enumerate((-0.2, 0.2)):
        seen = np.asarray(cameras.project((points - points.mean(axis=0)) @ _facing(tilt).T + [0, 0, 0.3]))
        for name, (u, v), (other, w) in zip(names, *seen, strict=True):
            lines.append(f"{number},{name},{u:.6f},{v:.6f},{other:.6f},{w:.6f}")
    board, picked = folder / "board.csv", folder / "picked.csv"
    board.write_text("\n".join(["name,x_mm,y_mm,z_mm", *rows]) + "\n", encoding="utf-8")
    picked.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return board, picked


def _facing(tilt: float) -> np.ndarray:
    """Turns the open side of the walls towards a camera, and by an angle, rad, besides."""
    from scipy.spatial.transform import Rotation

    diagonal, _ = Rotation.align_vectors([[0, 0, -1]], [[1, 1, 1]])
    return np.asarray((Rotation.from_euler("x", tilt) * diagonal).as_matrix())


def _recorded(folder: Path) -> Path:
    """A table of two markers."""
    lines = ["time,tip_x,tip_y,tip_z,base_x,base_y,base_z"]
    lines += [f"{t / 10},{t},0,1,5,{t},2" for t in range(12)]
    (folder / "take.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "take.csv"


def _filmed(scene: Scene, folder: Path) -> Path:
    """Images of beads on a body that is pulled in three steps."""
    actions = motion("pull", next(iter(scene.grasps)), 1, 0.005, 3)
    return render_recording(scene, moved(scene, ["3", "4"], actions, 1), actions, folder).recording
