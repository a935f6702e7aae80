"""Markers of a motion capture file in metres, by name, and landmarks of the skeleton by the names that laboratories
give to their markers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed, shown
from mbdkit_biomech.inverse_dynamics.files.measured_table import HEADINGS_SHOWN, MeasuredTable
from mbdkit_biomech.inverse_dynamics.motion.measured import si_values, times_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import ColumnOfTable, TimeColumn

Side = Literal["r", "l"]
SIDES: tuple[Side, Side] = ("r", "l")

LEFT = "_left"  #: Suffix of the names of the second leg.

_KNEE, _ANKLE = r"(knee|kne|femoral)?(epicondyle|epi|condyle)?(knee|kne)?", r"(ankle|ank)?(malleolus|mal)?(ankle|ank)?"
#: Patterns of names by landmark, in lower case, without subject, side and signs: ``Subject:R.Knee.Lateral`` is
#: ``kneelateral``. A name of which the joint is missing, such as ``RMedial``, is left out by `landmark`.
PATTERNS = {
    "asis": r"asis?|ias",
    "psis": r"psis?|ips",
    "sacrum": r"v?sac(r|rum|ral)?",
    "patella": r"pat(ella)?",
    "knee.lateral": rf"kne|knee|lfe|fle|(lateral|lat){_KNEE}|{_KNEE}(lateral|lat)",
    "knee.medial": rf"knm|mkne|kneem|mfe|fme|(medial|med){_KNEE}|{_KNEE}(medial|med)",
    "ankle.lateral": rf"ank|ankle|lmal|fal|(lateral|lat){_ANKLE}|{_ANKLE}(lateral|lat)",
    "ankle.medial": rf"anm|mank|anklem|mmal|tam|(medial|med){_ANKLE}|{_ANKLE}(medial|med)",
}

_WORDS = {"knee": r"kn|fe|fle|fme|epi|condyle", "ankle": r"an|mal|fal|tam"}


def plain_name(name: str) -> str:
    """Return a name in lower case, without the subject and without signs."""
    return "".join(filter(str.isalnum, name.rpartition(":")[2])).casefold()


def sided(name: str) -> tuple[Side | None, str]:
    """Return the side of a plain name and the name without it: at the beginning, or else at the end."""
    given = re.fullmatch(r"(right|r|left|l)(.+)", name) or re.fullmatch(r"(.+?)(right|left)", name)
    if given is None:
        return None, name
    side, rest = sorted(given.groups(), key=lambda part: part not in ("right", "r", "left", "l"))
    return ("r" if side.startswith("r") else "l"), rest


def landmark(names: Iterable[str], kind: str, side: Side | None) -> str | None:
    """Return the name of the marker of a landmark; None if there is none.

    Parameters
    ----------
    kind
        A key of `PATTERNS`.
    side
        Side of the body; None for landmarks in its middle.
    """
    words = _WORDS.get(kind.partition(".")[0], "")
    for name in names:
        own, rest = sided(plain_name(name)) if side is not None else (None, plain_name(name))
        if own == side and re.fullmatch(PATTERNS[kind], rest) and re.search(words, rest):
            return name
    return None


def side_of(names: Iterable[str]) -> Side:
    """Return the side that most names of markers begin with; right if there is no majority."""
    sides = [sided(plain_name(name))[0] for name in names]
    return "l" if sides.count("l") > sides.count("r") else "r"


LARGEST_LABORATORY = 1e4  #: Largest coordinate of a marker [m].


@dataclass(frozen=True)
class MarkerFile:
    """A table with markers, and its times (T,) [s]."""

    table: MeasuredTable
    time: np.ndarray

    @classmethod
    def of(cls, table: MeasuredTable, time: TimeColumn) -> MarkerFile:
        """Return a table of markers and its times."""
        return cls(table, times_of(table, time, "motion.time"))

    @property
    def names(self) -> list[str]:
        """Names of the markers."""
        headings = self.table.headings
        return [heading[:-2] for heading in headings if heading.endswith(".x") and not heading.startswith("plate")]

    def has(self, name: str) -> bool:
        """Return whether the file has a marker."""
        return len(self.table.resolved([f"{name}.{axis}" for axis in "xyz"])) == 3

    def vectors(self, name: str, unit: str, key: str) -> np.ndarray:
        """Return the vectors (T, 3) in the columns ``NAME.x``, ``NAME.y`` and ``NAME.z``."""
        columns = [si_values(ColumnOfTable(column=f"{name}.{axis}"), self.table, unit, key) for axis in "xyz"]
        return np.stack(columns, axis=1)

    def marker(self, name: str, key: str) -> np.ndarray:
        """Return the positions (T, 3) of a marker [m], nan where it was not seen; raise SpecError if there is none."""
        if not self.has(name):
            names = [shown(name) for name in self.names]
            some = listed(names[:HEADINGS_SHOWN]) + (", ..." if len(names) > HEADINGS_SHOWN else "")
            hint = did_you_mean(name, self.names) or f"; its markers: {some or 'none'}"
            raise SpecError(f"{self.table.name} has no marker '{shown(name)}'{hint}", key=key)
        values = self.vectors(name, "m", key)
        values[np.isnan(values).any(axis=1) | np.all(values == 0, axis=1)] = np.nan  # some programs write 0 for unseen
        if np.nanmax(np.abs(values), initial=0.0) > LARGEST_LABORATORY:
            raise SpecError(
                f"marker '{shown(name)}' of {self.table.name} is more than {LARGEST_LABORATORY:g} m from the origin; "
                "check the unit of length that the file states",
                key=key,
            )
        return values

    def markers(self, names: tuple[str, ...], key: str) -> np.ndarray:
        """Return the positions (T, N, 3) of markers [m]."""
        return np.stack([self.marker(name, key) for name in names], axis=1)
