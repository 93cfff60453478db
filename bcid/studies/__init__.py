"""Studies: what bcid is worth, found out on many made-up bodies whose truth is known."""
