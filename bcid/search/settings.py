"""The numbers of the search and of its report: how far it looks, and what it leaves out. No evidence depends on them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How far a search over hypotheses goes; differences are of logarithms of evidence and prior.

    Attributes:
        negligible: a hypothesis is evaluated while the Brier score of the answer may fall by more than this times its cost once it
            is; a fit to all steps costs one.
        cost_of_coarse_fit, cost_of_set: what a fit to a few steps costs, and a prediction of a set in them.
        fits: hypotheses that are fitted to all steps for each set of effects that further ones are sought beside, at most; and as
            many that cannot be followed.
        comparable: what is no more below the best than this is as likely as far as a tangent or a few steps tell.
        unlikely: what is further below the best is left out, as far as a tangent or a few steps tell.
        hopeless: what is further below the best is left out however rough the prediction is.
        steps, values: of each action so many steps besides rest are compared first, and more where those are fewer values: they
            would be explained by anything that has as many parameters.
        batch: anchor sets that are predicted in a few steps before their tangents are asked again.
        first_sets: sets that are predicted in a few steps to begin with.
        recovered_sets: of those that cannot be followed in a few steps so many are tried in all.
        few_patches: with no more than these all sets are compared by a cheap tangent, and those that differ by three by any.
        loosened_patches: with no more than these all sets are compared whose anchors give or come off.
        excluded: anchor sets that hold no more than this together are no hypotheses for further pulls.
        random_sets: of more patches than can be enumerated so many random sets are hypotheses before the first pull.
        sets_of_effect: an exploration fits each effect in a few steps, on so many sets.
        counting: a hypothesis with less probability does not count for what to do next.
        helping: what is expected to give fewer bits is no advice.
        settling: predictions for which a fit that has not come to an end goes on.
    """

    negligible: float = 0.05
    cost_of_coarse_fit: float = 0.25
    cost_of_set: float = 0.07
    fits: int = 6
    comparable: float = 3.0
    unlikely: float = 12.0
    hopeless: float = 60.0
    steps: int = 2
    values: int = 40
    batch: int = 4
    first_sets: int = 8
    recovered_sets: int = 2
    few_patches: int = 10
    loosened_patches: int = 8
    excluded: float = 1e-3
    random_sets: int = 64
    sets_of_effect: int = 3
    counting: float = 1e-3
    helping: float = 0.01
    settling: int = 16


SETTINGS = SearchSettings()
