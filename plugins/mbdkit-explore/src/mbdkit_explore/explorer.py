"""Runs of a spec with the values of sliders: computes motion, forces and verdict for the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from mbdkit.archive.headlines import headline_texts
from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError
from mbdkit.base.plain_data import copied, plain
from mbdkit.base.text import shown
from mbdkit.spec.loading import load_spec, read_source
from mbdkit.spec.reading import put
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.spec_kinds import kind_of, spec_loader
from mbdkit_biomech.inverse_dynamics.results.inverse_run import inverse
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_explore.sliders import Slider, sliders
from mbdkit_report import TONES, chart_data, film_of, plot_module
from mbdkit_report.pages.run_report import yaml_text
from mbdkit_studies import PreparedRun

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
        See `mbdkit_explore.sliders.sliders`.
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
