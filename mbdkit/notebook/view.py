"""A view of a result in a notebook: text, pictures and tables as one self-contained fragment of HTML."""

from __future__ import annotations

import base64
from dataclasses import dataclass

from matplotlib.figure import Figure

from mbdkit.figures.page_model import Illustration, Table
from mbdkit.plot.style import png
from mbdkit.report.report_page import FILTERS
from mbdkit.report.templating import render


@dataclass(frozen=True)
class Picture:
    """A Matplotlib figure with its description for readers who do not see it."""

    figure: Figure
    description: str

    @property
    def source(self) -> str:
        """The figure as a URL that contains it."""
        return f"data:image/png;base64,{base64.b64encode(png(self.figure)).decode('ascii')}"

    @property
    def width(self) -> int:
        """Width on the page [px]."""
        return round(float(self.figure.get_size_inches()[0]) * 96)


@dataclass(frozen=True)
class View:
    """The content that a notebook shows for an object.

    Parameters
    ----------
    title
        Heading.
    sentences
        Paragraphs below it.
    tone
        ``good``, ``warn`` or ``alarm`` if the first paragraph has a colour.
    facts
        Labels and texts, as in a summary; a text without a label continues the one above.
    drawing, pictures
        Illustration of the mechanism, and other pictures.
    tables
        Tables with their titles.
    is_folded
        Whether tables are closed until the reader opens them.
    """

    title: str
    sentences: tuple[str, ...] = ()
    tone: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    drawing: Illustration | None = None
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    is_folded: bool = False

    def html(self) -> str:
        """Return the HTML; all texts are escaped."""
        return render("notebook.html", {"view": self}, FILTERS)
