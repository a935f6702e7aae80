"""Keys of run specs in words with units, as readers of a study see them: ``time.step`` becomes step [s]."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from mbdkit.errors import MbdkitError
from mbdkit.spec.reading import parse_key

if TYPE_CHECKING:
    from mbdkit.studies.study import StudyPoint

_WORDS = {
    "time.step": "step",
    "time.end": "end of the run",
    "time.start": "start of the run",
    "time.steps": "number of steps",
    "integrator": "method",
    "integrator.rtol": "relative tolerance",
    "integrator.atol": "absolute tolerance",
    "output.every": "steps between recorded rows",
}
_SECTIONS = {"model", "integrator", "time", "output", "limits", "stabilization", "parameters"}
_KINDS = {"bodies", "joints", "forces", "markers", "springs"}


def point_words(point: StudyPoint) -> str:
    """Return the values of a point on the axes in words, such as ``RK4, step 0.1 s``."""
    return ", ".join(value_words(key, point) for key in point.axes)


def value_words(key: str, point: StudyPoint) -> str:
    """Return the value of a point on an axis: a label as it is, a number with the words and the unit of the key."""
    label = point.axes[key]
    if isinstance(label, str):
        return label
    return " ".join(filter(None, (key_words(key), f"{label:.6g}", key_unit(key, [point]))))


def key_words(key: str) -> str:
    """Return a key of a run spec in words, such as stiffness of support for ``model.springs.support.stiffness``."""
    if key in _WORDS:
        return _WORDS[key]
    path = [str(part) for part in parse_key(key)]
    shown = [part.replace("_", " ") for part in path if part not in _KINDS]
    if len(shown) > 1 and path[0] in _SECTIONS:
        shown = shown[1:]
    if shown[-1].isdigit() and len(shown) > 1:
        shown[-2:] = [f"{shown[-2]}, number {int(shown[-1]) + 1}"]
    return " of ".join(reversed(shown))


def key_unit(key: str, points: Iterable[StudyPoint]) -> str:
    """Return the unit in the description of the option that a key sets; empty if there is none.

    Parameters
    ----------
    points
        Points of the study that have this key; the first whose spec has the option shows what the key sets.
    """
    for point in points:
        try:
            found = _description(point.spec, parse_key(key))
        except (MbdkitError, LookupError, TypeError, AttributeError):  # the option is computed, or not installed
            continue
        match = re.search(r"\[([^\]\s][^\]]*)\]", found)
        return match[1].replace("^2", "²") if match and "," not in match[1] else ""
    return ""


def _description(holder: Any, path: tuple[str | int, ...]) -> str:
    """Return the description of the last field of pydantic models on a path."""
    described = ""
    for part in path:
        if isinstance(holder, BaseModel):
            described = type(holder).model_fields[str(part)].description or ""
            holder = getattr(holder, str(part))
        elif isinstance(holder, Mapping):
            holder = holder[part]
        else:
            holder = holder[int(part)]
    return described
