"""A run folder: everything a command computed, readable by machines, resumable after a kill, never silently overwritten.

    run.json      command, versions, fingerprints, timings, state ("running", "finished", "failed"), what the command makes

What else it holds is the business of the command, which names it when the run begins: --overwrite removes that and no more.

Every file is written whole under another name and then renamed: a reader never sees half of one. What a disk or a hand
changes later is noticed: `run.json` holds checksums of the files and of itself.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import shutil
import socket
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from importlib import metadata
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, TextIO

from bcid.base.body_arrays import refuse_unsound
from bcid.base.collective import Comm, on_root
from bcid.base.errors import BcidError, InputError, MachineError, unwritable
from bcid.base.inside_folder import read_inside
from bcid.base.text_file import as_text, parse_json
from bcid.base.units import with_units
from bcid.base.version import VERSION
from bcid.base.visible import visible

if TYPE_CHECKING:
    import xarray as xr

FORMAT, _FIRST_FORMAT = "bcid-run/2", "bcid-run/1"
# A name of what a command makes: a file, or with a slash at its end a folder.
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/?", re.ASCII)
_KEYS = ("command", "state", "inputs", "versions", "attempts", "seconds", "checksum")
_REMEDY = "repeat the run in another folder, or remove this one"
_PACKAGES = ("fenics-dolfinx", "fenics-ufl", "petsc4py", "mpi4py", "numpy", "scipy", "xarray")


class Busy(InputError):
    """Another process writes the run folder."""


class RunFolder:
    """A run folder that this process may write; make one with `RunFolder.start`, look at one with `RunFolder.open`.

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
    def start(
        cls,
        path: str | Path,
        command: str,
        inputs: dict[str, Any],
        overwrite: bool = False,
        makes: Iterable[str] = (),
    ) -> RunFolder:
        """Begin a run in a folder, or go on with one that was interrupted. Call it on one rank only.

        Args:
            path: the folder; made when it is not there.
            command: what is run, as "identify".
            inputs: what the result depends on (fingerprints, options); a run is only continued when they are equal.
            overwrite: discard what a run has left in the folder.
            makes: names of the files that the command makes there, and of its folders with a slash at their end.

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
                return cls._begun(path, command, inputs, lock, overwrite, list(makes))
            except BaseException:
                lock.close()
                raise

    @classmethod
    def _begun(
        cls, path: Path, command: str, inputs: dict[str, Any], lock: TextIO, overwrite: bool, makes: list[str]
    ) -> RunFolder:
        if overwrite:
            _empty(path)
        for name in makes:
            if name.endswith("/") and (path / name.rstrip("/")).is_symlink():
                raise InputError(f"{path / name.rstrip('/')}: is a link, which leads out of the run; remove it")
        if (path / "run.json").exists():
            return cls._continued(path, command, inputs, lock)
        record = {
            "format": FORMAT,
            "command": command,
            "state": "running",
            "inputs": inputs,
            "makes": makes,
            "versions": versions(),
        }
        run = cls(path, record | {"started": _now(), "seconds": 0.0, "attempts": 1}, lock)
        run._save()
        return run

    @classmethod
    def _continued(cls, path: Path, command: str, inputs: dict[str, Any], lock: TextIO) -> RunFolder:
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
        record |= {"format": FORMAT, "state": "running", "attempts": record["attempts"] + 1}
        run = cls(path, record, lock)
        run._save()
        return run

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """Look at a run; `InputError` when the folder is not one."""
        path = Path(path)
        if not os.path.lexists(path / "run.json"):
            raise InputError(f"{path}: is not a run folder (it has no run.json)")
        return cls(path, _read_record(path))

    def holds(self, name: str) -> bool:
        """Whether the run wrote a file of this name; what else lies in the folder is not the run's."""
        return name in self.record.get("files", {})

    def check(self) -> None:
        """Refuse a run of which a file is missing or damaged, as `InputError`."""
        for name in self.record.get("files", {}):
            self.read_bytes(name)

    @classmethod
    def finished(cls, path: str | Path) -> RunFolder:
        """Look at a run that has ended well; `InputError` when the folder is none, or the run has not."""
        run = cls.open(path)
        state = run.record["state"]
        if state != "finished":
            how = f"failed ({run.record.get('reason', 'no reason is known')})" if state == "failed" else "has not ended"
            raise InputError(
                f"{path}: the run {how}; give its command ({run.record['command']}) again to go on with it, "
                "or with --overwrite to begin anew"
            )
        return run

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
        """Write a file whole; returns its path. What is read on a terminal shows no control characters of others."""
        text = visible(text) if name.endswith(".txt") else text
        return self.write_bytes(name, text.encode())

    def write_bytes(self, name: str, content: bytes) -> Path:
        """Write a file whole; returns its path."""
        self._note(name, content)
        return write_whole(self.path / name, content)

    def _note(self, name: str, content: bytes) -> None:
        """Keep the checksum of a file; `run.json` gets it when the run ends, before which nobody reads its results."""
        self.record["files"] = {**self.record.get("files", {}), name: _checksum(content)}

    def read_bytes(self, name: str) -> bytes:
        """Content of a file, as it was written; `InputError` when it is missing or damaged."""
        if not self.holds(name):
            raise InputError(f"{self.path / name}: is missing: run.json does not list it; {_REMEDY}")
        content = _read(self.path, name)
        if self.record["files"][name] != _checksum(content):
            raise InputError(f"{self.path / name}: is damaged: it is not what the run wrote; repeat the run")
        return content

    def write_json(self, name: str, content: Any) -> Path:
        """Write a JSON file; numbers that are not finite are refused, for they are not JSON."""
        return self.write_text(name, _json(content))

    def read_json(self, name: str) -> Any:
        """Content of a JSON file; `InputError` when it is missing or damaged."""
        return _parsed(self.read_bytes(name), self.path / name)

    def write_dataset(self, name: str, data: xr.Dataset) -> Path:
        """Write arrays as NetCDF, each with its unit."""
        target = self.path / name
        with writing(self.path):
            partial = target.with_name(f".{target.name}.partial")
            with_units(data).to_netcdf(partial, engine="scipy")
            self._note(name, partial.read_bytes())
            partial.replace(target)
        return target

    def read_dataset(self, name: str) -> xr.Dataset:
        """Arrays of a NetCDF file, loaded; `InputError` when it is missing or damaged."""
        import xarray as xr

        target = self.path / name
        content = self.read_bytes(name)
        try:
            with xr.open_dataset(BytesIO(content), engine="scipy") as opened:
                data = opened.load()
        except Exception as error:
            raise InputError(f"{target}: is damaged and cannot be read: {error}") from None
        refuse_unsound(data, target)
        texts = [str(variable) for variable in data.variables if data[variable].dtype.kind in "OS"]
        return data.assign_coords({v: data[v].astype(str) for v in texts if v in data.coords}).assign(
            {v: data[v].astype(str) for v in texts if v not in data.coords}
        )

    def write_documents(self, documents: Mapping[str, Any]) -> None:
        """Write JSON objects, datasets and texts, each under its name, whose ending says which it is."""
        for name, content in documents.items():
            if name.endswith(".json"):
                self.write_json(name, content)
            elif name.endswith(".nc"):
                self.write_dataset(name, content)
            else:
                self.write_text(name, content)

    @property
    def first_format(self) -> bool:
        """Whether its JSON files have the keys of format/1."""
        return bool(self.record["format"] == _FIRST_FORMAT)

    def read_documents(self, but: Collection[str] = ()) -> dict[str, Any]:
        """What the run wrote into its folder itself, by file name, as for `write_documents`; `InputError` when damaged.

        `but` names files that are not read.
        """
        read: dict[str, Callable[[str], Any]] = {
            ".json": self.read_json,
            ".nc": self.read_dataset,
            ".txt": self.read_text,
        }
        names = [
            name
            for name in self.record.get("files", {})
            if "/" not in name and Path(name).suffix in read and name not in but
        ]
        return {name: read[Path(name).suffix](name) for name in names}

    def read_text(self, name: str) -> str:
        """Content of a text file; `InputError` when it is missing or damaged."""
        return as_text(self.read_bytes(name), self.path / name)


@contextmanager
def running(
    comm: Comm | None,
    path: str | Path,
    command: str,
    inputs: dict[str, Any],
    makes: Iterable[str],
    overwrite: bool = False,
) -> Iterator[RunFolder | None]:
    """Begin a run, or go on with one, and note the reason should it end early; collective on `comm`.

    Arguments as for `RunFolder.start`. Gives the run on rank 0, and None on the others.

    Raises:
        BcidError: as `RunFolder.start`, on all ranks.
    """
    started: list[RunFolder] = []
    on_root(comm, lambda: started.append(RunFolder.start(path, command, inputs, overwrite, makes)))
    with started[0].watched() if started else nullcontext():
        yield started[0] if started else None


def write_whole(target: Path, content: str | bytes) -> Path:
    """Write a file whole under another name, then rename it; returns its path."""
    encoded = content.encode() if isinstance(content, str) else content
    with writing(target.parent):
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f".{target.name}.partial")
        try:
            with partial.open("wb") as stream:
                stream.write(encoded)
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(target)
        except OSError:
            # On a read-only file system there is none, and removing it fails as well.
            with suppress(OSError):
                partial.unlink()
            raise
    return target


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns a failure to write into a `MachineError` that names the folder and the reason."""
    try:
        yield
    except OSError as error:
        raise unwritable(path, error) from None


def prove_writable(folder: Path) -> None:
    """Make a folder, and refuse one that nothing can be written to, before the work is done; `MachineError`."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {"bcid": VERSION, "python": platform.python_version()}
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


def _removed(path: Path) -> None:
    """Remove a file, a link or a folder."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _only_lock(path: Path) -> bool:
    """Whether a run was begun there, and got no further than its lock."""
    return all(entry.name in (".lock", ".run.json.partial") for entry in path.iterdir())


def _empty(path: Path) -> None:
    """Remove what a run left in its folder, and nothing else; `run.json` last, so that it stays a run until the end."""
    if not (path / "run.json").exists():
        return
    record = _read_record(path)
    made = [name for name in (*record.get("makes", ()), *record.get("files", {})) if _NAME.fullmatch(str(name))]
    for name in (*made, *(entry.name for entry in path.glob(".*.partial*"))):
        target = path / name.rstrip("/")
        if name.endswith("/") and not target.is_symlink():
            shutil.rmtree(target, ignore_errors=True)
        elif target.is_symlink() or not target.is_dir():
            target.unlink(missing_ok=True)
    (path / "run.json").unlink()


def _read_record(path: Path) -> dict[str, Any]:
    file = path / "run.json"
    record = _parsed(_read(path, file.name), file)
    if not isinstance(record, dict) or record.get("format") not in (FORMAT, _FIRST_FORMAT):
        raise InputError(f"{file}: is not a run of this version (expected format '{FORMAT}')")
    missing = [key for key in _KEYS if key not in record]
    if missing:
        raise InputError(f"{file}: is damaged: {', '.join(missing)} missing; {_REMEDY}")
    if sealed(record) != record:
        raise InputError(f"{file}: is damaged: its checksum is another; {_REMEDY}")
    if not _as_written(record):
        raise InputError(f"{file}: is damaged: what a run writes there has another form; {_REMEDY}")
    return record


def _as_written(record: dict[str, Any]) -> bool:
    """Whether the entries that all commands use are of the kinds that a run writes."""
    kinds: dict[str, Any] = {"command": str, "state": str, "inputs": dict, "versions": dict, "attempts": int}
    kinds |= {"seconds": int | float, "files": dict, "names": dict, "makes": list}
    tables = [record.get("files", {}), record.get("names", {})]
    return all(isinstance(record[key], kind) for key, kind in kinds.items() if key in record) and all(
        isinstance(value, str) for table in tables for value in table.values()
    )


def _read(folder: Path, name: str) -> bytes:
    """Content of a file of a run."""
    try:
        return read_inside(folder, name)
    except InputError as error:
        raise InputError(f"{error}; {_REMEDY}") from None


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
        content: dict[str, Any] = parse_json(as_text(read_inside(file.parent, file.name), file), file)
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
