"""Flags of a command from the fields of a class of options: their names, types, defaults, and what its docstring says of them."""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any, TypeVar

from bcid.base.errors import InputError, shortened
from bcid.base.options import Stop
from bcid.base.units import quantity

T = TypeVar("T")


def seed(text: str) -> int:
    """A seed: a run keeps it as a number of 64 bits."""
    if text.isascii() and text.isdigit() and len(text) < 20 and int(text) < 2**63:
        return int(text)
    raise argparse.ArgumentTypeError(f"'{shortened(text, 60)}': expected a whole number from 0 to 2^63 - 1")


def add_flags(parser: argparse._ActionsContainer, options: type, names: Collection[str] = ()) -> None:
    """Declare a flag for each field of a class of options, or for some; one that is not given is no attribute of the arguments.

    Of a switch, which is on by default, the flag turns it off.
    """
    said = about(options)
    for one in _shown(options, names):
        flag, words = one.name.replace("_", "-"), said[one.name]
        if one.type == "bool":
            parser.add_argument(
                f"--no-{flag}",
                dest=one.name,
                action="store_false",
                default=argparse.SUPPRESS,
                help=f"do not {words}",
            )
            continue
        usual = "" if one.default in (None, MISSING, ()) or isinstance(one.default, tuple) else f" ({one.default})"
        parser.add_argument(
            f"--{flag}",
            type=str if one.name != "seed" else seed,
            default=argparse.SUPPRESS,
            metavar=one.metadata["example"],
            help=(words + usual).replace("%", "%%"),
        )


def given(options: type, arguments: argparse.Namespace, names: Collection[str] = ()) -> dict[str, Any]:
    """The fields whose flags were given, with their values; of some where these are named.

    Raises:
        InputError: a value cannot be read; it names the flag.
    """
    shown = _shown(options, names)
    return {one.name: _value(one, getattr(arguments, one.name)) for one in shown if hasattr(arguments, one.name)}


def made(options: type[T], arguments: argparse.Namespace, more: Mapping[str, Any] | None = None) -> T:
    """The options that the flags give, and more of them."""
    return options(**given(options, arguments), **(more or {}))


def about(options: type) -> dict[str, str]:
    """What the docstring of a class says of its attributes, each in one line without a full stop."""
    text = inspect.getdoc(options) or ""
    found = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", text.partition("Attributes:\n")[2], re.MULTILINE)
    return {name: " ".join(words.split()).rstrip(".") for name, words in found}


def _shown(options: Any, names: Collection[str] = ()) -> Iterable[Field[Any]]:
    shown = [one for one in fields(options) if not one.metadata.get("hidden")]
    return [one for one in shown if not names or one.name in names]


def _value(one: Field[Any], text: Any) -> Any:
    """A flag's value: a number, one with a unit, names separated by commas, a rule."""
    if not isinstance(text, str):
        return text
    flag, kind = f"--{one.name.replace('_', '-')}", str(one.type).partition(" ")[0].partition("[")[0]
    unit = one.metadata.get("unit", "")
    readers: dict[str, Callable[[str], Any]] = {"int": int, "float": float, "tuple": names_in, "Stop": Stop.parse}
    if unit:
        return size_in(text, flag, unit)
    try:
        value = readers.get(kind, str)(text)
    except InputError as error:
        raise InputError(f"{flag}: {error}") from None
    except ValueError:
        expected = "a whole number" if kind == "int" else "a number"
        raise InputError(f"{flag} '{shortened(text, 60)}': expected {expected}") from None
    if kind == "tuple" and not value:
        raise InputError(f"{flag} '{text}': names nothing; give some, as {flag} {one.metadata['example']}")
    return value


def size_in(text: str, flag: str, unit: str) -> float:
    """A number with a unit that is not negative, SI.

    Raises:
        InputError: it is none; it names the flag.
    """
    try:
        value = quantity(text, unit)
    except InputError as error:
        raise InputError(f"{flag}: {error}") from None
    if value < 0:
        raise InputError(f"{flag} '{text}': must not be negative")
    return value


def names_in(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
