"""What the functions of bcid can be asked for. The flags of the command line are made of these classes (`bcid.app.flags`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from bcid.base.errors import InputError, nearest
from bcid.base.units import quantity

EXHAUSTIVE = ("auto", "yes", "no")
# With more patches not every set can be followed.
MOST_PATCHES = 16
LAST, SAME, SIMILARITY, REFINEMENT = "last", "same", "similarity", "refinement"
STOPS = (LAST, SAME, SIMILARITY, REFINEMENT)
_STARTS = ("maxima", "threshold")
# Kinds of terms beyond the catalogue; "fibres" are energies with a direction.
KINDS = ("energy", "fibres", "boundary", "body force", "grip", "observation")
CRITERIA = ("information", "entropy", "random")


class HasLevels(Protocol):
    """What options are held against: a scene."""

    @property
    def levels(self) -> Sequence[Any]:
        """Of the mesh hierarchy."""
        ...

    @property
    def patches(self) -> Any:
        """The candidates."""
        ...


def option(default: Any, example: str, unit: str = "", hidden: bool = False) -> Any:
    """A field that is a flag of the command line.

    Args:
        default: as of any field.
        example: what stands for its value in the help of a command, as "N".
        unit: of a number with a unit; the value is in SI units.
        hidden: it is no flag.
    """
    return field(default=default, metadata={"example": example, "unit": unit, "hidden": hidden})


def check_level(level: int | None, scene: HasLevels, name: str = "level") -> None:
    """Raise `InputError` for a level that the scene does not have."""
    if level is not None and not 0 <= level < len(scene.levels):
        raise InputError(f"{name} {level}: the scene has levels 0 to {len(scene.levels) - 1}")


@dataclass(frozen=True)
class Stop:
    """When the stages of hill climbing end before the last level; section 3.5 of Boonvisut & Cavusoglu (2014).

    Attributes:
        rule: "last": not before; "same": two stages in a row end on the same set (3.5.1); "similarity": that of the best set is at
            least `least` (3.5.2); "refinement": what the best set predicts changes by less than `tolerance` on the next level
            (3.5.3).
        least: similarity, a part of 1.
        tolerance: RMS change of a coordinate, m.
    """

    rule: str = SAME
    least: float = 0.0
    tolerance: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Stop:
        """A rule as it is written: "last", "same", "similarity 0.95" or "refinement 0.5 mm".

        Raises:
            InputError: it is none of these.
        """
        rule, _, value = text.strip().partition(" ")
        if rule not in STOPS:
            raise InputError(f"stop '{text}': {nearest(rule, STOPS)}")
        if rule in (LAST, SAME):
            if value:
                raise InputError(f"stop '{text}': '{rule}' stands alone")
            return cls(rule)
        example = "similarity 0.95" if rule == SIMILARITY else "refinement 0.5 mm"
        try:
            number = float(value) if rule == SIMILARITY else quantity(value, "m")
        except (ValueError, InputError) as error:
            raise InputError(f"stop '{text}': expected as '{example}' ({error})") from None
        made = cls(rule, least=number) if rule == SIMILARITY else cls(rule, tolerance=number)
        made.check()
        return made

    def check(self) -> None:
        """Raise `InputError` for thresholds that make no sense."""
        if self.rule not in STOPS:
            raise InputError(f"stop '{self.rule}': {nearest(self.rule, STOPS)}")
        if self.rule == SIMILARITY and not 0 < self.least < 1:
            raise InputError(f"stop: a similarity of {self.least:g}: must be above 0 and below 1")
        if self.rule == REFINEMENT and not (math.isfinite(self.tolerance) and self.tolerance > 0):
            raise InputError(f"stop: a change of {self.tolerance * 1e3:g} mm: must be above 0")


@dataclass(frozen=True)
class StageOptions:
    """How the stages of hill climbing go.

    Attributes:
        seeds: random sets that the first stage begins with.
        seed: seed of these random sets; the same number gives the same search.
        coarsest: first mesh level.
        finest: last mesh level that may be used; the scene's last by default.
        stop: when no finer level is needed: same set twice, "similarity 0.95", "refinement 0.5 mm", or last: all are used.
        start: what later stages begin with: maxima, or threshold for every set whose similarity is above the threshold.
        threshold: similarity, a fraction of the best on the level.
        perturb: random toggles of the sets that later stages begin with.
    """

    seeds: int = option(24, "N")
    seed: int = option(0, "N")
    coarsest: int = option(0, "LEVEL")
    finest: int | None = option(None, "LEVEL")
    stop: Stop = field(default_factory=Stop, metadata={"example": "RULE"})
    start: str = option("maxima", "WHAT")
    threshold: float = option(0.95, "X")
    perturb: int = option(0, "N")

    def last(self, scene: HasLevels) -> int:
        """The last level that may be used."""
        return len(scene.levels) - 1 if self.finest is None else self.finest

    def check(self, scene: HasLevels) -> None:
        """Raise `InputError` for options that the scene cannot serve."""
        if self.start not in _STARTS:
            raise InputError(f"start '{self.start}': {nearest(self.start, _STARTS)}")
        self.stop.check()
        for name, number, least in (
            ("seeds", self.seeds, 1),
            ("seed", self.seed, 0),
            ("perturb", self.perturb, 0),
            ("threshold", self.threshold, 0),
        ):
            if not (number >= least and math.isfinite(number)):
                raise InputError(f"{name} = {number}: must be at least {least}")
        if self.threshold >= 1:
            raise InputError(f"threshold = {self.threshold}: a part of the best similarity, so it must be below 1")
        check_level(self.coarsest, scene, "coarsest level")
        check_level(self.finest, scene, "finest level")
        if self.finest is not None and self.finest < self.coarsest:
            raise InputError(f"finest level {self.finest} is coarser than the coarsest level {self.coarsest}")


@dataclass(frozen=True)
class IdentifyOptions:
    """How the anchored patches are identified.

    Attributes:
        exhaustive: follow every set of patches until it has lost: yes, no, or auto (up to 10 patches; else those that differ from a
            likely one by two). With no, tangents and a few steps tell of sets.
        level: mesh level that both meshes go by; the last with at most 40,000 unknowns by default.
        stages: climb to the sets to begin with in stages, as the paper does; by default a few steps show them.
    """

    exhaustive: str = option("auto", "WHETHER")
    level: int | None = option(None, "LEVEL")
    stages: StageOptions | None = field(default=None, metadata={"hidden": True})

    def check(self, scene: HasLevels) -> None:
        """Raise `InputError` for options that the scene cannot serve."""
        count = len(scene.patches)
        if self.exhaustive not in EXHAUSTIVE:
            raise InputError(f"exhaustive '{self.exhaustive}': {nearest(self.exhaustive, EXHAUSTIVE)}")
        check_level(self.level, scene)
        if self.exhaustive == "yes" and count > MOST_PATCHES:
            raise InputError(
                f"exhaustive: {count} patches have {2**count} sets, all of which can be followed of up to {MOST_PATCHES} patches: "
                "use exhaustive no"
            )
        if self.stages is not None:
            self.stages.check(scene)


@dataclass(frozen=True)
class ExplainOptions:
    """How far a search for missing effects goes.

    Attributes:
        level: mesh level that both meshes go by; the last with at most 40,000 unknowns by default.
        max_effects: effects that may be named together.
        only: look at these effects only, as gravity,fibres; all of the catalogue by default.
        fitted: effects that are fitted on a few steps of each action, each time on one set, beside each model.
        sets: anchor sets that are compared on a few steps of each action.
    """

    level: int | None = option(None, "LEVEL")
    max_effects: int = option(2, "N")
    only: tuple[str, ...] | None = option(None, "a,b")
    fitted: int = option(10, "N", hidden=True)
    sets: int = option(28, "N", hidden=True)

    def check(self) -> None:
        """Raise `InputError` for what makes no sense."""
        if self.max_effects < 1:
            raise InputError(f"--max-effects {self.max_effects}: must be at least 1")


@dataclass(frozen=True)
class ProposeOptions:
    """How far a search for terms beyond the catalogue goes.

    Attributes:
        max_effects: terms that may be proposed together.
        kinds: kinds of terms that are tried, as energy for the law alone where it has no direction; all by default: energy, fibres,
            boundary, body force, grip, observation.
        level: mesh level that both meshes go by; the last with at most 40,000 unknowns by default.
    """

    max_effects: int = option(2, "N")
    kinds: tuple[str, ...] = option(KINDS, "a,b")
    level: int | None = option(None, "LEVEL")

    def check(self) -> None:
        """Raise `InputError` for what cannot be searched."""
        if self.max_effects < 1:
            raise InputError(f"--max-effects {self.max_effects}: must be at least 1")
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError(f"kind '{kind}': {nearest(kind, KINDS)} (--kinds)")


@dataclass(frozen=True)
class ExploreOptions:
    """How an exploration goes.

    Attributes:
        confidence: probability of a set from which on it is decided.
        budget: what all pulls may cost together.
        criterion: how pulls are chosen: by information, entropy (as in the paper), or random.
        look_ahead: look at pairs of pulls where one cannot decide.
        grasps: grasps to use, as I,II; all of the scene by default.
        level: fine mesh level; the last with at most 40,000 unknowns by default.
        noise: standard deviation of a coordinate that is expected of pulls to come; the scene's by default.
        samples: samples of the estimate of information.
        seed: seed of what is drawn: the estimate, random choice, and the first sets where there are too many to look at all.
        consider: effects that may act besides, as gravity,fibres; none by default.
        wrench_noise: standard deviation of the gripper's force, which then counts; by default forces do not.
    """

    confidence: float = option(0.95, "P")
    budget: float = option(12.0, "COST")
    criterion: str = option("information", "NAME")
    look_ahead: bool = option(True, "")
    grasps: tuple[str, ...] | None = option(None, "I,II")
    level: int | None = option(None, "LEVEL")
    noise: float | None = option(None, '"0.3 mm"', unit="m")
    samples: int = option(1000, "N")
    seed: int = option(0, "N")
    consider: tuple[str, ...] = option((), "a,b")
    wrench_noise: float | None = option(None, '"0.02 N"', unit="N")

    def check(self, scene: HasLevels) -> None:
        """Raise `InputError` for what makes no sense; effects and grasps are checked by `bcid.exploration.loop.check`."""
        if not 0.5 < self.confidence < 1:
            raise InputError(f"--confidence {self.confidence:g}: must be above 0.5 and below 1")
        if not (math.isfinite(self.budget) and self.budget > 0):
            raise InputError(f"--budget {self.budget:g}: must be positive")
        if self.criterion not in CRITERIA:
            raise InputError(f"--criterion {self.criterion}: {nearest(self.criterion, CRITERIA)}")
        if self.samples < 10:
            raise InputError(f"--samples {self.samples}: must be at least 10")
        check_level(self.level, scene, "--level")
        if self.wrench_noise is not None and not (math.isfinite(self.wrench_noise) and self.wrench_noise > 0):
            raise InputError(f"--wrench-noise {self.wrench_noise:g}: must be a positive force")
