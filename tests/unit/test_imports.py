"""The arrows between the parts, and a light `import bcid`."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "bcid"

# Each part may import itself and those to its left; "report" reads run folders and must not see what solves.
HEAVY = ("dolfinx", "petsc4py", "vtk", "pyvista", "cv2", "gmsh", "matplotlib")

BASE = {"", "base"}
DATA = BASE | {"scene", "measurement"}
ALLOWED = {
    "": BASE,
    "base": BASE,
    "scene": BASE | {"scene"},
    "measurement": DATA,
    "forms": DATA | {"forms"},
    "search": DATA | {"forms", "search"},
    "compare": DATA | {"forms", "search", "compare"},
    "explore": DATA | {"forms", "search", "compare", "explore"},
    "vision": DATA | {"vision"},
    "report": BASE | {"report"},
    "studies": DATA | {"forms", "search", "compare", "explore", "vision", "studies"},
    "app": DATA | {"forms", "search", "compare", "explore", "studies", "report", "vision", "app"},
    "__main__": {"app"},
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


def test_the_parser_and_the_doctor_need_little() -> None:
    """The parser knows what commands there are, the doctor nothing of what it looks at."""
    assert imported(PACKAGE / "app/cli.py") <= BASE | {"scene", "app"}
    assert imported(PACKAGE / "app/doctor.py") <= BASE


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
