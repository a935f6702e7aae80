"""Finished runs in memory that share the arrays of their layout: R runs as arrays (R, ...)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.run_writer import SharedForces
from mbdkit.base.frozen import dataclass, replace
from mbdkit.quantities.array import Array
from mbdkit.quantities.names import ArchiveNames
from mbdkit.trust.criteria import Judgement


@dataclass(frozen=True, eq=False, kw_only=True)
class FinishedRuns:
    """R finished runs; see `FinishedRun` for what is known of each.

    - `status`, `reason`: those of all runs.
    - `stats`: (R,) values by name.
    - `misalignment_max`: (R, J) largest misalignment of each joint over all steps [m].
    - `judgements`, `warnings`, `data_sha256`, `assembly`: one value for each run.
    - `sizes`: (R,) sizes of the mechanisms at their starts [m]; None if they are not known.
    - `integrals`: those of each run; empty if there are none.
    - `names`, `layout`, `shared`: those of all runs.
    - `arrays`: (R, T, ...) values by `Array.key`; T is the largest number of rows.
    - `lengths`: (R,) number of rows of each run along an axis that grows, by its name.
    - `single`: the run of which this is made; None if it has been made of several.
    """

    status: str
    reason: str
    stats: Mapping[str, np.ndarray]
    misalignment_max: np.ndarray
    judgements: Sequence[Judgement]
    warnings: Sequence[tuple[str, ...]]
    names: ArchiveNames
    layout: tuple[Array, ...]
    arrays: Mapping[str, np.ndarray]
    lengths: Mapping[str, np.ndarray]
    data_sha256: Sequence[str]
    assembly: Sequence[str]
    shared: SharedForces | None = None
    sizes: np.ndarray | None = None
    integrals: Sequence[Integrals] = ()
    single: FinishedRun | None = None

    def __len__(self) -> int:
        return len(self.data_sha256)

    @classmethod
    def of(cls, run: FinishedRun) -> FinishedRuns:
        """Return a run as the only one."""
        growing = {array.dims[0] for array in run.layout if array.grows}
        return cls(
            status=run.status,
            reason=run.reason,
            stats={name: np.array([value]) for name, value in run.stats.items()},
            misalignment_max=run.misalignment_max[None],
            judgements=[run.judgement],
            warnings=[run.warnings],
            names=run.names,
            layout=run.layout,
            arrays={key: np.asarray(values)[None] for key, values in run.arrays.items()},
            lengths={dim: np.array([run.rows(dim)]) for dim in growing},
            data_sha256=[run.data_sha256],
            assembly=[run.assembly],
            shared=run.shared,
            single=run,
        )

    def arrays_of(self, place: int) -> dict[str, np.ndarray]:
        """Return the arrays of a run, which are views."""
        ends = {array.key: int(self.lengths[array.dims[0]][place]) for array in self.layout if array.grows}
        return {key: values[place, : ends[key]] for key, values in self.arrays.items()}

    def run(self, place: int) -> FinishedRun:
        """Return one of the runs; its arrays are views."""
        if self.single is not None:
            return self.single
        return FinishedRun(
            status=self.status,
            reason=self.reason,
            stats={name: values[place].item() for name, values in self.stats.items()},
            misalignment_max=self.misalignment_max[place],
            judgement=self.judgements[place],
            warnings=self.warnings[place],
            integrals=self.integrals[place] if self.integrals else {},
            names=self.names,
            layout=self.layout,
            arrays=self.arrays_of(place),
            shared=self.shared,
            data_sha256=self.data_sha256[place],
            assembly=self.assembly[place],
        )

    def of_places(self, places: Sequence[int]) -> FinishedRuns:
        """Return some of the runs, all with the same numbers of rows, without the rows that they lack."""
        lengths = {dim: values[places] for dim, values in self.lengths.items()}
        ends = {array.key: int(lengths[array.dims[0]][0]) for array in self.layout if array.grows}
        return replace(
            self,
            stats={name: values[places] for name, values in self.stats.items()},
            misalignment_max=self.misalignment_max[places],
            judgements=[self.judgements[place] for place in places],
            warnings=[self.warnings[place] for place in places],
            arrays={key: values[places, : ends[key]] for key, values in self.arrays.items()},
            lengths=lengths,
            data_sha256=[self.data_sha256[place] for place in places],
            assembly=[self.assembly[place] for place in places],
            sizes=None if self.sizes is None else self.sizes[places],
            integrals=[self.integrals[place] for place in places] if self.integrals else (),
        )

    def with_layout(self, layout: tuple[Array, ...]) -> FinishedRuns:
        """Return the runs with some of their arrays."""
        keys = {array.key for array in layout if array.grows}
        arrays = {key: values for key, values in self.arrays.items() if key in keys}
        return replace(self, layout=layout, arrays=arrays, single=None)
