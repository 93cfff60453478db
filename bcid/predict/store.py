"""What expensive predictions gave, kept on disk: a run that was killed finds it there, and so do other runs that share a folder.

The loops that ask are deterministic. Started again they ask the same questions in the same order, and are given the answers that
are known already, to the last bit. A file is named after all that its answer depends on, and after how often a run asked for it
before, since a trajectory starts from the states of those before it. What weighs predictions is no part of its name.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError, MachineError
from bcid.base.fingerprint import fingerprint
from bcid.base.inside_folder import read_inside
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import versions, write_whole, writing

T = TypeVar("T")
Arrays = dict[str, Any]
# The folder of a run folder that they are in, unless the user names another.
CHECKPOINT = "checkpoint"
# Packages of bcid whose code makes predictions: what other code of them computed is another result.
_MAKERS = ("base", "scene", "measurement", "forms", "predict")
# Bytes at most: what comes after is computed again.
_MOST = 4e9
_CHECK, _LENGTH = 32, 8
# Kinds of numpy's types: booleans, integers, floating-point numbers.
_KINDS = "biuf"


class ResultFormat(Protocol[T]):
    """How a result is kept as arrays of numbers."""

    def arrays(self, result: T) -> tuple[Arrays, Any]:
        """Arrays by name and notes, whole on rank 0; collective."""
        ...

    def result(self, arrays: Arrays, notes: Any) -> T:
        """What this rank has of the result; `KeyError`, `ValueError` or `TypeError` where that cannot be."""
        ...


class PredictionStore:
    """Results in a folder; collective on `comm`.

    Args:
        folder: where they are, as rank 0 names it; made when the first is kept.
        comm: ranks that compute the results together. Another number of them may go on.
        inputs: what all results depend on besides what they are asked for with; the code that predicts counts in any case.
        progress: shows what is found, and when nothing more can be kept.
        shared: whether other runs use the folder too: results of other inputs are left there, and so are those of this run.

    Attributes:
        recalled, computed: how many results were known, and were not.
    """

    def __init__(
        self, folder: Path, comm: Comm, inputs: Any = None, progress: Progress | None = None, shared: bool = False
    ) -> None:
        self.folder, self.comm, self.progress, self.shared = folder, comm, progress or Silent(), shared
        self.recalled = self.computed = 0
        self._asked: Counter[str] = Counter()
        self._full = False
        self._identity = fingerprint({"inputs": inputs, "code": _code()})
        self._size = on_root(comm, self._begun)

    @classmethod
    def of_run(
        cls, run: Path, comm: Comm, inputs: Any, progress: Progress | None = None, shared: Path | None = None
    ) -> PredictionStore:
        """That of a run folder while the run lasts, or the one that it shares with others."""
        return cls(shared or run / CHECKPOINT, comm, inputs, progress, shared is not None)

    def _begun(self) -> int:
        """Remove what does not belong here, and say what is there; its bytes."""
        files = [file for file in self.folder.glob("*") if file.is_symlink() or not file.is_dir()]
        own = [file for file in files if file.name.startswith(f"{self._identity}-")]
        others = [file for file in files if file not in own]
        if self.shared:
            return sum(file.lstat().st_size for file in files)
        with writing(self.folder):
            for file in others:
                file.unlink()
            size = sum(file.lstat().st_size for file in own)
        if any(not file.name.endswith(".partial") for file in others):
            self.progress.say("begun anew: what an interrupted run left was computed by other code, or of other inputs")
        if own:
            what = f"{len(own)} predictions and sensitivities are there already"
            self.progress.say(f"going on with an interrupted run: {what}")
        return size

    def result(self, question: Callable[[], str], form: ResultFormat[T], work: Callable[[], T]) -> T:
        """What `work` gives, or has given before; collective.

        Args:
            question: tells all that the result depends on besides the inputs; called on rank 0.
            form: how the result is kept.
            work: computes it; collective.
        """
        file, held = on_root(self.comm, lambda: self._held(question()))
        found = _read(held, form)
        if found is not None:
            self.recalled += 1
            return found
        found = work()
        self._computed([(file, found)], form)
        return found

    def results(
        self,
        questions: Sequence[str],
        form: ResultFormat[T],
        work: Callable[[Sequence[int]], list[T]],
        enough: Callable[[T], bool] = lambda _: True,
    ) -> list[T]:
        """What `work` gives of many questions, or has given before; collective.

        Args:
            questions: each tells all that its result depends on besides the inputs; nothing that was asked before is part of it.
            form: how a result is kept.
            work: computes results in order from the numbers of their questions; collective.
            enough: whether a result that is kept is all that is asked for.
        """
        held = on_root(self.comm, lambda: [self._content(self._file(question, 0)) for question in questions])
        found = [_read(content, form) for content in held]
        missing = [k for k, known in enumerate(found) if known is None or not enough(known)]
        self.recalled += len(questions) - len(missing)
        fresh = work(missing) if missing else []
        self._computed([(self._file(questions[k], 0), result) for k, result in zip(missing, fresh, strict=True)], form)
        whole = {k: known for k, known in enumerate(found) if known is not None} | dict(
            zip(missing, fresh, strict=True)
        )
        return [whole[k] for k in range(len(questions))]

    def _held(self, question: str) -> tuple[Path, bytes | None]:
        """The file of a question that is asked now, and what is kept there."""
        file = self._file(question, self._asked[question])
        self._asked[question] += 1
        return file, self._content(file)

    def _file(self, question: str, asked: int) -> Path:
        """Where the result of a question is kept that was asked so often before."""
        key = hashlib.sha256(question.encode()).hexdigest()[:32]
        return self.folder / f"{self._identity}-{key}-{asked}"

    def _content(self, file: Path) -> bytes | None:
        try:
            return read_inside(self.folder, file.name, int(_MOST))
        except InputError:
            return None

    def _computed(self, fresh: Sequence[tuple[Path, T]], form: ResultFormat[T]) -> None:
        """Keep results that were not known; collective."""
        self.computed += len(fresh)
        for file, result in fresh:
            arrays, notes = form.arrays(result)
            on_root(self.comm, partial(self._keep, file, arrays, notes))

    def _keep(self, file: Path, arrays: Arrays, notes: Any) -> None:
        """Keep a result, unless there is no place for it: then the answer is made without."""
        if self._full:
            return
        content = packed(arrays, notes)
        if self._size + len(content) > _MOST:
            self._full = True
            self.progress.say(f"{self.folder} is full: killed from now on, the run would go on from here")
            return
        try:
            write_whole(file, content)
        except MachineError as error:
            self._full = True
            self.progress.say(f"{error}; the run goes on, but killed it would begin anew")
            if not self.shared:
                self._removed()
            return
        self._size += len(content)

    def clear(self) -> None:
        """Remove everything, unless others share it: the run is complete; collective."""
        if not self.shared:
            on_root(self.comm, self._removed)

    def _removed(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)


def _read(content: bytes | None, form: ResultFormat[T]) -> T | None:
    """A result from what is kept of it; None where that is nothing, or damaged."""
    if content is None:
        return None
    with suppress(KeyError, ValueError, TypeError, IndexError, AttributeError):
        return form.result(*unpacked(content))
    return None


def _code() -> str:
    """Fingerprint of the code that makes predictions, and of the versions of what solves."""
    digest = hashlib.sha256(str(versions()).encode())
    package = Path(__file__).resolve().parents[1]
    for file in sorted(file for name in _MAKERS for file in (package / name).rglob("*.py")):
        digest.update(str(file.relative_to(package)).encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def packed(arrays: Mapping[str, NDArray[Any]], notes: Any = None) -> bytes:
    """Arrays by name, and notes that JSON can hold, as bytes that begin with their checksum."""
    told = {name: [array.dtype.str, array.shape] for name, array in arrays.items()}
    head = json.dumps({"arrays": told, "notes": notes}).encode()
    content = [len(head).to_bytes(_LENGTH, "little"), head, *(array.tobytes() for array in arrays.values())]
    digest = hashlib.sha256()
    for part in content:
        digest.update(part)
    return b"".join([digest.digest(), *content])


def unpacked(content: bytes) -> tuple[dict[str, NDArray[Any]], Any]:
    """What was packed: arrays by name, which may be written to, and notes.

    Raises:
        ValueError: the bytes are damaged, or others.
    """
    view = memoryview(content)
    if hashlib.sha256(view[_CHECK:]).digest() != content[:_CHECK]:
        raise ValueError("the checksum is another")
    start = _CHECK + _LENGTH
    end = start + int.from_bytes(content[_CHECK:start], "little")
    try:
        head, arrays = json.loads(content[start:end]), {}
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    for name, (code, shape) in head["arrays"].items():
        kind = np.dtype(code)
        if kind.kind not in _KINDS:
            raise ValueError(f"{name} is no array of numbers")
        count = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(view, kind, count, end).reshape(shape).copy()
        end += arrays[name].nbytes
    return arrays, head["notes"]
