"""Numbers of a spec that sliders change, with their ranges, and runs with the values of the sliders: motion, forces and
verdict for the page.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from mbdkit.archive.headlines import headline_texts
from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.plain_data import Path, copied, parse_path, path_text, plain
from mbdkit.base.text import did_you_mean, listed, shown
from mbdkit.spec.loading import load_spec, read_source
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import put
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.spec_kinds import kind_of, spec_loader
from mbdkit_biomech.inverse_dynamics.results.inverse_run import inverse
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_report import TONES, chart_data, film_of, key_unit, key_words, keys_ending_in, plot_module
from mbdkit_report.pages.run_report import yaml_text
from mbdkit_studies import PreparedRun

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


NUMBERS = 20_000  #: Approximate number of pose values of a motion.
BISECTIONS = 6  #: Steps in which the end of a slider is found if the spec refuses its usual end.
ROWS = 300  #: Largest number of points of a curve.


class Explorer:
    """A spec with sliders.

    Parameters
    ----------
    spec
        The spec of a run or of inverse dynamics, whose values are the reference.
    names
        See `sliders`.
    """

    def __init__(self, spec: RunSpec | InverseSpec, names: Sequence[str] | None = None):
        self._prepared = PreparedRun(spec) if isinstance(spec, RunSpec) else None
        every = sliders(spec, names)
        within = [replace(one, low=self._reached(one, one.low), high=self._reached(one, one.high)) for one in every]
        free = [slider for slider in within if slider.low < slider.high]  # others are held, such as by a driver
        self.spec, self.sliders = spec, every if names and len(free) < len(every) else free or every
        self._by_key = {slider.key: slider for slider in self.sliders}
        self._data = plain(read_source(spec).data)
        self.title = str(spec.title or self._data["model"]["name"])

    def answer(self, values: Mapping[str, float]) -> dict[str, object]:
        """Return the contents of the page for the given values of sliders, as JSON values; only the ``error`` and the
        ``spec`` if the spec refuses a value or the run cannot be made.

        Parameters
        ----------
        values
            Values by key of the slider. Other sliders have the values of the spec; unknown keys are ignored.
        """
        known = {key: float(value) for key, value in values.items() if key in self._by_key}
        changed = {key: value for key, value in known.items() if value != self._by_key[key].value}
        data = copied(self._data)
        for key, value in changed.items():
            put(data, self._by_key[key].path, value)
        try:
            with self._prepared.run(changed) if self._prepared else self._inverse(data) as made:
                return self._shown(made, data)
        except MbdkitError as error:
            return {"error": shown(str(error)), "spec": yaml_text(data)}

    def _reached(self, slider: Slider, end: float) -> float:
        """Return an end of a slider if it is valid and can be assembled; otherwise, the place nearest to it on the way
        to the value of the spec, found by bisection.
        """
        if self._prepared is None or self._starts(slider, end):
            return end
        valid, wrong = slider.value, end
        for _ in range(BISECTIONS):
            middle = (valid + wrong) / 2
            valid, wrong = (middle, wrong) if self._starts(slider, middle) else (valid, middle)
        return valid

    def _starts(self, slider: Slider, value: float) -> bool:
        assert self._prepared is not None
        try:
            self._prepared.start_with({slider.key: value})
        except MbdkitError:
            return False
        return True

    def _inverse(self, data: dict[str, object]) -> Run:
        document = read_source(self.spec)
        document.data = copied(data)
        return inverse(cast("InverseSpec", spec_loader.of(kind_of(document.data).load)(document, ())))

    def _shown(self, made: Run, data: Mapping[str, object]) -> dict[str, object]:
        every = headline_texts(made, "\u00b1", all_measures=True)
        return {
            "film": film_of(made, NUMBERS),
            "verdict": made.verdict if made.status == "complete" else f"{made.status}: {made.status_reason}",
            "reasons": [shown(reason) for reason in made.verdict_reasons],
            "tone": TONES.get(made.verdict, "") if made.status == "complete" else "alarm",
            "headlines": [[shown(label), text, shown(key)] for label, text, key in every],
            "charts": _charts(made),
            "spec": yaml_text(data),
        }


def _charts(made: Run) -> list[dict[str, Any]]:
    """Return the charts of the forces of joints and of the torques of drivers, joints and actuators, as in reports."""
    charts = [chart for kind in ("reactions", "torques") for chart in plot_module(kind).charts(made)]
    return [data | {"lines": [_thinned(line) for line in data["lines"]]} for data in map(chart_data, charts)]


def _thinned(line: dict[str, Any]) -> dict[str, Any]:
    rows = np.unique(np.linspace(0, len(line["x"]) - 1, min(ROWS, len(line["x"]))).astype(int)).tolist()
    return line | {"band": None, "label": shown(line["label"])} | {key: [line[key][k] for k in rows] for key in "xy"}


def explorer_of(source: object, names: Sequence[str] | None = None, assignments: Iterable[str] = ()) -> Explorer:
    """Return the explorer of a run spec or an inverse spec from any source.

    Raises
    ------
    SpecError
        If the spec is wrong, or a name does not denote one of its numbers.
    """
    document = read_source(source)
    kind = kind_of(document.data)
    load = spec_loader.of(kind.load) if kind.run_kind else load_spec
    return Explorer(cast("RunSpec | InverseSpec", load(document, assignments)), names)
