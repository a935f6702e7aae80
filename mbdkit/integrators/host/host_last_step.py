"""The last step of a method in Python, with the states within it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.kernels.interpolation import fade
from mbdkit.integrators.host.host_energies import HostEnergies
from mbdkit.integrators.host.step_attempts import Attempt
from mbdkit.integrators.interface import Moment, StepTaken
from mbdkit.integrators.run.reached import Reached, RecordedRow
from mbdkit.methods.step_methods import StepState


class LastStep(NamedTuple):
    """A step that has been accepted."""

    before: Reached  #: Its start, with the size of the step that was accepted.
    attempt: Attempt
    ends: StepTaken
    energies: HostEnergies
    next_row: int  #: Number of the next row by interval at its start.
    has_dense_output: bool

    def inside(self, theta: float) -> Moment:
        """Return the state at the share `theta` of the step; see `Stepper.inside`."""
        taken = self.attempt.taken
        inner = self.attempt.inside(theta) if self.has_dense_output and theta not in (0.0, 1.0) else None
        if inner is None:
            return self.ends.between(theta)
        q, v, z = inner[:3]
        if taken.made is not taken.reached:
            share = fade(theta)
            q, v = q + share * (taken.reached.q - taken.made.q), v + share * (taken.reached.v - taken.made.v)
        return with_ground(q), with_ground(v), z

    def energy(self, theta: float) -> np.ndarray:
        """Return work and dissipated energy (2,) [J] at the share `theta` of the step."""
        return self.energies.at(theta, self.before, self.attempt.end, self.attempt.inside)

    def row(self, at: float, now: Reached) -> RecordedRow:
        """Return a row at a time within the step, with the statistics of the point `now` that it has reached."""
        theta = (at - self.ends.t0) / (self.ends.t1 - self.ends.t0)
        if theta >= 1.0:
            return now.row()._replace(time=at)
        q, v, z = self.inside(theta)
        own, own_before = now.state.multipliers, self.before.state.multipliers
        if own is not None and own_before is not None:
            own = own_before + theta * (own - own_before)
        return RecordedRow(at, StepState(q[:-3], v[:-3], own, z=z), self.energy(theta), now.interval)
