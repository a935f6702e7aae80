"""Numbers of a spec that sliders change, with their ranges."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, parse_path, path_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.spec.model_spec import ModelSpec
from mbdkit_report import key_unit, key_words, keys_ending_in

MOST = 12  #: Largest number of sliders that are chosen by default.
_TURNS = {"rad": math.radians(30), "deg": 30.0}  #: Half of the range of an angle, by unit.
#: Keys of a model whose numbers have no slider by default.
_LEFT_OUT = ("gravity", "name", "assembly", "pitches", "points", "point", "axis", "position", "velocity", "elements",
             "at", "from", "to", "a", "b", "radii")  # fmt: skip


@dataclass(frozen=True)
class Slider:
    """A number of a spec with its range.

    Parameters
    ----------
    path
        Key path in the spec.
    words
        Name that is shown at the slider, such as ``stiffness of support``.
    unit
        Unit of the value; empty if there is none, or it is not known.
    low, high
        Ends of the range, in this unit.
    value
        Value in the spec, in this unit.
    """

    path: Path
    words: str
    unit: str
    low: float
    high: float
    value: float

    @property
    def key(self) -> str:
        """The key path as text."""
        return path_text(self.path)


def sliders(spec: ModelSpec, names: Sequence[str] | None = None) -> list[Slider]:
    """Return the sliders of a spec.

    Parameters
    ----------
    names
        Named parameters or dotted keys of numbers. By default, the named parameters that are numbers; if there are
        none, numbers of the model, except positions and settings, and except zeros that are not angles. At most `MOST`
        sliders are chosen by default.

    Raises
    ------
    SpecError
        If a name does not denote a number of the spec, or the spec has no number to change.
    """
    data = json.loads(spec.canonical_json())
    if names:
        return [_slider(spec, data, _path_of(spec, name)) for name in names]
    paths: list[Path] = [("parameters", name) for name, value in spec.parameters.items() if not isinstance(value, str)]
    results = [_slider(spec, data, path) for path in paths or _numbers(data["model"], ("model",))]
    chosen = [result for result in results if paths or result.value or result.unit == "rad"][:MOST]
    if not chosen:
        raise SpecError(
            "no slider is chosen by default, because the numbers of the model are positions, settings or zeros; name "
            "numbers with --parameters"
        )
    return chosen


def _path_of(spec: ModelSpec, name: str) -> Path:
    return ("parameters", name) if name in spec.parameters else parse_path(name)


def _numbers(holder: object, path: Path) -> Iterator[Path]:
    """Yield the paths of the numbers in plain data, except those of positions and settings."""
    if isinstance(holder, dict):
        for key, value in holder.items():
            if key not in _LEFT_OUT:
                yield from _numbers(value, (*path, key))
    elif isinstance(holder, list):
        for index, value in enumerate(holder):
            yield from _numbers(value, (*path, index))
    elif isinstance(holder, int | float) and not isinstance(holder, bool):
        yield path


def _slider(spec: ModelSpec, data: Any, path: Path) -> Slider:
    holder = data
    for part in path:
        known = list(holder) if isinstance(holder, dict) else []
        try:
            holder = holder[int(part) if isinstance(holder, list) else part]
        except (KeyError, IndexError, TypeError, ValueError):
            keys = list(keys_ending_in(str(part), data["model"])) if len(path) == 1 else []
            hint = f" (did you mean '{keys[0]}'?)" if keys else ""
            hint = hint or did_you_mean(str(part), known) or f"; there are {listed(known)}"
            raise SpecError(f"the spec has no number '{path_text(path)}'{hint}") from None
    if isinstance(holder, bool) or not isinstance(holder, int | float):
        raise SpecError(f"'{path_text(path)}' is not a number of the spec")
    value, unit = float(holder), key_unit(path, [spec])
    if unit in _TURNS:
        low, high = value - _TURNS[unit], value + _TURNS[unit]
    else:
        low, high = sorted((0.5 * value, 2.0 * value)) if value else (-1.0, 1.0)
    return Slider(path, key_words(path), unit, low, high, value)
