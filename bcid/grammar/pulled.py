"""Families whose amount grows with the pull: in proportion to how far the gripper has moved."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.model import Term
from bcid.grammar.family import Family
from bcid.scene.rotation import as_rotation
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant, amounts

Array = NDArray[np.float64]
# A pull by this part of the body's size has the amount that a steady term is noticed by.
_NOTABLE = 0.1
# As virtual work: what grows with the pull takes its energy from elsewhere.
_WORKS = {
    "pressure": "",
    "traction": "return -ufl.inner(ufl.as_vector([c['tx'], c['ty'], c['tz']]), point.v)",
    "body_force": "return -ufl.inner(ufl.as_vector([c['fx'], c['fy'], c['fz']]), point.v)",
    "fibre_stress": "return c['c'] * ufl.inner(point.kin.F * a, ufl.grad(point.v) * a)",
}
_FAMILIES = ("pressure", "pressure_at_a_spot", "traction", "traction_at_a_spot", "body_force", "fibre_stress")
_PULL = "pull = ufl.sqrt(ufl.inner(point.gripper, point.gripper) + 1e-24) / point.size"


def pulled_families(families: Iterable[Family]) -> list[Family]:
    """Of families of the grammar."""
    return [_pulled(family) for family in families if family.name in _FAMILIES]


def gripper_moves(state: State) -> bool:
    """Whether there is a pull with which something could grow."""
    return any(action.grasp and np.ptp(action.translation, axis=0).any() for action in state.predictor.actions)


def _pulled(family: Family) -> Family:
    *lines, last = family.code.splitlines()
    last = _WORKS[family.name.removesuffix("_at_a_spot")] or last
    value = last.removeprefix("return ")
    factor = f"return pull * {value}" if not value.startswith("-") else f"return -pull * {value[1:]}"
    return replace(
        family,
        name=f"{family.name}_with_pull",
        about=f"{family.about}, in proportion to the gripper's way",
        formula=f"|g|/size times: {family.formula}, g the way of the gripper",
        code="\n".join([*(line for line in lines if not line.startswith("x = ")), _PULL, factor]),
        amounts=tuple(replace(p, scale=p.scale / _NOTABLE) for p in family.amounts),
        unit=None,
        works=True,
        steady=family.name,
    )


def pulled_variants(state: State, steady: Sequence[Variant], growing: Callable[[Term], Term]) -> list[Variant]:
    """Each steady variant as it grows with the pull; nothing is solved.

    Args:
        state: that the variants are of.
        steady: variants of a family.
        growing: the term of the family that grows with the pull, like that of a variant.
    """
    found, frame = list[Variant](), state.predictor.data.frame
    for variant in steady:
        term = growing(variant.term)
        plain = np.column_stack([state.errors.unwhiten(column) for column in variant.sensitivity.T])
        columns = state.errors.whiten(_ways(state, variant.term)[frame][:, None] * plain)
        found.append(Variant(term, tuple(amounts(term, [p.name for p in term.effect.amounts])), columns))
    return found


def _ways(state: State, term: Term) -> Array:
    """How far the gripper would have moved the middle of a term in each frame, in sizes of the body, shape (frames,)."""
    predictor = state.predictor
    points = predictor.forward(state.model).mesh.points
    low, high = points.min(axis=0), points.max(axis=0)
    middle = np.array([term.values.get(f"c{axis}", at) for axis, at in zip("xyz", (low + high) / 2, strict=True)])
    found = np.zeros(len(predictor.data.mask))
    for action in predictor.actions:
        if action.grasp:
            arm = middle - np.array(predictor.scene.grasps[action.grasp].centre)
            moved = action.translation + as_rotation(action.rotation).apply(arm) - arm
            found[action.frames] = np.linalg.norm(moved, axis=1)
    return np.asarray(found / np.linalg.norm(high - low))
