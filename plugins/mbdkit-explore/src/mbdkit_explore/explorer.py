"""Runs of a spec with the values of sliders: computes motion, forces and verdict for the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import cast

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
from mbdkit_explore.sliders import sliders
from mbdkit_report import TONES, film_of
from mbdkit_report.pages.run_report import yaml_text
from mbdkit_studies import PreparedRun

NUMBERS = 20_000  #: Approximate number of pose values of a motion.
ROWS = 300  #: Largest number of points of a curve.
#: Largest number of curves: the joints with the largest forces or, in inverse dynamics, the actuators with the largest
#: values.
CURVES = 6


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
        self.spec, self.sliders = spec, sliders(spec, names)
        self._by_key = {slider.key: slider for slider in self.sliders}
        self._data = plain(read_source(spec).data)
        self._prepared = PreparedRun(spec) if isinstance(spec, RunSpec) else None
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
            "curves": _curves(made),
            "spec": yaml_text(data),
        }


def _curves(made: Run) -> dict[str, object]:
    """Return the curves of a run over time: forces of joints or, in inverse dynamics, values of actuators. At most
    `CURVES` are included, those with the largest values.
    """
    time = np.asarray(made.time)
    if made.kind == "inverse":
        names, unit = list(made.actuators), "N or N m"
        values = made.array("actuators/value")
    elif made.records("joints/reaction_force") and made.joint_names:
        names, unit = list(made.joint_names), "N"
        values = np.linalg.norm(made.array("joints/reaction_force"), axis=2)
    else:
        return {"time": [], "names": [], "values": [], "unit": ""}
    order = np.argsort(-np.max(np.abs(np.nan_to_num(values)), axis=0), kind="stable")[:CURVES]
    rows = np.unique(np.linspace(0, len(time) - 1, min(ROWS, len(time))).astype(int))
    lines = [[float(f"{value:.5g}") for value in np.nan_to_num(values[rows, column])] for column in order]
    return {"time": time[rows].tolist(), "names": [shown(names[k]) for k in order], "values": lines, "unit": unit}


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
