"""The contents of pages as data: figures, tables, drawings and sections. Their appearance is defined elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from markupsafe import Markup

from mbdkit.base.text import plus_minus


@dataclass(frozen=True)
class Column:
    """Heading and unit of a column; the unit is empty for text and counts."""

    label: str
    unit: str = ""


def columns_of(headings: str) -> tuple[Column, ...]:
    """Return columns from their headings with units, such as ``body; mass [kg]``."""
    parts = (heading.removesuffix("]").partition(" [") for heading in headings.split("; "))
    return tuple(Column(label, unit) for label, _, unit in parts)


Cell = str | int | float | bool | None


class Stated(float):
    """A number as a cell of a table, with its text and its id, which is the same in every output."""

    text: str
    id: str

    @classmethod
    def of(cls, value: float, text: str, key: str) -> Stated:
        """Return the number `value` with a text and its id `key`."""
        found = cls(value)
        found.text, found.id = text, key
        return found


Ends = tuple[float, float] | None  #: Ends of a bar below and above a number; None or nan if they are unknown.


def bar_columns(what: str, unit: str, bars: Iterable[Ends]) -> list[Column]:
    """Return the columns of bars of a number that is called `what`: one, or two if a bar has two different ends."""
    is_even = all(bar is None or bar[0] == bar[1] or math.isnan(bar[0] + bar[1]) for bar in bars)
    return [Column(f"{sign} of {what}", unit) for sign in (("\u00b1",) if is_even else ("-", "+"))]


def bar_cells(value: float, bar: Ends, key: str, columns: int = 1) -> list[Cell]:
    """Return a number with the digits that its bar justifies, and its bar in one or two columns."""
    if bar is None or math.isnan(bar[0] + bar[1]):
        return [value, *[None] * columns]
    ends = [Stated.of(end, plus_minus(value, end).partition(" +- ")[2] or "0", key) for end in bar[:columns]]
    return [Stated.of(value, plus_minus(value, bar).partition(" ")[0], key), *ends]


@dataclass(frozen=True)
class Table:
    """A table with one cell per column in every row; None is an empty cell.

    A `headline` table is the main result of a study and is also printed on the terminal and in Markdown.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    headline: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: {len(self.columns)} columns, but a row of {len(row)} cells")


@dataclass(frozen=True)
class Axis:
    """An axis of a figure."""

    label: str
    unit: str = ""
    log: bool = False

    @property
    def title(self) -> str:
        """The label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


TIME = Axis("time", "s")


@dataclass(frozen=True, eq=False)
class Line:
    """One line of a figure.

    Attributes
    ----------
    label
        Label in the legend.
    x, y
        (K,) coordinates; nan interrupts the line.
    kind
        Whether to draw a line, points, or both.
    group
        Name of a group; by default the label. Lines of the same group have the same colour.
    color
        Colour as ``#rrggbb``, such as that of a body in other pictures; by default that of the group.
    band
        (M, 2) corners of a shaded outline around the line, such as its estimated error; None if there is none.
    is_emphasized
        Whether the line is that of which the figure is about: it is wider, and has the colour of text, which no other
        line has.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    kind: Literal["line", "points", "both"] = "line"
    group: str = ""
    band: np.ndarray | None = None
    color: str = ""
    is_emphasized: bool = False


@dataclass(frozen=True)
class Band:
    """A shaded range of the y axis, for example a published range."""

    label: str
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Guide:
    """A thin line that shows a slope, such as that of an order of convergence, with a label in its middle; `x` and `y`
    (2,) are the coordinates of its ends.
    """

    label: str
    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class Mark:
    """A thin vertical line, for example at the time of an event; the label may be empty."""

    label: str
    x: float


@dataclass(frozen=True)
class Figure:
    """Content of a figure; its appearance is left to the report.

    Attributes
    ----------
    name
        Short unique identifier, used in file names and links.
    title, caption
        Title, and an explanation of what the figure shows.
    x, y
        The axes.
    lines, bands, marks, guides
        Elements of the figure.
    equal
        Whether both axes have the same scale, as for paths in the plane.
    """

    name: str
    title: str
    caption: str
    x: Axis
    y: Axis
    lines: tuple[Line, ...]
    bands: tuple[Band, ...] = ()
    marks: tuple[Mark, ...] = ()
    guides: tuple[Guide, ...] = ()
    equal: bool = False
    NEAR: ClassVar[float] = 0.008  #: Lines closer than this share of the chart hide each other.

    def __post_init__(self) -> None:
        if self.y.log:
            object.__setattr__(self, "lines", tuple(map(_told_if_zero, self.lines)))

    @property
    def needs_key(self) -> bool:
        """Whether the lines need a legend: there are several lines, or a single one that the title does not name."""
        return len(self.lines) > 1 or any(line.label.lower() not in self.title.lower() for line in self.lines)

    def coincide(self, first: Line, second: Line) -> bool:
        """Return whether the second of two lines would hide most of the first one: half of its points are closer to it
        than `NEAR` times the extent of the chart.
        """
        if "points" in (first.kind, second.kind):
            return False
        (ax, ay), (bx, by) = (self._on_page(line) for line in (first, second))
        if not len(ax) or not len(bx):
            return False
        if not self.equal:
            away = np.abs(np.interp(ax, bx, by, left=np.inf, right=np.inf) - ay)
        else:
            few = np.linspace(0, len(ax) - 1, 60).astype(int)
            away = np.min(np.hypot(ax[few, None] - bx, ay[few, None] - by), axis=1)
        return float(np.median(away)) < self.NEAR * self._extent

    def _on_page(self, line: Line) -> tuple[np.ndarray, np.ndarray]:
        """Return the coordinates of the visible points of a line, and their logarithms on logarithmic axes."""
        seen = self.visible(line)
        return tuple(
            np.log10(values[seen]) if axis.log else values[seen]
            for values, axis in ((line.x, self.x), (line.y, self.y))
        )

    @cached_property
    def _extent(self) -> float:
        values = [self._on_page(line) for line in self.lines]
        spans = [np.ptp(np.concatenate(coordinate)) for coordinate in zip(*values, strict=True)]
        return float(max(spans) if self.equal else spans[1])

    def visible(self, line: Line) -> np.ndarray:
        """Return a mask (K,) of the points of a line that can be drawn: finite, and positive on logarithmic axes."""
        seen: np.ndarray = np.isfinite(line.x) & np.isfinite(line.y)
        for axis, values in ((self.x, line.x), (self.y, line.y)):
            if axis.log:
                seen &= np.nan_to_num(values) > 0
        return seen


_ZERO = " (exactly 0)"


def _told_if_zero(line: Line) -> Line:
    """Return a line whose label says that all its values are zero, because a logarithmic axis does not show it."""
    known = line.y[np.isfinite(line.y)]
    if not known.size or np.any(known) or line.label.endswith(_ZERO):
        return line
    return replace(line, label=line.label + _ZERO, group=line.group or line.label)


@dataclass(frozen=True)
class Illustration:
    """A drawing for wide pages, a drawing for narrow pages, and a description for readers who do not see them."""

    WIDE: ClassVar[float] = 900.0  #: Width of a drawing on a screen or on paper [px].
    NARROW: ClassVar[float] = 350.0  #: Width of a drawing on a telephone [px].

    wide: Markup
    narrow: Markup
    description: str
    caption: str

    @classmethod
    def of(cls, draw: Callable[[float], Markup], description: str, caption: str) -> Illustration:
        """Return the drawings that a function of the width [px] makes for wide and for narrow pages."""
        return cls(draw(cls.WIDE), draw(cls.NARROW), description, caption)


@dataclass(frozen=True)
class Section:
    """A section of a page.

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
    is_input
        Whether the section shows the input of the user. Such sections follow the results, and their tables are folded.
    """

    anchor: str
    title: str
    sentences: tuple[str, ...] = ()
    drawing: Illustration | None = None
    tables: tuple[Table, ...] = ()
    is_input: bool = False
