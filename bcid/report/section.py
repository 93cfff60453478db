"""The section of a report that shows one run: what it found first, how it was made last."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bcid.base.errors import BcidError
from bcid.report import answer_tables, gallery, tables
from bcid.report.body_view import view_data
from bcid.report.figure import styled
from bcid.report.found import Found
from bcid.report.gallery import Drawing
from bcid.report.lacking import lacking
from bcid.report.markup import Markup, tag
from bcid.report.provenance import provenance
from bcid.report.raster import embedded
from bcid.report.svg import inline
from bcid.report.table import Table
from bcid.report.verdict import Verdict, verdict
from bcid.report.viewer import view

# What damaged content makes the code raise that shows it, images and the drawing libraries included.
DAMAGE = (
    BcidError,
    ArithmeticError,
    AttributeError,
    LookupError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
)

_UNREADABLE = Verdict("What this run found cannot be read.", [], [])


class Section:
    """One run of a page.

    Attributes:
        found: the run.
        number: of the section, from 1; ids begin with it.
        said: the verdict.
        data: of the turnable view, once the section is made; None where there is none.
    """

    def __init__(self, found: Found, number: int) -> None:
        self.found = found
        self.number = number
        self.data: dict[str, Any] | None = None
        self.said: Verdict = self.tried("verdict", lambda: verdict(found)) or _UNREADABLE
        self._drawings = self.tried("figures", lambda: gallery.drawings(found)) or []

    @property
    def id(self) -> str:
        """Of its element."""
        return f"run-{self.number}"

    def tried(self, what: str, make: Callable[[], Any]) -> Any:
        """What `make` makes; None, with a note among the run's troubles, where damaged content stops it."""
        try:
            return make()
        except DAMAGE as error:
            self.found.troubles.append(
                f"{what}: cannot be shown, its file is damaged or from another version ({_reason(error)})"
            )
        except ImportError as error:
            self.found.troubles.append(f"{what}: cannot be drawn, {error.name} is not installed (the extra 'report')")
        return None

    def html(self, heading: str) -> Markup:
        """The section; its verdict is an element `heading`."""
        with styled():
            parts = [
                self._body(),
                self._answer(),
                self._proposal(),
                self._residuals(),
                self._ranking(),
                self._ladder(),
                self._belief(),
                self._images(),
            ]
        return tag("section", self._head(heading), parts, self._made(), class_="run", id=self.id)

    def _head(self, heading: str) -> list[Markup]:
        found, said = self.found, self.said
        about = " · ".join(part for part in (found.name, found.scene, f"bcid {found.command}", found.state) if part)
        numbers = [tag("div", tag("dt", name), tag("dd", value)) for name, value in said.numbers]
        doubts = [tag("p", text, class_="doubt") for text in said.doubts]
        made = [tag("p", about, class_="about"), tag(heading, said.sentence)]
        return [*made, *([tag("dl", numbers, class_="numbers")] if numbers else []), *doubts]

    # -- the parts

    def _body(self) -> Markup:
        drawings = self._of(gallery.BODY)
        still = next((self._image(d) for d in drawings if d.picture), None)
        self.data = self.tried("the view of the body", lambda: view_data(self.found))
        charts = self._charts([d for d in drawings if not d.picture])
        if self.data is None and still is None and not charts:
            return Markup("")
        content = []
        if self.data is not None:
            content.append(view(self.data, still, f"view-{self.number}"))
        elif still is not None:
            caption = next(d.caption for d in drawings if d.picture)
            content.append(tag("figure", still, tag("figcaption", caption), class_="picture"))
        return tag("section", tag("h3", "The body"), content, charts, class_="body")

    def _answer(self) -> Markup:
        """On which inputs of the scene it depends, and what would tell more."""
        diagnosis = self.found.documents.get("diagnosis", {})
        made = [
            self.tried("the answer with other inputs", lambda: answer_tables.sensitivity_table(diagnosis)),
            self.tried("what to do next", lambda: answer_tables.steps_table(diagnosis)),
        ]
        shown = [_table(table) for table in made if table is not None]
        return tag("section", tag("h3", "How far the answer holds"), shown) if shown else Markup("")

    def _proposal(self) -> Markup:
        proposal = self.found.documents.get("proposal")
        if proposal is None or not proposal["proposed"]:
            return Markup("")
        made = self.tried("what is proposed", lambda: [tables.proposal_table(proposal), tables.path_table(proposal)])
        return tag("section", tag("h3", "Beyond the catalogue"), [_table(table) for table in made or []])

    def _residuals(self) -> Markup:
        charts = self._charts(self._of(gallery.RESIDUALS))
        if not charts:
            return Markup("")
        lead = "What is left between measurement and model, per coordinate. The dashed line is the noise."
        made = self.tried("tables of residuals", lambda: tables.residual_tables(gallery.residuals_of(self.found)))  # type: ignore[arg-type]
        numbers = [tag("summary", "the numbers"), [_table(table) for table in made]] if made else []
        details = tag("details", numbers) if numbers else Markup("")
        return tag("section", tag("h3", "Residuals"), tag("p", lead, class_="lead"), charts, details)

    def _ranking(self) -> Markup:
        diagnosis = self.found.documents.get("diagnosis")
        drawings = self._of(gallery.RANKING)
        if diagnosis is None or not drawings:
            return Markup("")
        table = self.tried("table of missing effects", lambda: tables.ranking_table(diagnosis))
        pictures = [self._figure(d) for d in drawings if d.picture]
        charts = self._charts([d for d in drawings if not d.picture])
        title = "Missing effects" if table is not None else "The missing force"
        return tag("section", tag("h3", title), _table(table) if table else None, charts, pictures)

    def _ladder(self) -> Markup:
        diagnosis = self.found.documents.get("diagnosis")
        if diagnosis is None:
            return Markup("")
        charts = self._charts(self._of(gallery.LADDER))
        made = self.tried("ladder of models", lambda: [tables.ladder_table(diagnosis), tables.tests_table(diagnosis)])
        return tag("section", tag("h3", "The ladder of models"), charts, [_table(table) for table in made or []])

    def _belief(self) -> Markup:
        documents = self.found.documents
        content = [figure for drawing in self._of(gallery.BELIEF) if (figure := self._figure(drawing))]
        explored, identified = documents.get("exploration"), documents.get("identification")
        if explored is not None:
            table = self.tried("table of pulls", lambda: tables.pulls_table(explored))
            content += [_table(table, "wide")] if table else []
        if identified is not None:
            table = self.tried("table of anchor sets", lambda: tables.sets_table(identified))
            content += [_table(table)] if table else []
        title = "Belief by pull" if explored is not None else "Anchor sets"
        return tag("section", tag("h3", title), tag("div", content, class_="charts")) if content else Markup("")

    def _images(self) -> Markup:
        pictures = [figure for d in self._of(gallery.IMAGES) if (figure := self._figure(d))]
        return tag("section", tag("h3", "Images"), pictures) if pictures else Markup("")

    def _made(self) -> Markup:
        """What was run, what is lacking, and what could not be shown."""
        table = self.tried("what was run", lambda: provenance(self.found)) or Markup("")
        lacks = self.tried("what is lacking", lambda: lacking(self.found)) or []
        missing = tag("ul", [tag("li", text) for text in lacks], class_="lacks") if lacks else None
        troubles = [tag("p", text, class_="doubt") for text in self.found.troubles]
        summary = tag("details", tag("summary", "the summary that the run wrote"), tag("pre", self.found.summary))
        return tag(
            "section",
            tag("h3", "What was run"),
            troubles,
            missing and [tag("p", "This run lacks:", class_="lead"), missing],
            table,
            summary if self.found.summary else None,
        )

    # -- figures

    def _of(self, part: str) -> list[Drawing]:
        return [drawing for drawing in self._drawings if drawing.part == part]

    def _charts(self, drawings: list[Drawing]) -> list[Markup]:
        made = [self._figure(drawing) for drawing in drawings]
        alone = " alone" if len(made) == 1 else ""
        return [tag("div", made, class_=f"charts{alone}")] if any(made) else []

    def _figure(self, drawing: Drawing) -> Markup | None:
        content = self._image(drawing)
        if content is None:
            return None
        return tag("figure", content, tag("figcaption", drawing.caption), class_="picture" if drawing.picture else None)

    def _image(self, drawing: Drawing) -> Markup | None:
        prefix = f"s{self.number}-{drawing.name}-"

        def drawn() -> Markup:
            figure = drawing.draw()
            return embedded(figure, drawing.caption) if drawing.picture else inline(figure, prefix, drawing.caption)

        made: Markup | None = self.tried(f"figure '{drawing.name}'", drawn)
        return made


def _table(table: Table, class_: str | None = None) -> Markup:
    return tag("figure", table.html(), tag("figcaption", table.caption), class_=class_)


def _reason(error: BaseException) -> str:
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}: {text[0][:200]}" if text else type(error).__name__
