"""Evidence of sets on the coarsest and on the finest level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bcid.inference.outcome import Candidate


@dataclass(frozen=True)
class SetEvidence:
    """Logarithms of the evidence of sets.

    Attributes:
        finely: on the finest level, against the likeliest there.
        coarsely: on the coarsest level, against the likeliest there, `top`; nothing where a single level was used.
    """

    finely: Mapping[Candidate, float] = field(default_factory=dict)
    coarsely: Mapping[Candidate, float] = field(default_factory=dict)

    @property
    def top(self) -> Candidate:
        """The likeliest on the coarsest level: it was weighed on the finest too, and others keep their distance from it."""
        return min(self.coarsely, key=lambda c: (-self.coarsely[c], len(c), sorted(c)))

    @property
    def logs(self) -> dict[Candidate, float]:
        """Of all sets."""
        return {c: log + self.finely[self.top] for c, log in self.coarsely.items()} | dict(self.finely)
