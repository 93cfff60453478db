"""A hypothesis on a measurement: its fit, its evidence, what ranks further effects beside it."""
