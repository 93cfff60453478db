"""The numbers of the search: how far it looks, and what it leaves out. No evidence depends on them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How far a search over hypotheses goes.

    Attributes:
        negligible: a hypothesis is fitted to all steps while the Brier score is expected to fall by more than this once it is.
        fits: hypotheses that are fitted to all steps for each set of effects that further ones are sought beside, at most.
    """

    negligible: float = 0.02
    fits: int = 9


SETTINGS = SearchSettings()
