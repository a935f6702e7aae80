"""Work, dissipated energy and quadrature nodes of the steps of methods in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.quadrature import gauss_on_unit
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.integrators.interface import Nodes, StepTaken
from mbdkit.methods.step_methods import StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.integrators.host.python_projection import Taken
    from mbdkit.integrators.run.reached import Reached
    from mbdkit.integrators.run.step_results import Inside

_NODES, _WEIGHTS = gauss_on_unit(4)


#: Times and weights (S,), and positions and velocities (S, n); see `Step.stages`.
Stages = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]


class HostEnergies:
    """Sums of work and dissipated energy.

    What the method does not return is integrated with the index-1 multipliers: by Gauss-Legendre quadrature of order 8
    over the dense output of the step, or else by Simpson's rule, of order 4, over the cubic through both ends. The four
    or three solves per step are counted.

    `equations`: the equations of motion. `has_power`: whether loads, drivers or dampers are present; otherwise both
    sums remain zero.
    """

    def __init__(self, equations: EquationsOfMotion, has_power: bool):
        self._equations, self._has_power = equations, has_power

    def booked(self, begin: Reached, t: float, h: float, taken: Taken, inside: Inside) -> tuple[np.ndarray, np.ndarray]:
        """Return both sums after a step (2,) [J] and their compensation terms (2,)."""
        if not self._has_power:
            return begin.energy, begin.energy_low
        gains: list[float | None] = [taken.made.work, taken.made.dissipated]
        if None in gains:
            ours = self._of_dense(1.0, t, h, inside)
            if ours is None:
                ours = self._gains(t, h, taken)
            gains = [own if own is not None else gain for own, gain in zip(gains, ours, strict=True)]
        y = np.array(gains) + begin.energy_low
        total = begin.energy + y
        return total, y - (total - begin.energy)

    def _gains(self, t: float, h: float, taken: Taken) -> np.ndarray:
        old, new = taken.begin, taken.made
        a0, rates0, begin = self._at(t, old)
        a1, rates1, end = self._at(t + h, new)
        q = 0.5 * (old.q + new.q) + h / 8 * (old.v - new.v)
        v = 0.5 * (old.v + new.v) + h / 8 * (a0 - a1)
        z = 0.5 * (old.z + new.z) + h / 8 * (rates0 - rates1)
        return h / 6 * (begin + 4 * self._at(t + h / 2, StepState(q, v, z=z))[2] + end)

    def _at(self, t: float, state: StepState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the accelerations (n,), the rates (Z,) and the powers (2,) [W] at a state."""
        a, lam, rates = self._equations.observed(t, state.q, state.v, state.z)
        return a, rates, np.array(self._equations.powers(t, state.q, state.v, lam))

    def _of_dense(self, theta: float, t: float, h: float, inside: Inside) -> np.ndarray | None:
        """Return work and dissipated energy up to a share of a step, by quadrature; None without dense output."""
        gain = np.zeros(2)
        for node, weight in zip(_NODES.tolist(), _WEIGHTS.tolist(), strict=True):
            share = theta * node
            inner = inside(share)
            if inner is None:
                return None
            q, v, z = inner[:3]
            gain += theta * h * weight * self._at(t + share * h, StepState(q, v, z=z))[2]
        return gain

    def at(self, theta: float, before: Reached, now: Reached, inside: Inside) -> np.ndarray:
        """Return both sums (2,) [J] at the share `theta` of a step from `before` to `now`.

        They are those of dense output if it has them; otherwise, powers are integrated by Gauss-Legendre quadrature.
        """
        if not self._has_power:
            return before.energy
        t, h = before.begin, now.time - before.begin
        values = inside(theta)
        if values is None:
            return before.energy + theta * (now.energy - before.energy)
        if len(values) == 5:
            return before.energy + np.array(values[3:], dtype=float)
        gain = self._of_dense(theta, t, h, inside)
        assert gain is not None
        return before.energy + gain


class HostNodes:
    """Quadrature nodes of time integrals for methods in Python.

    They are the stages of the method, or else those of Gauss-Legendre quadrature of order 8 on the dense output of a
    library, or on the quintic polynomial through states and accelerations at both ends of the step.

    `size`: number of coordinates, those of the ground included. `sides`: (2,) earliest and latest time at which motions
    are evaluated in the present step [s]; see `Timetable.sides`.
    """

    def __init__(self, size: int, sides: np.ndarray):
        self._size, self._sides = size, sides
        self._steps: list[Nodes] = []

    def drop_last(self) -> None:
        """Discard the nodes of the last step, which is repeated or shortened, if they are stored."""
        del self._steps[-1:]

    def taken(self) -> Nodes:
        """Return the nodes of the steps since the last call."""
        steps, self._steps = self._steps, []
        return Nodes.joined([Nodes.none(self._size), *steps])

    def keep_step(
        self,
        equations: EquationsOfMotion,
        begin: Reached,
        end: Reached,
        stages: Stages | None,
        dense: Callable[[float], tuple[np.ndarray, np.ndarray]] | None,
    ) -> None:
        """Store the nodes of a step.

        `begin`, `end`: start of the step, and its end. `stages`: those of `Step.stages`; None for a step without them,
        or that has been shortened. `dense`: function of the share of the step up to `end` that returns positions and
        velocities (3 (B + 1),); None to use stages or the polynomial.
        """
        if stages is not None:
            time, weight, (q, v) = stages
            ground = np.zeros((len(time), 3))
            self._steps.append(Nodes(time, weight, np.hstack([q, ground]), np.hstack([v, ground])))
            return
        t0, t1 = begin.begin, end.begin
        if dense is None:
            ends: list[np.ndarray] = []
            accelerations: list[np.ndarray] = []
            for t, state in ((t0, begin.state), (t1, end.state)):
                ends += [with_ground(state.q), with_ground(state.v)]
                accelerations.append(with_ground(equations.observed(t, state.q, state.v, state.z)[0]))
            dense = StepTaken(t0, t1, *ends).quintic(*accelerations)
        q, v = zip(*map(dense, _NODES.tolist()), strict=True)
        h = t1 - t0
        time = np.clip(t0 + h * _NODES, *self._sides)
        self._steps.append(Nodes(time, h * _WEIGHTS, np.array(q), np.array(v)))
