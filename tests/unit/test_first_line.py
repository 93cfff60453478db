"""The first line of a summary: what is odd, what is not explained, and what cannot be told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from bcid import Measurement, Scene
from bcid.forms.mesh import level_mesh
from bcid.inference import nuisance_text
from bcid.inference.error_covariance import NuisanceEstimate
from bcid.results.summary import identification_summary
from bcid.search.answer.identification import Identification
from bcid.search.answer.identification_job import inputs_in_words

ROOT = Path(__file__).resolve().parents[2]


def found(**more: Any) -> Identification:
    counts = {"in full": 3, "stopped": 0, "failed": 0, "not": 253}
    known: dict[str, Any] = {
        "anchored": ("3", "4"),
        "probability": 0.98,
        "patches": {str(i): 0.5 for i in range(1, 9)},
        "rms": 3.1e-4,
        "noise_rms": 3e-4,
        "discretisation_rms": 2e-5,
        "certified": False,
        "evaluations": {0: 3.0},
        "evaluated": counts,
        "alternatives": (),
        "classes": (),
        "levels": (0,),
        "stages": (),
        "prediction": None,
        "failures": {},
        "seconds": 1.0,
        "not_converged": (),
        "outliers": (),
        "adequate": True,
        "input_uncertainties": (),
    }
    return Identification(**(known | more))


def told(remarks: tuple[str, ...] = (), **more: Any) -> list[str]:
    return identification_summary(found(scene="slab", remarks=remarks, **more)).splitlines()


def test_a_result_that_explains_stands_first_in_mm() -> None:
    lines = told()
    assert lines[0] == "Anchored patches of slab: {3 4}  (probability 98 %)"
    assert "The model misses the measurement by 0.31 mm per coordinate (RMS); the stated noise is 0.3 mm." in lines
    assert not any(" m " in line for line in lines)


def test_a_residual_far_above_the_noise_stands_first() -> None:
    lines = told(rms=14e-3, noise_rms=1e-4, adequate=False)
    assert lines[0] == "WARNING: no set explains this measurement: the best misses it by 140.0 times the noise."
    assert any(line.startswith("Anchored patches") for line in lines)


def test_what_the_scene_may_have_wrong_is_no_alarm() -> None:
    """A residual of three times the noise may be explained all the same, and a small one may not be."""
    markers = NuisanceEstimate("markers", 0.4e-3, 0.35e-3, 2.1, 48)
    lines = told(rms=9e-4, discrepancy_probability=0.07, input_uncertainties=nuisance_text.rows([markers]))
    assert lines[0].startswith("Anchored patches")
    assert (
        "Allowed for in the scene, as standard deviations (and what these data make likely): markers 0.4 mm (0.35 mm)."
        in lines
    )
    assert "Something is missing in the model besides, or it is wrong there: probability 7 %." in lines
    rows = nuisance_text.rows([replace(markers, most=6.0)])
    lines = told(rms=4e-4, discrepancy_probability=0.999, adequate=False, input_uncertainties=rows)
    assert lines[0] == "WARNING: no set explains this measurement: the best misses it by 1.3 times the noise."
    assert any(line.startswith("WARNING: markers would have to sit up to 2.4 mm from where") for line in lines)


def test_what_is_wrong_in_many_ways_is_one_warning() -> None:
    names = {"markers": 0.4e-3, "dimensions": 0.02, "grip_turn": 0.5}
    larger = tuple(NuisanceEstimate(name, size, 3 * size, 9.0, 6) for name, size in names.items())
    rows = nuisance_text.rows(larger)
    found = told(rms=4e-4, discrepancy_probability=0.999, input_uncertainties=rows)
    lines = [line for line in found if "allows for" in line]
    assert lines == [
        "WARNING: more would have to be wrong than the scene allows for (in brackets): markers 3.6 mm (0.4 mm), "
        "dimensions 18 % (2 %), grip turn 4.5 deg (0.5 deg)."
    ]
    assert len([line for line in told(rms=4e-4, input_uncertainties=rows[:2]) if line.startswith("WARNING")]) == 2


def test_an_unknown_noise_stands_first() -> None:
    assert told(noise_rms=None)[0].startswith(
        "WARNING: no noise is known: whether a set explains this measurement cannot be told"
    )


def test_what_is_odd_stands_before_all() -> None:
    lines = told(("markers 3 and 7 look swapped",), noise_rms=None)
    assert lines[0] == "LOOK AT THIS FIRST: markers 3 and 7 look swapped."
    assert lines[1].startswith("WARNING: no noise")
    assert "" not in lines[:3]


def test_a_summary_ends_with_sizes_and_the_fit_of_an_alignment() -> None:
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    seen = Measurement.read(ROOT / "examples/measurements/hidden-d")
    mesh = level_mesh(scene, scene.levels[0])
    assert inputs_in_words(scene, seen, mesh)[0] == "Body: volume 100 cm^3, boundary 240 cm^2."
    lines = inputs_in_words(scene, replace(seen, aligned=1.2e-4), mesh)
    assert lines[-1] == "Frame: [align] misses its markers by 0.12 mm (RMS distance)."
