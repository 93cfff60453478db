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
        random_sets: of more patches than can be enumerated so many random sets are hypotheses before the first pull.
        sets_of_effect: an exploration fits each effect in a few steps, on so many sets.
        predicted_sets: hypotheses that are asked what a pull would show, at most; of more only the linear response is looked at.
        drawn_sets: where there are more, so many drawn from them are asked whether a pull is allowed.
        batch_of_pulls: so many of the pulls that promise most by the linear response are predicted in full at a time.
        counting: hypotheses with less probability, and those that hold no more than this together, do not count for what to do
            next.
        helping: what is expected to give fewer bits is no advice, and no pull to make.
        odds: a set that is so many times less likely than another is given up.
        alike: halves of a patch stay apart when it is less likely than this that they are alike.
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
    random_sets: int = 64
    sets_of_effect: int = 3
    predicted_sets: int = 32
    drawn_sets: int = 12
    batch_of_pulls: int = 6
    counting: float = 1e-3
    helping: float = 0.02
    odds: float = 1e6
    alike: float = 1e-4
    settling: int = 16


SETTINGS = SearchSettings()
