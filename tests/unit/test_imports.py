"""The arrows between the parts, and a light `import bcid`."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "bcid"

# Each part may import itself and those to its left; "report" reads run folders and must not see what solves.
HEAVY = ("dolfinx", "petsc4py", "vtk", "pyvista", "cv2", "gmsh", "matplotlib")

BASE = {
    "errors",
    "units",
    "compat",
    "fingerprint",
    "frame_error",
    "progress",
    "collective",
    "confined",
    "scratch",
    "text_file",
    "",
}
DATA = BASE | {"scene", "scene_file", "measurement", "measurement_folder", "mapping", "c3d", "motions", "run"}
DATA |= {"alignment", "plausibility", "slips", "jumps", "gripper_motion"}
ALLOWED = {
    **dict.fromkeys(BASE, BASE),
    **dict.fromkeys(DATA - BASE, DATA),
    "forms": DATA | {"forms"},
    "search": DATA | {"forms", "search"},
    "compare": DATA | {"forms", "search", "compare"},
    "explore": DATA | {"forms", "search", "compare", "explore"},
    "vision": BASE | {"measurement", "measurement_folder", "run", "vision"},
    "report": BASE | {"run", "report"},
    "doctor": BASE | {"doctor"},
    "studies": DATA | {"forms", "search", "compare", "explore", "vision", "studies"},
    "commands": DATA | {"forms", "search", "compare", "explore", "studies", "report", "vision", "commands"},
    "cli": BASE | {"motions", "doctor", "commands", "cli"},
    "__main__": {"cli"},
}


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def part(path: Path) -> str:
    inside = path.relative_to(PACKAGE)
    return "" if inside.name == "__init__.py" and len(inside.parts) == 1 else inside.parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
            if node.module == "bcid":
                names = [f"bcid.{alias.name}" for alias in node.names]
        else:
            continue
        found |= {name.split(".")[1] if "." in name else "" for name in names if name.split(".")[0] == "bcid"}
    return {name if (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").exists() else "" for name in found}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_one_way(path: Path) -> None:
    own = part(path)
    assert own in ALLOWED, f"{own} is not in the map of the README: decide where it stands"
    assert imported(path) <= ALLOWED[own]


def test_import_is_light() -> None:
    """`import bcid` loads neither DOLFINx nor VTK nor OpenCV, nor what an extra brings."""
    code = f"import bcid, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    import bcid

    for name in bcid.__all__:
        assert getattr(bcid, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = bcid.nothing
