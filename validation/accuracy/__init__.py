"""Accuracy against truths that bcid did not compute, a command each."""
