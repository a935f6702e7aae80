"""Points of a study in words with units, as its readers see them: ``RK4, step 0.1 s``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

from mbdkit.base.errors import MbdkitError
from mbdkit.spec import RunSpec
from mbdkit.spec.key_words import key_unit, key_words

if TYPE_CHECKING:
    from mbdkit.studies.study_point import StudyPoint


def point_words(point: StudyPoint, units: Mapping[str, str] | None = None) -> str:
    """Return the values of a point on the axes in words, such as ``RK4, step 0.1 s``.

    Parameters
    ----------
    units
        Units of all keys, if these are known to be those of all points; by default the spec of the point is read.
    """
    return ", ".join(value_words(key, point, None if units is None else units[key]) for key in point.axes)


def value_words(key: str, point: StudyPoint, unit: str | None = None) -> str:
    """Return the value of a point on an axis: a label as it is, a number with the words and the unit of the key."""
    label = point.axes[key]
    if isinstance(label, str):
        return label
    return " ".join(filter(None, (key_words(key), f"{label:.6g}", axis_unit(key, [point]) if unit is None else unit)))


def axis_unit(key: str, points: Iterable[StudyPoint]) -> str:
    """Return the unit of an axis; empty if it has none, or if no spec of the points is valid here."""
    return key_unit(key, _valid_specs(points))


def _valid_specs(points: Iterable[StudyPoint]) -> Iterator[RunSpec]:
    for point in points:
        with suppress(MbdkitError):  # its plugin is not installed
            yield point.spec
