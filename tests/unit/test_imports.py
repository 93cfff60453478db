"""The arrows between the parts, and a light `import bcid`."""

import ast
import re
import subprocess
import sys
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
# The product, and the evidence about it: this imports that, never the other way round.
PACKAGES = ("bcid", "validation")

# Each part may import itself and those to its left; "report" reads run folders and must not see what solves.
HEAVY = ("dolfinx", "petsc4py", "vtk", "pyvista", "cv2", "gmsh", "matplotlib")

# Their import_module is given names that others write as "module:function", or names of programs and packages.
FOLLOWED = (
    "bcid",
    "validation.engine.dispatch",
    "validation.synthetic.case",
    "validation.reliability.forked",
    "bcid.app.doctor",
    "bcid.base.confined",
)

BASE = {"", "base"}
DATA = BASE | {"scene", "measurement"}
ALLOWED = {
    # The public names are looked up by it when they are asked for.
    "": BASE | {"api", "exploration", "forms", "grammar", "measurement", "scene", "search"},
    "base": BASE,
    "results": BASE | {"results"},
    "scene": BASE | {"scene"},
    "measurement": DATA,
    "forms": DATA | {"forms"},
    "inference": DATA | {"forms", "results", "inference"},
    "predict": DATA | {"forms", "results", "inference", "predict"},
    "search": DATA | {"forms", "results", "inference", "predict", "search"},
    "grammar": DATA | {"forms", "results", "inference", "predict", "search", "grammar"},
    "exploration": DATA | {"forms", "results", "inference", "predict", "search", "exploration"},
    "vision": DATA | {"vision"},
    "report": BASE | {"results", "report"},
    "api": DATA | {"forms", "results", "inference", "predict", "search", "grammar", "exploration", "report", "api"},
    "app": DATA
    | {"forms", "results", "inference", "predict", "search", "grammar", "exploration", "report", "vision", "app"},
    "__main__": {"app"},
}
ALLOWED["validation"] = {room for rooms in ALLOWED.values() for room in rooms} | {"validation"}


def modules(*packages: str) -> list[Path]:
    return sorted(path for package in packages for path in (PROJECT / package).rglob("*.py"))


def dotted(path: Path) -> str:
    """Name of a module."""
    return ".".join(path.relative_to(PROJECT).with_suffix("").parts).removesuffix(".__init__")


NAMES = {dotted(path): path for path in modules(*PACKAGES)}


def part(name: str) -> str:
    """The folder or file below the product that a module stands in; the evidence is one."""
    if name.split(".")[0] == "validation":
        return "validation"
    return name.split(".")[1] if "." in name else ""


def called(node: ast.Call) -> str:
    """Last part of the name of what is called."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def written(node: ast.AST, own: str) -> str:
    """A string as a pattern of the names it may stand for: `__name__` is known, what else is put in is any name."""
    if isinstance(node, ast.Constant):
        return re.escape(str(node.value))
    assert isinstance(node, ast.JoinedStr), "import_module of something that cannot be followed"
    found = ""
    for value in node.values:
        if isinstance(value, ast.Constant):
            found += re.escape(str(value.value))
        else:
            found += re.escape(own) if getattr(value.value, "id", "") == "__name__" else r"\w+"  # type: ignore[attr-defined]
    return found


def imported(path: Path) -> set[str]:
    """Modules of the package that a file imports anywhere in it, by name, by pattern, or as "module:function" of a job."""
    own, found = dotted(path), set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write the whole name"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in NAMES else str(node.module) for name in names}
        elif isinstance(node, ast.Call) and called(node) == "import_module" and own not in FOLLOWED:
            pattern = re.compile(written(node.args[0], own))
            found |= {name for name in NAMES if pattern.fullmatch(name)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= (
                {node.value.partition(":")[0]} if re.fullmatch(r"(bcid|validation)[\w.]*:\w+", node.value) else set()
            )
    return {name for name in found if name.split(".")[0] in PACKAGES and name != own}


ARROWS = {name: imported(path) for name, path in NAMES.items()}


@pytest.mark.parametrize("name", NAMES)
def test_imports_point_one_way(name: str) -> None:
    own = part(name)
    assert own in ALLOWED, f"{own} is not in the map: decide where it stands"
    assert ARROWS[name] <= set(NAMES), "imports what is not there"
    assert {part(other) for other in ARROWS[name]} <= ALLOWED[own]


def test_no_circles() -> None:
    """Not even between files of a folder, or through imports inside functions."""
    try:
        list(TopologicalSorter(ARROWS).static_order())
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_no_module_is_found_by_a_trick() -> None:
    """What is imported stands in the package or is installed: no path is changed, and one name means one module."""
    for path in modules("bcid"):
        assert not re.search(r"sys\.path\.(insert|append|extend)", path.read_text(encoding="utf-8")), path
    files = Counter(path.stem for path in modules("bcid") if path.stem != "__init__")
    assert [name for name, count in files.items() if count > 1] == []


def test_no_two_public_classes_share_a_name() -> None:
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in modules("bcid")]
    names = [n.name for tree in trees for n in tree.body if isinstance(n, ast.ClassDef) and not n.name.startswith("_")]
    assert [name for name, count in Counter(names).items() if count > 1] == []


def test_the_parser_and_the_doctor_need_little() -> None:
    """The parser knows what commands there are, the doctor nothing of what it looks at."""
    assert {part(name) for name in ARROWS["bcid.app.cli"]} <= BASE | {"scene", "app"}
    assert {part(name) for name in ARROWS["bcid.app.doctor"]} <= BASE


def test_import_is_light() -> None:
    """`import bcid` loads neither DOLFINx nor VTK nor OpenCV, nor what an extra brings."""
    code = f"import bcid, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_what_explains_is_loaded_without_a_slow_library() -> None:
    """Every command and every child of a study pays for it."""
    code = "import bcid.search.answer.comparison_job, sys; print('scipy.stats' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["False"]


def test_every_public_name_is_there() -> None:
    import bcid

    for name in bcid.__all__:
        assert getattr(bcid, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = bcid.nothing
