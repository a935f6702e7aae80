"""Points of a study in words with units, as its readers see them: ``RK4, step 0.1 s``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit.spec.key_words import key_unit, key_words

if TYPE_CHECKING:
    from mbdkit.studies.study import StudyPoint


def point_words(point: StudyPoint) -> str:
    """Return the values of a point on the axes in words, such as ``RK4, step 0.1 s``."""
    return ", ".join(value_words(key, point) for key in point.axes)


def value_words(key: str, point: StudyPoint) -> str:
    """Return the value of a point on an axis: a label as it is, a number with the words and the unit of the key."""
    label = point.axes[key]
    if isinstance(label, str):
        return label
    return " ".join(filter(None, (key_words(key), f"{label:.6g}", key_unit(key, [point.spec]))))
