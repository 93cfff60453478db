"""The section of a report that shows one run: what it found first, how it was made last."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from bcid.report import gallery
from bcid.report.body_view import view_data
from bcid.report.figure import encoded, styled
from bcid.report.found import DAMAGE, Found
from bcid.report.gallery import Drawing
from bcid.report.provenance import groups
from bcid.report.table import Table
from bcid.report.tables import tables
from bcid.report.verdict import Verdict, lacking, verdict

_UNREADABLE = Verdict("What this run found cannot be read.")
# Of pictures that VTK draws: pixels to an inch, and colours that are enough, with a third of the bytes.
_FINE, _COLOURS = 120, 192
# CSS pixels to an inch.
_PIXELS = 96
# Letters of charts are those of the page.
_LETTERS = b"Inter,'Helvetica Neue','Segoe UI',Roboto,'Liberation Sans',Arial,'DejaVu Sans'"


@dataclass(frozen=True)
class Shown:
    """An image of a page: its content as an address, width and height in CSS pixels, and what is to be seen on it.

    Nothing in it can run or load anything: browsers draw it apart from the page.
    """

    source: str
    width: int
    height: int
    caption: str
    picture: bool

    @classmethod
    def of(cls, figure: Figure, caption: str, picture: bool) -> Shown:
        """A chart as SVG, a picture as PNG."""
        kind, content = ("png", _small_png(figure)) if picture else ("svg+xml", _page_svg(figure))
        source = base64.b64encode(content).decode("ascii")
        width, height = (round(side * _PIXELS) for side in figure.get_size_inches())
        return cls(f"data:image/{kind};base64,{source}", width, height, caption, picture)


def _page_svg(figure: Figure) -> bytes:
    return encoded(figure, "svg", letters="none").replace(b"'DejaVu Sans'", _LETTERS)


def _small_png(figure: Figure) -> bytes:
    from PIL import Image

    packed = io.BytesIO()
    with Image.open(io.BytesIO(encoded(figure, "png", _FINE))) as image:
        image.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(packed, "png", optimize=True)
    return packed.getvalue()


class Section:
    """One run of a page, with all that the page shows of it.

    Attributes:
        found: the run.
        id, name: of its element, and of the folder.
        troubles: what could not be read or shown.
        said, sentence: the verdict, and its first sentence.
        view, still: data of the turnable view, and the picture that stands for it where it cannot be drawn; or None.
        parts: images and tables of each part, in the order of the page.
        facts: what was run, by group.
        lacks: what the run has not.
    """

    def __init__(self, found: Found, id: str) -> None:
        self.found, self.id, self.name, self.troubles = found, id, found.name, found.troubles
        self.said: Verdict = self._tried("verdict", lambda: verdict(found)) or _UNREADABLE
        self.sentence = self.said.sentence
        self._drawings: list[Drawing] = self._tried("figures", lambda: gallery.drawings(found)) or []
        with styled():
            self.still = next(iter(self._images(gallery.BODY)), None)
            self.view: dict[str, Any] | None = self._tried("the view of the body", lambda: view_data(found))
            self.parts = {part: (self._images(part), self._tables(part)) for part in gallery.PARTS}
        self.facts = self._tried("what was run", lambda: groups(found)) or {}
        self.lacks = self._tried("what is lacking", lambda: lacking(found)) or []

    # -- what damaged content may stop

    def _tried(self, what: str, make: Callable[[], Any]) -> Any:
        """What `make` makes; None, with a note among the run's troubles, where damaged content stops it."""
        try:
            return make()
        except DAMAGE as error:
            reason = f"{type(error).__name__}: {str(error).strip()}".splitlines()[0][:200].rstrip(": ")
            self.troubles.append(f"{what}: cannot be shown, its file is damaged or from another version ({reason})")
        except ImportError as error:
            self.troubles.append(f"{what}: cannot be drawn, {error.name} is not installed (the extra 'report')")
        return None

    def _images(self, part: str) -> list[Shown]:
        """The figures of a part of the report."""
        made = []
        for drawing in self._drawings:
            if drawing.part == part:
                made.append(self._tried(f"figure '{drawing.name}'", partial(_shown, drawing)))
        return [image for image in made if image is not None]

    def _tables(self, part: str) -> list[Table]:
        """The tables of a part of the report."""
        made = [self._tried(f"table '{name}'", make) for name, own, make in tables(self.found) if own == part]
        return [table for table in made if table is not None]


def _shown(drawing: Drawing) -> Shown:
    """A figure of a run, drawn."""
    return Shown.of(drawing.draw(), drawing.caption, drawing.picture)
