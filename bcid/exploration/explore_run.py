"""`bcid explore` as a job: read, check, explore, and write everything into a run folder."""

from __future__ import annotations

import itertools
import math
import shutil
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.inside_folder import refuse_links
from bcid.base.options import ExploreOptions
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running, sealed, unsealed
from bcid.exploration.loop import (
    Exploration,
    Step,
    check,
    explore,
    gripper_scale,
    paired,
    posterior_before,
)
from bcid.exploration.moves import Move
from bcid.exploration.posterior_summary import PosteriorSummary, prior_effects
from bcid.exploration.robots import Folder, Robot, Simulated
from bcid.forms.forward import check_geometry
from bcid.forms.mesh import level_mesh
from bcid.forms.mesh.check import measures
from bcid.forms.mesh.patches import divided
from bcid.forms.model import check_physics
from bcid.forms.written_effects import with_effects
from bcid.inference.hypotheses import Hypothesis, entropy
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Measurement
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.results.common_rows import ParameterRow
from bcid.results.exploration_record import (
    ExcludedPull,
    ExplorationHypothesis,
    ExplorationRecord,
    ExplorationStep,
    PosteriorHypothesis,
    PullOption,
)
from bcid.results.run_documents import write_documents
from bcid.results.summary import exploration_summary
from bcid.scene import Scene

SIMULATED, FOLDER = "simulated", "folder"
MAKES = ("steps/", "predictions/", "exploration.json", "summary.txt", "posterior.png")


def run_exploration(
    scene_file: Path,
    robot: str,
    folder: Path,
    options: ExploreOptions,
    comm: Comm,
    progress: Progress | None = None,
    overwrite: bool = False,
    store: Path | None = None,
    wait: float = 3600.0,
    hidden: Sequence[str] = (),
) -> Path:
    """Explore and write the run folder; collective on `comm`. Returns the folder.

    Everything is validated before the folder is touched. An exploration that was interrupted goes on with the pulls that it has
    made.

    Args:
        scene_file: with an [explore] table.
        robot: "simulated:3,4" (anchors, on the finest level of the scene) or "folder:DIR" (see `bcid.exploration.robots.Folder`).
        store: folder for predictions, which may be shared by runs; inside the run folder by default.
        wait: how long a folder is waited for, s.
        hidden: effects that the simulated body has and the scene does not, as "fibres: k1 = 5 kPa, angle = 30 deg".

    Raises:
        BcidError: see `Scene.read`, `bcid.exploration.loop.explore`, `RunFolder.start`, and the robots.
    """
    progress = progress or Silent()
    scene = divided(on_root(comm, lambda: Scene.read(scene_file, physics=check_physics)), comm)
    check(options, scene)
    kind, about = _robot_kind(robot, scene)
    body = with_effects(scene, hidden)
    if hidden and kind != SIMULATED:
        raise InputError(f"--true-effect '{hidden[0]}': belongs to a simulated robot")
    ladder = paired(scene, options.level, comm)
    check_geometry(ladder, 0, comm)
    inputs = {"scene": scene.fingerprint(), "robot": robot, "plan": asdict(options)}
    if hidden:
        inputs["hidden"] = list(hidden)
    place = store or folder / "predictions"
    predictions, gripper = PredictionStore(place, comm, shared=True), gripper_scale(options, scene)
    predictors = [
        PullPredictor(ladder, n, comm, predictions, progress=progress, gripper=gripper)
        for n in range(len(ladder.levels))
    ]
    hypotheses = posterior_before(scene, options, predictors[0], predictions)
    mover = None
    try:
        with running(comm, folder, "explore", inputs, MAKES, overwrite) as run:
            made = on_root(comm, lambda: _made(folder))
            if made:
                progress.say(f"going on with an interrupted exploration: {len(made)} pulls are there already")
            if comm.rank == 0:
                mover = _robot(kind, about, body, options, place, wait)
            found = explore(
                scene,
                mover,
                options,
                predictors[0],
                predictors[1] if len(predictors) > 1 else None,
                progress,
                made,
                (lambda move, seen: _keep(folder, move, seen)),
                posterior=hypotheses,
            )
            on_root(comm, lambda: _write(run, scene, options, found, predictors, str(scene_file), comm.size))
    finally:
        hypotheses.predictors.destroy()
        for predictor in predictors:
            predictor.destroy()
        if isinstance(mover, Simulated):
            mover.predictor.destroy()
    return folder


# -- the robot
# ------------------------------------------------------------------------------------------------------------------


def _robot_kind(text: str, scene: Scene) -> tuple[str, str]:
    kind, colon, about = text.partition(":")
    if not colon or kind not in (SIMULATED, FOLDER) or (kind == FOLDER and not about):
        raise InputError(f"--robot '{text}': expected simulated:1,2 (anchored patches) or folder:DIR")
    if kind == SIMULATED:
        for name in _names(about):
            if name not in scene.patches:
                raise InputError(
                    f"--robot '{text}': patch '{name}' is not in the scene; it has {', '.join(scene.patches)}"
                )
    return kind, about


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _robot(kind: str, about: str, scene: Scene, options: ExploreOptions, store: Path, wait: float) -> Robot:
    from mpi4py import MPI

    if kind == FOLDER:
        return Folder(Path(about), scene, wait)
    noise = options.noise if options.noise is not None else scene.noise_sigma or 0.0
    known = PredictionStore(store, MPI.COMM_SELF, shared=True)
    body = PullPredictor(scene, len(scene.levels) - 1, MPI.COMM_SELF, known, gripper=gripper_scale(options, scene))
    return Simulated(body, _names(about), noise, options.seed, options.wrench_noise or 0.0)


# -- the run folder
# ------------------------------------------------------------------------------------------------------------------


def _keep(folder: Path, move: Move, seen: Measurement) -> None:
    """Keep a pull: the measurement, then what was asked for, which makes it complete."""
    place = folder / "steps"
    number = len(list(place.glob("*/move.json"))) + 1
    step = place / f"{number:04d}"
    shutil.rmtree(step, ignore_errors=True)
    seen.write(step / "measurement")
    about = {"move": asdict(move), "measurement": Measurement.read(step / "measurement").fingerprint()}
    RunFolder.open(folder).write_json(f"steps/{number:04d}/move.json", sealed(about))


def _made(folder: Path) -> list[tuple[Move, Measurement]]:
    """The pulls that an interrupted exploration has made, as far as they are complete."""
    found, remedy = [], "start the exploration anew with --overwrite"
    refuse_links(folder / "steps")
    for file in sorted((folder / "steps").glob("*/move.json")):
        about = unsealed(file, remedy)
        seen = Measurement.read(file.parent / "measurement")
        if seen.fingerprint() != about["measurement"]:
            raise InputError(f"{file.parent / 'measurement'}: is damaged: it is not what was seen; {remedy}")
        found.append((Move(**about["move"]), seen))
    return found


def _write(
    run: RunFolder | None,
    scene: Scene,
    options: ExploreOptions,
    found: Exploration,
    predictors: list[PullPredictor],
    source: str,
    ranks: int,
) -> None:
    assert run is not None
    content = documents(scene, options, found, predictors[0].level)
    write_documents(run, content)
    result = content["exploration.json"].to_json()
    evaluations = {str(p.level): p.evaluations for p in predictors}
    run.record |= {"names": {"scene": source}, "ranks": ranks, "evaluations": evaluations}
    run.record["tangents"] = sum(p.tangents for p in predictors)
    run.finish({key: result[key] for key in ("reason", "anchored", "effect", "probability")})


def documents(scene: Scene, options: ExploreOptions, found: Exploration, level: int) -> dict[str, Any]:
    """What a run folder holds of an exploration, by file name: JSON objects and texts."""
    body = tuple(measures(scene, level_mesh(scene, scene.levels[level])))
    record = replace(exploration_record(scene, options, found), body=body)
    return {"exploration.json": record, "summary.txt": exploration_summary(record)}


def exploration_record(scene: Scene, options: ExploreOptions, found: Exploration) -> ExplorationRecord:
    """The content of `exploration.json`, lengths in mm."""
    view, telling = found.view, telling_pull(options, found)
    bits = effect_bits(options, found) if options.consider else [None] * len(found.steps)
    record = ExplorationRecord(
        reason=found.reason,
        anchored=_sorted(view.best.anchors, scene),
        effect=view.best.effect,
        probability=view.certainty,
        patches=view.patches,
        effects=view.effects,
        parameters=parameters(view),
        entropy=view.entropy,
        rms=_finite(view.rms),
        normalised_rms=_finite(view.missed),
        discrepancy_probability=view.missing,
        adequate=view.missing < THRESHOLDS.credible,
        stiffness=view.stiffness.record() if view.stiffness else None,
        remarks=tuple(found.remarks),
        not_allowed=tuple(ExcludedPull(pull=str(o.move), reason=o.forbidden) for o in found.options if o.forbidden),
        not_separated=tuple(_hypothesis(h, scene) for h in found.rivals),
        steps=tuple(_step(scene, step, about) for step, about in zip(found.steps, bits, strict=True)),
        scene=scene.name,
        telling_pull=telling.number if telling and options.consider else None,
    )
    return record.converted("mm")


def _step(scene: Scene, step: Step, effect_bits: float | None) -> ExplorationStep:
    likely = [(h, p) for h, p in step.view.probabilities.items() if p > 1e-4][:16]
    return ExplorationStep(
        number=step.number,
        pull=str(step.move),
        grasp=step.move.grasp,
        direction=step.move.direction,
        amplitude=step.move.amplitude,
        expected_bits=_finite(step.expected[0]),
        expected_stderr=_finite(step.expected[1]),
        gained_bits=step.gained,
        effect_bits=effect_bits,
        entropy=step.view.entropy,
        posterior=tuple(
            PosteriorHypothesis(anchored=_sorted(h.anchors, scene), effect=h.effect, probability=p) for h, p in likely
        ),
        patches=step.view.patches,
        effects=step.view.effects,
        normalised_rms=_finite(step.view.missed),
        discrepancy_probability=step.view.missing,
        outbound=None if step.ahead is None else str(step.ahead),
        options=tuple(
            PullOption(
                pull=str(o.move),
                expected_bits=_finite(o.expected.bits),
                expected_stderr=_finite(o.expected.error),
                cost=o.price,
                linear=o.linear,
                forbidden=o.forbidden,
            )
            for o in step.options
        ),
        spent=step.spent,
        predicted=step.predicted,
        seconds=round(step.seconds, 3),
    )


def _hypothesis(h: Hypothesis, scene: Scene) -> ExplorationHypothesis:
    return ExplorationHypothesis(anchored=_sorted(h.anchors, scene), effect=h.effect)


def parameters(view: PosteriorSummary) -> dict[str, ParameterRow]:
    """Numbers of the likeliest hypothesis' effect, SI, with standard errors."""
    fitted = view.fitted.get(view.best)
    if fitted is None:
        return {}
    return {
        name: ParameterRow(value=_finite(value), stderr=_finite(error), unit=fitted.unit(name))
        for name, (value, error) in fitted.amounts.items()
    }


def _sorted(anchors: frozenset[str], scene: Scene) -> tuple[str, ...]:
    return tuple(name for name in scene.patches if name in anchors)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def effect_bits(options: ExploreOptions, found: Exploration) -> list[float]:
    """By how much each pull lowered the entropy of the effects, bits."""
    before = [
        entropy(prior_effects(options.consider).values()),
        *(entropy(step.view.effects.values()) for step in found.steps),
    ]
    return [a - b for a, b in itertools.pairwise(before)]


def telling_pull(options: ExploreOptions, found: Exploration) -> Step | None:
    """The pull that told most about the effects; None where no effect is as likely as was asked for."""
    if not found.steps or max(found.view.effects.values()) < options.confidence:
        return None
    bits = effect_bits(options, found)
    return found.steps[bits.index(max(bits))]
