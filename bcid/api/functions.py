"""The functions that `import bcid` gives: all take a scene and a measurement, or a robot, and may be given an MPI communicator."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from bcid.api.results import DiagnosisResult, ExploreResult, IdentifyResult, ProposeResult
from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError, nearest
from bcid.base.options import ExplainOptions, ExploreOptions, IdentifyOptions, ProposeOptions
from bcid.base.progress import Progress
from bcid.exploration import explore_run
from bcid.exploration.loop import check as check_exploration
from bcid.exploration.loop import explore as explore_with
from bcid.exploration.loop import gripper_scale, paired
from bcid.exploration.robots import Robot
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import check_geometry
from bcid.forms.mesh.patches import divided
from bcid.forms.model import Model, Term, check_physics
from bcid.grammar.proposal_job import ProposalJob, effect_names
from bcid.measurement import Measurement
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.scene import Scene
from bcid.search.answer.comparison_job import ComparisonJob, compare_job, diagnose_job, explain_job, fit_job
from bcid.search.answer.identification_job import IdentificationJob
from bcid.search.answer.source import Source, fitting

SceneLike = Scene | str | Path
MeasurementLike = Measurement | str | Path


def identify(
    scene: SceneLike,
    measurement: MeasurementLike,
    comm: Comm | None = None,
    options: IdentifyOptions | None = None,
    model: Model | None = None,
    refine: int = 0,
    progress: Progress | None = None,
) -> IdentifyResult:
    """Find the anchored patches; collective on `comm`, with the same result on any number of ranks.

    Args:
        scene: the body, or its scene file.
        measurement: what was seen, or its folder or file.
        comm: MPI communicator over which anchor sets are spread; COMM_SELF by default.
        options: how to search.
        model: the model; by default the scene's.
        refine: how many times patches that leave a doubt are halved.
        progress: told what is going on, as `bcid.base.progress.progress_on()` (give it on rank 0 only).

    Raises:
        InputError: scene, measurement or options cannot be used, or do not fit each other.
        SolveError: the forward model failed for every set.
    """
    comm = comm or _alone()
    job = IdentificationJob(*_inputs(scene, measurement, comm), options, refine, model)
    return IdentifyResult.of(job.made(comm, progress).documents, "identify")


def compare(
    scene: SceneLike,
    measurement: MeasurementLike,
    anchors: Iterable[str],
    comm: Comm | None = None,
    model: Model | None = None,
    free: Sequence[str] = (),
    level: int | None = None,
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Is a model adequate, and where does it fail? Collective on `comm`.

    Args:
        scene, measurement, comm, progress: as for `identify`.
        anchors: names of the anchored patches.
        model: the model; by default the scene's.
        free: numbers of the model to fit first, such as "young".
        level: of the ladder, that both meshes go by; by default the last with at most 40,000 unknowns.

    Raises:
        InputError: something cannot be used, or does not fit.
        SolveError: the model cannot be followed.
    """
    comm = comm or _alone()
    source = _source(scene, measurement, comm, model, anchors, free)
    return _done(compare_job(source, level), comm, progress)


def diagnose(
    scene: SceneLike,
    measurement: MeasurementLike,
    anchors: Iterable[str],
    comm: Comm | None = None,
    model: Model | None = None,
    free: Sequence[str] = (),
    effects: Iterable[Effect] = (),
    only: Sequence[str] | None = None,
    level: int | None = None,
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Which effect is missing in a model? Collective on `comm`.

    Args:
        scene, measurement, anchors, comm, model, free, level, progress: as for `compare`.
        effects: effects of your own beside the catalogue.
        only: names of the effects to look at; all by default.

    Raises:
        InputError, SolveError: as `compare`.
    """
    comm = comm or _alone()
    source = _source(scene, measurement, comm, model, anchors, free, effects)
    return _done(diagnose_job(source, level, only), comm, progress)


def fit(
    scene: SceneLike,
    measurement: MeasurementLike,
    anchors: Iterable[str],
    comm: Comm | None = None,
    model: Model | None = None,
    add: Iterable[Term | str] = (),
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
    effects: Iterable[Effect] = (),
    level: int | None = None,
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Add effects to a model, fit its numbers, and compare the errors; collective on `comm`.

    Args:
        scene, measurement, anchors, comm, model, level, progress: as for `compare`.
        add: effects, as `Term("gravity", {"weight": 9810.0})` or "gravity: weight = 9.81 kN/m^3", or just "gravity".
        free: further numbers to fit, such as "young".
        fixed: numbers to keep, such as "gravity.weight".
        effects: effects of your own beside the catalogue.

    Raises:
        InputError, SolveError: as `compare`.
    """
    comm = comm or _alone()
    source = _source(scene, measurement, comm, model, anchors, (), effects)
    terms = list(add)
    if not terms and not free:
        raise InputError('fit: nothing to do; name an effect, as add=["gravity"], or a number, as free=["young"]')
    return _done(fit_job(source, level, terms, free, fixed, "add"), comm, progress)


def explain(
    scene: SceneLike,
    measurement: MeasurementLike,
    comm: Comm | None = None,
    options: ExplainOptions | None = None,
    model: Model | None = None,
    effects: Iterable[Effect] = (),
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Anchors and missing effects, until the model is adequate or nothing explains the measurement; collective on `comm`.

    Args:
        scene, measurement, comm, progress: as for `identify`.
        options: how far to go.
        model: the model to begin with; by default the scene's.
        effects: effects of your own beside the catalogue.

    Raises:
        InputError, SolveError: as `identify`.
    """
    comm = comm or _alone()
    source = _source(scene, measurement, comm, model, None, (), effects)
    return _done(explain_job(source, options), comm, progress)


def propose(
    scene: SceneLike,
    measurement: MeasurementLike,
    comm: Comm | None = None,
    options: ProposeOptions | None = None,
    model: Model | None = None,
    name: str = "proposed_term",
    progress: Progress | None = None,
) -> ProposeResult:
    """Find a term beyond the catalogue that explains a measurement, and write it down as an effect; collective on `comm`.

    Args:
        scene, measurement, comm, progress: as for `identify`.
        options: how far to go.
        model: the model that terms are added to; by default the scene's.
        name: of the effect; a second one is called NAME_2.

    Raises:
        InputError, SolveError: as `identify`.
    """
    comm, chosen = comm or _alone(), options or ProposeOptions()
    chosen.check()
    names = effect_names(Path(f"{name}.py"), chosen.max_effects)
    source = _source(scene, measurement, comm, model, None, ())
    job = ProposalJob(source, source.model, chosen, tuple(names))
    return ProposeResult.of(job.made(comm, progress).documents, "propose")


def explore(
    scene: SceneLike,
    robot: Robot | None,
    comm: Comm | None = None,
    options: ExploreOptions | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
) -> ExploreResult:
    """Choose pulls, make them, and learn, until the anchors are decided or cannot be; collective on `comm`.

    Args:
        scene: the body with its [explore] limits, or its scene file.
        robot: makes the pulls (see `bcid.exploration.robots`); needed on rank 0 only.
        comm, progress: as for `identify`.
        options: how to go on.
        store: folder in which predictions are kept for later explorations; a temporary one by default.

    Raises:
        InputError: scene or options cannot be used.
        BcidError: whatever the robot raises.
    """
    comm, chosen = comm or _alone(), options or ExploreOptions()
    body = divided(_scene(scene, comm), comm)
    check_exploration(chosen, body)
    ladder = paired(body, chosen.level, comm)
    check_geometry(ladder, 0, comm)
    with TemporaryDirectory(prefix="bcid-") as folder:
        place = PredictionStore(store or Path(comm.bcast(folder)), comm, shared=True)
        gripper, levels = gripper_scale(chosen, body), range(len(ladder.levels))
        predictors = [PullPredictor(ladder, n, comm, place, progress=progress, gripper=gripper) for n in levels]
        try:
            finer = predictors[1] if len(predictors) > 1 else None
            found = explore_with(body, robot, chosen, predictors[0], finer, progress)
        finally:
            for predictor in predictors:
                predictor.destroy()
    return ExploreResult.of(explore_run.documents(body, chosen, found, predictors[0].level), "explore")


def _alone() -> Comm:
    """This process by itself."""
    from mpi4py import MPI

    return MPI.COMM_SELF


def _scene(scene: SceneLike, comm: Comm) -> Scene:
    if isinstance(scene, Scene):
        return scene
    path = Path(scene)
    return on_root(comm, lambda: Scene.read(path, physics=check_physics))


def _inputs(scene: SceneLike, measurement: MeasurementLike, comm: Comm) -> tuple[Scene, Measurement]:
    """Both, read where they are files; patches divided, with what is odd about the measurement."""
    body = _scene(scene, comm)
    if isinstance(measurement, Measurement):
        seen = measurement
    else:
        path = Path(measurement)
        seen = on_root(comm, lambda: Measurement.read(path))
    return fitting(body, seen, comm)


def _source(
    scene: SceneLike,
    measurement: MeasurementLike,
    comm: Comm,
    model: Model | None,
    anchors: Iterable[str] | None,
    free: Sequence[str],
    effects: Iterable[Effect] = (),
) -> Source:
    body, seen = _inputs(scene, measurement, comm)
    check_geometry(body, 0, comm)
    held = None if anchors is None else frozenset(anchors)
    for name in sorted((held or frozenset()) - set(body.patches)):
        raise InputError(f"anchors: patch '{name}' is not in the scene; {nearest(name, body.patches)}")
    begun = model or Model.of(body)
    for name in free:
        if name not in begun.constants():
            raise InputError(f"free: the model {begun.name} has no number '{name}'; {nearest(name, begun.constants())}")
    files = Path(body.source), Path(seen.source)
    return Source(*files, body, seen, begun, held, tuple(free), (), tuple(effects))


def _done(job: ComparisonJob, comm: Comm, progress: Progress | None) -> DiagnosisResult:
    return DiagnosisResult.of(job.made(comm, progress).documents, job.command)
