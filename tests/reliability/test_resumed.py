"""An explanation that is killed goes on, reduced; row F8 of docs/reliability.md has the full size."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bcid.base.errors import MachineError
from bcid.predict import store
from bcid.predict.kept_predictions import MeasurementPrediction, PredictionKey
from bcid.predict.predictor import Predictor
from validation.reliability import disk, resumed

# Of the steps of the explanation, so many are there when it is killed.
EARLY, LATE = 5, 75


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return resumed.prepared(tmp_path_factory.mktemp("explained"))


@pytest.fixture(autouse=True, scope="module")
def followed() -> Iterator[list[str]]:
    """The models that predictors have followed in this process."""
    found, follow = list[str](), Predictor._followed

    def noted(self: Predictor, key: PredictionKey, *rest: Any) -> MeasurementPrediction:
        found.append(key.model.name)
        return follow(self, key, *rest)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Predictor, "_followed", noted)
        yield found


@pytest.fixture(scope="module")
def right(words: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing has stopped."""
    output = tmp_path_factory.mktemp("right") / "run"
    code, said = disk.command(*words, output)
    assert code == 0, said
    assert resumed.steps(output)["recalled"] == 0
    assert not (output / "checkpoint").exists()
    return output


def goes_on(words: list[str], output: Path, right: Path, known: int) -> str:
    """Run a command that was killed once more, to the same end; what it says on the way."""
    kept = len(list((output / "checkpoint").iterdir()))
    assert kept == known
    code, said = disk.command(*words, output)
    assert code == 0, said
    assert resumed.same(resumed.answer(output), resumed.answer(right))
    assert not (output / "checkpoint").exists()
    return said


def test_killed_early_and_late_it_goes_on(words: list[str], right: Path, tmp_path: Path, followed: list[str]) -> None:
    output, whole = tmp_path / "run", resumed.steps(right)["computed"]
    resumed.killed(words, output, EARLY)
    resumed.killed(words, output, LATE)
    other = tmp_path / "damaged"
    shutil.copytree(output, other)
    alone = len(followed)
    said = goes_on(words, output, right, EARLY + LATE)
    assert len(followed) - alone < alone / 2
    assert f"{EARLY + LATE} predictions and sensitivities are there already" in said
    assert resumed.steps(output) == {"computed": whole - EARLY - LATE, "recalled": EARLY + LATE}
    # What a disk has damaged is computed again.
    kept = sorted((other / "checkpoint").iterdir())[7]
    *most, last = kept.read_bytes()
    kept.write_bytes(bytes([*most, last ^ 1]))
    goes_on(words, other, right, EARLY + LATE)
    assert resumed.steps(other) == {"computed": whole - EARLY - LATE + 1, "recalled": EARLY + LATE - 1}


def test_what_two_ranks_have_computed_serves_one(words: list[str], right: Path, tmp_path: Path) -> None:
    resumed.killed(words, tmp_path / "run", EARLY, ranks=2)
    goes_on(words, tmp_path / "run", right, EARLY)
    assert resumed.steps(tmp_path / "run")["recalled"] == EARLY


def test_shared_store_predictions_of_another_run_same_answer(words: list[str], right: Path, tmp_path: Path) -> None:
    shared, output = tmp_path / "store", tmp_path / "run"
    resumed.killed(words, tmp_path / "killed", LATE)
    shutil.copytree(tmp_path / "killed" / "checkpoint", shared)
    code, said = disk.command(*words, output, "--store", shared)
    assert code == 0, said
    assert resumed.steps(output) == {"computed": resumed.steps(right)["computed"] - LATE, "recalled": LATE}
    assert resumed.same(resumed.answer(output), resumed.answer(right))
    assert len(list(shared.iterdir())) == resumed.steps(right)["computed"]


def test_shared_store_a_file_is_refused(words: list[str], tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    code, said = disk.command(*words, tmp_path / "run", "--store", file)
    assert (code, file.read_bytes()) == (2, b"")
    assert f"--store {file}: is a file; name a folder" in said
    assert not (tmp_path / "run").exists()


def test_a_full_disk_costs_no_answer(
    words: list[str], right: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, written = store.write_whole, list[Path]()

    def full(target: Path, content: bytes) -> Path:
        written.append(target)
        if len(written) > EARLY:
            raise MachineError(f"{target.parent}: cannot be written: No space left on device")
        return whole(target, content)

    monkeypatch.setattr(store, "write_whole", full)
    code, said = disk.command(*words, tmp_path / "run")
    assert code == 0, said
    assert said.count("No space left on device; the run goes on, but killed it would begin anew") == 1
    assert len(written) == EARLY + 1
    assert resumed.same(resumed.answer(tmp_path / "run"), resumed.answer(right))
