"""`bcid compare`, `diagnose`, `fit` and `explain` as jobs: what each does with a model and its measurement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from bcid.base.collective import Comm
from bcid.base.options import ExplainOptions, check_level
from bcid.base.progress import Progress
from bcid.forms.model import Term
from bcid.predict.predictor import Predictor
from bcid.predict.store import CHECKPOINT, PredictionStore
from bcid.search.answer.diagnosis import Diagnosis, check_terms, compared, diagnosed, explained, on_predictor, refitted
from bcid.search.answer.job import Job, Made
from bcid.search.answer.output import collect, documents
from bcid.search.answer.source import Source, find_effect
from bcid.search.answer.written_term import parsed_term

_RECORDS = ("diagnosis.json", "model.json", "identification.json", "discrepancy.json", "residuals.nc", "body.nc")
MAKES = (
    *(*_RECORDS, "summary.txt"),
    *("picture.png", "models.png", "discrepancy.png", "paraview/", "report.html", f"{CHECKPOINT}/"),
)


@dataclass(frozen=True)
class ComparisonJob(Job):
    """What is to be done with a model and its measurement.

    Attributes:
        command: "compare", "diagnose", "fit" or "explain".
        source: model and measurement.
        level: of the mesh hierarchy; by default the last with at most 40,000 unknowns.
        options: as the run folder has them.
        work: does it; collective.
        makes: files and folders of the run folder.
    """

    command: str
    source: Source
    level: int | None
    options: dict[str, Any]
    work: Callable[[Predictor, Source], Diagnosis]
    makes: tuple[str, ...] = MAKES

    main, told = "diagnosis.json", ("adequate", "verdict", "anchored", "rms", "noise_rms")

    @property
    def inputs(self) -> dict[str, Any]:
        """Fingerprints, model and options."""
        return self.source.inputs(self.options)

    @property
    def store_inputs(self) -> dict[str, Any]:
        """The effects of files."""
        return {"effects": self.inputs["effects"]}

    def made(self, comm: Comm, progress: Progress | None = None, store: PredictionStore | None = None) -> Made:
        """The diagnosis; collective on `comm`."""

        def use(predictor: Predictor, here: Source, done: Diagnosis) -> Made:
            content = collect(predictor, done)
            return Made(documents(here, done, content), notes(here, predictor, content))

        return on_predictor(self.source, comm, self.level, progress, self.work, use, store)


def notes(source: Source, predictor: Predictor, content: dict[str, Any]) -> dict[str, Any]:
    """What `run.json` holds of a diagnosis besides; `content` is what `bcid.search.answer.output.collect` gave."""
    found = {
        "names": {"scene": str(source.scene_file), "measurement": str(source.measurement_file)},
        "ranks": predictor.comm.size,
        "trajectories": {k: round(v, 3) for k, v in predictor.trajectories.items()},
        "mesh": content["mesh"].fingerprint(),
    }
    if predictor.store is not None:
        found["steps"] = {"computed": predictor.store.computed, "recalled": predictor.store.recalled}
    return found


def compare_job(source: Source, level: int | None = None) -> ComparisonJob:
    """Is the source's model adequate with its anchors, and where does it fail?

    Raises:
        InputError: the scene has no such level.
    """
    check_level(level, source.scene, "--level")
    return ComparisonJob("compare", source, level, {"level": level}, compared)


def diagnose_job(source: Source, level: int | None = None, only: Sequence[str] | None = None) -> ComparisonJob:
    """Which effect is missing in the source's model? `only` names the effects to look at; all by default.

    Raises:
        InputError: an effect or the level is not known.
    """
    check_level(level, source.scene, "--level")
    for name in only or ():
        find_effect(name, source.own)
    options = {"level": level, "only": list(only) if only else None}
    return ComparisonJob("diagnose", source, level, options, partial(diagnosed, only=only))


def fit_job(
    source: Source,
    level: int | None = None,
    add: Sequence[Term | str] = (),
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
    where: str = "--add",
) -> ComparisonJob:
    """Add effects to the source's model, fit its numbers, and compare the errors.

    Args:
        source, level: as for `compare_job`.
        add: effects, as terms or as `bcid.search.answer.written_term.parsed_term` reads them.
        free: further numbers to fit, such as "young".
        fixed: numbers to keep, such as "gravity.weight".
        where: what messages call the place of `add`.

    Raises:
        InputError: an effect, a number or the level is not known.
    """
    check_level(level, source.scene, "--level")
    terms = [parsed_term(one, source, where) if isinstance(one, str) else one for one in add]
    check_terms(source, terms, free, fixed)
    options = {"level": level, "add": [str(one) for one in add], "free": list(free), "fixed": list(fixed)}
    return ComparisonJob("fit", source, level, options, partial(refitted, terms=terms, free=free, fixed=fixed))


def explain_job(source: Source, options: ExplainOptions | None = None) -> ComparisonJob:
    """Anchors and missing effects, until the model is adequate or nothing explains the measurement.

    Raises:
        InputError: an effect or the level is not known.
    """
    chosen = options or ExplainOptions()
    check_level(chosen.level, source.scene, "--level")
    for name in chosen.only or ():
        find_effect(name, source.own)
    # Where no known effect explains the measurement, a term that does is looked for in a folder of its own.
    makes = (*MAKES, "propose/")
    return ComparisonJob("explain", source, chosen.level, asdict(chosen), partial(explained, options=chosen), makes)
