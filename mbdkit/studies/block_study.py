"""A study whose runs are stored in blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, overload

import numpy as np

from mbdkit.archive.block_format import KEEPING_TIMES
from mbdkit.archive.blocks import Block
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import NotStoredError
from mbdkit.base.errors import SpecError
from mbdkit.measures.take import Description
from mbdkit.studies import block_index
from mbdkit.studies.block_index import BlockIndex
from mbdkit.studies.planned_points import Grid, PlannedPoints
from mbdkit.studies.study import Study
from mbdkit.studies.study_blocks import StudyBlocks
from mbdkit.studies.study_index import Row, describe_column
from mbdkit.studies.study_point import StudyPoint


class BlockPoints(Sequence[StudyPoint]):
    """Points of a study in blocks, each made when it is asked for.

    Parameters
    ----------
    places
        Places of the points among those of the study; all by default.
    """

    def __init__(self, planned: PlannedPoints, table: BlockIndex, places: Sequence[int] | None = None):
        self.planned, self.table = planned, table
        self.places = range(len(planned)) if places is None else places

    def __len__(self) -> int:
        return len(self.places)

    @overload
    def __getitem__(self, place: int) -> StudyPoint: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[StudyPoint, ...]: ...

    def __getitem__(self, place: int | slice) -> StudyPoint | tuple[StudyPoint, ...]:
        if isinstance(place, slice):
            return tuple(self[one] for one in range(*place.indices(len(self))))
        place = self.places[place]
        point, columns = self.planned[place], self.table.columns
        row = Row(
            str(columns["run_id"][place]),
            str(columns["status"][place]),
            str(columns["status_reason"][place]),
            family=point.family,
            axes=point.axes,
            worst_joint=str(columns["worst_joint"][place]),
            data_sha256=str(columns["data_sha256"][place]),
            values={name: float(columns[name][place]) for name in self.table.described},
            verdict=str(columns["verdict"][place]),
            verdict_reasons=str(columns["verdict_reasons"][place]),
        )
        return StudyPoint(point.number, row, point, None, point.axes)


class BlockStudy(Study):
    """A study whose runs are stored in blocks; see `Study`."""

    def _open(self) -> None:
        """Read the index, which has columns instead of rows."""
        self._table_of_runs = block_index.read(self._files.index, self.spec.sha256())
        planned = self._planned = PlannedPoints(self.spec)
        if len(planned) != len(self._table_of_runs.columns["status"]):
            raise SpecError("the index does not match study.yaml; run `mbdkit study` to renew it", file=self.folder)
        self.points = BlockPoints(planned, self._table_of_runs)
        self.references = ()
        self._blocks = StudyBlocks.of(self.spec, planned)

    def described(self, name: str) -> tuple[str, str]:
        """Return the units and the description of a numeric column of the index, such as a measure."""
        found = self._table_of_runs.described.get(name) or describe_column(name)
        return found.units, found.long_name

    @property
    def measures(self) -> dict[str, Description]:
        """Units and descriptions, by column, of the measures that the study defines by expressions or plugins."""
        return {measure.name: self._table_of_runs.described[measure.name] for measure in self.spec.defined_measures()}

    def statuses(self) -> Sequence[str]:
        """Return the status of each point."""
        return list(self._table_of_runs.columns["status"])

    def verdicts(self) -> Sequence[str]:
        """Return the verdict on the run of each point; empty where there is none."""
        return list(self._table_of_runs.columns["verdict"])

    @property
    def failures(self) -> Sequence[StudyPoint]:
        """The points whose runs failed."""
        failed = np.flatnonzero(self._table_of_runs.columns["status"] == "failed")
        return BlockPoints(self._planned, self._table_of_runs, failed.tolist())

    def run(self, point: StudyPoint | int) -> Run | None:
        """Return the run of a point with the arrays that the study keeps, or None if it has no results."""
        chosen = self._point(point)
        if not chosen.row.data_sha256:
            return None
        with self._block(chosen) as block:
            return block.run(chosen.number)

    def _block(self, point: StudyPoint) -> Block:
        return Block(self._files.block(self._blocks.block_of(point.number - 1)))

    def _written_by(self, point: StudyPoint) -> str:
        with self._block(point) as block:
            return block.version

    def grid(self, family: str | None = None) -> Grid:
        """Return the plan of a family: its axes and the values of its sample."""
        grids = {grid.name: grid for grid in self._planned.grids}
        return grids[family] if family in grids else super().grid(family)

    def rows_of_runs(self) -> Iterator[tuple[Run, Sequence[int], np.ndarray]]:
        """Yield runs in which the rows of all runs of a block with the same structure are joined; see `Study`."""
        if self.spec.store not in KEEPING_TIMES:
            raise NotStoredError("values over time", str(self.spec.store))
        for number in range(self._blocks.count):
            path = self._files.block(number)
            if path.exists():
                with Block(path) as block:
                    for run, numbers, counts in block.joined_runs() if block.study_sha256 == self.spec.sha256() else ():
                        yield run, numbers.tolist(), counts

    def _columns(self, points: Sequence[StudyPoint]) -> dict[str, Any]:
        """Return the columns of the index without those of the axes."""
        axes = {"family", *self._planned.labels()}
        chosen = slice(None) if points is self.points else [point.number - 1 for point in points]
        return {name: column[chosen] for name, column in self._table_of_runs.columns.items() if name not in axes}

    def _table(self, points: Sequence[StudyPoint]) -> dict[str, Any]:
        columns = self._table_of_runs.columns
        count = len(columns["status"])
        whole = {"number": np.arange(1, count + 1), "family": np.full(count, "", object), **columns}
        chosen = slice(None) if points is self.points else [point.number - 1 for point in points]
        return {name: column[chosen] for name, column in whole.items()}

    def _units(self) -> dict[str, str]:
        return {name: found.units for name, found in self._table_of_runs.described.items()}
