"""The quantities that expressions are made of, evaluated at states of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit.engine.analysis import SingularSystemError
from mbdkit.engine.observe import observe
from mbdkit.engine.problem import Problem
from mbdkit.engine.reactions import share_evenly
from mbdkit.engine.system import OK
from mbdkit.events.expression import BODY, ENERGY, Quantity

_REACTION = ("force_x", "force_y", "torque")


class Observer:
    """Evaluates quantities at states; those of positions and velocities alone ask nothing of the engine.

    Parameters
    ----------
    problem
        The mechanism, with the solver of the run.
    quantities
        What is wanted.
    """

    def __init__(self, problem: Problem, quantities: Sequence[Quantity]):
        self.problem, self.quantities = problem, quantities
        mechanism = problem.mechanism
        self._body = {name: index for index, name in enumerate([*mechanism.bodies, "ground"])}
        self._joint = {name: index for index, name in enumerate(mechanism.joints)}
        number = {pair: j for j, pairs in enumerate(mechanism.joint_pairs) for pair in pairs}
        self._pair_joint = np.array([number[k] for k in range(len(mechanism.topology.pairs))], dtype=np.int64)
        self._dynamic = any(self._needs_engine(quantity) for quantity in quantities)
        self._buffers: dict[int, tuple[np.ndarray, ...]] = {}

    @staticmethod
    def _needs_engine(quantity: Quantity) -> bool:
        kinematic = quantity.attribute in BODY[:6] or quantity.attribute == "angle"
        return not kinematic

    def values(self, times: Sequence[float], q: np.ndarray, v: np.ndarray) -> list[list[float]]:
        """Return for each of K states its time, and the quantities after it; nan where they have no value.

        Parameters
        ----------
        times
            (K,) times [s].
        q, v
            (K, 3 (B + 1)) positions and velocities, ground last.
        """
        out = np.empty((len(times), 1 + len(self.quantities)))
        out[:, 0] = times
        if self._dynamic:
            acc, phi, reactions, energies = self._observed(out[:, 0].copy(), q, v)
        for place, quantity in enumerate(self.quantities, start=1):
            attribute = quantity.attribute
            if quantity.kind == "energy":
                index = ENERGY.index(attribute)
                out[:, place] = energies[index] if index < 2 else energies[0] + energies[1]
            elif quantity.kind == "bodies":
                level, coordinate = divmod(BODY.index(attribute), 3)
                source = (q, v, acc)[level] if level == 2 else (q, v)[level]
                out[:, place] = source[:, 3 * self._body[quantity.name] + coordinate]
            elif attribute == "angle":
                a, b = self.problem.mechanism.joint_bodies[self._joint[quantity.name]]
                out[:, place] = q[:, 3 * self._body[b] + 2] - q[:, 3 * self._body[a] + 2]
            else:
                out[:, place] = self._of_joint(quantity, phi, reactions)
        rows: list[list[float]] = out.tolist()
        return rows

    def _of_joint(self, quantity: Quantity, phi: np.ndarray, reactions: np.ndarray) -> np.ndarray:
        """Return (K,) values of a quantity that a joint has, the sum over its pairs of rows."""
        pairs = self.problem.mechanism.joint_pairs[self._joint[quantity.name]]
        if quantity.attribute == "misalignment":
            gaps = [phi[:, row.pair, row.place] for row in self._rows(pairs)]
            return np.sqrt(sum((gap**2 for gap in gaps), np.zeros(len(phi))))
        total = reactions[:, list(pairs)].sum(axis=1)
        if quantity.attribute == "force":
            return np.hypot(total[:, 0], total[:, 1])
        return total[:, _REACTION.index(quantity.attribute)]

    def _rows(self, pairs: Sequence[int]):  # type: ignore[no-untyped-def]
        return [row for row in self.problem.mechanism.rows if row.pair in pairs and row.unit == "m"]

    def _observed(
        self, times: np.ndarray, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Return accelerations, residuals, reactions and energies as the archive records them."""
        acc, lam, phi, rate, reactions, kinetic, potential, stress, its_reactions = self._room(len(times))
        done = 0
        while done < len(times):
            some = slice(done, None)
            for attempt in range(2):
                status, reached = observe(
                    self.problem.mechanism.topology, self.problem.scratch, self.problem.solver,
                    times[some], q[some], v[some], acc[some], lam[some], phi[some], rate[some], reactions[some],
                    kinetic[some], potential[some], stress[some], its_reactions[some],
                )  # fmt: skip
                if status == OK or reached or attempt or not self._renewed():
                    break
            done += reached
            if status != OK and not reached:
                for values in (acc, phi, reactions, kinetic, potential):
                    values[done] = np.nan
                done += 1
        if len(self.problem.mechanism.topology.spare):
            share_evenly(lam, reactions, stress, its_reactions, self._pair_joint, self.problem.mechanism.length)
        return acc, phi, reactions, (kinetic, potential)

    def _renewed(self) -> bool:
        """Choose new pivots; return whether there are any."""
        try:
            self.problem.use_pivots()
        except SingularSystemError:
            return False
        return True

    def _room(self, count: int) -> tuple[np.ndarray, ...]:
        """Return arrays for `count` states, the same ones for the same number."""
        if count not in self._buffers:
            topology, size = self.problem.mechanism.topology, self.problem.mechanism.size
            pairs, spare = len(topology.pairs), len(topology.spare)
            shapes = [
                (count, size), *3 * [(count, pairs, 2)], (count, pairs, 3), (count,), (count,),
                (count, spare, pairs, 2), (count, spare, pairs, 3),
            ]  # fmt: skip
            self._buffers[count] = tuple(np.zeros(shape) for shape in shapes)
        return self._buffers[count]
