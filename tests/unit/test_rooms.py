"""How large each room of the product is, and how many files and imports it has; `pytest -s` prints the table."""

import ast
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
# Lines and files of each room at most. They are lowered as rooms become smaller; a number that is raised needs a reason.
BUDGETS = {
    "base": (3310, 29),
    "scene": (1590, 12),
    "measurement": (6560, 33),
    "forms": (14420, 117),
    "inference": (3580, 22),
    "predict": (1850, 12),
    "results": (1705, 13),
    "search": (9140, 50),
    "grammar": (2510, 18),
    "exploration": (1840, 11),
    "vision": (5110, 30),
    "report": (3600, 26),
    "api": (575, 3),
    "app": (1850, 12),
    "validation": (19390, 156),
}
# Lines of one file, and files of one folder without others in it; effects, laws and formats stand in a file each.
LONGEST, FULLEST = 545, 30
ONE_EACH = ("effects", "materials", "formats")


def files(room: str) -> list[Path]:
    folder = PROJECT / room if room == "validation" else PROJECT / "bcid" / room
    return sorted(folder.rglob("*.py"))


def lines(path: Path) -> int:
    return path.read_text(encoding="utf-8").count("\n")


def imports(path: Path) -> int:
    """Import statements of a file that name the product or the evidence."""
    nodes = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.ImportFrom)]
    return sum((n.module or "").split(".")[0] in ("bcid", "validation") for n in nodes)


def test_every_room_has_a_budget() -> None:
    rooms = {path.name for path in (PROJECT / "bcid").iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert rooms | {"validation"} == set(BUDGETS)


@pytest.mark.parametrize("room", BUDGETS)
def test_a_room_stays_within_its_budget(room: str) -> None:
    found = files(room)
    size, count = sum(map(lines, found)), len(found)
    print(f"\n{room:12} {size:6} lines {count:4} files {sum(map(imports, found)):5} imports", end="")
    assert size <= BUDGETS[room][0]
    assert count <= BUDGETS[room][1]


def test_files_and_folders_can_be_kept_in_mind() -> None:
    product = sorted((PROJECT / "bcid").rglob("*.py"))
    assert [str(path) for path in product if lines(path) > LONGEST] == []
    folders = {path.parent for path in product if path.parent.name not in ONE_EACH}
    assert [str(folder) for folder in folders if len(list(folder.glob("*.py"))) > FULLEST] == []
