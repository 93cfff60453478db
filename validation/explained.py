"""Explaining a measurement from files into a run folder, as `bcid explain` does, for studies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bcid.base.collective import Comm
from bcid.base.options import ExplainOptions
from bcid.base.progress import Progress
from bcid.search.answer.comparison_job import explain_job
from bcid.search.answer.source import from_files


def run_explain(
    scene: Path,
    measurement: Path,
    folder: Path,
    options: ExplainOptions | None,
    comm: Comm,
    progress: Progress | None = None,
    overwrite: bool = False,
    files: Sequence[Path] = (),
    store: Path | None = None,
) -> Path:
    """Explain; collective on `comm`. Arguments as for `bcid.search.answer.job.Job.run`; returns the folder."""
    return explain_job(from_files(scene, measurement, files, comm), options).run(
        folder, comm, progress, overwrite, store
    )
