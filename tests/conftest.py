"""What tests of every kind share: where data are, and the slab that seven other codes computed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from numpy.typing import NDArray

if TYPE_CHECKING:
    from bcid.forms.solver.equilibrium import Equilibrium

PROJECT = Path(__file__).resolve().parents[1]
Array = NDArray[np.float64]
# How fast a machine is fails no test.
settings.register_profile("any-machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any-machine")


@pytest.fixture(scope="session")
def project() -> Path:
    """Root folder of the project."""
    return PROJECT


@pytest.fixture(scope="session")
def measurement_folder() -> Callable[[str], Path]:
    """Finds a measurement by name: among the examples, else in the optional data folder, else the test is skipped."""

    def find(name: str) -> Path:
        for folder in (PROJECT / "examples" / "measurements", PROJECT.parent / "shared" / "data" / "lab"):
            if (folder / name).is_dir():
                return folder / name
        pytest.skip(f"measurement {name} is neither among the examples nor in the optional data folder")

    return find


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """Finds a folder of published measurements in the optional data folder, else the test is skipped."""

    def find(name: str) -> Path:
        folder = PROJECT.parent / "shared" / "data" / "real" / name
        if not folder.is_dir():
            pytest.skip(f"the published measurements {name} are not in the optional data folder")
        return folder

    return find


@dataclass(frozen=True)
class Slab40:
    """The benchmark of tests/data/README.md on one mesh, with the field the other codes agree on.

    Attributes:
        points: nodes of the reference, m.
        field: their final displacement, m.
        probe: the node whose deflection is quoted for the compression.
    """

    equilibrium: Equilibrium
    points: Array
    field: Array
    probe: int

    def displacement(self) -> Array:
        """Displacement of the present state in the order of the reference's nodes, m; collective."""
        from scipy.spatial import cKDTree

        body = self.equilibrium.body
        owned = body.displacement_space.dofmap.index_map.size_local
        nodes, values = body.nodes[:owned], self.equilibrium.displacement()[:owned]
        where = np.vstack(body.comm.allgather(nodes))
        distance, order = cKDTree(where).query(self.points)
        assert distance.max() < 1e-12
        return np.asarray(np.vstack(body.comm.allgather(values))[order])


@pytest.fixture(scope="session")
def slab40() -> Callable[..., Slab40]:
    """Builds the benchmark: `slab40("small")`, `slab40("medium", rtol=1e-10)`, `slab40("large")`."""

    def build(name: str, comm: Any = None, rtol: float = 1e-9) -> Slab40:
        from mpi4py import MPI

        from bcid.forms.mesh import BodyMesh
        from bcid.forms.mesh.body import Body
        from bcid.forms.model import Anchors, Held, Model
        from bcid.forms.solver.equilibrium import Equilibrium, Settings
        from bcid.scene import Grasp, Level, Material, Region, Scene

        data = _slab40_arrays(name)
        points = data["points"] * 1e-3
        groups = {part: data[part].astype(np.int64)[:, None] for part in ("fixed", "patch")}
        scene = Scene(
            name=f"slab40-{name}",
            geometry=Path(f"{name}.npz"),
            length_unit=1e-3,
            levels=(Level(1),),
            material=Material("neo_hooke", {"young": "15 kPa", "poisson": 0.35}),
            patches={"fixed": Region(("fixed",))},
            grasps={"patch": Grasp(Region(("patch",)), (0.09, 0.05, 0.005))},
            fiducials={},
        )
        body = Body(comm or MPI.COMM_SELF, BodyMesh(points, data["cells"].astype(np.int64), groups))
        model = Model.of(scene) + Anchors({"fixed"}) + Held("patch")
        equilibrium = Equilibrium(body, model, scene, Settings(rtol=rtol))
        return Slab40(equilibrium, points, data["field"] * 1e-3, int(data["probe"]))

    return build


def _slab40_arrays(name: str) -> dict[str, NDArray[Any]]:
    with np.load(PROJECT / "tests" / "data" / f"slab40-{name}.npz", allow_pickle=False) as data:
        return dict(data)


_EXPLORE = """
[explore]
displacement = "8 mm"
amplitudes = ["8 mm"]
directions = { out = [1, 0, 0], lift = [0, 1, 0] }
"""


def _slab(folder: Path, project: Path, size: str) -> Path:
    text = (project / "examples/scenes/slab.toml").read_text(encoding="utf-8")
    text = text.replace("../../meshes/geo/slab.geo", str(project / "meshes/geo/slab.geo"))
    first, _, rest = text.partition("[material]")
    text = first.split("[[levels]]")[0] + f'[[levels]]\nelement_size = "{size}"\ndegree = 2\n\n[material]' + rest
    text = re.sub(r'(?m)^"([5678])" = "patch_\1"\n', "", text)
    file = folder / "slab.toml"
    file.write_text(text + _EXPLORE, encoding="utf-8")
    return file


@pytest.fixture
def coarse_scene(tmp_path: Path, project: Path) -> Path:
    """The slab with one level, of 17 mm, four patches, and two directions to pull in."""
    return _slab(tmp_path, project, "17 mm")


@pytest.fixture
def coarser_scene(tmp_path: Path, project: Path) -> Path:
    """The same with a level of 34 mm: pulls are predicted ten times as fast."""
    return _slab(tmp_path, project, "34 mm")
