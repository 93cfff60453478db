"""Which two meshes belong to a level, and what the fine one says where it cannot be followed to the end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid.forms.mesh import level_mesh
from bcid.inference.mesh_error import gain, gains
from bcid.measurement import Action
from bcid.predict.levels import pair
from bcid.predict.mesh_ladder import carried_on
from bcid.scene import Level, Scene


@pytest.mark.parametrize(
    ("name", "size", "working", "fine"),
    [
        ("slab", 0.0072, Level(2, 0.0216), Level(3, 0.0108)),
        ("gallbladder_hidden", 0.006, Level(2, 0.018), Level(3, 0.006)),
        # So few elements cannot be fewer.
        ("finger_hidden", 0.012, Level(2, 0.012), Level(3, 0.012)),
        # With pressures.
        ("bar", 0.006, Level(2, 0.018), Level(2, 0.006)),
    ],
)
def test_the_fine_mesh_has_elements_of_one_degree_more(
    project: Path, name: str, size: float, working: Level, fine: Level
) -> None:
    scene = Scene.read(project / "examples" / "scenes" / f"{name}.toml")
    number = [level.element_size for level in scene.levels].index(pytest.approx(size))
    for found, wanted in zip(pair(scene, number, MPI.COMM_SELF), (working, fine), strict=True):
        assert (found.degree, found.element_size) == (wanted.degree, pytest.approx(wanted.element_size))


def test_a_mesh_file_is_its_own_working_mesh(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "finger_hidden.toml")
    mesh = level_mesh(scene, Level(1, 0.012))
    monkeypatch.setattr("bcid.predict.levels.level_mesh", lambda *_: mesh)
    assert pair(replace(scene, levels=(Level(1),)), 0, MPI.COMM_SELF) == (Level(1), Level(2))
    refined = replace(scene, levels=(Level(1), Level(1, refinements=1)))
    assert pair(refined, 1, MPI.COMM_SELF) == (Level(1), Level(2, refinements=1))
    monkeypatch.setattr("bcid.predict.levels._FINE", 0)
    assert pair(refined, 1, MPI.COMM_SELF) == (Level(1), Level(1, refinements=1))
    assert pair(refined, 0, MPI.COMM_SELF) == (Level(1),)


def test_errors_fall_with_the_degree_of_the_fine_mesh() -> None:
    assert gain(3.0, 2) == pytest.approx(8.0)
    assert gain(2.0, 3) == pytest.approx(7.0)
    assert gain(1.01, 3) == pytest.approx(0.2)


def test_those_of_forces_fall_by_one_order_less() -> None:
    kinds = np.array([0, 1, 2])
    assert np.allclose(gains(2.0, 3, kinds), [[7.0], [3.0], [3.0]])
    assert np.allclose(gains(2.0, 1, kinds), 1.0)


def test_what_is_known_last_stays() -> None:
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    actions = [Action(str(n), 3 * n + np.arange(3), np.arange(3), "I", np.zeros((3, 3)), turns) for n in range(2)]
    apart = np.arange(6.0)[:, None, None] * np.ones((6, 2, 3))
    apart[5, 1] = np.nan
    found = carried_on(apart, actions)
    assert found is not None
    assert found[:, 0, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 4.0]
    assert np.isfinite(found).all()
    apart[4] = np.nan
    assert carried_on(apart, actions) is None
