"""Deals out the trials of a study to ranks or supervised child processes, and reads their results back."""
