"""Parts of a study: `Shard`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from mbdkit.base.errors import SpecError


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of a study.

    Parameters
    ----------
    number, count
        Number of the part, from 1, and number of parts. Runs are assigned to parts in turn, by their place in the list
        of all runs.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse a part from text such as ``2/3``.

        Raises
        ------
        SpecError
            If the text does not have this form.
        """
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise SpecError(f"a part of a study is written number/count, such as 1/2 and 2/2, not {text!r}")
        return cls(int(found[1]), int(found[2]))

    def has(self, place: int) -> bool:
        """Return whether the run at this place, counted from 0, belongs to the part."""
        return place % self.count == self.number - 1

    def overlaps(self, other: Shard) -> bool:
        """Return whether a run may belong to both parts, whatever the number of runs."""
        return (self.number - other.number) % math.gcd(self.count, other.count) == 0


WHOLE = Shard(1, 1)
"""All of a study."""
