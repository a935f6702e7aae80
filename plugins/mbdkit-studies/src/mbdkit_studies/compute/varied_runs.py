"""The runs of an ensemble, whose specs differ only in numbers: computed from arrays, without a spec for each run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.impure_items import impure_item_of
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.runs.varied_numbers import VariedNumbers
from mbdkit.runs.varied_runs import VariedRuns
from mbdkit.spec.reading import parse_key
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.spec_texts import SpecTexts
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.made_items import MadeItems

#: Share of the runs of a study, of which at least one, and at most how many, are computed in the ordinary way as well.
SHARE, MOST = 0.01, 200


class DifferenceError(MbdkitError):
    """A run that was computed from arrays differs from the same run, computed in the ordinary way."""


class EnsembleRuns:
    """The runs of an ensemble.

    Parameters
    ----------
    points
        Points of the study.
    measures
        Expressions that are evaluated for the runs.

    Attributes
    ----------
    reason : str
        Reason why the runs cannot be computed from arrays, as a clause; empty if they can.
    note : str
        What the user should know about it; empty if there is nothing.
    """

    def __init__(self, points: PlannedPoints, measures: Sequence[str]):
        self.note = ""
        self._points, self._table = points, points.table() or {}
        self._columns = [column for column in self._table.values() if column.dtype != object]
        self.reason = "" if self._columns and len(self._columns) == len(self._table) else "their values are no numbers"
        if self.reason:
            return
        self._specs = VariedSpecs(points.grids[0].base_json)
        self._keys = [parse_key(key) for key in self._table]
        try:
            self.base = points[0].spec
            self.texts = SpecTexts(self.base, self._keys)
        except MbdkitError:
            self.reason = "the text of their specs depends on more than these values"
            return
        if (other := impure_item_of(self.base)) is not None:
            self.reason = f"the {other.plugin.label()} {other.id} does not say that it is pure"
            self.note = f"each run is prepared by itself, which takes longer, because {self.reason}"
            return
        if any(path[0] not in ("model", "parameters") for path in self.texts.paths):
            self.reason = "values outside of the model differ"
            return
        self.numbers = VariedNumbers(self.texts.paths, self._with, measures)

    def _with(self, numbers: Sequence[float]) -> RunSpec:
        return self._specs.spec([*zip(self._keys, numbers, strict=True)])

    def spec(self, place: int) -> RunSpec:
        """Return the spec of the run with this index in the study."""
        return self._with([column[place].item() for column in self._columns])

    def varied_in(self, lanes: LaneRuns) -> VariedRuns:
        """Return what computes the runs."""
        return VariedRuns(lanes, self.numbers, lambda _, run: not run.settings.files_read)

    def finished(self, runs: VariedRuns, places: Sequence[int]) -> Iterator[tuple[list[int], FinishedRuns]]:
        """Yield indices in the study and results of some of the runs at `places`; `runs`: see `varied_in`."""
        columns = [column[places] for column in self._columns]
        if not (known := np.asarray(places)[self.texts.are_known(columns)].tolist()):
            return
        values = np.stack([column[known].astype(float) for column in self._columns], axis=1)
        for members, results in runs.finished(values, lambda member: self.spec(known[member])):
            yield [known[member] for member in members], results

    def hashes(self, places: Sequence[int]) -> tuple[list[str], list[str]]:
        """Return the hashes of the specs, and the identifiers, of the runs at some places."""
        return self.texts.hashes([column[places] for column in self._columns])

    def specs(self, places: Sequence[int]) -> Sequence[RunSpec]:
        """Return the specs of the runs at some places, each of which is made when it is needed."""
        return MadeItems(len(places), lambda number: self.spec(places[number]))


def drawn(places: Sequence[int], runs: int) -> frozenset[int]:
    """Return the places, among those of a block of a study with this number of runs, whose runs are computed twice."""
    generator = np.random.default_rng()
    count = len(places) * min(max(SHARE, 1 / runs), MOST / runs)
    return frozenset(generator.choice(places, math.floor(count + generator.random()), replace=False).tolist())


def is_determined(spec: RunSpec) -> bool:
    """Return whether a spec alone determines its mechanism, because its model and its force laws are pure."""
    return spec.model_item.is_pure and all(item.is_pure for item in spec.force_law_items)
