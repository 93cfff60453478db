"""A page of studies, in Markdown: section by section, what the paper did, what is done here and where, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

PICTURE = "picture.png"


def section(section: str, title: str, told: Mapping[str, str], code: Sequence[str], body: Sequence[str]) -> str:
    """One section: its head, what is told under each of a few words, where the code is, and the tables."""
    lines = [f"## {title}", "", f"Section {section}", ""]
    for word, text in told.items():
        if text:
            lines += [f"**{word}.** {' '.join(text.split())}", ""]
    if code:
        lines += [f"**In the code.** {', '.join(f'`{file}`' for file in code)}", ""]
    return "\n".join([*lines, *(part for text in body for part in (text, ""))]).rstrip() + "\n"
