"""Text that no hand has written, reduced; docs/reliability.md has the full size."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcid.app import cli
from bcid.base.errors import InputError, Problems, bounded, nearest
from bcid.base.text_file import parse_json, parse_toml
from bcid.base.units import parse_unit, quantity
from validation.reliability import Reached, absurd

HERE = Path("file.toml")


def met(found: Reached) -> None:
    assert found.met, "\n".join([found.reached, *found.misses[:10]])


def test_absurd_text_is_refused_by_every_reader() -> None:
    met(absurd.absurd(120, commands=3, seconds=60.0))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a = 1\nb = " + "1" * 5000, 2),
        ("a = 1\n\nb = [1, -9223372036854775809]", 3),
        ("b = 0x" + "f" * 17, 1),
        ('a = """\n[[[[\n"""\nb = ' + "[" * 51, 4),
        ("a = '[['\nb" + ".b" * 50 + " = 1", 2),
        ("b = " + "{ a = " * 100_000, 1),
    ],
)
def test_the_line_of_absurd_toml_is_named(text: str, line: int) -> None:
    with pytest.raises(InputError, match=rf"^file\.toml:{line}: not a TOML file"):
        parse_toml(text, HERE)


@pytest.mark.parametrize(
    "text",
    [
        "a = 9223372036854775807\nb = -9223372036854775808",
        "a = 0.12345678901234567890123456789\nb = 12345678901234567890.5\nc = 12345678901234567890e3",
        "12345678901234567890 = 1\na.12345678901234567890 = 1",
        "a = '" + "[" * 100 + "'\nb = \"" + "9" * 100 + '" # ' + "[" * 100,
        "a = " + "[" * 50 + "]" * 50,
        "a = 1979-05-27T07:32:00.123456-07:00",
    ],
)
def test_toml_within_the_bounds_is_read(text: str) -> None:
    assert parse_toml(text, HERE)


def test_the_line_of_absurd_json_is_named() -> None:
    for text in ('{"b": "[[",\n"a": ' + "1" * 5000 + "}", '{\n"a": ' + "[" * 100_000):
        with pytest.raises(InputError, match=r"^a\.json:2: not a JSON file"):
            parse_json(text, Path("a.json"))
    assert parse_json('{"a": "[[[[", "b": [1, 2.5, -3]}', Path("a.json"))["b"] == [1, 2.5, -3]


def test_a_message_is_bounded_and_keeps_both_ends() -> None:
    said = str(InputError(f"scene.toml:3: young: '{'x' * 1_000_000}' is no quantity; write a unit"))
    assert len(said) < 1000
    assert said.startswith("scene.toml:3: young")
    assert said.endswith("is no quantity; write a unit")
    assert len(bounded("a\n" * 100_000).splitlines()) < 70


def test_many_names_are_counted() -> None:
    names = [f"name{i}" for i in range(100_000)]
    problems = Problems("file")
    problems.add_unknown("file", names, ["name", "colour"])
    assert len(problems.found) == 100_000
    assert "..." in nearest("x" * 1_000_000, names)
    assert "did you mean 'name7'" in nearest("nam7", names)


@pytest.mark.parametrize("text", ["1" * 100_000 + "..", "1e200 mm", "1e-200 mm", "1e7 m", "1 " * 100_000, "1e31 Pa"])
def test_absurd_quantities_are_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"is not a quantity|too large or too small"):
        quantity(text, "Pa" if "Pa" in text else "m")


@pytest.mark.parametrize("unit", ["kN^999", "GPa^-99", "m" + "/m" * 100_000, "m^" + "9" * 5000])
def test_absurd_units_are_refused(unit: str) -> None:
    with pytest.raises(InputError, match="is not known"):
        parse_unit(unit)


@pytest.mark.parametrize("seed", ["-1", "9223372036854775808", "1" * 5000, "1.5", "١"])
def test_a_seed_that_no_run_could_keep_is_refused(seed: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["simulate", "scene.toml", "--anchors", "1", "--motion", "pull", "-o", "out", f"--seed={seed}"]
    with pytest.raises(SystemExit, match="2"):
        cli.build_parser().parse_args(words)
    said = capsys.readouterr().err.splitlines()[-1]
    assert "expected a whole number from 0 to 2^63 - 1" in said
    assert len(said) < 300
