"""A block that is cut out of a body tells how stiff a ball in it is."""

from __future__ import annotations

import pytest
from verify.test_driven import BALL, cut, volume  # noqa: F401

from bcid import Measurement, Scene, explain
from bcid.base.options import ExplainOptions


def test_a_block_that_is_cut_out_of_a_body_tells_how_stiff_a_ball_in_it_is(cut: Scene, volume: Measurement) -> None:
    """What holds and pulls the body is not known; what was measured on the surface of the block stands for it."""
    found = explain(
        cut, volume, options=ExplainOptions(only=("region_stiffness", "stiffness_gradient", "strain_stiffening"))
    )
    assert found.verdict == "region_stiffness"
    assert found.posterior.effects["region_stiffness"] > 0.9
    assert found.parameters[f"{BALL}.ratio"].value == pytest.approx(5.0, rel=0.06)
