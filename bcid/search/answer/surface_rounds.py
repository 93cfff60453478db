"""Points are associated with a prediction, hypotheses are weighed, and the likeliest one's prediction associates them anew.

As in the iterative closest point method this is repeated until it no longer changes: until what is found is what the points were
associated by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from typing import TypeVar

from bcid.base.collective import Comm
from bcid.base.options import LAST, StageOptions, Stop
from bcid.base.progress import Progress
from bcid.forms.mesh.patches import first_level
from bcid.forms.model import Model
from bcid.inference.hypotheses import label
from bcid.measurement import Measurement
from bcid.scene import Scene
from bcid.search.answer.association import Association
from bcid.search.set_misfits import MeasuredMisfits
from bcid.search.stages import in_stages

T = TypeVar("T")
Hypothesis = tuple[Scene, Model, frozenset[str]]
# Rounds at most of guessing and of the whole search, and levels that guesses are climbed on.
_GUESSES, _ROUNDS, _LEVELS = 6, 3, 2


def settled(
    scene: Scene,
    measurement: Measurement,
    comm: Comm,
    progress: Progress,
    model: Model,
    anchors: Iterable[str] | None,
    search: Callable[[Scene, Measurement], T],
    found: Callable[[T], Hypothesis],
    drop: Callable[[T], None] = lambda _: None,
) -> tuple[T, Measurement]:
    """What a search finds with points associated by what it finds, and the measurement with surface marks; collective.

    Args:
        scene, measurement: without surface marks; a measurement without a cloud is searched as it is.
        comm, progress: of the search.
        model: that the search begins with.
        anchors: that it begins with; None where they are to be found: they are guessed then.
        search: given the scene and the measurement with surface marks.
        found: scene, model and anchors that a search ended with.
        drop: frees what a search gave that is not the last.
    """
    if measurement.cloud is None:
        return search(scene, measurement), measurement
    association = Association(scene, measurement, comm)
    with ExitStack() as stack:
        stack.callback(association.destroy)
        progress.say(
            f"{len(association.marks.middle)} surface marks stand for the surface that the points show at rest"
        )
        scene = association.scene
        begun = _guessed(association, measurement, model, comm, progress) if anchors is None else frozenset(anchors)
        known = scene, model, begun
        for round_ in range(_ROUNDS):
            progress.say(f"points of the surface are associated by what {_name(known)} predicts")
            seen = association.about(*known, measurement)
            made = search(scene, seen)
            again = found(made)
            if _key(again) == _key(known):
                return made, seen
            known = again
            if round_ + 1 < _ROUNDS:
                drop(made)
        text = f"the points of the surface were associated by another prediction than the answer's, {_name(known)}: it is open"
        return made, replace(seen, remarks=(*seen.remarks, text))


def _guessed(
    association: Association, measurement: Measurement, model: Model, comm: Comm, progress: Progress
) -> frozenset[str]:
    """A likely set, by climbing on the coarsest levels from all patches and from the last guess."""
    scene = association.scene
    everything = guess = frozenset(scene.patches)
    first = first_level(scene, 0, len(scene.levels) - 1, comm)[0]
    last = min(first + _LEVELS, len(scene.levels)) - 1
    options = StageOptions(coarsest=first, stop=Stop(LAST))
    tried: set[frozenset[str]] = set()
    for number in range(_GUESSES):
        if guess in tried:
            break
        tried.add(guess)
        progress.step("points of the surface associated by guesses", number, 0, f"now {label(guess, scene.patches)}")
        misfits = MeasuredMisfits(scene, association.about(scene, model, guess, measurement), comm, model)
        try:
            stages = in_stages(misfits, options, last, list(dict.fromkeys([guess, everything])))
        finally:
            misfits.destroy()
        if not stages:
            break
        guess = stages[-1].anchors
    return guess


def _key(known: Hypothesis) -> tuple[tuple[str, ...], str, frozenset[str]]:
    scene, model, anchors = known
    return tuple(scene.patches), model.name, anchors


def _name(known: Hypothesis) -> str:
    scene, model, anchors = known
    return f"{label(anchors, scene.patches)} with {model.name}"
