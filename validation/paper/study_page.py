"""The section of a study file on the page of the paper."""

from __future__ import annotations

from collections.abc import Sequence

from validation.paper.cells import Row
from validation.paper.study_file import StudyFile
from validation.paper.study_tables import READING, counts
from validation.sections import PICTURE, section
from validation.text_table import TextTable


def study_page(study: StudyFile, made: Sequence[TextTable], rows: Sequence[Row], drawn: bool) -> str:
    """The section of a study file; its picture lies beside it."""
    told = {
        "In the paper": study.in_paper,
        "Here": study.about,
        "Left open by the paper": study.chosen,
        "Beyond the paper": study.adds,
    }
    body = ["\n".join(f"{line.strip()}  " for line in counts(rows)).rstrip() + f". {READING}"]
    body += [table.markdown() for table in made]
    if drawn:
        body.append(f"![{study.title}]({PICTURE})")
    code = (*study.code, f"validation/paper/{study.source.name}")
    return section(study.section, study.title, told, code, body)
