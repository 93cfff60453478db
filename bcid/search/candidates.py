"""Which effects may be missing beside a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from bcid.forms.course import constant
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term
from bcid.search.fitting.state import State

Anchored = frozenset[str]


@dataclass(frozen=True)
class Start:
    """Where the fit of an effect begins.

    Attributes:
        anchors: the set.
        values: of its numbers.
    """

    anchors: Anchored
    values: Mapping[str, float]


@dataclass(frozen=True)
class StandIn:
    """What may hold the body in the place of a patch.

    Attributes:
        anchors: the set without that patch.
        term: it, with numbers that do about what the patch does.
    """

    anchors: Anchored
    term: Term


class Candidates(Protocol):
    """Where effects that may be missing come from."""

    @property
    def among(self) -> int:
        """How many there are to choose from: each is as likely before the data are looked at."""
        ...

    @property
    def alike(self) -> bool:
        """Whether they are ways to write the same, see `HypothesisOdds`."""
        ...

    @property
    def starts(self) -> Mapping[str, Start]:
        """By name how effects are fitted first, in this order; others with the set with which they promise most."""
        ...

    def beside(self, state: State, begun: Model, sets: Sequence[Anchored]) -> list[Effect]:
        """Those that may be missing beside a model, which was begun from another; collective.

        Args:
            state: the model, compared with all steps.
            begun: the model without the effects that were added.
            sets: other likely sets of anchors.
        """
        ...

    def standing_in(self, state: State, begun: Model) -> list[StandIn]:
        """What may hold the body in the place of each patch of a set, as far as no name is known for where it does.

        Args:
            state: the model with the set.
            begun: the model without the effects that were added.
        """
        ...

    def holding_alike(self, term: Term) -> list[Term]:
        """What holds the body where one of these does, in another way."""
        ...


@dataclass(frozen=True)
class Known:
    """Effects that are known before: of the catalogue, and the user's.

    Attributes:
        effects: all of them.
    """

    effects: tuple[Effect, ...]

    @property
    def among(self) -> int:
        return len(self.effects)

    @property
    def alike(self) -> bool:
        return False

    @property
    def starts(self) -> Mapping[str, Start]:
        return {}

    def beside(self, state: State, begun: Model, sets: Sequence[Anchored]) -> list[Effect]:
        """All that the model does not have."""
        have = {constant(term.effect).name for term in state.model.added(begun)}
        return [effect for effect in self.effects if effect.name not in have]

    def standing_in(self, state: State, begun: Model) -> list[StandIn]:
        """Nothing: they act where the scene has a name for it."""
        return []

    def holding_alike(self, term: Term) -> list[Term]:
        """Nothing, likewise."""
        return []
