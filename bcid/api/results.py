"""Results: what a function of `bcid` found, or a run folder holds; shown in a notebook, drawn, or as a table."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.base.units import percent, unit_factor

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Result:
    """What was found: the same documents that a run folder holds.

    Attributes:
        documents: JSON objects, xarray datasets (SI) and texts by file name, as "identification.json". Lengths in JSON
            objects are in their `length_unit`; those of the attributes of this class are in m.
        command: the command whose run folder holds the same.
        path: the run folder it was read from, or None.
    """

    documents: Mapping[str, Any]
    command: str
    path: Path | None = None

    #: The JSON object that the verdict stands in.
    main: ClassVar[str] = ""

    @property
    def found(self) -> dict[str, Any]:
        """The JSON object that the verdict stands in."""
        content: dict[str, Any] = self.documents[self.main]
        return content

    @property
    def summary(self) -> str:
        """The result in plain sentences, as in summary.txt."""
        return str(self.documents["summary.txt"])

    @property
    def headline(self) -> str:
        """First line of the summary that is no remark."""
        lines = (line.strip() for line in self.summary.splitlines())
        return next((line for line in lines if line and not line.startswith("look at")), "")

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is odd about the measurement, to be looked at first."""
        return tuple(self.found.get("remarks", ()))

    @property
    def stiffness(self) -> dict[str, tuple[float, float]] | None:
        """Of each stiffness of the law its value by known forces and the standard error, Pa; None where none is measured.

        Those of a sheet of unknown thickness are times it, N/mm.
        """
        told = self.found.get("stiffness")
        return None if told is None else {name: (c["value"], c["stderr"]) for name, c in told["constants"].items()}

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline}>"

    def __str__(self) -> str:
        return self.summary

    def _repr_html_(self) -> str:
        """For notebooks: remarks and headline, the main table, and the whole summary to fold out."""
        doubts = "".join(f"<p><b>Look at this first:</b> {escape(text)}</p>" for text in self.remarks)
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
            run.write_documents(self.documents)
            run.finish({})
        return run.path

    def _dataset(self, name: str) -> xr.Dataset:
        data: xr.Dataset = self.documents[name]
        return data

    @property
    def _length(self) -> float:
        """Length unit of the JSON objects, m."""
        return unit_factor(str(self.found["length_unit"]), "m")

    def _metres(self, value: float | None) -> float | None:
        return None if value is None else value * self._length


def _shown(figure: Figure) -> Figure:
    """The figure, which notebooks show as a picture although it is none of pyplot's."""

    def png() -> bytes:
        with io.BytesIO() as stream:
            figure.savefig(stream, format="png", dpi=80)
            return stream.getvalue()

    figure.__dict__["_repr_png_"] = png
    return figure


def _set(names: Sequence[str]) -> str:
    return "{" + " ".join(names) + "}"


@dataclass(frozen=True)
class AnchorSet:
    """A set of anchored patches.

    Attributes:
        anchored: names of the patches.
        probability: of the set; an upper bound where it was not followed to the end.
        rms: RMS residual per coordinate, m.
    """

    anchored: tuple[str, ...]
    probability: float
    rms: float


class IdentifyResult(Result):
    """The anchored patches, and how sure that is."""

    main = "identification.json"

    @property
    def anchored(self) -> tuple[str, ...]:
        """Names of the anchored patches, in the scene's order."""
        return tuple(self.found["anchored"])

    @property
    def probability(self) -> float:
        """Probability of this set among all that were looked at."""
        return float(self.found["probability"])

    @property
    def patches(self) -> dict[str, float]:
        """Probability that each patch is anchored."""
        return dict(self.found["patches"])

    @property
    def rms(self) -> float:
        """RMS residual per coordinate, m."""
        return float(self.found["rms"]) * self._length

    @property
    def noise(self) -> float | None:
        """The stated noise per coordinate, m; None where none is stated."""
        return self._metres(self.found["noise_rms"])

    @property
    def missing(self) -> float | None:
        """Probability that something is missing in the model besides; None where the mesh is too large for that to be asked."""
        found = self.found.get("missing")
        return None if found is None else float(found)

    @property
    def certified(self) -> bool:
        """Whether every set of patches was looked at on the finest level used, and could be solved for."""
        return bool(self.found["certified"])

    @property
    def alternatives(self) -> tuple[AnchorSet, ...]:
        """The next best sets, best first."""
        return tuple(
            AnchorSet(tuple(a["anchored"]), float(a["probability"]), float(a["rms"]) * self._length)
            for a in self.found["alternatives"]
        )

    @property
    def classes(self) -> tuple[tuple[tuple[str, ...], ...], ...]:
        """The likely sets in classes that these data cannot tell apart; the first holds the reported set."""
        return tuple(tuple(tuple(names) for names in members) for members in self.found["classes"])

    @property
    def evaluations(self) -> dict[int, float]:
        """Forward trajectories by mesh level, in whole-trajectory equivalents."""
        return {int(level): float(count) for level, count in self.found["evaluations"].items()}

    @property
    def headline(self) -> str:
        """The set and its probability."""
        return f"anchored {_set(self.anchored)}, probability {percent(self.probability)}, misses by {self.rms * 1e3:.3g} mm"

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each set: patches, probability, RMS residual (m); the reported one first."""
        import pandas as pd

        sets = [AnchorSet(self.anchored, self.probability, self.rms), *self.alternatives]
        return pd.DataFrame([{"anchored": _set(s.anchored), "probability": s.probability, "rms": s.rms} for s in sets])

    def plot(self) -> Figure:
        """The body with its anchors, measured and predicted fiducials, and the probability of each patch."""
        from bcid.report.figure import styled
        from bcid.report.found import in_mm
        from bcid.report.identification_picture import summary_figure

        with styled():
            return _shown(summary_figure(in_mm(self.found), self._dataset("body.nc"), self._dataset("prediction.nc")))


@dataclass(frozen=True)
class LadderModel:
    """A model of the ladder.

    Attributes:
        model: its name, as "neo_hooke + gravity".
        anchored: names of the anchored patches.
        rms: RMS residual per coordinate, m.
        held_out_rms: the same where each action is predicted from the others, m, or None.
        adequate: whether noise and error of the mesh explain what is left; None where that cannot be told: no noise is stated.
        p_value: of that.
    """

    model: str
    anchored: tuple[str, ...]
    rms: float
    held_out_rms: float | None
    adequate: bool | None
    p_value: float


class DiagnosisResult(Result):
    """What `compare`, `diagnose`, `fit` and `explain` found: whether a model is adequate, and what it lacks."""

    main = "diagnosis.json"

    @property
    def verdict(self) -> str:
        """Effects that were adopted, joined by "+"; "none" or "unknown"."""
        return str(self.found["verdict"])

    @property
    def adequate(self) -> bool | None:
        """Whether noise and error of the mesh explain what the last model leaves; None where no noise is stated to tell that by."""
        return self.found["adequate"]

    @property
    def anchored(self) -> tuple[str, ...]:
        """Names of the anchored patches, in the scene's order."""
        return tuple(self.found["anchored"])

    @property
    def rms(self) -> float:
        """RMS residual of the last model per coordinate, m."""
        return float(self.found["rms"]) * self._length

    @property
    def noise(self) -> float:
        """Noise per coordinate, stated or estimated, m."""
        return float(self.found["noise_rms"]) * self._length

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Fitted numbers of the adopted effects by full name, as "gravity.weight": value, stderr and unit."""
        return {
            f"{effect['effect']}{'(' + effect['place'] + ')' if effect['place'] else ''}.{name}": dict(number)
            for effect in self.found["adopted"]
            for name, number in effect["parameters"].items()
        }

    @property
    def courses(self) -> list[dict[str, Any]]:
        """Amounts that change with time, as `diagnosis.json` has them: effect, place, amount, times (s), values, stderr, ..."""
        return [dict(row) for row in self.found.get("courses", ())]

    @property
    def ladder(self) -> tuple[LadderModel, ...]:
        """The models, the one that was begun with first."""
        return tuple(
            LadderModel(
                m["model"],
                tuple(m["anchored"]),
                float(m["rms"]) * self._length,
                self._metres(m["held_out_rms"]),
                m["adequate"],
                float(m["p_value"]),
            )
            for m in self.found["ladder"]
        )

    @property
    def begins(self) -> dict[str, Any] | None:
        """By when something unknown has begun, as `diagnosis.json` has it; None where nothing is told to begin."""
        return self.found.get("begins")

    @property
    def cannot_be_told_from(self) -> tuple[str, ...]:
        """Effects that explain as much as the one that was adopted."""
        return tuple(self.found["cannot_be_told_from"])

    @property
    def headline(self) -> str:
        """The last model, and whether it is adequate."""
        if self.command in ("explain", "propose"):
            return super().headline
        last = self.ladder[-1]
        word = {True: "adequate", False: "not adequate", None: "nothing against it"}[last.adequate]
        misses = f"misses by {last.rms * 1e3:.3g} mm (noise {self.noise * 1e3:.3g})"
        return f"{last.model}, anchors {_set(last.anchored)}: {misses}, {word}"

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each model of the ladder; lengths in m."""
        import pandas as pd

        return pd.DataFrame([vars(m) | {"anchored": _set(m.anchored)} for m in self.ladder])

    def effects(self) -> pd.DataFrame:
        """One row for each effect of the catalogue that was ranked, the most promising first; lengths in m."""
        import pandas as pd

        rows = []
        for row in self.found["ranking"]:
            lengths = {k: self._metres(row[k]) for k in ("expected_rms", "fitted_rms", "held_out_rms")}
            rows.append({k: row[k] for k in ("effect", "place", "score", "p_value", "power")} | lengths)
        return pd.DataFrame(rows)

    def plot(self) -> Figure:
        """The falling error beside the ranked effects where effects were ranked, else what the models miss."""
        from bcid.report.diagnosis_picture import residual_figure
        from bcid.report.figure import styled
        from bcid.report.found import in_mm
        from bcid.report.ladder import ladder_figure

        found = in_mm(self.found)
        with styled():
            if found["ranking"]:
                return _shown(ladder_figure(found))
            return _shown(residual_figure(found, self._dataset("body.nc"), self._dataset("residuals.nc")))


class ProposeResult(DiagnosisResult):
    """What `propose` found: terms beyond the catalogue, and how far the model is adequate with them."""

    @property
    def proposed(self) -> tuple[dict[str, Any], ...]:
        """The terms: effect, family, formula, place and parameters, each with value, stderr and unit; () for none."""
        return tuple(dict(term) for term in self._proposal["proposed"])

    @property
    def files(self) -> dict[str, str]:
        """Text of the Python file of each term, by the name of its effect."""
        return {term["effect"]: term["file"] for term in self._proposal["proposed"]}

    @property
    def complete(self) -> bool:
        """Whether something is proposed beside which hardly anything else (5 % at most) can be missing."""
        return bool(self._proposal["complete"])

    @property
    def _proposal(self) -> dict[str, Any]:
        found: dict[str, Any] = self.documents["proposal.json"]
        return found


class ExploreResult(Result):
    """What an exploration learnt, pull by pull."""

    main = "exploration.json"

    @property
    def anchored(self) -> tuple[str, ...]:
        """Names of the anchored patches of the likeliest hypothesis, in the scene's order."""
        return tuple(self.found["anchored"])

    @property
    def effect(self) -> str:
        """Effect of the likeliest hypothesis; "" for none."""
        return str(self.found["effect"])

    @property
    def probability(self) -> float:
        """Probability of the likeliest hypothesis."""
        return float(self.found["probability"])

    @property
    def patches(self) -> dict[str, float]:
        """Probability that each patch is anchored."""
        return dict(self.found["patches"])

    @property
    def reason(self) -> str:
        """Why it ended, as "decided"."""
        return str(self.found["reason"])

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each pull: grasp, direction, amplitude (m), bits expected and gained, what is likeliest after it."""
        import pandas as pd

        return pd.DataFrame([self._row(step) for step in self.found["steps"]])

    def _row(self, step: Mapping[str, Any]) -> dict[str, Any]:
        likeliest = step["belief"][0]
        told = {k: step[k] for k in ("number", "grasp", "direction", "expected_bits", "gained_bits")}
        amplitude = step["amplitude"] * self._length
        name = " + ".join([_set(likeliest["anchored"]), *filter(None, [likeliest["effect"]])])
        return told | {"amplitude": amplitude, "likeliest": name, "probability": likeliest["probability"]}

    def plot(self) -> Figure:
        """The belief after each pull, and the bits that were expected and gained."""
        from bcid.report.exploration_picture import belief_figure
        from bcid.report.figure import styled
        from bcid.report.found import in_mm

        with styled():
            return _shown(belief_figure(in_mm(self.found)))


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
            `Result.write`.

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
    documents = run.read_documents()
    if kind.main not in documents or "summary.txt" not in documents:
        raise InputError(f"{path}: {kind.main} or summary.txt is missing from the run; repeat it")
    return kind(documents, run.record["command"], run.path)
