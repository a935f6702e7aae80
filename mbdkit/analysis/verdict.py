"""Verdicts in plain words, with the figures that they rest on: what a report prints and draws.

Verdicts are about ranges and factors, with a margin in which the answer is left open, so that the last digits, which
differ between machines, never decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal, TypeVar

import numpy as np

MARGIN = 1.05
"""A value within this factor of a border is too near to it to decide: no two machines differ by so much."""


class Answer(StrEnum):
    """What became of a claim."""

    YES = "yes"
    NO = "no"
    PARTLY = "partly"
    OPEN = "open"
    """Not decided: runs are missing or failed, or a value lies on the border."""


@dataclass(frozen=True)
class Range:
    """A range of positive values with its unit.

    Parameters
    ----------
    low, high
        Its borders, both included.
    unit
        Such as ``mm``.
    """

    low: float
    high: float
    unit: str = ""

    def holds(self, value: float, *, margin: float = MARGIN) -> Answer:
        """Return whether a value lies inside: yes, no, or open where it is missing or on a border."""
        if not math.isfinite(value):
            return Answer.OPEN
        if self.low * margin <= value <= self.high / margin:
            return Answer.YES
        return Answer.NO if value < self.low / margin or value > self.high * margin else Answer.OPEN

    @classmethod
    def around(cls, value: float, factor: float, unit: str = "") -> Range:
        """Return the range within a factor of a value."""
        return cls(value / factor, value * factor, unit)

    def __str__(self) -> str:
        return f"{self.low:.2g} to {self.high:.2g} {self.unit}".rstrip()


def exceeds(value: float, other: float, *, margin: float = MARGIN) -> Answer:
    """Return whether a value is larger than another: open where one is missing or they are nearly equal."""
    if not (math.isfinite(value) and math.isfinite(other)):
        return Answer.OPEN
    if value > other * margin:
        return Answer.YES
    return Answer.NO if value < other / margin else Answer.OPEN


def together(answers: Sequence[Answer]) -> Answer:
    """Return one answer for several: yes or no where all agree, partly where some do; open ones decide nothing."""
    decided = {answer for answer in answers if answer is not Answer.OPEN}
    if not decided or (len(decided) == 1 and Answer.OPEN in answers):
        return Answer.OPEN
    return decided.pop() if len(decided) == 1 else Answer.PARTLY


@dataclass(frozen=True)
class Claim:
    """One claim and what became of it.

    Attributes
    ----------
    name
        Short and unique, for links.
    statement
        What was claimed, as a sentence.
    published, computed
        The figures side by side, as text with units.
    answer
        Whether it holds.
    sentence
        The finding as a sentence.
    """

    name: str
    statement: str
    published: str
    computed: str
    answer: Answer
    sentence: str


UNDECIDED = "Not decided: the runs that would tell are missing or failed."


def told(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return the claims as they are told: an open one says that it is not decided, whatever its figures seem to say."""
    return tuple(replace(claim, sentence=UNDECIDED) if claim.answer is Answer.OPEN else claim for claim in claims)


@dataclass(frozen=True)
class Column:
    """A column's heading and unit (empty for text and plain counts)."""

    label: str
    unit: str = ""


Named = TypeVar("Named", "Claim", "Table", "Figure")
Cell = str | int | float | bool | None


@dataclass(frozen=True)
class Table:
    """A table: every row has a cell for each column; None is an empty cell.

    A `headline` is the one that a study is made for: it is told on the terminal and in Markdown too.
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
        For the legend.
    x, y
        (K,) coordinates; nan where there is nothing to draw.
    kind
        A line, points, or both.
    group
        Lines of the same group share a colour; the method's label in most figures.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    kind: Literal["line", "points", "both"] = "line"
    group: str = ""


@dataclass(frozen=True)
class Band:
    """A shaded range of the y axis, such as a published one."""

    label: str
    low: float
    high: float


@dataclass(frozen=True)
class Mark:
    """A place on the x axis that a thin line marks, such as the time of an event; without a label it has none."""

    label: str
    x: float


@dataclass(frozen=True)
class Figure:
    """What a figure shows; how it is drawn is the report's affair.

    Attributes
    ----------
    name
        Short and unique, for file names and links.
    title, caption
        What it is, and what to see in it.
    x, y
        Its axes.
    lines, bands, marks
        What is drawn.
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
    equal: bool = False


@dataclass(frozen=True)
class Verdict:
    """What a study says.

    Attributes
    ----------
    name, title
        Which verdict it is, and a heading.
    sentence
        The whole verdict in a few plain sentences.
    claims, tables, figures
        What it rests on.
    notes
        What a reader must know to judge it.
    """

    name: str
    title: str
    sentence: str
    claims: tuple[Claim, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def claim(self, name: str) -> Claim:
        """Return the claim of this name; raises KeyError."""
        return _named(self.claims, name)

    def table(self, name: str) -> Table:
        """Return the table of this name; raises KeyError."""
        return _named(self.tables, name)

    def figure(self, name: str) -> Figure:
        """Return the figure of this name; raises KeyError."""
        return _named(self.figures, name)

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values for JSON: arrays as lists, numbers that are not finite as None."""
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
