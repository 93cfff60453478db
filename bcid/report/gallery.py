"""Which figures a run has: the same for the page and for files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bcid.base.run_folder import RunFolder
from bcid.report import exploration_picture as exploration
from bcid.report import ladder, residual
from bcid.report.calibration_picture import calibration_figure
from bcid.report.course_chart import course_chart
from bcid.report.diagnosis_picture import residual_figure, where_figure
from bcid.report.force_chart import felt, force_chart, torque_chart
from bcid.report.found import Found
from bcid.report.identification_picture import body_figure, probability_chart
from bcid.report.residual import Residual
from bcid.report.text import model_name
from bcid.report.tracking_picture import rest_picture, tracking_figure

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

BODY, RESIDUALS, RANKING, LADDER, BELIEF, IMAGES = "body", "residuals", "ranking", "ladder", "belief", "images"


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


def residuals_of(found: Found) -> Residual | None:
    """Residuals of a run, or None where it has none."""
    result = found.documents.get("diagnosis") or found.documents.get("identification")
    if found.positions is None or result is None:
        return None
    return Residual.of(found.positions, result.get("noise_rms"), str(result.get("length_unit", "mm")))


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
        made.append(Drawing("patches", BELIEF, text, lambda: probability_chart(identification)))
    return made


def _of_residuals(found: Found) -> list[Drawing]:
    if found.positions is None or not found.result:
        return []

    def drawn(draw: Callable[[Residual], Figure]) -> Callable[[], Figure]:
        return lambda: draw(_present(residuals_of(found)))

    last = model_name(str(found.positions.attrs.get("model", "the model")))
    captions = {
        "action": "By action. A model that is right misses every action by about the noise.",
        "step": "By step, over all actions. A residual that grows with the pull, or is there at rest, tells of the model.",
        "fiducial": "By fiducial. A few that stand out tell where the model fails.",
        "map": f"How far each fiducial is from where {last} has it, frame by frame; bright is far.",
    }
    drawers = {
        "action": residual.action_chart,
        "step": residual.step_chart,
        "fiducial": residual.fiducial_chart,
        "map": residual.map_chart,
    }
    made = [Drawing(f"residual-{name}", RESIDUALS, captions[name], drawn(draw)) for name, draw in drawers.items()]
    return [*made, *_of_forces(found, found.positions, last)]


def _of_forces(found: Found, positions: xr.Dataset, model: str) -> list[Drawing]:
    """Where the gripper felt something."""
    if not felt(positions):
        return []
    length = str(found.result.get("length_unit", "mm"))
    stiff = "" if "diagnosis" in found.documents else ", with the stiffness that the scene has"
    text = f"Force of the gripper: measured, and as {model} predicts it{stiff}."
    return [
        Drawing("force-gripper", RESIDUALS, text, lambda: force_chart(positions)),
        Drawing("torque-gripper", RESIDUALS, "Its torque.", lambda: torque_chart(positions, length)),
    ]


def _present(found: Residual | None) -> Residual:
    if found is None:
        raise ValueError("no residuals")
    return found


def _of_diagnosis(found: Found) -> list[Drawing]:
    diagnosis, where = found.documents.get("diagnosis"), found.documents.get("where")
    if diagnosis is None:
        return []
    made = []
    if diagnosis.get("ranking"):
        text = (
            "What each effect alone would make of the error: expected before any fit (circles), and fitted (diamonds)."
        )
        made.append(Drawing("ranking", RANKING, text, lambda: ladder.ranking_chart(diagnosis)))
    if where is not None and found.body is not None and found.positions is not None:
        body, positions = found.body, found.positions
        text = "The force that would explain what the model misses, where it can be told from none."
        draw: Callable[[], Figure] = lambda: where_figure(diagnosis, where, body, positions)  # noqa: E731
        made.append(Drawing("force", RANKING, text, draw, True))
    text = "The error of each model, fitted to all actions, and each action predicted from the others (held out)."
    made.append(Drawing("ladder", LADDER, text, lambda: ladder.ladder_chart(diagnosis)))
    if courses := diagnosis.get("courses"):
        text = "Amounts that change with time. The bands hold 95 %: of the values (light), and of what they are from each other."
        made.append(Drawing("courses", LADDER, text, lambda: course_chart(courses)))
    return made


def _of_exploration(found: Found) -> list[Drawing]:
    explored = found.documents.get("exploration")
    if explored is None or not explored.get("steps"):
        return []
    texts: dict[str, tuple[str, Callable[[dict[str, Any]], Figure]]] = {
        "sets": ("The likeliest anchor sets after each pull.", exploration.sets_chart),
        "patches-by-pull": ("How probable it is that a patch is anchored, after each pull.", exploration.patches_chart),
        "bits": ("What each pull was expected to tell, and told.", exploration.bits_chart),
    }

    def drawn(draw: Callable[[dict[str, Any]], Figure]) -> Callable[[], Figure]:
        return lambda: draw(explored)

    return [Drawing(name, BELIEF, text, drawn(draw)) for name, (text, draw) in texts.items()]


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
