"""Text, TOML and JSON that others wrote: read whole, within bounds, and refused in one message where it cannot be used.

The parsers of Python fail in their own ways on text that no hand has written: brackets nested by the thousand, numbers of
thousands of digits, keys of thousands of parts. What would make them do so is looked for before they see it.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError

# Longest files, bytes: settings are written by hand or by a script, tables by a camera.
LONGEST_SETTINGS = 500_000
LONGEST_TABLE = 1_000_000_000
# Nested brackets, and parts of a dotted key.
DEEPEST = 50
# Whole numbers of TOML have 64 bits, and so have those of numpy.
_SMALLEST, _LARGEST = -(2**63), 2**63 - 1
_TOML_TOKEN = re.compile(
    r'''
      (?P<text>  """(?:[^"\\]++|\\.|"(?!""))*+"{3,5} | \'\'\'(?:[^\']++|\'(?!\'\'))*+\'{3,5}
               | "(?:[^"\\\n]++|\\[^\n])*+" | \'[^\'\n]*+\' )
    | (?P<open_text> ["\'] )
    | (?P<comment> \#[^\n]*+ )
    | (?P<open>  [\[{] )
    | (?P<close> [\]}] )
    | (?P<word>  [A-Za-z0-9_+-][A-Za-z0-9_.+-]*+ )
    | (?P<dot>   \. )
    | (?P<end>   [\n=,] )
    ''',
    re.VERBOSE | re.DOTALL,
)
_JSON_TOKEN = re.compile(r'(?P<text>"(?:[^"\\]++|\\.)*+")|(?P<open_text>")|(?P<open>[\[{])|(?P<close>[\]}])', re.DOTALL)
_WHOLE = re.compile(r"[+-]?(?:[0-9][0-9_]*+|0x[0-9A-Fa-f_]++|0o[0-7_]++|0b[01_]++)")
_KEY = re.compile(r"[ \t]*=")


def read_lines(path: Path, absent: str = "no such file") -> list[str]:
    """The lines of a table; `absent` says what is missing where there is none.

    Raises:
        InputError: it cannot be read, is no text, or is longer than any table.
    """
    return as_lines(_content(path, LONGEST_TABLE, absent), path)


def read_export(path: Path) -> list[str]:
    """The lines of a table of another program, in UTF-8 or, as some write on Windows, in code page 1252; see `read_lines`."""
    content = _content(path, LONGEST_TABLE, "no such file")
    try:
        content.decode("utf-8-sig")
    except UnicodeDecodeError:
        content = content.decode("cp1252", "replace").encode()
    return as_lines(content, path)


def as_lines(content: bytes, path: Path) -> list[str]:
    """The lines of the table `path` with this content; see `read_lines`."""
    text = as_text(content, path, LONGEST_TABLE, "utf-8-sig")
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError(f"{path}:{line}: holds NUL characters: this is not a text file")
    return text.splitlines()


def read_text(path: Path, absent: str = "no such file") -> str:
    """The text of a file with settings; see `read_lines`."""
    return as_text(_content(path, LONGEST_SETTINGS, absent), path, LONGEST_SETTINGS)


def as_text(content: bytes, path: Path, longest: int = LONGEST_TABLE, encoding: str = "utf-8") -> str:
    """The text of the file `path` with this content, of at most so many bytes.

    Raises:
        InputError: it is longer, or no text.
    """
    refuse_longer(content, path, longest)
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from None


def refuse_longer(content: bytes, path: Path, longest: int) -> None:
    """Refuse the content of the file `path` if it has more than `longest` bytes.

    Raises:
        InputError: it has.
    """
    if len(content) > longest:
        raise InputError(f"{path}: is longer than {longest / 1e6:g} MB, the most that is read; is it the right file?")


def _content(path: Path, longest: int, absent: str) -> bytes:
    """The content of a file, up to where it is known to be too long."""
    try:
        # A pipe or a device would be waited for, or read without end.
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError(f"{path}: is no regular file; expected a file")
        with path.open("rb") as stream:
            return stream.read(longest + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: {absent}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; expected a file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as text: {getattr(error, 'strerror', None) or error}") from None


def read_toml(path: Path, absent: str = "no such file") -> dict[str, Any]:
    """What a TOML file holds; its whole numbers have 64 bits, as the standard has it.

    Raises:
        InputError: it cannot be read, or is not TOML.
    """
    return parse_toml(read_text(path, absent), path)


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """What the text of the TOML file `path` holds; see `read_toml`."""
    _refuse_absurd(text, path)
    table: dict[str, Any] = _parsed(lambda: tomllib.loads(text), path, "TOML")
    return table


def read_json(path: Path) -> Any:
    """What a JSON file that others wrote holds.

    Raises:
        InputError: it cannot be read, or is not JSON.
    """
    return parse_json(as_text(_content(path, LONGEST_TABLE, "no such file"), path), path)


def parse_json(text: str, path: Path) -> Any:
    """What the text of the JSON file `path` holds; see `read_json`."""
    depth = 0
    for match in _JSON_TOKEN.finditer(text):
        if match.lastgroup == "open_text":
            break
        depth = _deeper(match, depth, text, path, "JSON")

    def whole(digits: str) -> int:
        try:
            return _whole(digits)
        except ValueError as error:
            raise _absurd(path, text, text.find(digits), "JSON", str(error)) from None

    return _parsed(lambda: json.loads(text, parse_int=whole), path, "JSON")


def _parsed(parse: Callable[[], Any], path: Path, what: str) -> Any:
    try:
        return parse()
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a {what} file: {error}") from None


def _deeper(match: re.Match[str], depth: int, text: str, path: Path, what: str) -> int:
    """How deep in brackets the text is behind a token."""
    depth += (match.lastgroup == "open") - (match.lastgroup == "close")
    if depth > DEEPEST:
        raise _absurd(path, text, match.start(), what, f"more than {DEEPEST} brackets stand within each other")
    return depth


def _refuse_absurd(text: str, path: Path) -> None:
    """Refuse TOML with brackets too deep, keys of too many parts, or whole numbers beyond 64 bits, and name the line."""
    depth = parts = 0
    for match in _TOML_TOKEN.finditer(text):
        kind, word = match.lastgroup, match.group()
        if kind == "open_text":
            # Text without an end: the parser says so, and reads no further either.
            return
        depth = _deeper(match, depth, text, path, "TOML")
        parts = parts + word.count(".") if kind in ("word", "dot") else parts if kind == "text" else 0
        if parts >= DEEPEST:
            raise _absurd(path, text, match.start(), "TOML", f"a key has more than {DEEPEST} parts")
        if kind == "word" and len(word) > 18 and _WHOLE.fullmatch(word) and not _KEY.match(text, match.end()):
            try:
                _whole(word)
            except ValueError as error:
                raise _absurd(path, text, match.start(), "TOML", str(error)) from None


def _whole(digits: str) -> int:
    """The whole number that is written; `ValueError` when it has more than 64 bits."""
    base = 0 if digits[:2] in ("0x", "0o", "0b") else 10
    # No number of 64 bits is written with 100 characters, unless with zeros in front.
    number = int(digits, base) if len(digits) < 100 else _LARGEST + 1
    if _SMALLEST <= number <= _LARGEST:
        return number
    shown = digits if len(digits) <= 30 else f"{digits[:20]}... ({len(digits)} characters)"
    raise ValueError(f"{shown} is a whole number of more than 64 bits; allowed are -2^63 to 2^63 - 1")


def _absurd(path: Path, text: str, place: int, what: str, rule: str) -> InputError:
    line = text.count("\n", 0, place) + 1
    return InputError(f"{path}:{line}: not a {what} file that can be used: {rule}; correct or shorten it")
