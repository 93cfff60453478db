"""bcid as others install it: the wheel is built, installed into an environment of its own, and used away from the checkout."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
CLIENT = """
from bcid import Measurement, Scene, identify, load
from bcid.api.results import IdentifyResult

scene = Scene.read("scene.toml")
measurement = Measurement.read("measurement")
found: IdentifyResult = identify(scene, measurement)
probability: float = found.probability
patches: dict[str, float] = found.patches
print(load("run").headline)
"""
WRONG = 'from bcid import identify\nnumber: int = identify("scene.toml", "measurement", refine="much")\n'


@dataclass(frozen=True)
class Installed:
    """An environment with the wheel.

    Attributes:
        wheel: the file.
        python: of the environment.
        folder: an empty folder to work in.
    """

    wheel: Path
    python: Path
    folder: Path

    def run(self, *command: object) -> str:
        """What a command prints; nothing of the checkout is in sight."""
        hidden = ("PYTHONPATH", "BCID_")
        kept = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
        done = subprocess.run(
            [self.python, *map(str, command)], cwd=self.folder, env=kept, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout + done.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel, in an environment that sees the packages of this one, but not the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder / "dist")]
    made = subprocess.run(build, cwd=PROJECT, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    (wheel,) = (folder / "dist").glob("*.whl")
    subprocess.run(
        [sys.executable, "-m", "venv", "--without-pip", "--system-site-packages", folder / "venv"], check=True
    )
    python = folder / "venv/bin/python"
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True).stdout.strip())
    # Packages only: paths that this environment adds to its own, the checkout among them, are not followed from here.
    (packages / "others.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    (folder / "work").mkdir()
    return Installed(wheel, python, folder / "work")


def test_the_wheel_holds_what_its_commands_need(installed: Installed) -> None:
    assert installed.wheel.stat().st_size < 4e6
    with zipfile.ZipFile(installed.wheel) as archive:
        names = set(archive.namelist())
    # Modules and what lies beside them, all of the checkout's examples, and the marker of type information.
    folders = ("bcid", "examples", "meshes")
    files = [file for folder in folders for file in (PROJECT / folder).rglob("*") if file.is_file()]
    for name in (str(file.relative_to(PROJECT)) for file in files if "__pycache__" not in file.parts):
        assert (name if name.startswith("bcid/") else f"bcid/shipped/{name}") in names
    assert "bcid/py.typed" in names
    assert not [name for name in names if "__pycache__" in name or name.startswith("tests/")]
    (about,) = (name for name in names if name.endswith("METADATA"))
    with zipfile.ZipFile(installed.wheel) as archive:
        written = archive.read(about).decode()
    assert "Provides-Extra: all" in written
    assert "dolfinx-solver-real" in written


@pytest.mark.slow
def test_the_installed_package_identifies(installed: Installed) -> None:
    place = installed.run("-c", "import bcid; print(bcid.__file__)")
    assert str(PROJECT) not in place
    assert "Everything that bcid needs works." in installed.run("-m", "bcid", "doctor")
    installed.run("-m", "bcid", "examples", "all")
    arguments = ["all/examples/scenes/slab.toml", "--anchors", "3,4", "--motion", "pull", "--level", "0", "-o", "made"]
    installed.run("-m", "bcid", "simulate", *arguments)
    found = installed.run(
        "-m", "bcid", "identify", "all/examples/scenes/slab.toml", "made", "-o", "run", "--level", "0", "--no-picture"
    )
    assert "Anchored patches of slab: {3 4}" in found
    (installed.folder / "load.py").write_text("import bcid\nprint(repr(bcid.load('run')))\n", encoding="utf-8")
    assert "<IdentifyResult: anchored {3 4}" in installed.run("load.py")


@pytest.mark.slow
def test_a_client_is_checked_against_the_types(installed: Installed) -> None:
    for name, text in (("client.py", CLIENT), ("wrong.py", WRONG)):
        (installed.folder / name).write_text(text, encoding="utf-8")
    mypy = [sys.executable, "-m", "mypy", "--python-executable", str(installed.python), "--ignore-missing-imports"]
    command = [*mypy, "--cache-dir", str(installed.folder / "cache")]

    def checked(file: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run([*command, file], cwd=installed.folder, capture_output=True, text=True, check=False)

    good, bad = checked("client.py"), checked("wrong.py")
    assert good.returncode == 0, good.stdout + good.stderr
    assert bad.returncode == 1
    assert 'expression has type "IdentifyResult"' in bad.stdout
    assert '"refine"' in bad.stdout
