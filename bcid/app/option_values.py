"""Values of options as a user writes them."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.base.errors import InputError


def names_in(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def listed(text: str | None) -> tuple[str, ...] | None:
    """Names of effects separated by commas; None where the option is not given."""
    if text is None:
        return None
    names = names_in(text)
    if not names:
        raise InputError(f"--only '{text}': names no effect; give some, as --only gravity,soft_anchor")
    return names


def all_names(given: Sequence[str]) -> list[str]:
    """Names of an option that may be repeated, and each time give several separated by commas."""
    return [name for text in given for name in names_in(text)]


def noise_in(text: str | None, option: str = "--noise", unit: str = "m") -> float | None:
    """A standard deviation in a unit; None where the option is not given."""
    noise = quantity_in(text, option, unit)
    if noise is not None and noise < 0:
        raise InputError(f"{option} '{text}': must not be negative")
    return noise


def length_in(text: str | None, option: str) -> float | None:
    """A length, m; None where the option is not given."""
    return quantity_in(text, option, "m")


def quantity_in(text: str | None, option: str, unit: str) -> float | None:
    """A number in a unit; None where the option is not given."""
    from bcid.base.units import quantity

    try:
        return None if text is None else quantity(text, unit)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None


def direction_in(text: str | None) -> tuple[float, ...] | None:
    """Three numbers separated by commas or blanks; None where the option is not given."""
    if text is None:
        return None
    try:
        return tuple(float(number) for number in text.replace(",", " ").split())
    except ValueError:
        raise InputError(f"--direction '{text}': expected three numbers, as 0,0,1") from None


def random_state_in(number: int) -> int:
    if number < 0:
        raise InputError(f"--random-state {number}: must be at least 0")
    return number
