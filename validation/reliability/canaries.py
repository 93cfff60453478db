"""Files whose definitions, names, attributes or extensions hold code: running it would open the secret, as a tracer sees.

Readers that make code of definitions (rosbags), that know objects (SciPy, nibabel), and that take names as they are.
"""

from __future__ import annotations

import json
import pickle
import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from validation.reliability import foreign_files, scanned

_UNITS = 'length_unit = "mm"\ntime_unit = "s"\nforce_unit = "N"\n'
_ARRAYS = '[arrays]\npositions = "trial/data/xyz"\norder = "marker axis frame"\n'


def messages(code: str) -> dict[str, tuple[str, str]]:
    """Hostile names and definitions of ROS messages by what is wrong with them; `code` stands where code could come to lie."""
    name, line = "evil_msgs/msg/Evil", "=" * 80
    broken = f'"""\n    {code}\n    """'
    return {
        "field": (name, f"int32 x={code}\n"),
        "field that goes on": (name, f"int32 x\n    y = {code}\n"),
        "field with a line break": (name, f"int32 x\r{code}\n"),
        "default": (name, f'string x "{broken}"\n'),
        "text": (name, f"string X='''{broken}'''\n"),
        "text with quotes": (name, f"string X=\"'+{code}+'\"\n"),
        "text with escapes": (name, f"string X=\\'+{code}+\\'\n"),
        "type of a field": (name, f'evil_msgs/A"){code}(" x\n'),
        "length": (name, f"int32[{code}] x\n"),
        "bound": (name, f"string<={code} x\n"),
        "second definition": (name, f"int32 x\n{line}\nMSG: evil_msgs/B{broken}\nint32 y\n"),
        "name": (f"evil_msgs/msg/Evil:\n    {code}\nclass C", "int32 x\n"),
        "name with quotes": (f"evil_msgs/msg/Evil{broken}", "int32 x\n"),
        "name in a table": (f"evil_msgs/msg/Evil': ([], [({code}", "int32 x\n"),
    }


def interfaces(code: str) -> dict[str, str]:
    """Hostile definitions in IDL."""
    module = "module evil_msgs { module msg { %s }; };"
    return {
        "constant as a length": module % f'const string X = "{code}"; struct Evil {{ int32 a[X]; }};',
        "constant as a bound": module % f'const string X = "{code}"; struct Evil {{ string<X> a; }};',
        "name of a struct": module % f'struct Evil"""{code}""" {{ int32 a; }};',
        "name of a field": module % f"struct Evil {{ int32 a = {code}; }};",
        "text": module % f"module Evil_Constants {{ const string X = '+{code}+'; }}; struct Evil {{ int32 a; }};",
    }


def files(place: Callable[[], Path], secret: Path) -> Iterator[tuple[str, Path]]:
    """Names of cases, and the mapping or scene that reads the file; each in a folder of its own."""
    code = f"open('{secret}')"
    for what, (name, text) in messages(code).items():
        yield f"ROS 1: {what}", _mapping(_bag1(place() / "evil.bag", name, text), "m")
        yield f"ROS 2: {what}", _mapping(_bag2(place() / "evil", name, text, "ros2msg"), "m")
    for what, text in interfaces(code).items():
        yield f"IDL: {what}", _mapping(_bag2(place() / "evil", "evil_msgs/msg/Evil", text, "ros2idl"), "m")
    evil = pickle.dumps(Opens(str(secret)), 0)
    yield "MAT with a pickle", _mapping(_matlab(place() / "take.mat", evil), more=_ARRAYS)
    for kind in (5, 14, 16, 17):
        yield f"MAT whose array is of class {kind}", _mapping(_classed(place(), kind), more=_ARRAYS)
    yield "HDF5 with a pickle as attribute", _mapping(_attributed(place(), evil), more=_ARRAYS)
    yield "C3D whose labels are code", _mapping(_labelled(place(), code))
    yield "NIfTI with a pickle as extension", _extended(place() / "s.nii", evil)


class Opens:
    """Unpickling it opens a file."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return open, (self.path,)


def _mapping(file: Path, unit: str = "mm", more: str = "rate = 50\n") -> Path:
    mapping = file.parent / "mapping.toml"
    units = _UNITS.replace('"mm"', f'"{unit}"')
    mapping.write_text(f'format = "bcid-mapping/1"\nfile = "{file.name}"\n{units}{more}', encoding="utf-8")
    return mapping


def _bag1(file: Path, name: str, text: str) -> Path:
    """A bag of ROS 1 in which a sound topic stands beside the hostile one; a connection needs no message."""
    from rosbags.rosbag1 import Writer

    with Writer(file) as writer:
        found = writer.add_connection("/evil", name, msgdef=text, md5sum="0" * 32)
        writer.write(found, 10**9, struct.pack("<i", 1))
    return file


def _bag2(folder: Path, name: str, text: str, encoding: str) -> Path:
    """A bag of ROS 2 with the definition of the message in its table."""
    made = foreign_files.ros(folder.parent, "ros2").rename(folder)
    database = next(made.glob("*.db3"))
    with sqlite3.connect(database) as content:
        old = content.execute("select name, type from topics limit 1").fetchone()
        content.execute("update topics set type = ? where name = ?", (name, old[0]))
        content.execute("delete from message_definitions where topic_type = ?", (old[1],))
        content.execute(
            "insert into message_definitions (topic_type, encoding, encoded_message_definition, type_description_hash) "
            "values (?, ?, ?, '')",
            (name, encoding, text),
        )
    content.close()
    about = made / "metadata.yaml"
    # A text in quotes is the same in YAML and JSON.
    about.write_text(about.read_text(encoding="utf-8").replace(old[1], json.dumps(name)), encoding="utf-8")
    return made


def _matlab(file: Path, evil: bytes) -> Path:
    from scipy.io import savemat

    savemat(file, {"trial": {"data": {"xyz": np.frombuffer(evil, np.uint8)}}})
    return file


def _classed(folder: Path, kind: int) -> Path:
    """A MAT file whose arrays of numbers state another class (MAT-File Format, table 1-3): objects, functions, opaque ones."""
    from scipy.io import savemat

    file = folder / "take.mat"
    savemat(file, {"trial": {"data": {"xyz": foreign_files.XYZ.transpose(1, 2, 0)}}})
    content = file.read_bytes()
    # Array flags: an element of 32-bit numbers (6), 8 bytes long; class 6 is double.
    flags = struct.pack("<III", 6, 8, 6)
    assert flags in content
    file.write_bytes(content.replace(flags, struct.pack("<III", 6, 8, kind)))
    return file


def _attributed(folder: Path, evil: bytes) -> Path:
    import h5py

    file = foreign_files.hdf5(folder)
    with h5py.File(file, "r+") as content:
        for name in ("CLASS", "MATLAB_class", "pandas_type", "TITLE"):
            content["trial/data/xyz"].attrs[name] = np.bytes_(evil)
    return file


def _labelled(folder: Path, code: str) -> Path:
    import ezc3d

    file = foreign_files.c3d(folder)
    content = ezc3d.c3d(str(file))
    content["parameters"]["POINT"]["LABELS"]["value"] = [code, f"__import__('os') or {code}", "%s%n{0.__class__}"]
    content.write(str(file))
    return file


def _extended(file: Path, evil: bytes) -> Path:
    from nibabel.nifti1 import Nifti1Extension

    labels = np.zeros((12, 12, 12), np.uint8)
    labels[3:9, 3:9, 3:9] = 1
    # 16 is the code of pickles.
    scanned.image(file, labels, np.diag([5.0, 5, 5, 1]), lambda head: head.extensions.append(Nifti1Extension(16, evil)))
    scanned.scene_of(file, more="label = 1", sizes=(10.0,))
    return file.parent / "scene.toml"


def read(file: Path) -> Any:
    """Read a mapping, or mesh the geometry of a scene."""
    from bcid import Measurement, Scene
    from bcid.forms.mesh import level_mesh

    if file.name != "scene.toml":
        return Measurement.read(file)
    scene = Scene.read(file)
    return level_mesh(scene, scene.levels[0])
