"""Verdicts as sentences, with the claims, tables and figures that support them; reports print and draw these.

Answers are based on ranges and factors. Within a margin around each limit the answer is open, so that it does not
depend on the last digits, which differ between machines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal, TypeVar

import numpy as np

MARGIN = 1.05
"""Within this factor of a limit the answer is open; differences between machines are smaller."""


class Answer(StrEnum):
    """Answer to a claim."""

    YES = "yes"
    NO = "no"
    PARTLY = "partly"
    OPEN = "open"
    """Not decided, because runs are missing or failed, or a value lies too close to a limit."""


@dataclass(frozen=True)
class Range:
    """A range of positive values with its unit.

    Parameters
    ----------
    unit
        Unit, for example ``mm``; empty if there is none.
    """

    low: float
    high: float
    unit: str = ""

    def holds(self, value: float, *, margin: float = MARGIN) -> Answer:
        """Return whether a value lies inside: yes, no, or open if it is not finite or close to a limit."""
        if not math.isfinite(value):
            return Answer.OPEN
        if self.low * margin <= value <= self.high / margin:
            return Answer.YES
        return Answer.NO if value < self.low / margin or value > self.high * margin else Answer.OPEN

    @classmethod
    def around(cls, value: float, factor: float, unit: str = "") -> Range:
        """Return the range from `value` divided by `factor` to `value` times `factor`."""
        return cls(value / factor, value * factor, unit)

    def __str__(self) -> str:
        return f"{self.low:.2g} to {self.high:.2g} {self.unit}".rstrip()


def exceeds(value: float, other: float, *, margin: float = MARGIN) -> Answer:
    """Return whether `value` is larger than `other`: open if either is not finite or they are nearly equal."""
    if not (math.isfinite(value) and math.isfinite(other)):
        return Answer.OPEN
    if value > other * margin:
        return Answer.YES
    return Answer.NO if value < other / margin else Answer.OPEN


def together(answers: Sequence[Answer]) -> Answer:
    """Combine answers: the common one if all agree, open if some are open and the rest agree, else partly."""
    decided = {answer for answer in answers if answer is not Answer.OPEN}
    if not decided or (len(decided) == 1 and Answer.OPEN in answers):
        return Answer.OPEN
    return decided.pop() if len(decided) == 1 else Answer.PARTLY


@dataclass(frozen=True)
class Claim:
    """One claim and its answer.

    Attributes
    ----------
    name
        Short unique identifier, used in links.
    statement
        The claim as a sentence.
    published, computed
        Published and computed values, as text with units.
    answer
        Whether the claim holds.
    sentence
        The finding as a sentence.
    """

    name: str
    statement: str
    published: str
    computed: str
    answer: Answer
    sentence: str


UNDECIDED = "Not decided: the required runs are missing or failed."


def told(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return the claims for a report: the sentence of an open claim is replaced by `UNDECIDED`."""
    return tuple(replace(claim, sentence=UNDECIDED) if claim.answer is Answer.OPEN else claim for claim in claims)


@dataclass(frozen=True)
class Column:
    """Heading and unit of a column; the unit is empty for text and counts."""

    label: str
    unit: str = ""


Named = TypeVar("Named", "Claim", "Table", "Figure")
Cell = str | int | float | bool | None


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
        Lines of the same group have the same colour; in most figures the label of the method.
    color
        Colour as ``#rrggbb`` of what has the same colour in other pictures, such as a body; by default that of its
        group.
    band
        (M, 2) corners of a shaded outline around the line, such as its estimated error; None if there is none.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    kind: Literal["line", "points", "both"] = "line"
    group: str = ""
    band: np.ndarray | None = None
    color: str = ""


@dataclass(frozen=True)
class Band:
    """A shaded range of the y axis, for example a published range."""

    label: str
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Guide:
    """A thin line that shows a slope, such as that of an order of convergence.

    Attributes
    ----------
    label
        Label in its middle.
    x, y
        (2,) its ends.
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

    @property
    def needs_key(self) -> bool:
        """Whether the lines need names: there are several, or a single one that the title does not name."""
        return len(self.lines) > 1 or any(line.label.lower() not in self.title.lower() for line in self.lines)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a study or a run.

    Attributes
    ----------
    name, title
        Name of the verdict, and its heading.
    sentence
        The verdict in a few sentences.
    claims, tables, figures
        The results that support it.
    notes
        Assumptions and explanations for the reader.
    """

    name: str
    title: str
    sentence: str
    claims: tuple[Claim, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def claim(self, name: str) -> Claim:
        """Return the claim with this name; raise KeyError if there is none."""
        return _named(self.claims, name)

    def table(self, name: str) -> Table:
        """Return the table with this name; raise KeyError if there is none."""
        return _named(self.tables, name)

    def figure(self, name: str) -> Figure:
        """Return the figure with this name; raise KeyError if there is none."""
        return _named(self.figures, name)

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as values for JSON: arrays become lists, numbers that are not finite become None."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain


def _named(items: Sequence[Named], name: str) -> Named:
    for item in items:
        if item.name == name:
            return item
    raise KeyError(f"there is no {name!r}; there are {', '.join(item.name for item in items) or 'none'}")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, StrEnum) else value
