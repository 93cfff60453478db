"""What a run has not, and which command would make it."""

from __future__ import annotations

from bcid.report.found import Found

_ON_IMAGES = ("calibrate", "track")


def lacking(found: Found) -> list[str]:
    """Sentences, each with what to do."""
    if found.command == "study":
        return ["a body, residuals and models: a study is told by its table"]
    if found.command in _ON_IMAGES:
        return [f"a body, anchors and models: bcid {found.command} makes what bcid identify starts from"]
    if found.state != "finished":
        return ["its result: the same command goes on where it was"]
    documents, missing = found.documents, []
    if found.body is None or found.positions is None:
        if "exploration" in documents:
            missing.append("the body in 3-D and residuals: give a pull of steps/ to bcid identify or explain")
        else:
            missing.append("the body in 3-D and residuals: body.nc or the positions are not in the folder")
    if "diagnosis" not in documents and "exploration" not in documents:
        missing.append("a ladder of models and missing effects: bcid diagnose RUN makes them")
    elif "diagnosis" in documents and not documents["diagnosis"].get("ranking"):
        missing.append("a table of missing effects: none was ranked; bcid diagnose RUN does it")
    if "identification" not in documents and "exploration" not in documents:
        missing.append(
            "probabilities of the patches: they are in the run of bcid identify or explain that it started from"
        )
    if "exploration" not in documents:
        missing.append("belief by pull: bcid explore makes it")
    return missing
