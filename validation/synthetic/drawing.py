"""Drawing the cases of the hidden study.

It needs numpy only. Case i depends on i and on what is chosen for the study, so that cases can be made in any order and on
any number of processes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from validation.synthetic.bodies import BODIES
from validation.synthetic.cases import OUTSIDE, SIZES, Case, Hidden, Motion
from validation.synthetic.chance import Rng, generator, in_turn, log_uniform
from validation.synthetic.conditions import CONDITIONS, Conditions
from validation.synthetic.recipes import recipe
from validation.synthetic.study_body import StudyBody

# What a block of twenty cases of a body holds.
BLOCK = ("none",) * 4 + ("one",) * 10 + ("two",) * 2 + ("outside",) * 4
SECONDS_PER_STEP = (0.25, 4.0)
# How often one to four patches are anchored, where the body has such sets.
_COUNTS = {1: 0.15, 2: 0.4, 3: 0.3, 4: 0.15}


@dataclass(frozen=True)
class CaseChoice:
    """What cases are drawn from.

    Attributes:
        seed: of all that is random.
        least: size that effects are drawn from, in units of noise; the largest is 10.
        bodies: names of those that take turns.
        conditions: one of `CONDITIONS`.
    """

    seed: int = 0
    least: float = SIZES[0]
    bodies: tuple[str, ...] = tuple(BODIES)
    conditions: str = "all"


@dataclass(frozen=True)
class Plan:
    """What a case is about; neither the attempt nor sizes change it.

    Attributes:
        body: of the case.
        conditions: under which it is diagnosed.
        kind: "none", "one", "two" or "outside".
        effects: names of what is hidden.
    """

    body: StudyBody
    conditions: Conditions
    kind: str
    effects: tuple[str, ...]


def draw(choice: CaseChoice, index: int, attempt: int = 0) -> Case:
    """Case `index` of a study."""
    made = plan(choice, index)
    rng = generator(choice.seed, 1, index, attempt)
    anchors = _anchors(rng, made.body, peeled="release" in made.effects)
    motions = _motions(rng, made.body, anchors)
    noise = log_uniform(rng, *made.body.noises(made.conditions.nuisances))
    case = Case(choice.seed, index, attempt, made.body, made.conditions, made.kind, anchors, motions, noise, ())
    return replace(case, hidden=tuple(_hidden(rng, name, case, choice.least) for name in made.effects))


def plan(choice: CaseChoice, index: int) -> Plan:
    """Bodies take turns; every twenty cases of a body hold the same kinds, and its effects and conditions take turns."""
    turn, place = divmod(index, len(choice.bodies))
    body = BODIES[choice.bodies[place]]
    key = (choice.seed, list(BODIES).index(body.name))
    conditions = in_turn(CONDITIONS[choice.conditions], turn, *key, 6)
    kind, before = _kind(turn, *key, 2)
    names: tuple[str, ...] = ()
    if kind == "one":
        names = (in_turn(body.catalogue, before, *key, 3),)
    elif kind == "two":
        names = _pair(body.catalogue, before, *key, 4)
    elif kind == "outside":
        names = (in_turn(OUTSIDE, before, *key, 5),)
    return Plan(body, conditions, kind, names)


def _kind(turn: int, *key: int) -> tuple[str, int]:
    """Kind of a body's case, and how many of that kind came before it."""
    block, place = divmod(turn, len(BLOCK))
    order = generator(*key, block).permutation(len(BLOCK))
    kind = BLOCK[order[place]]
    return kind, sum(BLOCK[k] == kind for k in order[:place]) + block * BLOCK.count(kind)


def _pair(names: tuple[str, ...], turn: int, *key: int) -> tuple[str, str]:
    """Two effects; of an odd number of them one is left out in each round."""
    half = len(names) // 2
    cycle, place = divmod(turn, half)
    order = generator(*key, cycle).permutation(len(names))
    return names[order[2 * place]], names[order[2 * place + 1]]


def _anchors(rng: Rng, body: StudyBody, peeled: bool) -> tuple[str, ...]:
    sets = body.sets(peeled)
    counts = sorted({len(s) for s in sets})
    share = np.array([_COUNTS[count] for count in counts])
    count = int(rng.choice(counts, p=share / share.sum()))
    of_count = [s for s in sets if len(s) == count]
    return of_count[rng.integers(len(of_count))]


def _motions(rng: Rng, body: StudyBody, anchors: tuple[str, ...]) -> tuple[Motion, ...]:
    """Four or five actions, among them a pull, one across and a lift; one or more lead back, one may have a twist."""
    count = int(rng.integers(4, 6))
    names = [body.pull, str(rng.choice(body.across)), body.lift, *map(str, rng.choice(list(body.ways), count - 3))]
    order = rng.permutation(count)
    back = rng.random(count) < 0.25
    back[rng.integers(count)] = True
    twisted = int(rng.integers(count)) if rng.random() < 0.5 else -1
    common = log_uniform(rng, *SECONDS_PER_STEP)
    grasps = [grasp for grasp in body.grasps if not body.beside.get(grasp, frozenset()) & set(anchors)]
    crowded = len(grasps) < len(body.grasps)
    result = []
    for k, i in enumerate(order):
        steps = int(rng.integers(6, 11))
        way = body.ways[names[i]]
        amplitude = float(rng.uniform(*(way.crowded if crowded and way.crowded else way.reach)))
        seconds = common if rng.random() < 0.5 else log_uniform(rng, *SECONDS_PER_STEP)
        angle = float(rng.uniform(*body.twist) * rng.choice([-1, 1])) if k == twisted else 0.0
        steps += steps % 2 if back[k] else 0
        x, y, z = body.axis
        twist = (angle * x, angle * y, angle * z)
        grasp = str(rng.choice(grasps))
        result.append(Motion(grasp, names[i], way.along, amplitude, steps, bool(back[k]), twist, seconds))
    return tuple(result)


def _hidden(rng: Rng, name: str, case: Case, least: float) -> Hidden:
    target = log_uniform(rng, least, SIZES[1])
    weights, shapes, place = recipe(name, rng, case)
    return Hidden(name, target, weights, shapes, place)
