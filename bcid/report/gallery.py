"""Which figures a run has: those of the page and of files, and the pictures that stand in its folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bcid.base.run_folder import RunFolder
from bcid.report import exploration_picture as exploration
from bcid.report import residual
from bcid.report.calibration_picture import calibration_figure
from bcid.report.diagnosis_picture import discrepancy_figure, residual_figure
from bcid.report.figure import chart
from bcid.report.found import Found
from bcid.report.identification_picture import body_figure, draw_probabilities, summary_figure
from bcid.report.models_chart import models_chart, models_figure, ranking_chart
from bcid.report.residual import Residual, residuals_of
from bcid.report.time_charts import course_chart, felt, force_chart, torque_chart
from bcid.report.tracks_picture import rest_picture, tracking_figure
from bcid.results.words import model_name

BODY, ANSWER, PROPOSAL, RESIDUALS, RANKING = "body", "answer", "proposal", "residuals", "ranking"
MODELS, POSTERIOR, IMAGES = "models", "posterior", "images"
PARTS = (ANSWER, PROPOSAL, RESIDUALS, RANKING, MODELS, POSTERIOR, IMAGES)

_BY_STEP = "By step, over all actions. A residual that grows with the pull, or is there at rest, tells of the model."


@dataclass(frozen=True)
class Drawing:
    """A figure of a run that can be drawn.

    Attributes:
        name: of its files.
        part: of the report that it belongs to.
        caption: what is to be seen.
        draw: draws it; raises whatever damaged files make it raise.
        picture: whether it is an image rather than lines and text.
    """

    name: str
    part: str
    caption: str
    draw: Callable[[], Figure]
    picture: bool = False


def drawings(found: Found) -> list[Drawing]:
    """All figures that a run holds the data of, in the order of the report."""
    body, positions, identification = found.body, found.positions, found.identification
    made = []
    if found.diagnosis is not None and body is not None and positions is not None:
        text = "The body with its anchors, and what the models miss as arrows, where the first model misses most."
        made.append(Drawing("body", BODY, text, pictures(found)["picture"], True))
    elif identification is not None and body is not None and positions is not None:
        text = "The body with its anchors, and the measured and predicted paths of an action."
        draw_body = partial(body_figure, identification, body, positions)
        made.append(Drawing("body", BODY, text, draw_body, True))
    if identification is not None:
        text = "How probable it is that a patch is anchored. Dark: the set that is reported; hatched: the others."
        draw_patches = partial(_chart_of, draw_probabilities, identification)
        made.append(Drawing("patches", POSTERIOR, text, draw_patches))
    made += [*_of_residuals(found), *_of_diagnosis(found), *_of_exploration(found)]
    texts = {
        "calibration": "Where corners lie in the images, what the cameras miss them by, and the error of each pair.",
        "tracking": "The beads at rest; when, how well and how consistently each was seen.",
    }
    for name, draw in pictures(found).items():
        if name in texts:
            made.append(Drawing(name, IMAGES, texts[name], draw, True))
    return made


def pictures(found: Found) -> dict[str, Callable[[], Figure]]:
    """The figures that stand in the folder of a finished run, by their names: what a command shows of its result."""
    body, positions, tracks = found.body, found.positions, found.tracks
    diagnosis, identification, discrepancy = found.diagnosis, found.identification, found.discrepancy
    explored, calibration, tracking = found.exploration, found.calibration, found.tracking
    made: dict[str, Callable[[], Figure]] = {}
    if diagnosis is not None and body is not None and positions is not None:
        made["picture"] = partial(residual_figure, diagnosis, body, positions)
        made["models"] = partial(models_figure, diagnosis)
        if discrepancy is not None:
            made["discrepancy"] = partial(discrepancy_figure, diagnosis, discrepancy, body, positions)
    elif identification is not None and body is not None and positions is not None:
        made["picture"] = partial(summary_figure, identification, body, positions)
    if explored is not None:
        made["posterior"] = partial(exploration.posterior_figure, explored)
    if calibration is not None:
        made["calibration"] = partial(calibration_figure, calibration)
    if tracking is not None and tracks is not None:
        made["tracking"] = lambda: tracking_figure(tracking, tracks, rest_picture(RunFolder.open(found.path)))
    return made


def _chart_of(draw: Callable[[Any, Any], None], content: Any, height: float = 3.2) -> Figure:
    """A chart of some content."""
    return chart(lambda axes: draw(axes, content), height)


def _residual_chart(draw: Callable[[Any, Any], None], found: Found) -> Figure:
    """A chart of the residuals of a run, which are made when it is drawn: damaged files are found then."""
    return _chart_of(draw, residuals_of(found))


def _of_residuals(found: Found) -> list[Drawing]:
    positions = found.positions
    if positions is None or not (found.diagnosis or found.identification):
        return []
    last = model_name(str(positions.attrs.get("model", "the model")))
    draws: dict[str, tuple[Callable[[Axes, Residual], None], str]] = {
        "action": (residual.draw_actions, "By action. A model that is right misses every action by about the noise."),
        "step": (residual.draw_steps, _BY_STEP),
        "fiducial": (residual.draw_fiducials, "By fiducial. A few that stand out tell where the model fails."),
        "map": (
            residual.draw_map,
            f"How far each fiducial is from where {last} has it, frame by frame; bright is far.",
        ),
    }
    made = []
    for name, (draw, text) in draws.items():
        made.append(Drawing(f"residual-{name}", RESIDUALS, text, partial(_residual_chart, draw, found)))
    if felt(positions):
        stiff = "" if found.diagnosis else ", with the stiffness that the scene has"
        text = f"Force of the gripper: measured, and as {last} predicts it{stiff}."
        made.append(Drawing("force-gripper", RESIDUALS, text, lambda: force_chart(positions)))
        made.append(Drawing("torque-gripper", RESIDUALS, "Its torque.", lambda: torque_chart(positions)))
    return made


def _of_diagnosis(found: Found) -> list[Drawing]:
    diagnosis, drawn = found.diagnosis, pictures(found)
    if diagnosis is None:
        return []
    made = []
    if diagnosis.ranking:
        text = (
            "What each effect alone would make of the error: expected before any fit (circles), and fitted (diamonds)."
        )
        made.append(Drawing("ranking", RANKING, text, lambda: ranking_chart(diagnosis)))
    if "discrepancy" in drawn:
        text = "The force that would explain what the model misses, where it can be told from none."
        made.append(Drawing("force", RANKING, text, drawn["discrepancy"], True))
    text = "The error of each model, fitted to all actions, and each action predicted from the others (held out)."
    made.append(Drawing("models", MODELS, text, lambda: models_chart(diagnosis)))
    if histories := diagnosis.time_histories:
        text = "Amounts that change with time. The bands hold 95 %: of the values (light), and of what they are from each other."
        made.append(Drawing("time-histories", MODELS, text, lambda: course_chart(histories)))
    return made


def _of_exploration(found: Found) -> list[Drawing]:
    steps = found.exploration.steps if found.exploration else ()
    draws = {
        "sets": (exploration.draw_sets, "The likeliest anchor sets after each pull."),
        "patches-by-pull": (exploration.draw_patches, "How probable it is that a patch is anchored, after each pull."),
        "bits": (exploration.draw_bits, "What each pull was expected to tell, and told."),
    }
    made = []
    for name, (draw, text) in draws.items():
        made.append(Drawing(name, POSTERIOR, text, partial(_chart_of, draw, steps, 3.6)))
    return made if steps else []
