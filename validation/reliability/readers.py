"""S7: mutated files of every format that is read: each ends in a result or a refusal in words, the child's death among them.

``python -m validation.reliability.readers NAME COUNT SEED`` is the process that reads those of one format; a line of JSON for each.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from validation.reliability import ROOT, Reached, foreign_files, forked, scanned

# What reads a file of a folder, made before it is damaged; the file is what is damaged.
_Made = tuple[Path, Callable[[], Any]]
# A case that takes longer than its child may take (30 s for a small file, 60 s for a mesh) hangs.
_HANGS = 100.0
_MAPPING = 'format = "bcid-mapping/1"\nlength_unit = "{unit}"\ntime_unit = "s"\nforce_unit = "N"\nfile = "{file}"\n'
_ARRAYS = '[arrays]\npositions = "trial/data/xyz"\norder = "marker axis frame"\n'
_CELLS = '[arrays]\npositions = "DIC3DPPresults/Points3D"\n'
_MOVED = "data_dic_save/displacements/plot_{}_ref_formatted"
_GRID = f'[arrays]\ndisplacements = ["{_MOVED.format("u")}", "{_MOVED.format("v")}"]\ngrid = 5.0\n'
_WORDS = (b"nan", b"inf", b"-1", b"1e308", b"99999999999", b"4294967295", b"", b"[" * 60_000, b'"', b"\0")
_COUNTS = (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0, 1 << 20)
_CLOUD = 'format = "bcid-measurement/1"\nlength_unit = "mm"\ntime_unit = "s"\nforce_unit = "N"\n[surface]\n'


def _mapped(write: Callable[[Path], Path | str], more: str = "", unit: str = "mm") -> Callable[[Path], _Made]:
    """A recording that a mapping names."""

    def make(folder: Path) -> _Made:
        from bcid import Measurement

        written = write(folder)
        file = written if isinstance(written, Path) else sorted(folder.glob(written))[0]
        named = written.name if isinstance(written, Path) else written
        mapping = folder / "mapping.toml"
        mapping.write_text(_MAPPING.format(file=named, unit=unit) + "rate = 50\n" * (not more) + more, encoding="utf-8")
        return _damaged_part(file), lambda: Measurement.read(mapping)

    return make


def _damaged_part(file: Path) -> Path:
    """Of a folder with a bag its largest file."""
    return max(file.iterdir(), key=lambda one: one.stat().st_size) if file.is_dir() else file


def _body(name: str, more: str = 'length_unit = "mm"', sizes: tuple[float, ...] = (30.0,)) -> Callable[[Path], _Made]:
    """A surface, label image or mesh that a scene names."""

    def make(folder: Path) -> _Made:
        from bcid.forms.mesh import level_mesh

        file, refined = folder / name, False
        points, triangles = scanned.box()
        if file.name.endswith((".nii", ".nii.gz")):
            labels = np.zeros((12, 12, 12), np.uint8)
            labels[3:9, 3:9, 3:9] = 1
            scanned.image(file, labels, np.diag([5.0, 5, 5, 1]))
        elif file.suffix in (".stl", ".ply", ".obj"):
            scanned.save(file, points, triangles)
        else:
            _mesh(file)
            refined = True
        scene = scanned.scene_of(file, more=more, sizes=(0.0,) if refined else sizes, refined=refined)
        return file, lambda: level_mesh(scene, scene.levels[0])

    return make


def _mesh(file: Path) -> None:
    """A cube of tetrahedra."""
    import meshio

    corners = np.array([[x, y, z] for x in (0, 40) for y in (0, 40) for z in (0, 40)], dtype=float)
    # Six around the diagonal from corner 0 to corner 7.
    cells = [[0, a, b, 7] for a, b in ((1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1))]
    options = {".msh": {"file_format": "gmsh"}, ".xdmf": {"data_format": "XML"}}.get(file.suffix, {})
    meshio.write_points_cells(file, corners, [("tetra", np.array(cells))], **options)


def _cloud(ending: str, save: Callable[[Path, Any], Any], line: str = "clouds") -> Callable[[Path], _Made]:
    """A cloud or depth image of a measurement without markers."""

    def make(folder: Path) -> _Made:
        from bcid import Measurement

        camera = "[surface.camera]\nfx = 20\nfy = 20\ncx = 5\ncy = 5\nposition = [0, 0, 0]\nrotation = [1, 0, 0, 0]\n"
        text = f'{_CLOUD}{line} = "{{step}}{ending}"\nunit = "mm"\n' + camera * (line == "depth")
        (folder / "measurement.toml").write_text(text, encoding="utf-8")
        poses = "action,step,time,grasp,x,y,z,qw,qx,qy,qz\na,0,0,I,0,0,0,1,0,0,0\na,1,1,I,1,0,0,1,0,0,0\n"
        (folder / "grasps.csv").write_text(poses, encoding="utf-8")
        values = np.random.default_rng(0).uniform(10, 90, (12, 12) if line == "depth" else (40, 3))
        save(folder / f"0{ending}", values)
        return folder / f"0{ending}", lambda: Measurement.read(folder)

    return make


def _save_ply(file: Path, points: Any) -> None:
    import meshio

    meshio.Mesh(points, [("vertex", np.arange(len(points))[:, None])]).write(file)


def _save_png(file: Path, depth: Any) -> None:
    import cv2

    cv2.imwrite(str(file), np.round(depth).astype(np.uint16))


def _save_pcd(file: Path, points: Any) -> None:
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\nPOINTS {0}\nDATA binary\n"
    )
    file.write_bytes(head.format(len(points)).encode() + points.astype("<f8").tobytes())


def _images(ending: str) -> Callable[[Path], _Made]:
    """A folder with one image of a camera."""

    def make(folder: Path) -> _Made:
        import cv2

        file = folder / "left" / f"1{ending}"
        file.parent.mkdir()
        cv2.imwrite(str(file), np.random.default_rng(0).integers(0, 256, (24, 32), np.uint8))
        return file, lambda: _every_image(file.parent)

    return make


def _film(ending: str, code: str) -> Callable[[Path], _Made]:
    """A film of a camera."""

    def make(folder: Path) -> _Made:
        import cv2

        file = folder / f"left{ending}"
        writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*code), 25, (64, 48))
        for number in range(6):
            writer.write(np.full((48, 64, 3), 20 * number, np.uint8))
        writer.release()
        return file, lambda: _every_image(file)

    return make


def _every_image(source: Path) -> None:
    """Read the images of a camera, at most 20; refused where one cannot be read."""
    from bcid.vision.images import Images

    images = Images.open(source)
    try:
        for number in images.numbers[:20]:
            if images.read(number) is None:
                raise InputError(images.troubles[number])
    finally:
        images.close()


def _cameras(name: str) -> Callable[[Path], _Made]:
    """A calibration of two cameras."""

    def make(folder: Path) -> _Made:
        from bcid.vision.camera import Cameras

        file = folder / name
        matrix = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
        values = {"K1": matrix, "D1": np.zeros((1, 5)), "K2": matrix, "D2": np.zeros((1, 5)), "R": np.eye(3)}
        values["T"] = np.array([[-100.0], [0], [0]])
        if file.suffix == ".mat":
            _bouguet(file, matrix)
        elif file.suffix == ".npy":
            poses = np.stack([np.eye(4)[:3], np.column_stack([np.eye(3), values["T"]])])
            np.save(file, matrix @ poses)
        else:
            import cv2

            storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
            for key, value in values.items():
                storage.write(key, value)
            storage.release()
        return file, lambda: Cameras.read(file, "mm")

    return make


def _bouguet(file: Path, matrix: Any) -> None:
    from scipy.io import savemat

    values: dict[str, Any] = {"R": np.eye(3), "T": [[-100.0], [0], [0]], "nx": 640, "ny": 480}
    for side in ("left", "right"):
        values |= {f"fc_{side}": matrix[[0, 1], [0, 1]], f"cc_{side}": matrix[:2, 2], f"kc_{side}": np.zeros(5)}
    savemat(file, values)


def _netcdf(folder: Path) -> _Made:
    from bcid import Measurement
    from validation.reliability import MEASURED

    file = folder / "seen.nc"
    Measurement.read(MEASURED).to_netcdf(file)
    return file, lambda: Measurement.read(file)


def _folder(name: str) -> Callable[[Path], _Made]:
    """A file of a measurement folder of bcid."""

    def make(folder: Path) -> _Made:
        from bcid import Measurement
        from validation.reliability.inputs import write_inputs

        write_inputs(folder)
        return folder / "seen" / name, lambda: Measurement.read(folder / "seen")

    return make


def _ros(kind: str) -> Callable[[Path], Path]:
    return lambda folder: foreign_files.ros(folder, kind)


READERS: dict[str, Callable[[Path], _Made]] = {
    "C3D": _mapped(foreign_files.c3d),
    "MAT 5": _mapped(foreign_files.mat, _ARRAYS),
    "MAT 7.3": _mapped(foreign_files.mat73, _ARRAYS),
    "HDF5": _mapped(foreign_files.hdf5, _ARRAYS),
    "DeepLabCut HDF5": _mapped(foreign_files.deeplabcut_hdf5),
    "DeepLabCut CSV": _mapped(foreign_files.deeplabcut),
    "Anipose": _mapped(foreign_files.anipose),
    "ROS 1 bag": _mapped(_ros("ros1"), unit="m"),
    "ROS 2 bag": _mapped(_ros("ros2"), unit="m"),
    "MCAP": _mapped(_ros("mcap"), unit="m"),
    "Motive": _mapped(foreign_files.motive, unit="m"),
    "Nexus": _mapped(foreign_files.nexus),
    "Qualisys": _mapped(foreign_files.qualisys),
    "TRC": _mapped(foreign_files.trc),
    "VIC-3D": _mapped(foreign_files.vic3d),
    "ARAMIS": _mapped(foreign_files.aramis),
    "ARAMIS node map": _mapped(foreign_files.nodemap),
    "MatchID": _mapped(foreign_files.matchid),
    "MultiDIC": _mapped(foreign_files.multidic, _CELLS),
    "DuoDIC": _mapped(foreign_files.duodic, _CELLS),
    "Ncorr": _mapped(foreign_files.ncorr, _GRID),
    "PLY cloud": _cloud(".ply", _save_ply),
    "PCD cloud": _cloud(".pcd", _save_pcd),
    "NPY cloud": _cloud(".npy", np.save),
    "XYZ cloud": _cloud(".xyz", np.savetxt),
    "PNG depth": _cloud(".png", _save_png, "depth"),
    "NPY depth": _cloud(".npy", np.save, "depth"),
    "PNG images": _images(".png"),
    "JPEG images": _images(".jpg"),
    "TIFF images": _images(".tif"),
    "BMP images": _images(".bmp"),
    "AVI film": _film(".avi", "MJPG"),
    "MP4 film": _film(".mp4", "mp4v"),
    "Matroska film": _film(".mkv", "mp4v"),
    "STL surface": _body("s.stl"),
    "PLY surface": _body("s.ply"),
    "OBJ surface": _body("s.obj"),
    "NIfTI": _body("s.nii", "label = 1", (10.0,)),
    "NIfTI, packed": _body("s.nii.gz", "label = 1", (10.0,)),
    "MSH": _body("m.msh"),
    "VTK": _body("m.vtk"),
    "VTU": _body("m.vtu"),
    "XDMF": _body("m.xdmf"),
    "MED": _body("m.med"),
    "Abaqus": _body("m.inp"),
    "Nastran": _body("m.bdf"),
    "CGNS": _body("m.cgns"),
    "OpenCV YAML": _cameras("c.yml"),
    "OpenCV XML": _cameras("c.xml"),
    "MATLAB stereo": _cameras("c.mat"),
    "NPY projections": _cameras("c.npy"),
    "NetCDF": _netcdf,
    "fiducials.csv": _folder("fiducials.csv"),
    "measurement.toml": _folder("measurement.toml"),
}


def mutated(good: bytes, rng: np.random.Generator) -> bytes:
    """One to three changes: flipped bits, a cut, a splice, a repeated block, a count or word that is absurd."""
    for _ in range(rng.integers(1, 4)):
        first, second = sorted(map(int, rng.integers(len(good) + 1, size=2)))
        kind = rng.integers(6)
        if kind == 0:
            changed = bytearray(good)
            for place in rng.integers(len(good), size=rng.integers(1, 9)) if good else ():
                changed[place] ^= 1 << int(rng.integers(8))
            good = bytes(changed)
        elif kind == 1:
            good = good[: max(first, len(good) // 8)] if rng.random() < 0.7 else good[first:]
        elif kind == 2:
            good = good[:first] + good[second:]
        elif kind == 3:
            good = good[:second] + good[first:second][:4096] * int(rng.integers(1, 20)) + good[second:]
        elif kind == 4:
            count = _COUNTS[rng.integers(len(_COUNTS))].to_bytes(8 if rng.random() < 0.3 else 4, "little")
            good = good[:first] + count + good[first + len(count) :]
        else:
            words = good.split(b" ") if b" " in good else good.split(b",")
            words[rng.integers(len(words))] = _WORDS[rng.integers(len(_WORDS))]
            good = (b" " if b" " in good else b",").join(words)
    return good


def _read_all(names: Sequence[str], count: int, seed: int) -> None:
    """Read mutated files of formats, and print how each ended."""
    for name in names:
        rng = np.random.default_rng([seed, sum(name.encode())])
        with tempfile.TemporaryDirectory(prefix="bcid-") as place:
            file, read = READERS[name](Path(place))
            good = file.read_bytes()
            read()
            forked.install()
            for number in range(count):
                file.write_bytes(mutated(good, rng))
                print(json.dumps({"begins": number, "format": name}), flush=True)
                begin = time.monotonic()
                end = _ended(read)
                print(json.dumps({"end": end, "seconds": time.monotonic() - begin, "format": name}), flush=True)


def _ended(read: Callable[[], Any]) -> str:
    try:
        read()
    except InputError as error:
        words = str(error)
        child = "the reader died" in words or "took more than" in words
        return "ended in the child" if child else "refused"
    except Exception as error:
        return f"EXCEPTION {type(error).__name__}: {str(error)[:200]}"
    return "read"


def ends_of(names: Iterable[str], count: int, seed: int = 0) -> tuple[Counter[str], list[str]]:
    """How `count` mutated files of each format ended, read in one process, and what went wrong."""
    command = [sys.executable, "-m", "validation.reliability.readers", str(count), str(seed), *names]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    cases, misses = [line for line in lines if "end" in line], []
    for k, case in enumerate(cases):
        about = f"{case['format']}, case {k % count} of seed {seed}"
        misses += [f"{about}: {case['end']}"] if case["end"][:4] == "EXCE" else []
        misses += [f"{about}: {case['seconds']:.0f} s"] if case["seconds"] > _HANGS else []
    if done.returncode != 0 or len(cases) < count * (len(command) - 5):
        last = lines[-1]["format"] if lines else "the first"
        misses.append(f"{last}, seed {seed}: bcid died, code {done.returncode}: {done.stderr[-300:]}")
    return Counter("exception" if case["end"][:4] == "EXCE" else case["end"] for case in cases), misses


def damage(count: int = 300, seed: int = 0) -> Reached:
    """S7: `count` mutated files of each format."""
    total: Counter[str] = Counter()
    misses: list[str] = []
    for name in READERS:
        ends, wrong = ends_of([name], count, seed)
        total += ends
        misses += wrong
        print(f"   {name}: {', '.join(f'{what} {times}' for what, times in sorted(ends.items()))}", flush=True)
    text = f"{len(READERS)} formats: " + ", ".join(f"{what} {times}" for what, times in sorted(total.items()))
    goal = "mutated files of every format: a result, a refusal in words, or the end of the child; no crash, no hang"
    return Reached(goal, text, not misses, tuple(misses))


if __name__ == "__main__":
    _read_all(sys.argv[3:], int(sys.argv[1]), int(sys.argv[2]))
