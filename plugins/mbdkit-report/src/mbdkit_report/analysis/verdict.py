"""Verdicts as sentences, with the claims, tables and figures that support them, for use in reports.

An answer says whether a value lies in a range, or exceeds another value. Within a margin around each limit the answer
is open, so that it does not depend on the last digits, which differ between machines.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, ClassVar, TypeVar

from mbdkit.base.plain_data import json_text
from mbdkit_report.figures.page_model import Figure, Table


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
    low, high
        Limits of the range, in `unit`.
    unit
        Unit, for example ``mm``; empty if the values have no unit.
    """

    #: Within this factor of a limit the answer is open. Values from different machines differ by less.
    MARGIN: ClassVar[float] = 1.05

    low: float
    high: float
    unit: str = ""

    def holds(self, value: float) -> Answer:
        """Return whether a value lies inside: yes, no, or open if it is not finite or close to a limit."""
        if not math.isfinite(value):
            return Answer.OPEN
        if self.low * self.MARGIN <= value <= self.high / self.MARGIN:
            return Answer.YES
        return Answer.NO if value < self.low / self.MARGIN or value > self.high * self.MARGIN else Answer.OPEN

    @classmethod
    def around(cls, value: float, factor: float, unit: str = "") -> Range:
        """Return the range from `value` divided by `factor` to `value` times `factor`."""
        return cls(value / factor, value * factor, unit)

    def __str__(self) -> str:
        return f"{self.low:.2g} to {self.high:.2g} {self.unit}".rstrip()


def exceeds(value: float, other: float) -> Answer:
    """Return whether `value` is larger than `other`; open if either is not finite, or if they are nearly equal."""
    if not (math.isfinite(value) and math.isfinite(other)):
        return Answer.OPEN
    if value > other * Range.MARGIN:
        return Answer.YES
    return Answer.NO if value < other / Range.MARGIN else Answer.OPEN


def together(answers: Sequence[Answer]) -> Answer:
    """Combine answers: the common answer if all agree; open if there are none, or if some are open and all others
    agree; otherwise partly.
    """
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


Named = TypeVar("Named", "Claim", "Table", "Figure")


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
    notes: tuple[str, ...] = ()

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
        plain: dict[str, Any] = json.loads(json_text(asdict(self)))
        return plain


def _named(items: Sequence[Named], name: str) -> Named:
    for item in items:
        if item.name == name:
            return item
    raise KeyError(f"there is no {name!r}; there are {', '.join(item.name for item in items) or 'none'}")
