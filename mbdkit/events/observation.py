"""The quantities that expressions are made of, evaluated at states of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.kernels.observe import observe
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.redundant_reactions import share_evenly
from mbdkit.engine.singularity import new_vectors
from mbdkit.engine.workspace import Workspace
from mbdkit.events.event_expression import BODY, Quantity

_REACTION = ("force_x", "force_y", "torque")


class Seen(NamedTuple):
    """K states and what follows from them: accelerations, residuals and reactions of pairs of rows, energies."""

    q: np.ndarray
    v: np.ndarray
    acc: np.ndarray
    phi: np.ndarray
    reactions: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray


class Observer:
    """Evaluates quantities at states; those of positions and velocities alone ask nothing of the engine.

    Parameters
    ----------
    workspace
        The mechanism, with the solver of the run.
    quantities
        What is wanted.
    """

    def __init__(self, workspace: Workspace, quantities: Sequence[Quantity]):
        self.workspace, self.quantities = workspace, quantities
        mechanism = workspace.mechanism
        self._body = {name: index for index, name in enumerate([*mechanism.bodies, "ground"])}
        self._joint = {name: index for index, name in enumerate(mechanism.joints)}
        number = {pair: j for j, pairs in enumerate(mechanism.joint_pairs) for pair in pairs}
        self._pair_joint = np.array([number[k] for k in range(len(mechanism.topology.pairs))], dtype=np.int64)
        self._columns = [self._column(quantity) for quantity in quantities]
        kinematic = (*BODY[:6], "angle")
        self._dynamic = any(quantity.attribute not in kinematic for quantity in quantities)
        self._buffers: dict[int, tuple[np.ndarray, ...]] = {}
        self._near = new_vectors(workspace)

    def values(self, times: Sequence[float], q: np.ndarray, v: np.ndarray) -> list[list[float]]:
        """Return for each of K states its time, and the quantities after it; nan where they have no value.

        Parameters
        ----------
        times
            (K,) times [s].
        q, v
            (K, 3 (B + 1)) positions and velocities, ground last.
        """
        seen = self._observed(np.array(times), q, v) if self._dynamic else Seen(q, v, q, q, q, q, q)
        columns = [times, *(column(seen).tolist() for column in self._columns)]
        return [list(row) for row in zip(*columns, strict=True)]

    def _column(self, quantity: Quantity) -> Callable[[Seen], np.ndarray]:
        """Return what reads the (K,) values of a quantity."""
        mechanism, name, attribute = self.workspace.mechanism, quantity.name, quantity.attribute
        if quantity.kind == "energy":
            kinetic, potential = attribute != "potential", attribute != "kinetic"
            return lambda seen: kinetic * seen.kinetic + potential * seen.potential
        if quantity.kind == "bodies":
            level, coordinate = divmod(BODY.index(attribute), 3)
            place = 3 * self._body[name] + coordinate
            return lambda seen: seen[level][:, place]
        if attribute == "angle":
            first, second = (3 * self._body[body] + 2 for body in mechanism.joint_bodies[self._joint[name]])
            return lambda seen: seen.q[:, second] - seen.q[:, first]
        pairs = list(mechanism.joint_pairs[self._joint[name]])
        if attribute == "misalignment":
            rows = [row for row in mechanism.rows if row.pair in pairs and row.unit == "m"]
            pair, end = [row.pair for row in rows], [row.place for row in rows]
            return lambda seen: np.sqrt(np.sum(seen.phi[:, pair, end] ** 2, axis=1))
        if attribute == "force":
            return lambda seen: np.hypot(*np.sum(seen.reactions[:, pairs, :2], axis=1).T)
        component = _REACTION.index(attribute)
        return lambda seen: np.sum(seen.reactions[:, pairs, component], axis=1)

    def _observed(self, times: np.ndarray, q: np.ndarray, v: np.ndarray) -> Seen:
        """Return what the archive records of states."""
        acc, lam, phi, rate, reactions, kinetic, potential, distance, stress, its_reactions = self._room(len(times))
        done = 0
        while done < len(times):
            some = slice(done, None)
            for attempt in range(2):
                status, reached = observe(
                    self.workspace.engine,
                    times[some], q[some], v[some], acc[some], lam[some], phi[some], rate[some], reactions[some],
                    kinetic[some], potential[some], distance[some], stress[some], its_reactions[some], self._near,
                )  # fmt: skip
                if status == OK or reached or attempt or not self._renewed():
                    break
            done += reached
            if status != OK and not reached:
                for values in (acc, phi, reactions, kinetic, potential):
                    values[done] = np.nan
                done += 1
        if len(self.workspace.mechanism.topology.spare) and np.all(np.isfinite(reactions)):
            share_evenly(lam, reactions, stress, its_reactions, self._pair_joint, self.workspace.mechanism.length)
        return Seen(q, v, acc, phi, reactions, kinetic, potential)

    def _renewed(self) -> bool:
        """Choose new pivots; return whether there are any."""
        try:
            self.workspace.use_pivots()
        except SingularSystemError:
            return False
        return True

    def _room(self, count: int) -> tuple[np.ndarray, ...]:
        """Return arrays for `count` states, the same ones for the same number."""
        if count not in self._buffers:
            topology, size = self.workspace.mechanism.topology, self.workspace.mechanism.size
            pairs, spare = len(topology.pairs), len(topology.spare)
            shapes = [
                (count, size), *3 * [(count, pairs, 2)], (count, pairs, 3), (count,), (count,), (count,),
                (count, spare, pairs, 2), (count, spare, pairs, 3),
            ]  # fmt: skip
            self._buffers[count] = tuple(np.zeros(shape) for shape in shapes)
        return self._buffers[count]
