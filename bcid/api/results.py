"""Results: what a function of `bcid` found, or a run folder holds; shown in a notebook, drawn, or as a table."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.base.units import percent
from bcid.results.common_rows import ParameterRow, set_label
from bcid.results.diagnosis_record import DiagnosisRecord
from bcid.results.exploration_record import ExplorationRecord, ExplorationStep
from bcid.results.identification_record import IdentificationRecord
from bcid.results.proposal_record import ProposalRecord, ProposedTerm
from bcid.results.record import FileRecord, inside
from bcid.results.run_documents import read_documents, write_documents

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, kw_only=True)
class Result(FileRecord):
    """What was found: the content of the JSON file that the answer stands in, lengths in m, and the other files of its run.

    Attributes:
        documents: all files by name: records ("identification.json"), xarray datasets (SI) and texts.
        command: the command whose run folder holds the same.
        path: the run folder it was read from, or None.
    """

    documents: Mapping[str, Any] = inside()
    command: str = inside()
    path: Path | None = inside(default=None)

    @classmethod
    def of(cls, documents: Mapping[str, Any], command: str, path: Path | None = None) -> Self:
        """The result that the documents of a run are."""
        record: FileRecord = documents[cls.file].converted("m")
        return cls(**record.content(), documents=documents, command=command, path=path)

    @property
    def summary(self) -> str:
        """The result in plain sentences, as in summary.txt."""
        return str(self.documents["summary.txt"])

    @property
    def headline(self) -> str:
        """First line of the summary that is no remark."""
        lines = (line.strip() for line in self.summary.splitlines())
        return next((line for line in lines if line and not line.startswith("look at")), "")

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline}>"

    def __str__(self) -> str:
        return self.summary

    def _repr_html_(self) -> str:
        """For notebooks: remarks and headline, the main table, and the whole summary to fold out."""
        texts = getattr(self, "remarks", ())
        doubts = "".join(f"<p><b>Look at this first:</b> {escape(text)}</p>" for text in texts)
        table = self.to_dataframe().to_html(index=False, na_rep="", float_format="{:.4g}".format, border=0)
        folded = f"<details><summary>Summary</summary><pre>{escape(self.summary)}</pre></details>"
        return f"<div>{doubts}<p><b>{escape(self.headline)}</b></p>{table}{folded}</div>"

    def to_dataframe(self) -> pd.DataFrame:
        """The main table, lengths in m; each class says what its rows are."""
        raise NotImplementedError

    def plot(self) -> Figure:
        """The picture of the result, as in the run folder.

        Raises:
            ImportError: matplotlib or pyvista is not installed (the extra "report").
        """
        raise NotImplementedError

    def write(self, folder: str | Path) -> Path:
        """Write the documents into a new folder, from which `bcid.load` and `bcid report` read them.

        Raises:
            InputError: the folder exists and holds something.
            MachineError: it cannot be written.
        """
        run = RunFolder.start(folder, self.command, {"from": "python"}, makes=list(self.documents))
        with run.watched():
            write_documents(run, self.documents)
            run.finish({})
        return run.path

    def _dataset(self, name: str) -> xr.Dataset:
        data: xr.Dataset = self.documents[name]
        return data


def _shown(figure: Figure) -> Figure:
    """The figure, which notebooks show as a picture although it is none of pyplot's."""

    def png() -> bytes:
        with io.BytesIO() as stream:
            figure.savefig(stream, format="png", dpi=80)
            return stream.getvalue()

    figure.__dict__["_repr_png_"] = png
    return figure


@dataclass(frozen=True, repr=False, kw_only=True)
class IdentifyResult(Result, IdentificationRecord):
    """The anchored patches, and how certain they are: all that `identification.json` holds, lengths in m."""

    @property
    def headline(self) -> str:
        """The set and its probability."""
        return f"anchored {set_label(self.anchored)}, probability {percent(self.probability)}, misses by {self.rms * 1e3:.3g} mm"

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each set: patches, probability, RMS residual (m); the reported one first."""
        import pandas as pd

        rows = [
            {"anchored": set_label(s.anchored), "probability": s.probability, "rms": s.rms} for s in self.alternatives
        ]
        first = {"anchored": set_label(self.anchored), "probability": self.probability, "rms": self.rms}
        return pd.DataFrame([first, *rows])

    def plot(self) -> Figure:
        """The body with its anchors, measured and predicted markers, and the probability of each patch."""
        from bcid.report.figure import styled
        from bcid.report.identification_picture import summary_figure

        with styled():
            body, prediction = self._dataset("body.nc"), self._dataset("prediction.nc")
            return _shown(summary_figure(self.converted("mm"), body, prediction))


@dataclass(frozen=True, repr=False, kw_only=True)
class DiagnosisResult(Result, DiagnosisRecord):
    """What `compare`, `diagnose`, `fit` and `explain` found: all that `diagnosis.json` holds, lengths in m."""

    @property
    def parameters(self) -> dict[str, ParameterRow]:
        """Fitted numbers of the selected effects by full name, as "gravity.weight"."""
        return {
            f"{one.effect}{f'({one.place})' if one.place else ''}.{name}": number
            for one in self.selected_effects
            for name, number in one.parameters.items()
        }

    @property
    def headline(self) -> str:
        """The last model, and whether it is adequate."""
        if self.command in ("explain", "propose"):
            return super().headline
        last = self.model_sequence[-1]
        word = {True: "adequate", False: "not adequate", None: "nothing against it"}[last.adequate]
        misses = f"misses by {last.rms * 1e3:.3g} mm (noise {self.noise_rms * 1e3:.3g})"
        return f"{last.model}, anchors {set_label(last.anchored)}: {misses}, {word}"

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each model of the model sequence; lengths in m."""
        import pandas as pd

        return pd.DataFrame([one.content() | {"anchored": set_label(one.anchored)} for one in self.model_sequence])

    def effects(self) -> pd.DataFrame:
        """One row for each effect of the catalogue that was ranked, the most promising first; lengths in m."""
        import pandas as pd

        names = ("effect", "place", "score", "p_value", "power", "expected_rms", "fitted_rms", "held_out_rms")
        return pd.DataFrame([{name: getattr(row, name) for name in names} for row in self.ranking])

    def plot(self) -> Figure:
        """The falling error beside the ranked effects where effects were ranked, else what the models miss."""
        from bcid.report.diagnosis_picture import residual_figure
        from bcid.report.figure import styled
        from bcid.report.models_chart import models_figure

        found = self.converted("mm")
        with styled():
            if found.ranking:
                return _shown(models_figure(found))
            return _shown(residual_figure(found, self._dataset("body.nc"), self._dataset("residuals.nc")))


@dataclass(frozen=True, repr=False, kw_only=True)
class ProposeResult(DiagnosisResult):
    """What `propose` found: terms beyond the catalogue, and how far the model is adequate with them."""

    @property
    def proposal(self) -> ProposalRecord:
        """All that `proposal.json` holds, lengths in m."""
        record: ProposalRecord = self.documents[ProposalRecord.file].converted("m")
        return record

    @property
    def proposed(self) -> tuple[ProposedTerm, ...]:
        """The terms; () for none."""
        return self.proposal.proposed

    @property
    def files(self) -> dict[str, str]:
        """Text of the Python file of each term, by the name of its effect."""
        return {term.effect: term.file for term in self.proposed}

    @property
    def complete(self) -> bool:
        """Whether something is proposed beside which hardly anything else (5 % at most) can be missing."""
        return self.proposal.complete


@dataclass(frozen=True, repr=False, kw_only=True)
class ExploreResult(Result, ExplorationRecord):
    """What an exploration learnt, pull by pull: all that `exploration.json` holds, lengths in m."""

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each pull: grasp, direction, amplitude (m), bits expected and gained, what is likeliest after it."""
        import pandas as pd

        return pd.DataFrame([_pull_row(step) for step in self.steps])

    def plot(self) -> Figure:
        """The posterior after each pull, and the bits that were expected and gained."""
        from bcid.report.exploration_picture import posterior_figure
        from bcid.report.figure import styled

        with styled():
            return _shown(posterior_figure(self.converted("mm")))


def _pull_row(step: ExplorationStep) -> dict[str, Any]:
    likeliest = step.posterior[0]
    names = ("number", "grasp", "direction", "expected_bits", "gained_bits", "amplitude")
    return {key: getattr(step, key) for key in names} | {
        "likeliest": likeliest.label,
        "probability": likeliest.probability,
    }


_KINDS: dict[str, type[Result]] = {
    "identify": IdentifyResult,
    "explore": ExploreResult,
    **dict.fromkeys(("compare", "diagnose", "fit", "explain"), DiagnosisResult),
    "propose": ProposeResult,
}


def load(path: str | Path) -> Result:
    """The result that a finished run folder holds.

    Args:
        path: a folder written by `bcid identify`, `compare`, `diagnose`, `fit`, `explain`, `propose` or `explore`, or by
            `Result.write`; of this version, or of one that wrote format/1.

    Raises:
        InputError: it is no run, is damaged, has not finished, or holds a result of another kind.
    """
    run = RunFolder.finished(path)
    kind = _KINDS.get(run.record["command"])
    if kind is None:
        raise InputError(
            f"{path}: holds a run of '{run.record['command']}'; results are loaded of {', '.join(_KINDS)}. "
            "Its files are JSON, NetCDF and CSV"
        )
    run.check()
    documents = read_documents(run)
    if kind.file not in documents or "summary.txt" not in documents:
        raise InputError(f"{path}: {kind.file} or summary.txt is missing from the run; repeat it")
    return kind.of(documents, run.record["command"], run.path)
