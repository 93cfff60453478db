"""What is asked of the diagnosis of a case, and whether it is right."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from bcid.base.units import unit_factor
from validation.synthetic.amounts import HALF, intervals_hold, parameters_right

Json = Mapping[str, Any]
# For each question the answers that were right or wrong; none where it is not asked.
Verdicts = dict[str, tuple[bool, ...]]

# From this size on, in units of noise, an effect must be found; a smaller one may be.
VISIBLE = 3.0
HELD_OUT = 1.2
# An answer told with less is open.
SURE = 0.95

_ALL = ("none", "one", "two", "outside")
# What is right, by question.
QUESTIONS = {
    "named": "one effect: the verdict is that effect",
    "first": "one effect: it is ranked first",
    "first two": "one effect: it is among the first two",
    "parameters": "one effect: amounts within 20 %, directions within 15 deg, places right",
    "intervals": "amounts of effects that were named rightly: the 95 % interval holds the truth",
    "stiffness": "forces: the 95 % interval of the stiffness holds the truth",
    "held out": "one, two or none: held-out error at most 1.2 times the noise",
    "held out, mesh": "the same of the noise and the told error of the mesh together",
    "adequate": "nothing hidden: the model is called adequate",
    "not misnamed": "outside the catalogue: the verdict is 'unknown', or 'none'",
    "both": "two effects: the verdict names both",
    "anchors": "the anchored patches are right, where that is asked",
    "settled": "the anchored patches are right to the last, or told with less than 95 %",
    "no false name": "the verdict names no effect that is not hidden",
    "noise told": "a noise that is stated wrongly is doubted",
    "noise trusted": "a noise that is stated rightly is not doubted",
}


def judge(result: Json) -> Verdicts:
    """The answers of a case to each question. A case without a diagnosis is wrong in all that it is asked."""
    truth, diagnosis = result["truth"], result["diagnosis"]
    verdicts: Verdicts = dict.fromkeys(QUESTIONS, ())
    if truth is None:
        return verdicts
    for question, (asked, answer) in _JUDGES.items():
        if asked(truth):
            verdicts[question] = (False,) if diagnosis is None else _answers(answer(truth, diagnosis))
    return verdicts


def _answers(found: bool | tuple[bool, ...] | None) -> tuple[bool, ...]:
    return () if found is None else found if isinstance(found, tuple) else (found,)


def named(diagnosis: Json) -> list[str]:
    """Effects of the verdict without their places, sorted: "gravity+soft_anchor(7)" gives gravity, soft_anchor."""
    return sorted(part.split("(")[0].strip() for part in str(diagnosis["verdict"]).split("+"))


def hidden(truth: Json) -> list[str]:
    """Names of the hidden effects, sorted; ["none"] if there is none."""
    return sorted(effect["effect"] for effect in truth["effects"]) or ["none"]


def ranked(diagnosis: Json, count: int) -> list[str]:
    """The first names of the ranking, each once."""
    names = [entry["effect"] for entry in diagnosis["ranking"]]
    return list(dict.fromkeys(str(name).split("(")[0].strip() for name in names))[:count]


def verdict_right(truth: Json, diagnosis: Json) -> bool:
    """Whether the verdict is right: it names what must be found and nothing that is not hidden.

    What is outside the catalogue is unknown. What is smaller than 3 noises may be missed.
    """
    found = set(named(diagnosis))
    must = {effect["effect"] for effect in truth["effects"] if effect["size"] >= VISIBLE}
    if truth["kind"] == "outside":
        return found == {"unknown"} or (found == {"none"} and not must)
    return must <= found - {"none"} <= set(hidden(truth))


def anchors_right(truth: Json, diagnosis: Json) -> bool:
    """Whether the anchored patches are the true ones, but for those that are not asked."""
    return not (set(diagnosis["anchored"]) ^ set(truth["anchored"])) - set(truth["not_asked"])


def set_right(truth: Json, diagnosis: Json) -> bool:
    """Whether the anchored patches are the true ones to the last: what its told probability is of."""
    return set(diagnosis["anchored"]) == set(truth["anchored"])


def _named(truth: Json, diagnosis: Json) -> bool:
    return named(diagnosis) == hidden(truth)


def _among(count: int) -> Callable[[Json, Json], bool]:
    return lambda truth, diagnosis: hidden(truth)[0] in ranked(diagnosis, count)


def _held_out(truth: Json, diagnosis: Json, mesh: float = 0.0) -> bool:
    """Compared with the true noise, whatever is stated, and an error of the mesh (in the unit of the diagnosis) besides."""
    error = diagnosis.get("held_out_rms")
    unit = unit_factor(diagnosis.get("length_unit", "mm"), "m")
    return error is not None and error * unit <= HELD_OUT * math.hypot(truth["noise"], mesh * unit)


def _held_out_beside_mesh(truth: Json, diagnosis: Json) -> bool:
    """The error of the mesh that is told may be left in what is predicted."""
    return _held_out(truth, diagnosis, diagnosis.get("discretisation_rms") or 0.0)


def _intervals(truth: Json, diagnosis: Json) -> tuple[bool, ...]:
    wrong = set(named(diagnosis)) - set(hidden(truth))
    return () if wrong else intervals_hold(truth, diagnosis)


def _stiffness(truth: Json, diagnosis: Json) -> bool:
    told = diagnosis.get("stiffness") or {"constants": {}}
    return bool(told["constants"]) and all(
        abs(c["value"] - truth["stiffness"] * c["scene"]) <= HALF * c["stderr"] for c in told["constants"].values()
    )


def _settled(truth: Json, diagnosis: Json) -> bool:
    told = diagnosis.get("anchors_probability")
    if told is not None and told >= SURE:
        return set_right(truth, diagnosis)
    return told is not None or anchors_right(truth, diagnosis)


def _no_false_name(truth: Json, diagnosis: Json) -> bool:
    return set(named(diagnosis)) <= {*hidden(truth), "none", "unknown"}


def _doubted(wanted: bool) -> Callable[[Json, Json], bool | None]:
    """Not asked of a diagnosis that never says whether it doubts the noise."""
    return lambda truth, diagnosis: bool(diagnosis["noise_warning"]) == wanted if "noise_warning" in diagnosis else None


def _of(*kinds: str) -> Callable[[Json], bool]:
    return lambda truth: truth["kind"] in kinds


def _stated(*ways: str) -> Callable[[Json], bool]:
    return lambda truth: truth["conditions"]["noise"] in ways


_JUDGES: dict[str, tuple[Callable[[Json], bool], Callable[[Json, Json], bool | tuple[bool, ...] | None]]] = {
    "named": (_of("one"), _named),
    "first": (_of("one"), _among(1)),
    "first two": (_of("one"), _among(2)),
    "parameters": (_of("one"), parameters_right),
    "intervals": (_of("one", "two"), _intervals),
    "stiffness": (lambda truth: truth.get("stiffness") is not None, _stiffness),
    "held out": (_of("none", "one", "two"), _held_out),
    "held out, mesh": (_of("none", "one", "two"), _held_out_beside_mesh),
    "adequate": (_of("none"), lambda truth, diagnosis: bool(diagnosis["adequate"]) and named(diagnosis) == ["none"]),
    "not misnamed": (_of("outside"), lambda truth, diagnosis: named(diagnosis) in (["unknown"], ["none"])),
    "both": (_of("two"), _named),
    "anchors": (_of(*_ALL), anchors_right),
    "settled": (_of(*_ALL), _settled),
    "no false name": (_of(*_ALL), _no_false_name),
    "noise told": (_stated("half", "double"), _doubted(True)),
    "noise trusted": (_stated("right"), _doubted(False)),
}
