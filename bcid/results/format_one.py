"""JSON files of runs of version 0.2 and before, format/1: their keys in those of format/2."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Keys that mean the same at any depth of a file.
_EVERYWHERE = {
    "looked_at": "evaluated",
    "unfollowed": "not_converged",
    "missing": "discrepancy_probability",
    "astray": "outliers",
    "explains": "adequate",
    "nuisances": "input_uncertainties",
    "likely": "estimate",
    "most_sigmas": "largest_sigmas",
    "used_up": "exceeds_prior",
    "used_up_briefly": "exceeds_prior_short",
    "best_rms": "reported_rms",
    "rough_rms": "noise_like_rms",
    "adopted": "selected_effects",
    "courses": "time_histories",
    "stderr_apart": "stderr_from_mean",
    "cannot_be_told_from": "ambiguous_with",
    "off": "shift",
    "open_bits": "entropy",
    "ladder": "model_sequence",
    "probabilities": "posterior",
    "neglected": "unfitted_probability",
    "begins": "change_point",
    "noise_doubt": "noise_warning",
    "explained": "explained_fraction",
    "missed": "normalised_rms",
    "amounts": "parameters",
    "belief": "posterior",
    "expected_error": "expected_stderr",
    "error": "expected_stderr",
    "bits": "expected_bits",
    "before": "outbound",
    "entered": "selected",
    "competed": "candidates",
}
# Tables whose keys are names of the user.
_NAMED = frozenset(
    (
        *("patches", "effects", "evaluations", "failures", "contributions", "curvature", "parameters", "growing"),
        *("refined", "action", "fiducial", "step", "axis", "law", "constants", "not_applicable"),
    )
)


def upgraded(content: Any) -> Any:
    """The content of a file of format/1 with the keys of format/2."""
    return _renamed(content, False)


def _renamed(content: Any, named: bool) -> Any:
    if isinstance(content, Mapping):
        keys = {key: key if named else _EVERYWHERE.get(key, key) for key in content}
        return {keys[key]: _renamed(value, not named and keys[key] in _NAMED) for key, value in content.items()}
    return [_renamed(value, False) for value in content] if isinstance(content, list) else content
