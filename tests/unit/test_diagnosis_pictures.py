"""Pictures of a diagnosis, from a small run folder made by hand: no solver is needed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import runs
import xarray as xr
from matplotlib.figure import Figure

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.report.diagnosis_picture import discrepancy_figure, residual_figure, worst_frame
from bcid.report.export import draw_pictures
from bcid.report.figure import round_length
from bcid.report.labels import Viewpoint, beside_arrows
from bcid.report.models_chart import models_figure
from bcid.report.text import conclusion, falling
from bcid.results.common_rows import ConstantRow
from bcid.results.diagnosis_record import DiagnosisRecord, DiscrepancyRecord, ForceRow, ModelRow, TotalForce
from bcid.results.words import model_name


def rung(model: str, rms: float, adequate: bool) -> ModelRow:
    return ModelRow(model=model, anchored=("left",), rms=rms, held_out_rms=rms, adequate=adequate, p_value=0.5)


def diagnosis(**more: Any) -> DiagnosisRecord:
    steps = (rung("neo_hooke", 1.4, False), rung("neo_hooke + gravity", 0.21, True))
    return replace(DiagnosisRecord.from_json(runs.diagnosis()), **({"model_sequence": steps} | more))


def body() -> xr.Dataset:
    """A tetrahedron that is held at one face."""
    points = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    return xr.Dataset(
        {
            "points": (("node", "axis"), points),
            "cells": (("cell", "corner"), np.array([[0, 1, 2, 3]], dtype=np.int32)),
            "triangles": (
                ("triangle", "vertex"),
                np.array([[0, 2, 3], [0, 1, 2], [0, 1, 3], [1, 2, 3]], dtype=np.int32),
            ),
            "place": ("triangle", [1, 0, 0, 2]),
            "place_name": ("place_number", ["", "patch left", "grasp I"]),
            "displacement": (("frame", "node", "axis"), np.zeros((2, 4, 3))),
        },
        attrs={"scene": "corner", "up": "0 1 0"},
    )


def dense() -> xr.Dataset:
    """A field on the face x = 0, which fails in one corner."""
    dims = ("frame", "fiducial", "axis")
    rest = 0.1 * np.array([(0, y, z) for y in np.linspace(0, 1, 14) for z in np.linspace(0, 1, 14) if y + z < 1])
    measured = np.tile(rest, (2, 1, 1))
    measured[1, :, 0] += 5e-3 * np.exp(-(((rest[:, 1] - 0.1) / 0.02) ** 2))
    about = {name: (dims, np.tile(rest, (2, 1, 1))) for name in ("predicted_first", "predicted")}
    frames = {"action": ("frame", ["1", "1"]), "step": ("frame", [0, 1])}
    return xr.Dataset(about | {"measured": (dims, measured), "grasp": ("frame", ["I", "I"])}, frames)


def residuals() -> xr.Dataset:
    dims = ("frame", "fiducial", "axis")
    rest = 0.1 * np.array([[0.2, 0.2, 0.2], [0.3, 0.1, 0.3]])
    measured = np.tile(rest, (2, 1, 1))
    measured[1, 0, 1] -= 5e-3
    # A fiducial that was not seen in a frame.
    measured[1, 1] = np.nan
    return xr.Dataset(
        {
            "measured": (dims, measured),
            "predicted_first": (dims, np.tile(rest, (2, 1, 1))),
            "predicted": (dims, np.tile(rest, (2, 1, 1))),
            "grasp": ("frame", ["I", "I"]),
        },
        {"action": ("frame", ["1", "1"]), "step": ("frame", [0, 1])},
    )


def where(
    steady: tuple[ForceRow, ...],
    growing: dict[str, tuple[ForceRow, ...]],
    together: ForceRow | None = None,
    explained: float = 0.99,
) -> DiscrepancyRecord:
    """A missing force; what it is in all is its first region, unless that is given."""
    whole = TotalForce(steady=together or steady[0], growing={action: rows[0] for action, rows in growing.items()})
    return DiscrepancyRecord(
        explained_fraction=explained, rms=0.22, length_unit="mm", steady=steady, growing=growing, together=whole
    )


def force(size: list[float], stderr: float = 0.01, position: float = 20.0) -> ForceRow:
    return ForceRow(position=(position, 20.0, 20.0), force=tuple(size), stderr=stderr)


WHERE = where((force([0.0, -0.1, 0.0]),), {"1": (force([0.05, 0.0, 0.0]),)})


def folder(path: Path, found: DiagnosisRecord, where: DiscrepancyRecord | None) -> Path:
    run = RunFolder.start(path, "explain", {})
    run.write_json("diagnosis.json", found.to_json())
    run.write_dataset("body.nc", body())
    run.write_dataset("residuals.nc", residuals())
    if where is not None:
        run.write_json("discrepancy.json", where.to_json())
    run.finish({})
    return path


def names(files: list[Path]) -> set[str]:
    return {file.name for file in files}


def test_every_picture_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("pyvista")
    written = draw_pictures(folder(tmp_path / "run", diagnosis(), WHERE))
    assert names(written) == {"picture.png", "discrepancy.png", "models.png", "body.vtkhdf"}
    assert all(file.stat().st_size > (5000 if file.suffix == ".png" else 0) for file in written)
    assert not list((tmp_path / "run").glob(".*.partial*"))


def test_what_a_dense_field_misses_is_a_map() -> None:
    """In colours between the surface's nodes, which lie at its corners alone; where nothing was seen there are none."""
    pytest.importorskip("pyvista")
    from bcid.report.scene3d import coloured, surface

    field = dense()
    missed = 1e3 * np.linalg.norm((field["measured"] - field["predicted"]).values[1], axis=1)
    drawn = coloured(surface(body(), 1), 1e3 * field["predicted"].values[1], missed)
    value, points = drawn.point_data["value"], drawn.points
    seen = points[:, 0] < 1e-6
    assert np.isfinite(value[seen]).all()
    assert np.isnan(value[points[:, 0] > 30]).all()
    corner, far = points[seen][:, 1] > 90, points[seen][:, 1] < 50
    assert value[seen][corner].min() > 2 > 0.1 > value[seen][far].max()
    figure = residual_figure(diagnosis(), body(), field)
    assert any("measured − predicted" in axes.get_title(loc="right") for axes in figure.axes)
    assert not [text for text in figure.legends[0].get_texts() if "as long as" in text.get_text()]


def test_nothing_is_missing(tmp_path: Path) -> None:
    """An adequate plain model has neither a missing force nor a second model, and a force may be no force."""
    pytest.importorskip("pyvista")
    found = diagnosis(verdict="none", model_sequence=(rung("neo_hooke", 0.2, True),), ranking=())
    assert names(draw_pictures(folder(tmp_path / "run", found, None))) == {"picture.png", "models.png", "body.vtkhdf"}
    nothing = where((force([0.0, 0.0, 0.0]),), {})
    assert "discrepancy.png" in names(draw_pictures(folder(tmp_path / "other", found, nothing)))


def orange(figure: Figure) -> int:
    """Pixels in the colour of arrows."""
    image = np.asarray(figure.axes[0].images[0].get_array()).astype(int)
    red, green, blue = np.moveaxis(image, 2, 0)
    return int(((red > 150) & (green < 130) & (blue < 90)).sum())


def said(figure: Figure) -> str:
    """All texts of a figure."""
    return " ".join(text.get_text() for text in [*figure.texts, *(axes.title for axes in figure.axes)])


@pytest.mark.parametrize(
    ("stderr", "explained", "told"), [(0.01, 0.99, True), (0.05, 0.99, False), (0.01, 0.05, False), (0.0, 0.99, True)]
)
def test_a_force_is_drawn_only_where_it_can_be_told(stderr: float, explained: float, told: bool) -> None:
    pytest.importorskip("pyvista")
    steady = [force([0.0, -0.1, 0.0], stderr), force([0.0, -9e-6, 0.0], position=30)]
    figure = discrepancy_figure(diagnosis(), where(steady, {}, explained=explained), body(), residuals())
    assert (orange(figure) > 100) is told
    assert ("No missing force can be told" in said(figure)) is (explained < 0.1)
    assert ("told on 1 of 2 regions" in said(figure)) is told
    # A part that cannot be told has no panel of its own.
    assert len(figure.axes) == 1


@pytest.mark.parametrize(("stderr", "told"), [(0.02, True), (0.09, False)])
def test_a_force_that_no_region_tells_is_drawn_as_one(stderr: float, told: bool) -> None:
    """A weight is spread over the body: what it is on each region is lost in the error, and still a force is missing."""
    pytest.importorskip("pyvista")
    steady = [force([0.0, -0.05, 0.0], 0.04, x) for x in (10, 30)]
    whole = force([0.0, -0.1, 0.0], stderr)
    figure = discrepancy_figure(diagnosis(), where(steady, {}, together=whole), body(), residuals())
    assert (orange(figure) > 100) is told
    assert ("together (+0 −100 +0) mN,\ntold on no single region" in said(figure)) is told
    assert ("A force is missing; where it acts cannot be told" in said(figure)) is not told
    assert "No missing force" not in said(figure)


def test_nothing_explains_it(tmp_path: Path) -> None:
    pytest.importorskip("pyvista")
    found = diagnosis(verdict="unknown", adequate=False, model_sequence=(rung("neo_hooke", 1.4, False),))
    assert "discrepancy.png" in names(draw_pictures(folder(tmp_path / "run", found, WHERE)))
    assert conclusion(found) == "none of the known effects explains it"


def test_a_run_without_a_diagnosis(tmp_path: Path) -> None:
    RunFolder.start(tmp_path / "run", "identify", {}).finish({})
    with pytest.raises(InputError, match="has nothing to draw"):
        draw_pictures(tmp_path / "run")


def test_the_ladder_in_one_line() -> None:
    assert falling(diagnosis()) == "neo-Hookean 1.4 mm → + gravity 0.21 mm (noise 0.2)"
    steps = [rung("gent", 2, False), rung("gent + soft_anchor(3)", 1, False), rung("gent + gravity", 0.2, True)]
    assert (
        falling(diagnosis(model_sequence=steps))
        == "gent 2 mm → + soft anchor (3) 1 mm → gent + gravity 0.2 mm (noise 0.2)"
    )


def test_titles() -> None:
    assert conclusion(diagnosis()) == "adequate with gravity"
    assert conclusion(diagnosis(verdict="gravity+time_lag", adequate=False)) == "missing: gravity and time lag"
    assert conclusion(diagnosis(verdict="unknown", adequate=False, ranking=())) == "the model is not adequate"
    assert conclusion(diagnosis(verdict="none")) == "the plain model is adequate"
    one = ConstantRow(value=1.0, stderr=0.1, interval=(0.8, 1.2), unit="Pa", per_thickness=False)
    free = {"young": one, "poisson": one}
    assert conclusion(diagnosis(verdict="none", law=free)) == "adequate with young and poisson fitted"
    assert model_name("neo_hooke + gravity (young fitted)") == "neo-Hookean + gravity (young fitted)"
    assert model_name("soft_anchor(3)") == "soft anchor (3)"


def test_one_action_has_nothing_held_out() -> None:
    steps = (replace(rung("neo_hooke", 1.4, False), held_out_rms=None),)
    assert len(models_figure(diagnosis(model_sequence=steps)).axes) == 2


def test_scale_and_frame() -> None:
    assert [round_length(x) for x in (0.7, 1, 3.9, 19, 50, np.inf, 0)] == [0.5, 1, 2, 10, 50, 1, 1]
    assert worst_frame(np.array([[[np.nan] * 3], [[1.0, 0, 0]], [[0, 0, 2.0]]])) == 2


def test_large_forces_are_told_in_newtons_and_long_titles_fit() -> None:
    pytest.importorskip("pyvista")
    found = where((force([0.0, -138.4, 0.0], 28.4),), {})
    models = "neo_hooke + support_friction + active_stress + viscosity + stiffness_gradient + strain_stiffening"
    figure = discrepancy_figure(diagnosis(model_sequence=(rung(models, 1.4, True),)), found, body(), residuals())
    assert "together (+0 −138 +0) N,\ntold on 1 of 1 regions" in said(figure)
    assert all(text.get_window_extent().x1 < figure.bbox.width for text in figure.texts)


def test_texts_at_arrows_do_not_hide_each_other() -> None:
    """Two arrows that point to each other: one text stands behind its arrow."""
    view = Viewpoint(*np.eye(3), 100.0)
    starts, arrows = np.array([[0.0, 0, 0], [30, 0, 0]]), np.array([[10.0, 0, 0], [-10, 0, 0]])
    first, second = beside_arrows(starts, arrows, ["287 ± 56", "330 ± 41"], "black", [], view)
    assert first.place[0] > 10.0
    assert second.place[0] > 30.0
    assert (first.beside, second.beside) == (1, 1)


@pytest.mark.filterwarnings("error")
def test_a_long_ladder_is_told_by_its_bars_alone() -> None:
    rungs = [rung(f"neo_hooke + effect_{k}", 1.4 - 0.2 * k, False) for k in range(6)]
    figure = models_figure(diagnosis(model_sequence=rungs))
    assert "→" not in said(figure)
