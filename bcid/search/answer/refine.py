"""Refinement: patches that leave a doubt are halved, and halves that prove different are kept apart."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from bcid.base.collective import Comm
from bcid.base.errors import InputError
from bcid.base.options import IdentifyOptions
from bcid.base.progress import Progress, Silent
from bcid.forms.mesh.patches import divided, element_size, extents, half_names, halves, replaced, touching
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.hypotheses import label
from bcid.inference.misfit import Misfit
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Measurement
from bcid.predict.store import PredictionStore
from bcid.scene import Region, Scene
from bcid.search.answer.identification import Identification
from bcid.search.identify import identify
from bcid.search.settings import SETTINGS

# No patch is divided further when there are so many: every step of a climb looks at all of them.
_MOST_PIECES = 64
# A result with a residual larger than the present one's by more than this factor is not taken.
_NO_WORSE = 1.001

Anchored = frozenset[str]
Cuts = dict[str, tuple[str, str]]


@dataclass(frozen=True)
class Refinement:
    """What refining an identification gave.

    Attributes:
        found: the identification with the patches of `scene`.
        scene: the scene with the patches that were kept.
        refined: the halves of every patch that was cut: {"3": ("3.1", "3.2"), "3.2": ("3.2.1", "3.2.2")}.
        log: what each round did, in words.
        evaluations: forward trajectories per level over all rounds, in whole-trajectory equivalents.
        seconds: time spent in all rounds.
    """

    found: Identification
    scene: Scene
    refined: Cuts
    log: tuple[str, ...]
    evaluations: dict[int, float]
    seconds: float

    def record(self) -> Identification:
        """The identification, with what refining did."""
        evaluations = {level: round(count, 3) for level, count in self.evaluations.items()}
        return replace(self.found, evaluations=evaluations, refined=dict(self.refined), rounds=self.log)


def check_rounds(scene: Scene, rounds: int) -> None:
    """Raise `InputError` when a scene cannot be refined so many times."""
    if rounds < 0:
        raise InputError(f"refine = {rounds}: must be at least 0")
    for whole in scene.patches if rounds else ():
        for name in scene.patches:
            if is_part(name, whole):
                raise InputError(f"patch '{name}' has the name of a part of patch '{whole}'; rename one of them")


def identify_refined(
    scene: Scene,
    measurement: Measurement,
    comm: Comm | None = None,
    options: IdentifyOptions | None = None,
    rounds: int = 2,
    model: Model | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    store: PredictionStore | None = None,
) -> Refinement:
    """Find the anchored patches, then halve those that leave a doubt, up to `rounds` times; collective on `comm`.

    The rules are in docs/method.md; the other arguments and errors are those of `bcid.search.identify.identify`.
    """
    from mpi4py import MPI

    comm, begin = comm or MPI.COMM_SELF, time.perf_counter()
    scene = divided(scene, comm)
    check_rounds(scene, rounds)
    spent: dict[int, float] = {}

    def search(body: Scene, chosen: IdentifyOptions, start: Sequence[Anchored]) -> Identification:
        found = identify(body, measurement, comm, chosen, model, settings, progress, start, store)
        for level, count in found.evaluations.items():
            spent[level] = spent.get(level, 0.0) + count
        return found

    values = Misfit(scene, measurement).values
    done = _Rounds(Tree(scene, comm), options or IdentifyOptions(), progress or Silent(), search, values)
    done.run(rounds)
    seconds = time.perf_counter() - begin
    return Refinement(done.found, done.scene, done.refined, tuple(done.log), spent, seconds)


def is_part(name: str, whole: str) -> bool:
    """Whether a name is that of a half of a patch, or of a half of its halves."""
    return name.startswith(whole) and re.fullmatch(r"(\.[12])+", name[len(whole) :]) is not None


def anchors(candidate: Iterable[str], patch: str) -> bool | None:
    """Whether a set, in the names of any patches, anchors a patch; None when it anchors only a part of it."""
    chosen = set(candidate)
    if any(name == patch or is_part(patch, name) for name in chosen):
        return True
    if not any(is_part(name, patch) for name in chosen):
        return False
    parts = {anchors(chosen, half) for half in half_names(patch)}
    return parts.pop() if len(parts) == 1 else None


def expanded(candidate: Iterable[str], patches: Iterable[str]) -> Anchored | None:
    """A set in terms of other patches; None when it anchors a part of one."""
    states = {patch: anchors(candidate, patch) for patch in patches}
    return None if None in states.values() else frozenset(patch for patch, on in states.items() if on)


def resolved(candidate: Iterable[str], patches: Iterable[str]) -> list[Anchored]:
    """A set in terms of other patches, those it anchors in part once with and once without."""
    states = {patch: anchors(candidate, patch) for patch in patches}
    sure = frozenset(patch for patch, on in states.items() if on)
    partly = frozenset(patch for patch, on in states.items() if on is None)
    return list(dict.fromkeys([sure | partly, sure]))


def significant_splits(refined: Mapping[str, tuple[str, str]], probability: Mapping[str, float]) -> Cuts:
    """The cuts whose two sides are alike with a probability of at most `SearchSettings.alike`.

    Args:
        refined: all cuts.
        probability: that each patch is anchored, in the names of the smallest parts.

    Two patches with the probabilities a and b differ with a probability of at least |a - b|, whatever they have to do with
    each other. A cut also stays when one within its sides does.
    """
    kept: Cuts = {}

    def leaves(name: str) -> list[str]:
        return [leaf for half in refined[name] for leaf in leaves(half)] if name in refined else [name]

    # Parts have longer names than what they are parts of.
    for name in sorted(refined, key=len, reverse=True):
        lower, upper = refined[name]
        spread = max(abs(probability[a] - probability[b]) for a in leaves(lower) for b in leaves(upper))
        if spread >= 1 - SETTINGS.alike or lower in kept or upper in kept:
            kept[name] = lower, upper
    return {name: refined[name] for name in refined if name in kept}


class Tree:
    """A scene and the halves of its patches, made once."""

    def __init__(self, scene: Scene, comm: Comm) -> None:
        self.base, self.comm = scene, comm
        self._regions: dict[str, Region] = dict(scene.patches)

    def scene(self, refined: Mapping[str, tuple[str, str]]) -> Scene:
        """The scene with cut patches replaced by their halves."""
        patches = self.base.patches
        for name in sorted(refined, key=len):
            patches = replaced(patches, name, {half: self._regions[half] for half in refined[name]})
        return replace(self.base, patches=patches)

    def cut(self, scene: Scene, names: Sequence[str], smallest: float) -> Cuts:
        """Halves of the patches whose halves are not smaller than this (m); collective."""
        size = extents(scene, self.comm)
        chosen = [name for name in names if size[name] / 2 >= smallest]
        finer = halves(scene, chosen, self.comm)
        cuts = {name: half_names(name) for name in chosen}
        self._regions |= {half: finer.patches[half] for pair in cuts.values() for half in pair}
        return cuts


class _Rounds:
    """The rounds of one refinement.

    Args:
        tree: the scene and its cuts.
        options: of the search.
        progress: told what is going on.
        search: identifies with the patches of a scene, beginning with given sets.
        values: number of measured coordinates.
    """

    def __init__(
        self,
        tree: Tree,
        options: IdentifyOptions,
        progress: Progress,
        search: Callable[[Scene, IdentifyOptions, Sequence[Anchored]], Identification],
        values: int,
    ) -> None:
        self.tree, self.options, self.progress = tree, options, progress
        self.search, self.values = search, values
        # Not every set of so many halves can be followed.
        self.of_halves = replace(options, exhaustive="auto") if options.exhaustive == "yes" else options
        self.refined: Cuts = {}
        self.scene = tree.base
        # How deep each patch was cut in vain.
        self.vain: dict[str, int] = {}
        self.log: list[str] = []

    def run(self, rounds: int) -> None:
        """Identify, then refine up to so many times."""
        self.found = self.search(self.scene, self.options, ())
        for number in range(1, rounds + 1):
            if not self.round(number):
                break

    def round(self, number: int) -> bool:
        """Split, search, merge; returns whether there was something to split."""
        why, depths = self.doubtful()
        cuts = self.split(depths)
        if len(cuts) == len(self.refined):
            self.say(f"round {number}: {why}" + ("; no patch can be split further" if depths else ""))
            return False
        split = [name for name in self.scene.patches if name in cuts]
        self.say(f"round {number}: {why}; split {' '.join(split)}")
        finer = self.tree.scene(cuts)
        toggled = [frozenset(self.found.anchored) ^ {name} for name in split if name in self.scene.patches]
        fresh = self.search(finer, self.of_halves, self.starts(finer, toggled))
        self.merge(cuts, fresh)
        merged = [name for name in split if name not in self.refined]
        self.vain |= {name: depths[name] for name in merged}
        text = (
            f"kept the halves of {' '.join(kept)}"
            if (kept := [n for n in cuts if n in self.refined])
            else "kept no halves"
        )
        best = f"best {label(self.found.anchored, self.scene.patches)}, residual {self.found.rms * 1e3:.3g} mm"
        self.say(f"round {number}: {text}, merged those of {' '.join(merged) or 'none'}; {best}")
        return True

    def say(self, text: str) -> None:
        self.log.append(text)
        self.progress.say(text)

    def doubtful(self) -> tuple[str, dict[str, int]]:
        """How the present result stands, in words, and the patches to split with how many times."""
        patches, anchored = list(self.scene.patches), self.found.anchored
        near = touching(self.scene, self.found.levels[-1], self.tree.comm)
        border = [p for p in patches if p in anchored or any(p in near[a] for a in anchored)] or patches
        undecided = [p for p in patches if THRESHOLDS.surprise < self.found.patches[p] < 1 - THRESHOLDS.surprise]
        why = f"undecided: {' '.join(undecided)}" if undecided else "every patch is decided"
        if self.explained():
            return why, {p: 1 for p in patches if p in {*border, *undecided} and p not in self.vain}
        if any(p in self.vain for p in border):
            border = patches
        depths = {p: self.vain.get(p, 0) + 1 for p in patches if p in {*border, *undecided}}
        return f"no set explains the measurement (residual {self.found.rms * 1e3:.3g} mm); {why}", depths

    def explained(self) -> bool:
        """Whether noise and mesh account for the residual; when no noise is stated nothing is known against it."""
        noise, rms = self.found.noise_rms, self.found.rms
        if noise is None:
            return True
        most = math.sqrt(1 + THRESHOLDS.detection * math.sqrt(2 / self.values))
        return rms <= most * math.hypot(noise, self.found.discretisation_rms or 0.0)

    def split(self, depths: Mapping[str, int]) -> Cuts:
        """All cuts so far and those that halve each patch as many times, as far as elements and number of patches allow."""
        cuts = dict(self.refined)
        smallest = element_size(self.tree.base, self.found.levels[-1], self.tree.comm)
        level = list(depths)
        for depth in range(max(depths.values(), default=0)):
            scene = self.tree.scene(cuts)
            room = _MOST_PIECES - len(scene.patches)
            fresh = self.tree.cut(scene, level[: max(room, 0)], smallest)
            cuts |= fresh
            level = [h for n, pair in fresh.items() if depths[self.root(n, depths)] > depth + 1 for h in pair]
        return cuts

    @staticmethod
    def root(name: str, depths: Mapping[str, int]) -> str:
        return next(patch for patch in depths if name == patch or is_part(name, patch))

    def starts(self, scene: Scene, more: Iterable[Anchored] = ()) -> list[Anchored]:
        """Where to begin with the patches of a scene: the best sets so far, then `more`."""
        sets = [
            self.found.anchored,
            *(other.anchored for other in self.found.alternatives[: SETTINGS.first_sets]),
            *more,
        ]
        return list(dict.fromkeys(c for s in sets for c in resolved(s, scene.patches)))

    def merge(self, cuts: Cuts, fresh: Identification) -> None:
        """Take the result of a round, with the halves that did not prove different merged; nothing when it explains less."""
        kept = significant_splits(cuts, fresh.patches)
        if self.nothing_found(kept, fresh):
            return
        if kept != cuts:
            fresh = self.again(kept, fresh)
        if fresh.levels[-1] == self.found.levels[-1] and fresh.rms > self.found.rms * _NO_WORSE:
            return
        if kept != self.refined:
            self.vain = {}
            self.refined, self.scene, self.found = kept, self.tree.scene(kept), fresh
        elif fresh.anchored != self.found.anchored:
            self.found = fresh

    def nothing_found(self, cuts: Cuts, fresh: Identification) -> bool:
        """Whether a search with more cuts leaves those that are there, and the best set."""
        return cuts == self.refined and expanded(fresh.anchored, self.scene.patches) == frozenset(self.found.anchored)

    def again(self, cuts: Cuts, fresh: Identification) -> Identification:
        """Search with fewer cuts, from the best set of a search with more."""
        scene = self.tree.scene(cuts)
        starts = dict.fromkeys([*resolved(fresh.anchored, scene.patches), *self.starts(scene)])
        return self.search(scene, self.of_halves, list(starts))
