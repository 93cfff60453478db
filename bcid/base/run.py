"""A run folder: everything a command computed, readable by machines, resumable after a kill, never silently overwritten.

    run.json              command, versions, fingerprints, timings, state ("running", "finished", "failed")
    outcomes/             what was computed so far, one small file per batch: a killed run goes on from here
    identification.json   the result of `bcid identify`
    exploration.json      the result of `bcid explore`;  steps/ its pulls, predictions/ what was predicted
    calibration.json      the result of `bcid calibrate`;  cameras.json the two cameras alone, calibration.png their corners
    diagnosis.json        the result of `bcid compare`, `diagnose`, `fit` and `explain`
    where.json            the force that would explain what the model misses
    model.json            the model with its values and anchors, from which another run can start
    prediction.nc         measured and predicted positions, gripper wrench (SI)
    residuals.nc          measured positions and those of the first and the last model (SI)
    body.nc               mesh, named places, displacement of every frame (SI)
    paraview/             the same for ParaView
    summary.txt           the result in plain sentences
    picture.png           the body, its anchors, measured and predicted trajectories, or what a model misses
    where.png, ladder.png the missing force; the falling error
    belief.png            the belief after each pull
    report.html           what `bcid demo` ends with; `bcid report` writes it for any run
    measurement/          what `bcid track` measured;  tracking.json, tracking.nc, film.mp4, rest.png, tracking.png how

Every file is written whole under another name and then renamed: a reader never sees half of one. What a disk or a hand
changes later is noticed: `run.json` holds checksums of the files and of itself, and the name of a batch ends with its own.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from bcid.base.errors import BcidError, InputError, MachineError, unwritable
from bcid.base.text_file import as_text, parse_json

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "bcid-run/1"
_FILES = (
    "identification.json",
    "diagnosis.json",
    "where.json",
    "model.json",
    "prediction.nc",
    "residuals.nc",
    "body.nc",
    "summary.txt",
    "picture.png",
    "where.png",
    "ladder.png",
    "hidden.json",
    "table.txt",
    "table.csv",
    "study.json",
    "trials.parquet",
    "degradation.png",
    "exploration.json",
    "belief.png",
    "calibration.json",
    "cameras.json",
    "calibration.png",
    "tracking.json",
    "tracking.nc",
    "film.mp4",
    "rest.png",
    "tracking.png",
    "report.html",
)
_FOLDERS = (
    "outcomes",
    "paraview",
    "cases",
    "results",
    "foretold",
    "shared",
    "logs",
    "steps",
    "predictions",
    "measurement",
)
_KEYS = ("command", "state", "inputs", "versions", "attempts", "seconds", "checksum")
_REMEDY = "repeat the run in another folder, or remove this one"
_PACKAGES = ("fenics-dolfinx", "fenics-ufl", "petsc4py", "mpi4py", "numpy", "scipy", "xarray")


class Busy(InputError):
    """Another process writes the run folder."""


class Run:
    """A run folder that this process may write; make one with `Run.start`, look at one with `Run.open`.

    Attributes:
        path: the folder.
        record: the content of `run.json`.
    """

    def __init__(self, path: Path, record: dict[str, Any], lock: TextIO | None = None) -> None:
        self.path = path
        self.record = record
        self._lock = lock
        self._began = time.time()

    @classmethod
    def start(cls, path: str | Path, command: str, inputs: dict[str, Any], overwrite: bool = False) -> Run:
        """Begin a run in a folder, or go on with one that was interrupted. Call it on one rank only.

        Args:
            path: the folder; made when it is not there.
            command: what is run, as "identify".
            inputs: what the result depends on (fingerprints, options); a run is only continued when they are equal.
            overwrite: discard what the folder holds, if it is a run.

        Raises:
            InputError: the folder holds a finished run, a run with other inputs, or something else, or another process
                writes it.
            MachineError: it cannot be written.
        """
        path = Path(path)
        with writing(path):
            if path.exists() and not path.is_dir():
                raise InputError(f"{path}: is a file; give the name of a folder for the run")
            foreign = (
                path.is_dir() and any(path.iterdir()) and not (path / "run.json").exists() and not _only_lock(path)
            )
            if foreign:
                raise InputError(f"{path}: holds files that are not a run; choose a new folder")
            path.mkdir(parents=True, exist_ok=True)
            lock = _locked(path)
            try:
                return cls._begun(path, command, inputs, lock, overwrite)
            except BaseException:
                lock.close()
                raise

    @classmethod
    def _begun(cls, path: Path, command: str, inputs: dict[str, Any], lock: TextIO, overwrite: bool) -> Run:
        if overwrite:
            _empty(path)
        for name in _FOLDERS:
            if (path / name).is_symlink():
                raise InputError(f"{path / name}: is a link, which leads out of the run; remove it")
        if (path / "run.json").exists():
            return cls._continued(path, command, inputs, lock)
        record = {
            "format": FORMAT,
            "command": command,
            "state": "running",
            "inputs": inputs,
            "versions": versions(),
        }
        run = cls(path, record | {"started": _now(), "seconds": 0.0, "attempts": 1}, lock)
        run._save()
        return run

    @classmethod
    def _continued(cls, path: Path, command: str, inputs: dict[str, Any], lock: TextIO) -> Run:
        record = _read_record(path)
        if record["state"] == "finished":
            raise InputError(
                f"{path}: holds a finished run ({record['command']}); choose another folder, or add --overwrite"
            )
        if record["command"] != command or json.loads(json.dumps(inputs)) != record["inputs"]:
            raise InputError(
                f"{path}: holds an unfinished run of '{record['command']}' with other inputs or options; "
                "choose another folder, or add --overwrite"
            )
        if record["versions"] != versions():
            raise InputError(
                f"{path}: was begun with other versions of bcid or DOLFINx; choose another folder, or add --overwrite"
            )
        record |= {"state": "running", "attempts": record["attempts"] + 1}
        run = cls(path, record, lock)
        run._save()
        return run

    @classmethod
    def open(cls, path: str | Path) -> Run:
        """Look at a run; `InputError` when the folder is not one."""
        path = Path(path)
        if not (path / "run.json").is_file():
            raise InputError(f"{path}: is not a run folder (it has no run.json)")
        return cls(path, _read_record(path))

    @property
    def resumed(self) -> bool:
        """Whether an interrupted run is being continued."""
        return int(self.record["attempts"]) > 1

    def finish(self, result: dict[str, Any]) -> None:
        """Note the result in `run.json` and close the run."""
        self._close("finished", result=result)

    def fail(self, reason: str) -> None:
        """Note why the run ended early; it can be continued."""
        self._close("failed", reason=reason)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Note the reason when what is done inside ends early, by whatever."""
        try:
            yield
        except BaseException as error:
            # Where the disk is what failed, the record cannot be written either.
            with suppress(MachineError):
                self.fail(str(error) if isinstance(error, BcidError) else type(error).__name__)
            raise

    def _close(self, state: str, **more: Any) -> None:
        self.record |= {"state": state, "ended": _now(), **more}
        self.record["seconds"] = round(self.record["seconds"] + time.time() - self._began, 3)
        try:
            self._save()
        finally:
            self.release()

    def release(self) -> None:
        """Let others write the folder."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _save(self) -> None:
        write_whole(self.path / "run.json", _json(sealed(self.record)))

    def write_text(self, name: str, text: str) -> Path:
        """Write a file whole; returns its path."""
        self._note(name, text.encode())
        return write_whole(self.path / name, text)

    def _note(self, name: str, content: bytes) -> None:
        """Keep the checksum of a file; `run.json` gets it when the run ends, before which nobody reads its results."""
        self.record["files"] = {**self.record.get("files", {}), name: _checksum(content)}

    def _bytes(self, name: str) -> bytes:
        """Content of a file, as it was written; `InputError` when it is missing or damaged."""
        try:
            content = (self.path / name).read_bytes()
        except FileNotFoundError:
            raise InputError(f"{self.path / name}: is missing from the run") from None
        except OSError as error:
            raise InputError(f"{self.path / name}: cannot be read: {error.strerror or error}") from None
        if self.record.get("files", {}).get(name, _checksum(content)) != _checksum(content):
            raise InputError(f"{self.path / name}: is damaged: it is not what the run wrote; repeat the run")
        return content

    def write_json(self, name: str, content: Any) -> Path:
        """Write a JSON file; numbers that are not finite are refused, for they are not JSON."""
        return self.write_text(name, _json(content))

    def read_json(self, name: str) -> Any:
        """Content of a JSON file; `InputError` when it is missing or damaged."""
        return _parsed(self._bytes(name), self.path / name)

    def write_dataset(self, name: str, data: xr.Dataset) -> Path:
        """Write arrays as NetCDF."""
        target = self.path / name
        with writing(self.path):
            partial = target.with_name(f".{target.name}.partial")
            data.to_netcdf(partial, engine="scipy")
            self._note(name, partial.read_bytes())
            partial.replace(target)
        return target

    def read_dataset(self, name: str) -> xr.Dataset:
        """Arrays of a NetCDF file, loaded; `InputError` when it is missing or damaged."""
        import xarray as xr

        target = self.path / name
        content = self._bytes(name)
        try:
            with xr.open_dataset(BytesIO(content), engine="scipy") as opened:
                data = opened.load()
        except Exception as error:
            raise InputError(f"{target}: is damaged and cannot be read: {error}") from None
        texts = [str(variable) for variable in data.variables if data[variable].dtype.kind in "OS"]
        return data.assign_coords({v: data[v].astype(str) for v in texts if v in data.coords}).assign(
            {v: data[v].astype(str) for v in texts if v not in data.coords}
        )

    def add_batch(self, batch: list[dict[str, Any]]) -> None:
        """Keep a batch of results, so that a killed run need not compute them again."""
        numbers = [int(file.name[:6]) for file in self._batch_files()]
        text = _json(batch)
        write_whole(self.path / f"outcomes/{max(numbers, default=-1) + 1:06d}-{_checksum(text.encode())}.json", text)

    def batches(self, dropped: Callable[[str], None] = lambda _: None) -> Iterator[list[dict[str, Any]]]:
        """What `add_batch` kept, in order; one that is damaged is removed, and `dropped` is told so in words."""
        for file in self._batch_files():
            content = file.read_bytes()
            if file.name[7:] == f"{_checksum(content)}.json":
                yield _parsed(content, file)
            else:
                file.unlink()
                dropped(f"{file}: is damaged; what it held is computed again")

    def _batch_files(self) -> list[Path]:
        return sorted((self.path / "outcomes").glob("[0-9]" * 6 + "-*.json"))


def write_whole(target: Path, content: str | bytes) -> Path:
    """Write a file whole under another name, then rename it; returns its path."""
    with writing(target.parent):
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f".{target.name}.partial")
        with partial.open("wb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(target)
    return target


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns a failure to write into a `MachineError` that names the folder and the reason."""
    try:
        yield
    except OSError as error:
        raise unwritable(path, error) from None


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    from bcid import __version__

    found = {"bcid": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def _locked(path: Path) -> TextIO:
    """An exclusive lock, which the kernel drops when this process dies."""
    lock = (path / ".lock").open("a+", encoding="utf-8")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        holder = lock.read().strip() or "another process"
        lock.close()
        raise Busy(f"{path}: is being written by {holder}; wait for it, or choose another folder") from None
    try:
        lock.truncate(0)
        lock.write(f"process {os.getpid()} on {socket.gethostname()} since {_now()}\n")
        lock.flush()
    except OSError:
        # What could not be written stays in the stream, which would try again when it is closed.
        with suppress(OSError):
            lock.close()
        raise
    return lock


def _only_lock(path: Path) -> bool:
    """Whether a run was begun there, and got no further than its lock."""
    return all(entry.name in (".lock", ".run.json.partial") for entry in path.iterdir())


def _empty(path: Path) -> None:
    """Remove what a run left in its folder, and nothing else; `run.json` last, so that it stays a run until the end."""
    if not (path / "run.json").exists():
        return
    _read_record(path)
    for name in (*_FILES, *(entry.name for entry in path.glob(".*.partial*"))):
        (path / name).unlink(missing_ok=True)
    for name in _FOLDERS:
        if (path / name).is_symlink():
            (path / name).unlink()
        shutil.rmtree(path / name, ignore_errors=True)
    (path / "run.json").unlink()


def _read_record(path: Path) -> dict[str, Any]:
    file = path / "run.json"
    try:
        record = _parsed(file.read_bytes(), file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise InputError(f"{file}: is not a run of this version (expected format '{FORMAT}')")
    missing = [key for key in _KEYS if key not in record]
    if missing:
        raise InputError(f"{file}: is damaged: {', '.join(missing)} missing; {_REMEDY}")
    if sealed(record) != record:
        raise InputError(f"{file}: is damaged: its checksum is another; {_REMEDY}")
    return record


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """The content of a run.json, or of another file that stands for itself, with the checksum of all else in it."""
    rest = {key: value for key, value in record.items() if key != "checksum"}
    return rest | {"checksum": _checksum(json.dumps(rest, sort_keys=True).encode())}


def unsealed(file: Path, remedy: str) -> dict[str, Any]:
    """What a file holds that was `sealed`.

    Args:
        file: the JSON file.
        remedy: what is to be done when it is damaged.

    Raises:
        InputError: it is missing or damaged.
    """
    try:
        content: dict[str, Any] = parse_json(as_text(file.read_bytes(), file), file)
        if sealed(content)["checksum"] != content["checksum"]:
            raise ValueError("its checksum is another")
    except (OSError, ValueError, KeyError, TypeError, AttributeError, InputError) as error:
        raise InputError(f"{file}: is missing or damaged ({error}); {remedy}") from None
    return content


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _json(content: Any) -> str:
    return json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _parsed(content: bytes, path: Path) -> Any:
    try:
        return parse_json(as_text(content, path), path)
    except InputError as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise InputError(f"{path}: is damaged and cannot be read: {reason}; {_REMEDY}") from None


def _now() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
