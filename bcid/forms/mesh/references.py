"""References of a mesh file to other files: all are refused, but for an HDF5 file beside its XDMF.

A mesh that is read from somewhere else than the file that the scene names would be another body than its user thinks, and one
whose change no fingerprint sees.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.parsers import expat

from bcid.base.errors import InputError
from bcid.base.own_storage import refuse_outside

_XML = (".vtu", ".xdmf", ".xmf", ".xml")
_CARDS = (".inp", ".bdf", ".fem", ".nas")
_TWO_FILES = (".node", ".ele")
_HDF5 = b"\x89HDF\r\n\x1a\n"
# A file in a DataItem of XDMF that may be copied: a plain name, followed by the path of a dataset.
_BESIDE = re.compile(rb">\s*([^<>:/\\\s][^<>:/\\]*):\s*/?[^<>]*<")
# Parameters of Abaqus keywords that name a file.
_FILE_PARAMETERS = ("INPUT", "FILE")


def beside(source: Path) -> list[Path]:
    """Files next to an XDMF file that it names, to be read with it: no links, nothing in other folders."""
    if source.suffix.lower() not in (".xdmf", ".xmf"):
        return []
    names = {name.strip().decode("utf-8", "replace") for name in _BESIDE.findall(source.read_bytes())}
    found = [source.resolve().parent / name for name in sorted(names - {source.name})]
    return [file for file in found if file.is_file() and not file.is_symlink()]


def refuse_references(source: Path) -> None:
    """Look through a mesh file and those beside it, as a child has them in a folder of their own.

    Raises:
        InputError: a reference to another file, or what could become one.
    """
    suffix = source.suffix.lower()
    if suffix in _TWO_FILES:
        raise InputError("a mesh in two files cannot be read; convert it to one, as .vtu")
    if suffix in _XML:
        _refuse_in_xml(source)
    if suffix in _CARDS:
        _refuse_in_cards(source)
    for file in source.parent.iterdir():
        if _is_hdf5(file):
            _refuse_in_hdf5(file)


def _refuse_in_xml(source: Path) -> None:
    """Document types (they define entities), inclusions, and data items of XDMF that are kept elsewhere."""
    items: list[tuple[str, list[str]]] = []

    def begin(name: str, attributes: dict[str, str]) -> None:
        if name.rpartition(":")[2].lower() == "include":
            raise InputError(f"<{name}> includes another file; write the mesh into one file")
        if name == "DataItem":
            items.append((attributes.get("Format", "XML"), []))

    def text(words: str) -> None:
        if items and sum(map(len, items[-1][1])) < 4096:
            items[-1][1].append(words)

    def document_type(*_: Any) -> None:
        raise InputError("holds a document type (<!DOCTYPE>), which no mesh needs; take it out")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.CharacterDataHandler = begin, text
    parser.StartDoctypeDeclHandler = document_type
    try:
        with source.open("rb") as stream:
            parser.ParseFile(stream)
    except expat.ExpatError:
        # Raw data behind the header of a VTU file is no XML; what is damaged is the reader's business.
        pass
    if source.suffix.lower() != ".vtu":
        _refuse_items(items, source.parent)


def _refuse_items(items: list[tuple[str, list[str]]], folder: Path) -> None:
    for kind, words in items:
        content = "".join(words).strip()
        if kind == "Binary":
            raise InputError(f"a DataItem reads the binary file '{content[:80]}'; write the mesh with HDF5 or as .vtu")
        if kind == "HDF":
            name = content.rpartition(":")[0].strip()
            if not name or name != Path(name).name or not (folder / name).is_file():
                raise InputError(
                    f"a DataItem reads '{content[:80]}'; only an HDF5 file beside it, which is no link, can be named"
                )


def _refuse_in_cards(source: Path) -> None:
    # Of Nastran's bulk data meshio waits for a card behind their first line, for ever where there is none.
    missing = [] if source.suffix.lower() == ".inp" else ["BEGIN BULK", "ENDDATA"]
    with source.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            if missing and line.lstrip().startswith(missing[0]):
                missing.pop(0)
            if line.startswith(("**", "$")):
                continue
            words = [word.strip() for word in line.split(",")]
            include = re.split(r"[\s='\"]", words[0].replace("*", "").strip().upper(), maxsplit=1)[0] == "INCLUDE"
            named = line.lstrip().startswith("*") and any(
                word.partition("=")[0].strip().upper() in _FILE_PARAMETERS and "=" in word for word in words[1:]
            )
            if include or named:
                raise InputError(
                    f"line {number}: '{line.strip()[:80]}' reads another file; write the mesh into one file"
                )
    if missing:
        raise InputError(f"has no line {missing[0]}: it is truncated, or no bulk data of Nastran; export it again")


def _is_hdf5(file: Path) -> bool:
    """Whether a file begins as HDF5 does, at any of the places where its user block may end (512, 1024, 2048, ...)."""
    with file.open("rb") as stream:
        at = 0
        while head := stream.read(len(_HDF5)):
            if head == _HDF5:
                return True
            at = max(512, 2 * at)
            stream.seek(at)
    return False


def _refuse_in_hdf5(file: Path) -> None:
    import h5py

    with h5py.File(file, "r") as content:
        refuse_outside(content)
