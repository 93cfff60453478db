"""Names and numbers in words, as summaries and reports say them."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.base.units import for_people, limited, p_value, uncertain
from bcid.results.common_rows import InputUncertaintyRow, ParameterRow
from bcid.results.diagnosis_record import SeparatingPull

# Verdicts that are no effects.
NO_EFFECTS = {
    "none": "nothing missing",
    "unknown": "something unknown",
    # In runs of format/1.
    "others": "effects that were not looked at",
}


# Adequacy of a model; None: no noise is stated.
ADEQUACY = {True: "adequate", False: "not adequate", None: "nothing against it"}


def plain(name: str) -> str:
    """A name of a law or an effect as it is read: "neo-Hookean", "soft anchor (3)"."""
    law, bracket, rest = name.partition(" (")
    return {"neo_hooke": "neo-Hookean"}.get(law, law.replace("_", " ").replace("(", " (")) + bracket + rest


def model_name(model: str) -> str:
    """The name of a model as it is read: "neo-Hookean + gravity"."""
    return " + ".join(plain(part) for part in model.split(" + "))


def parameter_text(name: str, number: ParameterRow) -> str:
    """A fitted number: "weight = 1257.6 ± 9.4 N/m^3", "lag at most 0.02 (95 %)"; lengths in mm."""
    if number.value is None:
        return f"{name} cannot be told"
    if number.limit is not None:
        return f"{name} {limited(number.value, number.limit, number.unit)}"
    return f"{name} = {uncertain(*for_people(number.value, number.stderr, number.unit))}"


def not_adequate_either(p: float) -> str:
    """That a model with the effects that are named does not explain all of a measurement, as its p-value says."""
    return f"With that the model is not adequate either ({p_value(p)}): something else may act besides, or instead."


def pull_text(pull: SeparatingPull, per_mm: float = 1e3) -> str:
    """As in "pull grasp I along +x by 8 mm"; `per_mm` is how many mm its unit of length is."""
    return f"grasp {pull.grasp} along {pull.direction} by {pull.distance * per_mm:.3g} mm"


def input_text(rows: Sequence[InputUncertaintyRow]) -> str:
    """What the scene may have wrong, and what of it these data make likely; "" where nothing is allowed for."""
    texts = ", ".join(one.text for one in rows if one.text)
    return (
        f"Allowed for in the scene, as standard deviations (and what these data make likely): {texts}." if texts else ""
    )


def exceeding(rows: Sequence[InputUncertaintyRow]) -> list[str]:
    """By how much more the scene is wrong than it says; in one short sentence where that are more than two inputs."""
    larger = [one for one in rows if one.exceeds_prior]
    if len(larger) <= 2:
        return [one.exceeds_prior for one in larger]
    short = ", ".join(one.exceeds_prior_short for one in larger)
    return [f"more would have to be wrong than the scene allows for (in brackets): {short}"]
