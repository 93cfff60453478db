"""Calibrations of two cameras that other programs wrote: what each file states, and in which conventions."""
