"""What single actions gave, for measurements that repeat them beside others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")
# So many are kept: of some ten sets in each of some ten pulls, on two levels, with their sensitivities.
_KEPT = 512


class KeptActions:
    """Results of the latest actions on this process."""

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def result(self, question: str, work: Callable[[], T]) -> T:
        """What `work` gives, or gave when the same was asked before."""
        if question not in self._known:
            found = work()
            while len(self._known) >= _KEPT:
                del self._known[next(iter(self._known))]
            self._known[question] = found
        known: T = self._known[question]
        return known
