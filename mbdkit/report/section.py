"""A section of a report: sentences, a drawing, and tables."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from mbdkit.analysis.verdict import Table


@dataclass(frozen=True)
class Drawing:
    """A drawing for wide pages and one for narrow ones, and its description for readers who do not see it."""

    wide: Markup
    narrow: Markup
    description: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A section.

    Parameters
    ----------
    anchor, title
        Identifier for links, and heading.
    sentences
        Paragraphs of text.
    drawing
        Drawing above the tables; None if there is none.
    tables
        Tables, each with its title.
    """

    anchor: str
    title: str
    sentences: tuple[str, ...] = ()
    drawing: Drawing | None = None
    tables: tuple[Table, ...] = ()
