"""Which figures a run has: those of the page and of files, and the pictures that stand in its folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bcid.base.run_folder import RunFolder
from bcid.report import exploration_picture as exploration
from bcid.report import residual
from bcid.report.calibration_picture import calibration_figure
from bcid.report.diagnosis_picture import residual_figure, where_figure
from bcid.report.figure import chart
from bcid.report.found import Found
from bcid.report.identification_picture import body_figure, draw_probabilities, summary_figure
from bcid.report.ladder import ladder_chart, ladder_figure, ranking_chart
from bcid.report.residual import Residual, residuals_of
from bcid.report.text import model_name
from bcid.report.time_charts import course_chart, felt, force_chart, torque_chart
from bcid.report.tracking_picture import rest_picture, tracking_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BODY, ANSWER, PROPOSAL, RESIDUALS, RANKING = "body", "answer", "proposal", "residuals", "ranking"
LADDER, BELIEF, IMAGES = "ladder", "belief", "images"


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
    made = [*_of_body(found), *_of_residuals(found), *_of_diagnosis(found), *_of_exploration(found)]
    return [*made, *_of_images(found)]


def pictures(found: Found) -> dict[str, Callable[[], Figure]]:
    """The figures that stand in the folder of a finished run, by their files: what a command shows of its result."""
    documents, body, positions = found.documents, found.body, found.positions
    made: dict[str, Callable[[], Figure]] = {}
    if "diagnosis" in documents and body is not None and positions is not None:
        made["picture.png"] = lambda: residual_figure(documents["diagnosis"], body, positions)
        made["ladder.png"] = lambda: ladder_figure(documents["diagnosis"])
        if "where" in documents:
            made["where.png"] = lambda: where_figure(documents["diagnosis"], documents["where"], body, positions)
    elif "identification" in documents and body is not None and positions is not None:
        made["picture.png"] = lambda: summary_figure(documents["identification"], body, positions)
    if "exploration" in documents:
        made["belief.png"] = lambda: exploration.belief_figure(documents["exploration"])
    return made | {f"{drawing.name}.png": drawing.draw for drawing in _of_images(found)}


def _of_body(found: Found) -> list[Drawing]:
    made = []
    body, positions = found.body, found.positions
    diagnosis, identification = found.documents.get("diagnosis"), found.documents.get("identification")
    if body is not None and positions is not None:
        if diagnosis is not None:
            text = "The body with its anchors, and what the models miss as arrows, where the first model misses most."
            draw: Callable[[], Figure] = lambda: residual_figure(diagnosis, body, positions)  # noqa: E731
            made.append(Drawing("body", BODY, text, draw, True))
        elif identification is not None:
            text = "The body with its anchors, and the measured and predicted paths of an action."
            made.append(Drawing("body", BODY, text, lambda: body_figure(identification, body, positions), True))
    if identification is not None:
        text = "How probable it is that a patch is anchored. Dark: the set that is reported; hatched: the others."
        draw = lambda: chart(lambda axes: draw_probabilities(axes, identification))  # noqa: E731
        made.append(Drawing("patches", BELIEF, text, draw))
    return made


def _of_residuals(found: Found) -> list[Drawing]:
    positions = found.positions
    if positions is None or not found.result:
        return []

    def drawn(draw: Callable[[Axes, Residual], None]) -> Callable[[], Figure]:
        return lambda: chart(lambda axes: draw(axes, residuals_of(found)))

    last = model_name(str(positions.attrs.get("model", "the model")))
    steps = "By step, over all actions. A residual that grows with the pull, or is there at rest, tells of the model."
    texts: dict[str, tuple[str, Callable[[Axes, Residual], None]]] = {
        "action": ("By action. A model that is right misses every action by about the noise.", residual.draw_actions),
        "step": (steps, residual.draw_steps),
        "fiducial": ("By fiducial. A few that stand out tell where the model fails.", residual.draw_fiducials),
        "map": (
            f"How far each fiducial is from where {last} has it, frame by frame; bright is far.",
            residual.draw_map,
        ),
    }
    made = [Drawing(f"residual-{name}", RESIDUALS, text, drawn(draw)) for name, (text, draw) in texts.items()]
    if felt(positions):
        length = str(found.result.get("length_unit", "mm"))
        stiff = "" if "diagnosis" in found.documents else ", with the stiffness that the scene has"
        text = f"Force of the gripper: measured, and as {last} predicts it{stiff}."
        made.append(Drawing("force-gripper", RESIDUALS, text, lambda: force_chart(positions)))
        made.append(Drawing("torque-gripper", RESIDUALS, "Its torque.", lambda: torque_chart(positions, length)))
    return made


def _of_diagnosis(found: Found) -> list[Drawing]:
    diagnosis, where = found.documents.get("diagnosis"), found.documents.get("where")
    if diagnosis is None:
        return []
    made = []
    if diagnosis.get("ranking"):
        text = (
            "What each effect alone would make of the error: expected before any fit (circles), and fitted (diamonds)."
        )
        made.append(Drawing("ranking", RANKING, text, lambda: ranking_chart(diagnosis)))
    if where is not None and found.body is not None and found.positions is not None:
        body, positions = found.body, found.positions
        text = "The force that would explain what the model misses, where it can be told from none."
        draw: Callable[[], Figure] = lambda: where_figure(diagnosis, where, body, positions)  # noqa: E731
        made.append(Drawing("force", RANKING, text, draw, True))
    text = "The error of each model, fitted to all actions, and each action predicted from the others (held out)."
    made.append(Drawing("ladder", LADDER, text, lambda: ladder_chart(diagnosis)))
    if courses := diagnosis.get("courses"):
        text = "Amounts that change with time. The bands hold 95 %: of the values (light), and of what they are from each other."
        made.append(Drawing("courses", LADDER, text, lambda: course_chart(courses)))
    return made


def _of_exploration(found: Found) -> list[Drawing]:
    explored = found.documents.get("exploration")
    if explored is None or not explored.get("steps"):
        return []

    def drawn(draw: Callable[[Axes, list[dict[str, Any]]], None]) -> Callable[[], Figure]:
        return lambda: chart(lambda axes: draw(axes, explored["steps"]), 3.6)

    likely = "How probable it is that a patch is anchored, after each pull."
    return [
        Drawing("sets", BELIEF, "The likeliest anchor sets after each pull.", drawn(exploration.draw_sets)),
        Drawing("patches-by-pull", BELIEF, likely, drawn(exploration.draw_patches)),
        Drawing("bits", BELIEF, "What each pull was expected to tell, and told.", drawn(exploration.draw_bits)),
    ]


def _of_images(found: Found) -> list[Drawing]:
    made = []
    calibration, tracking, tracks = found.documents.get("calibration"), found.documents.get("tracking"), found.tracks
    if calibration is not None:
        text = "Where corners lie in the images, what the cameras miss them by, and the error of each pair."
        made.append(Drawing("calibration", IMAGES, text, lambda: calibration_figure(calibration), True))
    if tracking is not None and tracks is not None:
        text = "The beads at rest; when, how well and how consistently each was seen."
        draw: Callable[[], Figure] = lambda: tracking_figure(tracking, tracks, rest_picture(RunFolder.open(found.path)))  # noqa: E731
        made.append(Drawing("tracking", IMAGES, text, draw, True))
    return made
