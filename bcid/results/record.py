"""Records: dataclasses that are written as JSON and read back, with every value checked and lengths in a stated unit."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cache
from typing import Any, ClassVar, Self, Union, get_args, get_origin, get_type_hints

from bcid.base.errors import InputError
from bcid.base.units import unit_factor

_LENGTH, _INSIDE = "length", "inside"
_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def length(**given: Any) -> Any:
    """A field whose numbers, at any depth, are lengths."""
    return field(metadata={_LENGTH: True}, **given)


def inside(**given: Any) -> Any:
    """A field that no file holds."""
    return field(metadata={_INSIDE: True}, **given)


@dataclass(frozen=True, kw_only=True)
class Record:
    """A JSON object whose keys are the names of its fields, and whose values are of their types."""

    def content(self) -> dict[str, Any]:
        """What its file holds, by field."""
        return {f.name: getattr(self, f.name) for f in _filed(type(self))}

    def to_json(self) -> dict[str, Any]:
        """The content of its file; lengths as they are."""
        return {name: _plain(value) for name, value in self.content().items()}

    @classmethod
    def from_json(cls, content: Any, where: str = "") -> Self:
        """The record that a file holds; keys that it does not know are left out.

        Args:
            content: parsed JSON.
            where: what messages call it.

        Raises:
            InputError: a key is missing, or a value is of another type; it names the key.
        """
        if not isinstance(content, Mapping):
            raise InputError(f"{where or 'the file'}: expected a table, found {_shown(content)}")
        own: Any = cls
        values, kinds = {}, _types(own)
        for f in _filed(cls):
            name = f"{where}.{f.name}" if where else f.name
            if f.name in content:
                values[f.name] = _read(kinds[f.name], content[f.name], name)
            elif f.default is MISSING and f.default_factory is MISSING:
                raise InputError(f"{name}: is missing")
        return cls(**values)

    def scaled(self, factor: float) -> Self:
        """The same with its lengths, and those of records in it, times a factor."""
        changed = {f.name: _scaled(getattr(self, f.name), factor, _LENGTH in f.metadata) for f in _filed(type(self))}
        return replace(self, **changed)


@dataclass(frozen=True, kw_only=True)
class FileRecord(Record):
    """The content of a JSON file of a run folder.

    Attributes:
        file: its name.
        former: its name in format/1, where that is another.
        length_unit: of all its lengths, "m" or "mm".
    """

    file: ClassVar[str] = ""
    former: ClassVar[str] = ""

    length_unit: str = "m"

    @classmethod
    def from_json(cls, content: Any, where: str = "") -> Self:
        """As `Record.from_json`; also refuses a unit of length that is none."""
        found = super().from_json(content, where)
        unit_factor(found.length_unit, "m")
        return found

    def converted(self, unit: str) -> Self:
        """The same with its lengths in another unit.

        Raises:
            InputError: it is no unit of length.
        """
        factor = unit_factor(self.length_unit, "m") / unit_factor(unit, "m")
        return self if unit == self.length_unit else replace(self.scaled(factor), length_unit=unit)


@cache
def _types(cls: type[Record]) -> dict[str, Any]:
    return get_type_hints(cls)


def _filed(cls: type[Record]) -> list[Field[Any]]:
    """The fields that a file holds."""
    return [f for f in fields(cls) if _INSIDE not in f.metadata]


def _plain(value: Any) -> Any:
    if isinstance(value, Record):
        return value.to_json()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, tuple) else value


def _scaled(value: Any, factor: float, is_length: bool) -> Any:
    if isinstance(value, Record):
        return value.scaled(factor)
    if isinstance(value, Mapping):
        return {key: _scaled(entry, factor, is_length) for key, entry in value.items()}
    if isinstance(value, tuple):
        return tuple(_scaled(entry, factor, is_length) for entry in value)
    return value * factor if is_length and isinstance(value, int | float) else value


def _read(kind: Any, value: Any, where: str) -> Any:
    """A JSON value as a type of a field: a number, a text, a record, or tuples and tables of them."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return None if value is None else _read(inner[0], value, where)
    if origin is tuple:
        if not isinstance(value, list):
            raise InputError(f"{where}: expected a list, found {_shown(value)}")
        return tuple(_read(inner[0], entry, f"{where}[{k}]") for k, entry in enumerate(value))
    if origin is dict:
        if not isinstance(value, Mapping):
            raise InputError(f"{where}: expected a table, found {_shown(value)}")
        return {_key(inner[0], key, where): _read(inner[1], entry, f"{where}.{key}") for key, entry in value.items()}
    if issubclass(kind, Record):
        return kind.from_json(value, where)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise InputError(f"{where}: expected {_KINDS[kind]}, found {_shown(value)}")
    return value


def _key(kind: type, key: str, where: str) -> Any:
    if kind is int and not key.isdecimal():
        raise InputError(f"{where}: expected whole numbers as keys, found '{key}'")
    return kind(key)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]} ..."
