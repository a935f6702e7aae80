"""Batches: many simulations of one mechanism that stay in lanes and advance by a number of fixed steps per call.

The simulations are G vectors of lanes, each a `LaneRun`. Unlike `mbdkit.integrators.lanes.lane_loop`, a call records no
rows, evaluates no energies and keeps the state of all simulations, which may change between two calls. Every call
therefore begins with a new first stage. Vectors that one thread advances in turn share their working arrays, if the
numbers of their mechanisms are equal: with arrays of their own, a thousand double pendulums take 20 % longer.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.kernels.misalignment import raise_misalignments
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.vectors import stays_finite
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import kernel
from mbdkit.engine.native.number_arrays import Lanes, new_lanes
from mbdkit.integrators.lanes.lane_loop import lose, observe_row, take_explicit_step
from mbdkit.integrators.lanes.lane_run import LaneRun, load_lane_run
from mbdkit.integrators.run.run_state import add_increments


class LaneBatch(NamedTuple):
    """Simulations in G vectors of lanes."""

    runs: np.ndarray  #: (G,) addresses of the `LaneRun` of each vector.
    taken: np.ndarray  #: (G,) number of steps since the start of each simulation; lanes.
    observed: np.ndarray  #: (1,) whether the last state of a call is observed.


def new_lane_batch(vectors: int) -> LaneBatch:
    """Return the bundle of a batch of `vectors` vectors of lanes."""
    return LaneBatch(np.zeros(vectors, dtype=np.int64), new_lanes(vectors), np.zeros(1, dtype=np.int64))


load_lane_batch = bundle_loader(lambda: new_lane_batch(1))


class BatchState(NamedTuple):
    """What each simulation of a batch has of its own, as arrays of lanes of G vectors; fields as in `LaneRun`."""

    q: Lanes
    q_low: Lanes
    v: Lanes
    v_low: Lanes
    z: Lanes
    z_low: Lanes
    worst: Lanes
    lost: Lanes
    row_time: Lanes
    observed: Observed  #: (G, 1, ...) values computed for the last state.

    @classmethod
    def like(cls, run: LaneRun, vectors: int) -> BatchState:
        """Return zeros for `vectors` runs like this one."""

        def many(x: np.ndarray) -> Lanes:
            return new_lanes(vectors, *x.shape[:-1])

        own: dict[str, Any] = {name: many(getattr(run, name)) for name in cls._fields[:-1]}
        return cls(**own, observed=Observed(*map(many, run.observed)))

    def run(self, number: int, work: LaneRun) -> LaneRun:
        """Return the run of one vector, with all other arrays from `work`."""
        own: dict[str, Any] = {name: getattr(self, name)[number] for name in self._fields[:-1]}
        observed = Observed(*(values[number] for values in self.observed))
        q, v, z = own["q"], own["v"], own["z"]
        rows = {"row_q": q[None], "row_v": v[None], "row_z": z[None]}
        return work._replace(from_q=q, from_v=v, from_z=z, observed=observed, **own, **rows)


@kernel
def advance_explicit(batch: int, first: int, last: int, steps: int) -> None:
    """Advance the simulations of the vectors `first` to `last - 1` by steps of an explicit method."""
    b = load_lane_batch(batch)
    for g in range(first, last):
        c = load_lane_run(b.runs[g])
        start, step = c.times.start[0], c.times.step[0]
        for n in range(steps):
            take_explicit_step(c, c.method, start + b.taken[g] * step, step, n)
            lose(c, not (stays_finite(c.q, c.dq) & stays_finite(c.v, c.dv)))
            if len(c.z) > 0:
                lose(c, not stays_finite(c.z, c.dz))
            add_increments(c, True)
            b.taken[g] += 1.0
        end = start + b.taken[g] * step
        raise_misalignments(c.top, c.w, end, c.q, c.worst)
        for k in range(len(c.worst)):
            lose(c, c.worst[k] > c.squared_misalignment[k])
        if b.observed[0] != 0:
            c.row_time[0] = end
            observe_row(c, 0)
