"""What was found, in the words of a report: names of models and effects, numbers, lists."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bcid.results.common_rows import ParameterRow
from bcid.results.diagnosis_record import DiagnosisRecord, ModelRow
from bcid.results.words import model_name, parameter_text, plain

# Characters that HTML does not allow, or that turn the text after them around.
_UNWANTED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")


def clean(text: str) -> str:
    """Text without characters that cannot be in a page."""
    return _UNWANTED.sub("\ufffd", text)


def steps_of(models: Sequence[ModelRow]) -> list[tuple[str, ModelRow]]:
    """Each model of a sequence, named by what it has beyond the one before, else by all it has."""
    steps, before = [], ""
    for rung in models:
        model = rung.model
        more = model.removeprefix(f"{before} + ") if before and model.startswith(f"{before} + ") else ""
        name = model_name(more or model)
        steps.append((f"+ {name}" if more else name, rung))
        before = model
    return steps


def falling(found: DiagnosisRecord) -> str:
    """The model sequence in one line: "neo-Hookean 1.42 mm → + gravity 0.205 mm (noise 0.2)"."""
    steps = [f"{name} {rung.rms:.3g} {found.length_unit}" for name, rung in steps_of(found.model_sequence)]
    return f"{' → '.join(steps)} (noise {found.noise_rms:.3g})"


def conclusion(found: DiagnosisRecord) -> str:
    """The verdict of a diagnosis in a few words, for a title."""
    if found.verdict == "unknown":
        return "none of the known effects explains it" if found.ranking else "the model is not adequate"
    if found.verdict == "none":
        if found.adequate is None:
            return "nothing is seen to be missing"
        fitted = list(found.law)
        return f"adequate with {listed(fitted)} fitted" if fitted else "the plain model is adequate"
    effects = " and ".join(plain(name) for name in found.verdict.split("+"))
    return f"adequate with {effects}" if found.adequate else f"missing: {effects}"


def patches(names: Sequence[str]) -> str:
    """ "patch 3", "patches 3 and 4", "no patch"."""
    if not names:
        return "no patch"
    return f"patch {names[0]}" if len(names) == 1 else f"patches {listed(names)}"


def listed(names: Sequence[str]) -> str:
    """ "1, 2 and 4"."""
    return str(names[-1]) if len(names) == 1 else f"{', '.join(map(str, names[:-1]))} and {names[-1]}"


def amount(name: str, number: ParameterRow) -> str:
    """A fitted number: "weight = 1257.6 ± 9.4 N/m³", "lag at most 0.02 (95 %)"; lengths in mm."""
    return parameter_text(plain(name), number).replace("^3", "³").replace("^2", "²")


def duration(seconds: float) -> str:
    """ "1 h 5 min", "3 min 20 s", "12 s"."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole % 3600 // 60
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {whole % 60} s" if minutes else f"{seconds:.1f} s"
