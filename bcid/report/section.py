"""The section of a report that shows one run: what it found first, how it was made last."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bcid.report import gallery
from bcid.report.body_view import view_data
from bcid.report.figure import encoded, styled
from bcid.report.found import DAMAGE, Found
from bcid.report.gallery import Drawing
from bcid.report.provenance import groups
from bcid.report.table import Table
from bcid.report.tables import Listing, listings
from bcid.report.verdict import Verdict, lacking, verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TITLES = {
    gallery.ANSWER: "How far the answer holds",
    gallery.PROPOSAL: "Beyond the catalogue",
    gallery.RESIDUALS: "Residuals",
    gallery.RANKING: "Missing effects",
    gallery.LADDER: "The ladder of models",
    gallery.BELIEF: "Belief by pull",
    gallery.IMAGES: "Images",
}
_LEAD = "What is left between measurement and model, per coordinate. The dashed line is the noise."
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
        kind, content = ("png", _small_png(figure)) if picture else ("svg+xml", encoded(figure, "svg", letters="none"))
        source = base64.b64encode(content.replace(b"'DejaVu Sans'", _LETTERS)).decode("ascii")
        width, height = (round(side * _PIXELS) for side in figure.get_size_inches())
        return cls(f"data:image/{kind};base64,{source}", width, height, caption, picture)


def _small_png(figure: Figure) -> bytes:
    from PIL import Image

    packed = io.BytesIO()
    with Image.open(io.BytesIO(encoded(figure, "png", _FINE))) as image:
        image.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(packed, "png", optimize=True)
    return packed.getvalue()


Row = list[Shown | Table]


@dataclass(frozen=True)
class PagePart:
    """What of a run belongs together.

    Attributes:
        title: above it.
        rows: figures and tables, those of a row beside each other.
        lead: a sentence before them.
        details: tables that are folded.
    """

    title: str
    rows: list[Row]
    lead: str = ""
    details: list[Table] = field(default_factory=list)


class Section:
    """One run of a page, with all that the page shows of it.

    Attributes:
        found: the run.
        id, name: of its element, and of the folder.
        troubles: what could not be read or shown.
        said, sentence: the verdict, and its first sentence.
        view, still: data of the turnable view, and the picture that stands for it where it cannot be drawn; or None.
        parts: in the order of the page.
        facts: what was run, by group.
        lacks: what the run has not.
    """

    def __init__(self, found: Found, id: str) -> None:
        self.found, self.id, self.name, self.troubles = found, id, found.name, found.troubles
        self.said: Verdict = self._tried("verdict", lambda: verdict(found)) or _UNREADABLE
        self.sentence = self.said.sentence
        self._drawings: list[Drawing] = self._tried("figures", lambda: gallery.drawings(found)) or []
        self._listings: list[Listing] = self._tried("tables", lambda: listings(found)) or []
        with styled():
            self.still = next(iter(self._images(gallery.BODY)), None)
            self.view: dict[str, Any] | None = self._tried("the view of the body", lambda: view_data(found))
            self.parts = [made for part in _TITLES if any((made := self._part(part)).rows)]
        self.facts = self._tried("what was run", lambda: groups(found)) or {}
        self.lacks = self._tried("what is lacking", lambda: lacking(found)) or []

    def _part(self, part: str) -> PagePart:
        """Charts beside each other, then tables, then pictures, with few exceptions."""
        images, listed = self._images(part), self._tables(part)
        charts: Row = [image for image in images if not image.picture]
        tables: list[Row] = [[table] for table in listed]
        pictures: list[Row] = [[image] for image in images if image.picture]
        title = _TITLES[part]
        if part == gallery.RESIDUALS:
            return PagePart(title, [charts], _LEAD, listed)
        if part == gallery.RANKING:
            return PagePart(title if tables else "The missing force", [*tables, charts, *pictures])
        if part == gallery.BELIEF and "exploration" not in self.found.documents:
            return PagePart("Anchor sets", [[*charts, *listed]])
        return PagePart(title, [charts, *tables, *pictures])

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
                make = lambda one=drawing: Shown.of(one.draw(), one.caption, one.picture)  # noqa: E731
                made.append(self._tried(f"figure '{drawing.name}'", make))
        return [image for image in made if image is not None]

    def _tables(self, part: str) -> list[Table]:
        """The tables of a part of the report."""
        chosen = [listing for listing in self._listings if listing.part == part]
        made = [self._tried(f"table '{listing.name}'", listing.make) for listing in chosen]
        return [table for table in made if table is not None]
