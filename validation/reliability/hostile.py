"""S1, S4: hostile files, and files beside and behind others: nothing is run, nothing else is opened, as a tracer sees it.

``python -m validation.reliability.hostile FOLDER full`` is the process that is traced: it reads the corpus, prints how cases ended.
"""

from __future__ import annotations

import json
import os
import pickle
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import BcidError
from validation.reliability import ROOT, Reached, canaries, foreign_files
from validation.reliability.canaries import Opens
from validation.reliability.inputs import small_scene, write_inputs
from validation.reliability.tracer import Event, traced

_SCRIPTS = (
    'SystemCall "touch {canary}";',
    'NonBlockingSystemCall "touch {canary}";',
    'Printf("x") > "{canary}";',
    'Merge "{secret}";',
    'Include "{secret}";',
    'Save "{canary}";',
    'OnelabRun("x", "touch {canary}");',
    'CreateDir "{canary}";',
    'General.BackgroundImageFileName = "{secret}"; Save "{canary}";',
    '// $MeshFormat\nSystemCall "touch {canary}";',
)
_HEADS = ("", "\n", " ", "\ufeff", "/* */", "$meshformat\n", "$Mesh\n")
_ENDINGS = (".pos", ".stl", ".step", ".brep", ".med", ".cgns", ".unv", ".py", ".opt", ".geo_unrolled", ".MSH")
# A file of this name may be opened in no case.
_SECRET = "secret"
# Where the interpreter, packages, libraries and devices are, and bcid itself.
_SYSTEM = ("/usr", "/lib", "/lib64", "/bin", "/sbin", "/etc", "/proc", "/sys", "/dev", "/run/bcid/venv", "/opt")
# What a child of bcid begins with, after the interpreter.
_CHILDREN = tuple(
    ("-P", "-m", f"bcid.{name}")
    for name in ("forms.mesh.child", "vision.calibrations.opencv_storage", "vision.decoder")
)
_CHILDREN += tuple(
    ("-P", "-m", f"bcid.measurement.formats.{name}")
    for name in ("array_tree", "capture_c3d", "pose_estimation", "cloud_file", "ros_bag")
)
# Asked by ctypes where a library is, before a child has given up its rights.
_FINDERS = ("/sbin/ldconfig", "/usr/sbin/ldconfig")


@dataclass(frozen=True)
class Case:
    """A file, or several, and what reads it as a user would.

    Attributes:
        name: for messages.
        read: reads it; raises `BcidError` where it is refused.
        refused: whether it must be; None where both will do.
        named: files that it may open in its own folder, by name; None for all.
        program: it is a program: what it tries and may not do is no fault.
    """

    name: str
    read: Callable[[], Any]
    refused: bool | None = True
    named: tuple[str, ...] | None = None
    program: bool = False


class Corpus:
    """Makes the cases in a folder; each has a folder of its own.

    Attributes:
        folder: of them all.
        canary: exists when something was run or written.
        secret: a mesh that nobody has named.
    """

    def __init__(self, folder: Path, full: bool) -> None:
        self.folder, self.full = folder, full
        self.canary = folder / "canary"
        self.secret = folder / _SECRET
        self.words = {"canary": str(self.canary), "secret": str(self.secret)}
        self.secret.write_text(f'SystemCall "touch {self.canary}-secret";\n', encoding="utf-8")
        self.made = 0

    def place(self) -> Path:
        """The folder of the next case."""
        self.made += 1
        made = self.folder / f"case-{self.made}"
        made.mkdir()
        return made

    def body(self, place: Path, file: str, refused: bool | None = True, what: str = "", **more: Any) -> Case:
        """Mesh a file of a folder, as a scene names it."""
        from bcid import Scene
        from bcid.forms.mesh import level_mesh
        from bcid.forms.model import check_physics

        scene_file = small_scene(place)
        text = scene_file.read_text(encoding="utf-8")
        if not file.endswith(".geo"):
            text = text.replace('element_size = "50 mm"', "refinements = 0")
            text = text.replace('element_size = "20 mm"', "refinements = 1")
        line = next(line for line in text.splitlines() if line.startswith("file = "))
        scene_file.write_text(text.replace(line, f'file = "{file}"'), encoding="utf-8")

        def read() -> Any:
            scene = Scene.read(scene_file, physics=check_physics)
            return level_mesh(scene, scene.levels[0])

        named = more.pop("named", (file,))
        return Case(what or file, read, refused, ("scene.toml", *named), **more)

    def content(self, content: str | bytes, ending: str, refused: bool | None = True, what: str = "") -> Case:
        """A mesh file with this content."""
        place = self.place()
        data = content if isinstance(content, bytes) else content.format(**self.words).encode()
        (place / f"m{ending}").write_bytes(data)
        return self.body(place, f"m{ending}", refused, what or f"{ending}: {data[:50]!r}")

    def cases(self) -> Iterator[Case]:
        """All of them."""
        yield from self.scripts()
        yield from self.side_files()
        yield from self.links()
        yield from self.references()
        yield from self.hdf5()
        yield from self.others()
        yield from self.recordings()
        yield from self.objects()
        yield from self.definitions()
        yield from self.runs()

    def scripts(self) -> Iterator[Case]:
        """What gmsh would run, under the names of data; XML with entities; counts without end."""
        for script in _SCRIPTS:
            for head in _HEADS[: (3 if script is not _SCRIPTS[0] else None) if self.full else 1]:
                yield self.content(head + script, ".msh")
        sections = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
        for script in _SCRIPTS[: 4 if self.full else 1]:
            yield self.content(sections + script, ".msh")
            yield self.content(sections + "$Comments\n" + script + "\n$EndComments\n", ".msh")
        for ending in _ENDINGS if self.full else _ENDINGS[-3:]:
            yield self.content(_SCRIPTS[0], ending)
        entity = f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x SYSTEM "file://{self.secret}">]>'
        for ending in (".vtu", ".xdmf", ".xml"):
            yield self.content(f"{entity}<VTKFile type='UnstructuredGrid'>&x;</VTKFile>", ending)
        laughs = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]><a>&b;</a>'
        yield self.content(laughs, ".vtu")
        yield self.content(b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 999999999999 1 999999999999\n", ".msh")
        for script in _SCRIPTS if self.full else _SCRIPTS[:4]:
            place = self.place()
            (place / "m.geo").write_text(script.format(**self.words), encoding="utf-8")
            yield self.body(place, "m.geo", True, f"program {script[:40]}", program=True)

    def side_files(self) -> Iterator[Case]:
        """Sound meshes beside files that readers open of their own accord."""
        run = _SCRIPTS[0].format(**self.words)
        for ending in (".msh", ".vtk"):
            place = self.place()
            _sound(place / f"m{ending}")
            for other in (f"m{ending}.opt", ".gmshrc", ".gmsh-options", "m.opt", "m.geo", "m.pos", "gmshrc"):
                (place / other).write_text(run, encoding="utf-8")
            for other in ("numpy.py", "gmsh.py", "meshio.py", "sitecustomize.py", "usercustomize.py"):
                (place / other).write_text(f"open({str(self.canary)!r}, 'w')", encoding="utf-8")
            yield self.body(
                place, f"m{ending}", False if ending == ".msh" else None, f"{ending} beside side files and modules"
            )
        place = self.place()
        (place / "m.geo").write_text((ROOT / "meshes/geo/slab.geo").read_text(encoding="utf-8"), encoding="utf-8")
        (place / "m.geo.opt").write_text(run, encoding="utf-8")
        yield self.body(place, "m.geo", True, ".geo beside an options file")
        place = self.place()
        _sound(place / "m.xml")
        (place / "m_facet_region.xml").write_text("<mesh_function/>", encoding="utf-8")
        yield self.body(place, "m.xml", None, "DOLFIN's XML beside a mesh function")
        for ending in (".node", ".ele"):
            place = self.place()
            for other in (".node", ".ele"):
                (place / f"m{other}").write_text("1 3 0 0\n1 0 0 0\n", encoding="utf-8")
            yield self.body(place, f"m{ending}", True, f"TetGen's {ending} with its other half")

    def links(self) -> Iterator[Case]:
        """Links whose own names are harmless."""
        run = _SCRIPTS[0].format(**self.words)
        for ending, target in ((".vtk", "evil.msh"), (".vtk", "evil.geo"), (".msh", "evil.geo"), (".inp", "evil.geo")):
            place = self.place()
            (place / target).write_text(run, encoding="utf-8")
            (place / f"m{ending}").symlink_to(place / target)
            yield self.body(place, f"m{ending}", True, f"{ending} linked to {target}", named=(f"m{ending}", target))
        place = self.place()
        _sound(place / "elsewhere.msh")
        (place / "elsewhere.msh.opt").write_text(run, encoding="utf-8")
        (place / "m.msh").symlink_to(place / "elsewhere.msh")
        yield self.body(place, "m.msh", False, "linked to a sound mesh", named=("m.msh", "elsewhere.msh"))

    def references(self) -> Iterator[Case]:
        """Text that names other files."""
        place = self.place()
        _sound(place / "other.inp")
        other = str(place / "other.inp")
        for number, line in enumerate(
            (
                f"*INCLUDE, INPUT={other}",
                f"*include,input={other}",
                "*INCLUDE, INPUT=other.inp",
                f"INCLUDE, INPUT={other}",
                f"*NODE, INPUT={other}",
                f"*ELEMENT, TYPE=C3D4, FILE={other}",
            )
        ):
            (place / f"m{number}.inp").write_text(f"*HEADING\nx\n{line}\n", encoding="utf-8")
            yield self.body(place, f"m{number}.inp", True, line[:40])
        for line in (f"INCLUDE '{other}'", f"include {other}"):
            yield self.content(f"CEND\nBEGIN BULK\n{line}\nENDDATA\n", ".bdf")
        place = self.place()
        (place / "values.bin").write_bytes(np.zeros(12).tobytes())
        for what, item in (
            ("Binary", f'<DataItem Format="Binary" Dimensions="4 3" DataType="Float">{place}/values.bin</DataItem>'),
            ("XInclude", f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{self.secret}"/>'),
        ):
            (place / f"{what}.xdmf").write_text(_xdmf(item, item), encoding="utf-8")
            yield self.body(place, f"{what}.xdmf", True, f"XDMF: {what}")

    def hdf5(self) -> Iterator[Case]:
        """HDF5 files that name others, beside an XDMF and alone; a filter that is a plugin."""
        import h5py

        place = self.place()
        elsewhere = self.place()
        _heavy(elsewhere / "far.h5")
        _heavy(place / "near.h5")
        (place / "link.h5").symlink_to(elsewhere / "far.h5")
        with h5py.File(place / "external.h5", "w") as made:
            for name in ("points", "cells"):
                made[name] = h5py.ExternalLink(str(elsewhere / "far.h5"), name)
        with h5py.File(place / "soft.h5", "w") as made:
            made["hidden"] = h5py.ExternalLink(str(elsewhere / "far.h5"), "/")
            for name in ("points", "cells"):
                made[name] = h5py.SoftLink(f"/hidden/{name}")
        with h5py.File(elsewhere / "far.h5") as far, h5py.File(place / "virtual.h5", "w") as made:
            for name in ("points", "cells"):
                layout = h5py.VirtualLayout(far[name].shape, far[name].dtype)
                layout[...] = h5py.VirtualSource(far[name])
                made.create_virtual_dataset(name, layout)
        (elsewhere / "raw").write_bytes(np.zeros(12).tobytes())
        with h5py.File(place / "raw.h5", "w") as made:
            made.create_dataset("points", (4, 3), "f8", external=[(str(elsewhere / "raw"), 0, 96)])
            made["cells"] = [[0, 1, 2, 3]]
        _filtered(place / "filter.h5")
        for name, refused in (
            ("near.h5", False),
            (f"{elsewhere}/far.h5", True),
            (f"../{elsewhere.name}/far.h5", True),
            *((f"{name}.h5", True) for name in ("link", "external", "soft", "virtual", "raw", "filter")),
        ):
            file = f"{Path(name).stem}-{self.made}-{len(name)}.xdmf"
            items = [
                f'<DataItem Format="HDF" Dimensions="4 3" DataType="Float" Precision="8">{name}:/points</DataItem>'
            ]
            items += [f'<DataItem Format="HDF" Dimensions="1 4" DataType="Int" Precision="8">{name}:/cells</DataItem>']
            (place / file).write_text(_xdmf(*items), encoding="utf-8")
            named = (file, Path(name).name) if "/" not in name and name != "link.h5" else (file,)
            yield self.body(place, file, None if name == "near.h5" else refused, f"XDMF with {name}", named=named)
        for ending in (".h5m", ".cgns", ".hmf", ".med", ".e") if self.full else (".cgns",):
            target = place / f"m{ending}"
            target.write_bytes((place / "external.h5").read_bytes())
            yield self.body(place, target.name, True, f"{ending} with an external link")

    def others(self) -> Iterator[Case]:
        """Measurements and calibrations."""
        from bcid import Measurement
        from bcid.vision.camera import Cameras
        from bcid.vision.recording import Recording

        place = self.place()
        write_inputs(place)
        # HDF5 begins like this; whatever its links lead to, it is not opened as such.
        (place / "link.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + str(self.secret).encode())
        (place / "pickle.nc").write_bytes(pickle.dumps(_Bomb(str(self.canary))))
        (place / "huge.nc").write_bytes(b"CDF\x01\x00\x00\x00\x00\x00\x00\x00\x0a\x7f\xff\xff\xff" + b"\x7f" * 64)
        for name in ("link", "pickle", "huge"):
            yield Case(f"netCDF: {name}", lambda n=name: Measurement.read(place / f"{n}.nc"))
        entity = f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x SYSTEM "file://{self.secret}">]><opencv_storage>&x;</opencv_storage>'
        for ending, text in (
            (".xml", entity),
            (".yml", f"%YAML:1.0\n--- !!python/object/apply:os.system ['touch {self.canary}']\n"),
            (".json", "[" * 100_000),
        ):
            (place / f"hostile{ending}").write_text(text, encoding="utf-8")
            yield Case(f"calibration {ending}", lambda e=ending: Cameras.read(place / f"hostile{e}"))
        (place / "not-a-table").write_text("root:x:0:0", encoding="utf-8")
        for name in ("seen/fiducials.csv", "recording.toml"):
            (place / name).unlink()
            (place / name).symlink_to(place / "not-a-table")
        yield Case("a link in place of fiducials.csv", lambda: Measurement.read(place / "seen"))
        yield Case("a link in place of a recording", lambda: Recording.read(place / "recording.toml"))

    def recordings(self) -> Iterator[Case]:
        """Videos that are lists of other files, images of formats that nobody has asked for, C3D files that are none."""
        from bcid import Measurement
        from bcid.vision.images import Images

        place = self.place()
        lists = (
            f"ffconcat version 1.0\nfile '{self.secret}'\n",
            f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{self.secret}\n#EXT-X-ENDLIST\n",
            f"<?xml version='1.0'?><MPD><BaseURL>{self.secret}</BaseURL></MPD>",
        )
        for ending in (".avi", ".mp4", ".mkv") if self.full else (".avi",):
            for number, text in enumerate(lists):
                file = place / f"list{number}{ending}"
                file.write_text(text, encoding="utf-8")
                yield Case(f"video: {text[:20]!r} as {ending}", lambda f=file: Images.open(f), named=(file.name,))
        for number, head in enumerate(
            (b"v/1\x01", b"#?RADIANCE\n", b"P6 1 1 255\n", b"RIFF\0\0\0\0WEBPVP8 ", b"GIF89a")
        ):
            folder = place / f"images{number}"
            folder.mkdir()
            (folder / "1.png").write_bytes(head + b"\0" * 64)
            yield Case(f"image: {head!r}", lambda f=folder: Images.open(f), named=("1.png",))
        (place / "junk.c3d").write_bytes(b"\x02\x50" + str(self.secret).encode() * 40)
        mapping = place / "mapping.toml"
        units = 'length_unit = "mm"\ntime_unit = "s"\nforce_unit = "N"\n'
        mapping.write_text(
            f'format = "bcid-mapping/1"\nfile = "junk.c3d"\n{units}[fiducials]\na = "A"\n', encoding="utf-8"
        )
        yield Case("C3D: junk", lambda: Measurement.read(mapping), named=("mapping.toml", "junk.c3d"))

    def objects(self) -> Iterator[Case]:
        """Python objects in recordings, clouds and calibrations: making one opens the secret, as a tracer sees."""
        from bcid import Measurement
        from bcid.vision.camera import Cameras

        place = self.place()
        units = 'length_unit = "mm"\ntime_unit = "s"\nforce_unit = "N"\n'
        for number, write in enumerate((_object_block, _object_labels)):
            write(place / f"{number}.h5", Opens(str(self.secret)))
            mapping = place / f"mapping{number}.toml"
            mapping.write_text(f'format = "bcid-mapping/1"\nfile = "{number}.h5"\n{units}', encoding="utf-8")
            yield Case(f"DeepLabCut: {write.__name__}", lambda m=mapping: Measurement.read(m))
        np.save(place / "cameras.npy", np.array([Opens(str(self.secret))], dtype=object))
        yield Case("calibration .npy of objects", lambda: Cameras.read(place / "cameras.npy"))
        np.save(place / "0.npy", np.array([Opens(str(self.secret))], dtype=object))
        surface = f'format = "bcid-measurement/1"\n{units}[surface]\nclouds = "{{step}}.npy"\nunit = "mm"\n'
        (place / "measurement.toml").write_text(surface, encoding="utf-8")
        poses = "action,step,time,grasp,x,y,z,qw,qx,qy,qz\na,0,0,I,0,0,0,1,0,0,0\na,1,1,I,1,0,0,1,0,0,0\n"
        (place / "grasps.csv").write_text(poses, encoding="utf-8")
        yield Case("cloud .npy of objects", lambda: Measurement.read(place))
        bag = foreign_files.ros(place, "ros2")
        text = (bag / "metadata.yaml").read_text(encoding="utf-8")
        evil = f"!!python/object/apply:builtins.open ['{self.secret}']"
        (bag / "metadata.yaml").write_text(text.replace(":\n", f":\n  evil: {evil}\n", 1), encoding="utf-8")
        mapping = place / "bag.toml"
        mapping.write_text(f'format = "bcid-mapping/1"\nfile = "{bag.name}"\n{units}', encoding="utf-8")
        yield Case("ROS 2 bag whose metadata make an object", lambda: Measurement.read(mapping), None)

    def definitions(self) -> Iterator[Case]:
        """Code in definitions, names, attributes and extensions; of many, every sixth where the corpus is reduced."""
        for number, (name, file) in enumerate(canaries.files(self.place, self.secret)):
            if self.full or number % 6 == 0:
                yield Case(name, lambda f=file: canaries.read(f), None)

    def runs(self) -> Iterator[Case]:
        """Run folders of others, whose model names a program."""
        from bcid.base.run_folder import RunFolder
        from bcid.search.answer.source import from_run

        place = self.place()
        write_inputs(place)
        (place / "effect.py").write_text(f"open({str(self.canary)!r}, 'w')\n", encoding="utf-8")
        run = RunFolder.start(place / "run", "explain", {"scene": "a", "measurement": "b", "effects": ["c"]})
        run.record["names"] = {"scene": str(place / "scene.toml"), "measurement": str(place / "seen")}
        model = {"files": [str(place / "effect.py")], "law": {}, "effects": [], "anchored": ["1"], "free": []}
        run.write_json("model.json", model)
        run.finish({})
        yield Case("a run whose model names a file of effects", lambda: from_run(place / "run", (), None))


class _Bomb:
    """Unpickling it writes the canary."""

    def __init__(self, canary: str) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return os.system, (f"touch {self.canary}",)


def _object_block(file: Path, one: Any) -> None:
    """A table of DeepLabCut with an object among its values."""
    import warnings

    import pandas as pd

    table = pd.read_hdf(foreign_files.deeplabcut_hdf5(file.parent)).astype(object)
    table.iloc[0, 0] = one
    with warnings.catch_warnings(action="ignore"):
        table.to_hdf(file, key="df_with_missing", format="fixed", mode="w")


def _object_labels(file: Path, one: Any) -> None:
    """A table of DeepLabCut whose labels are an object."""
    import h5py

    made = foreign_files.deeplabcut_hdf5(file.parent).rename(file)
    with h5py.File(made, "r+") as content:
        content["df_with_missing"].attrs["info"] = np.bytes_(pickle.dumps(one, 0))


_POINTS = np.array([[0.0, 0, 0], [100, 0, 0], [0, 10, 0], [0, 0, 100]])


def _sound(file: Path) -> None:
    """A tetrahedron with all groups of the small scene, as its first triangles; other formats than .msh have none."""
    import meshio

    if file.suffix != ".msh":
        format_name = {".xml": "dolfin-xml", ".vtk": "vtk", ".inp": "abaqus"}[file.suffix]
        meshio.write_points_cells(file, _POINTS, [("tetra", [[0, 1, 2, 3]])], file_format=format_name)
        return
    file.write_bytes((file.parents[1] / "sound.msh").read_bytes())


def _heavy(file: Path) -> None:
    import h5py

    with h5py.File(file, "w") as made:
        made["points"], made["cells"] = _POINTS, [[0, 1, 2, 3]]


def _filtered(file: Path) -> None:
    """Values that only a filter of a plugin (number 305) could read."""
    import h5py

    with h5py.File(file, "w") as made:
        create = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        create.set_chunk((4, 3))
        create.set_filter(305, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple((4, 3))
        made_id = h5py.h5d.create(made.id, b"points", h5py.h5t.IEEE_F64LE, space, create)
        made_id.write_direct_chunk((0, 0), np.zeros(12).tobytes(), 0)
        made["cells"] = [[0, 1, 2, 3]]


def _xdmf(points: str, cells: str) -> str:
    return (
        '<Xdmf Version="3.0"><Domain><Grid Name="Grid">'
        f'<Geometry GeometryType="XYZ">{points}</Geometry>'
        f'<Topology TopologyType="Tetrahedron" NumberOfElements="1">{cells}</Topology></Grid></Domain></Xdmf>'
    )


def _read_all(folder: Path, full: bool) -> None:
    """Read every case, with a mark before and after each, and print how each ended as lines of JSON."""
    corpus = Corpus(folder, full)
    os.chdir(folder)
    # Tries the folder by writing to it.
    tempfile.gettempdir()
    for number, case in enumerate(corpus.cases()):
        _mark(folder, number)
        try:
            case.read()
            end = "read"
        except BcidError as error:
            end = f"refused: {error}"
        except Exception as error:
            end = f"EXCEPTION {error!r}"
        _mark(folder, -1)
        touched = sorted(path.name for path in folder.rglob("canary*"))
        for path in list(folder.rglob("canary*")):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        told = {"name": case.name, "refused": case.refused, "named": case.named, "program": case.program}
        print(json.dumps(told | {"end": end, "touched": touched, "folder": f"case-{corpus.made}"}), flush=True)


def _mark(folder: Path, number: int) -> None:
    """Leaves a line in the trace: a file that is not there is opened."""
    try:
        (folder / f"mark{number}").open()
    except OSError:
        return


def _environment(folder: Path) -> dict[str, str]:
    """A home and plugin folders that are full of traps."""
    home = folder / "home"
    home.mkdir()
    for name in (".gmshrc", ".gmsh-options", ".gmshsock"):
        (home / name).write_text(_SCRIPTS[0].format(canary=folder / "canary", secret=""), encoding="utf-8")
    for name in ("libH5Zevil.so", "gmshevil.so"):
        (home / name).write_bytes(b"\x7fELF")
    plugins = dict.fromkeys(("HDF5_PLUGIN_PATH", "GMSHPLUGINSHOME", "GMSH_HOME"), str(home))
    return {
        **os.environ,
        **plugins,
        "HOME": str(home),
        "TMPDIR": str(folder),
        "OMP_NUM_THREADS": "1",
        "XDG_CONFIG_HOME": str(home),
    }


def hostile(full: bool = True) -> Reached:
    """S1, S4: read each file in a process that is traced; nothing is run, nothing else is opened, the canary is not there."""
    goal = "hostile files, side files and references: nothing is run, nothing else is opened or written"
    with tempfile.TemporaryDirectory(prefix="bcid-hostile-") as name:
        folder = Path(name)
        # The folder of a sound mesh of the slab, made before anything is watched.
        _sound_slab(folder / "sound.msh")
        command = [sys.executable, "-m", "validation.reliability.hostile", str(folder), "full" if full else "reduced"]
        done = traced(command, folder / "trace", _environment(folder) | {"PYTHONPATH": str(ROOT)})
        if done is None:
            return Reached(goal, "strace is not installed: nothing was looked at", False)
        seen, said = done
        cases = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        misses = list(_judged(cases, _by_case(seen, folder), folder))
    refused = sum(case["end"].startswith("refused") for case in cases)
    text = f"{len(cases)} files, {refused} refused; with every system call that opens, writes, executes or connects looked at"
    return Reached(goal, text, not misses and len(cases) >= (100 if full else 50), tuple(misses))


def _sound_slab(file: Path) -> None:
    """The coarse slab as a .msh, made by gmsh in a process of its own."""
    import subprocess

    code = (
        "import gmsh, sys; gmsh.initialize(['x', '-v', '1', '-setnumber', 'h', '50'], interruptible=False); "
        "gmsh.open(sys.argv[1]); gmsh.model.mesh.generate(3); gmsh.write(sys.argv[2])"
    )
    subprocess.run(
        [sys.executable, "-c", code, str(ROOT / "meshes/geo/slab.geo"), str(file)], check=True, capture_output=True
    )


def _by_case(seen: Sequence[Event], folder: Path) -> dict[int, list[Event]]:
    """Events between the marks, by the number of the case."""
    found: dict[int, list[Event]] = {}
    now = -1
    for event in seen:
        if event.call == "open" and event.path.startswith(f"{folder}/mark"):
            now = int(event.path.removeprefix(f"{folder}/mark"))
        elif now >= 0:
            found.setdefault(now, []).append(event)
    return found


def _judged(cases: Sequence[dict[str, Any]], events: dict[int, list[Event]], folder: Path) -> Iterator[str]:
    for number, case in enumerate(cases):
        refused = case["end"].startswith("refused")
        wrong = [] if case["refused"] in (None, refused) and not case["end"].startswith("EXCEPTION") else [case["end"]]
        wrong += [f"touched {', '.join(case['touched'])}"] if case["touched"] else []
        wrong += [text for event in events.get(number, []) if (text := _fault(event, case, folder))]
        if wrong:
            yield f"{case['name']}: {'; '.join(dict.fromkeys(wrong))[:600]}"


def _fault(event: Event, case: dict[str, Any], folder: Path) -> str:
    """What is wrong with a system call; "" if nothing is."""
    if case["program"] and not event.done:
        return ""
    if event.call == "connect":
        return f"connects to {event.path[:80]}"
    if event.call == "execute":
        child = any(event.words[1 : 1 + len(words)] == words for words in _CHILDREN)
        return "" if child or event.path in _FINDERS or not event.done else f"executes {' '.join(event.words)[:120]}"
    path = Path(event.path)
    inside = folder in path.parents
    if inside and path.relative_to(folder).parts[0].startswith("bcid-"):
        return ""
    if inside and event.call == "open":
        parts = path.relative_to(folder).parts
        named = case["named"]
        allowed = parts[0] == case["folder"] and (named is None or len(parts) < 2 or path.name in named)
        known = len(parts) >= 2 and named is not None and path.name in named
        return "" if allowed or known or path.is_dir() else f"opens {'/'.join(parts)}"
    if event.call == "write":
        # The folder itself: a temporary file without a name tells whether the temporary folder is full.
        harmless = path == folder or str(path).startswith("/dev/") or "__pycache__" in path.parts or not event.done
        return "" if harmless else f"writes {path}"
    system = str(path).startswith((*_SYSTEM, sys.prefix, sys.base_prefix, str(ROOT)))
    return "" if system or path in folder.parents or path == folder else f"opens {path}"


if __name__ == "__main__":
    _read_all(Path(sys.argv[1]), sys.argv[2] == "full")
