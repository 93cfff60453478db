"""Hypotheses compared on a few steps of each action."""

from __future__ import annotations

import math

import numpy as np

from bcid.base.errors import SolveError
from bcid.comparison.state import State
from bcid.forms.solver.equilibrium import Settings
from bcid.predict.predictor import Predictor
from bcid.search.settings import SETTINGS

# A set with which steps must be halved more often is seldom the true one.
FEW_STEPS = Settings(rtol=1e-6, halvings=2)


def few_steps(predictor: Predictor) -> int:
    """How many steps of each action are compared first: of few markers more."""
    data = predictor.data
    seen = len(data) / max(len(np.unique(data.frame)), 1)
    return max(SETTINGS.steps, math.ceil(SETTINGS.values / max(seen * len(predictor.actions), 1)))


def in_few_steps(state: State) -> State:
    """The same hypothesis on a few steps of each action, or as it is where it needs smaller ones; collective."""
    try:
        return state.thinned(few_steps(state.predictor), FEW_STEPS)
    except SolveError:
        return state
