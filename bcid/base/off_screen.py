"""Pictures in three dimensions are drawn in memory, with or without a display."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyvista as pv


def off_screen(size: tuple[int, int], lighting: str) -> pv.Plotter:
    """An empty picture of so many pixels; `lighting` is "three lights" or "none"."""
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    # VTK warns of a missing display before it does without.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    return pv.Plotter(off_screen=True, window_size=list(size), lighting=lighting)
