"""Detection of redundant joints: constraint rows that depend on other rows in every position of the mechanism.

The constraint Jacobian is evaluated at the start and at consistent positions nearby: after small displacements along
the degrees of freedom, and a short time later with moving drivers. Rows that depend on others in all these positions
are redundant. If they depend on others at the start only, the start is a singular position with undefined
accelerations. To choose the rows that are removed, distant positions are evaluated as well, so that the remaining rows
stay independent during the motion.
"""

from __future__ import annotations

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism, Redundancy, with_ground
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.independent_rows import choose_spare, direction_frames
from mbdkit.engine.kernels.observe import constraints_at, tangents_at
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.least_change import LeastChange
from mbdkit.engine.self_stress import SMALL, looped_rows, scaled_matrix, self_stresses
from mbdkit.engine.workspace import Workspace

#: Displacements from the start at which redundancy is tested, relative to the characteristic length and to 1 rad.
MOVES = (1e-4, 1e-2, 0.1)

#: At least one of the displacements up to this size is possible from every position that is not singular.
#:
#: It is also the time after the start [s] up to which drivers must be consistent.
SMALL_MOVE = 1e-2

#: Times after the start at which drivers are checked: for each pair, the smaller of a time [s] and a fraction of the
#: run.
LATER = ((1e-3, 1e-3), (1e-2, 1e-2), (0.1, 0.1))

#: Number of distant positions, and the displacement from one to the next. Together they cover a full rotation.
#:
#: Half of the positions lie on each side of the start. With drivers, the same number of times of the run is added.
FAR, FAR_MOVE = 40, 0.2

#: Limit on the total number of coordinates of the distant positions; large mechanisms have fewer positions.
FAR_COORDINATES = 12_000

CLOSED = 1e-11  #: Largest residual of a position that counts as consistent, relative to the largest coordinate.

#: Rows are inconsistent if the accelerations that they require differ by more than this, relative to the size of the
#: terms.
CONTRADICTION = 1e-7

INVOLVED = 1e-6  #: The reaction of a joint is not unique if its component in a self-stress is above this.


@dataclass(frozen=True)
class _Place:
    """A consistent position: coordinates (n,), and scale factors (m',) and self-stresses (m', r) of the m' rows in
    closed loops.

    The factors scale the rows to a norm of about 1; they are equal for both rows of a pair. The self-stresses belong to
    the scaled rows.
    """

    q: np.ndarray
    scale: np.ndarray
    stresses: np.ndarray

    @property
    def spare(self) -> int:
        """Number of self-stresses."""
        return self.stresses.shape[1]


def without_redundancy(
    compiled: CompiledMechanism, t0: float, q0: np.ndarray, v0: np.ndarray, end: float
) -> CompiledMechanism:
    """Return the mechanism with an independent set of constraint rows; residuals of the others are still monitored.

    Rows of drivers are kept if possible, then rows of joints that come first in the mechanism.

    `compiled`: the compiled mechanism with all constraint rows. `t0`, `end`: start and end of the run [s]. `q0`, `v0`:
    (3 B,) consistent positions and velocities at the start. Raises SpecError if redundant joints are inconsistent, or
    the start is a singular position. The message names the joints.
    """
    rows = looped_rows(compiled)
    if len(rows) == 0:
        return compiled
    return _Analysis(compiled, rows, t0, end).run(q0, v0)


class _Analysis:
    def __init__(self, compiled: CompiledMechanism, rows: np.ndarray, t0: float, end: float):
        self.compiled, self.rows, self.t0, self.end = compiled, rows, t0, end
        self.n = 3 * len(compiled.bodies)
        self.search = self.at(t0)
        #: Indices into `rows` of the rows that take part in self-stresses at the start.
        #:
        #: At other positions, self-stresses are first computed for these rows only.
        self.involved = np.arange(len(rows))
        self.pair = np.array([compiled.rows[i].pair for i in rows], dtype=np.int64)
        self.place = np.array([compiled.rows[i].place for i in rows], dtype=np.int64)
        self.joint = compiled.topology.pair_joint[self.pair]
        #: (n,) approximate displacement of a point [m] per unit change of each coordinate.
        self.unit = np.tile([1.0, 1.0, compiled.length], len(compiled.bodies))

    def at(self, t: float) -> LeastChange:
        """Return a solver that finds positions satisfying the constraints at time `t`."""
        return LeastChange(self.compiled, t, np.zeros(self.n, dtype=bool))

    def run(self, q0: np.ndarray, v0: np.ndarray) -> CompiledMechanism:
        q = q0 if self.gap(self.search, q0) <= CLOSED else self.closed(self.search, q0)
        start = self.place_at(self.search, q)
        if start.spare == 0:
            return self.compiled
        self.involved = np.flatnonzero(np.linalg.norm(start.stresses, axis=1) > SMALL)
        self.check_accelerations(start, v0)
        step = self.freedom(start)
        around = ([] if step is None else self.moved(start, step)) + self.later(start, v0)
        if any(position.spare < start.spare for position in around):
            raise self.singular(start)
        places = [start] + [position for position in around if position.spare == start.spare]
        number = min(FAR, FAR_COORDINATES // self.n)
        if step is not None:
            places += self.wandered(start, step, number // 2) + self.wandered(start, -step, number // 2)
        if self.compiled.drivers:
            places += self.driven(start, number)
        return self.reduced(places)

    # ---- consistent positions ------------------------------------------------------------------------------------

    def gap(self, search: LeastChange, q: np.ndarray) -> float:
        """Return the largest residual at `q`, relative to the largest coordinate (at least 1)."""
        return float(np.max(np.abs(search.evaluate(q)[0]), initial=0.0)) / max(1.0, float(np.max(np.abs(q))))

    def closed(self, search: LeastChange, q: np.ndarray) -> np.ndarray:
        return search.closed(q, 1e-14 * max(1.0, float(np.max(np.abs(q)))))

    def place_at(self, search: LeastChange, q: np.ndarray, spare: int = 0) -> _Place:
        """Return the consistent position `q` with its self-stresses; `spare` is their expected number."""
        _, (row, column, value), _ = search.evaluate(q)
        local = np.full(len(self.compiled.rows), -1)
        local[self.rows] = np.arange(len(self.rows))
        here = local[row] >= 0
        row, column, value = local[row[here]], column[here], value[here] / self.unit[column[here]]
        size = np.bincount(self.pair[row], value**2, minlength=len(self.compiled.topology.pairs))[self.pair]
        scale = 1 / np.sqrt(np.where(size > 0, size, 1.0))
        jacobian = scaled_matrix(len(self.rows), row, column, value * scale[row])
        stresses = self_stresses(jacobian[self.involved], spare)
        if stresses.shape[1] < spare:
            stresses = self_stresses(jacobian, spare)
        else:
            everywhere = np.zeros((len(self.rows), stresses.shape[1]))
            everywhere[self.involved] = stresses
            stresses = everywhere
        return _Place(q, scale, stresses)

    def freedom(self, start: _Place) -> np.ndarray | None:
        """Return an admissible displacement (n,) whose size is the characteristic length; None without degrees of
        freedom.
        """
        _, jacobian, _ = self.search.evaluate(start.q)
        touched = np.zeros(self.n, dtype=bool)
        touched[jacobian[1][np.isin(jacobian[0], self.rows)]] = True
        if np.count_nonzero(touched) == len(self.rows) - start.spare:
            return None
        step = np.where(touched, np.random.default_rng(0).normal(size=self.n), 0.0) / self.unit
        for _ in range(3):  # one projection leaves components that are only nearly admissible
            step = self.allowed(start.q, step)
        return step * (self.compiled.length / float(np.max(np.abs(step * self.unit)[touched])))

    def allowed(self, q: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the admissible displacement at `q` nearest to `step`."""
        solve = self.search.kkt(self.search.evaluate(q)[1])
        return solve(-self.search.mass * step, np.zeros(len(self.compiled.rows)))[0]

    def moved(self, start: _Place, step: np.ndarray) -> list[_Place]:
        """Return positions near the start.

        Raises SpecError if no small admissible displacement leads to a consistent position, because the start is
        singular then.
        """
        places: list[_Place] = []
        small = 0
        for part in MOVES:
            q = self.closed(self.search, start.q + part * step)
            weight = self.search.mass * step
            came = np.sum(weight * (q - start.q)) / np.sum(weight * step)
            if self.gap(self.search, q) <= CLOSED and came >= 0.5 * part:
                places.append(self.place_at(self.search, q, start.spare))
                small += part <= SMALL_MOVE
        if not small:
            raise self.singular(start)
        return places

    def wandered(self, start: _Place, step: np.ndarray, number: int) -> list[_Place]:
        """Return positions on a path from the start, as long as they have as many self-stresses as the start."""
        size = FAR_MOVE * float(np.max(np.abs(step * self.unit)))
        q, step = start.q, FAR_MOVE * step
        places: list[_Place] = []
        for _ in range(number):
            if (position := self.place_from(self.search, q + step, start)) is None:
                break
            places.append(position)
            step = self.allowed(position.q, position.q - q)
            largest = float(np.max(np.abs(step * self.unit)))
            if not largest > 1e-3 * size:
                break  # the mechanism cannot move further in this direction
            q, step = position.q, step * (size / largest)
        return places

    def driven(self, start: _Place, number: int) -> list[_Place]:
        """Return positions at equidistant times of the run, omitting times at which no consistent position is found."""
        q = start.q
        places: list[_Place] = []
        for k in range(1, number + 1):
            position = self.place_from(self.at(self.t0 + (self.end - self.t0) * k / number), q, start)
            if position is not None:
                places.append(position)
                q = position.q
        return places

    def place_from(self, search: LeastChange, q: np.ndarray, start: _Place) -> _Place | None:
        """Return the consistent position near `q`; None unless it exists and has as many self-stresses as the start."""
        q = self.closed(search, q)
        if not self.gap(search, q) <= CLOSED:
            return None
        position = self.place_at(search, q, start.spare)
        return position if position.spare == start.spare else None

    def later(self, start: _Place, v0: np.ndarray) -> list[_Place]:
        """Return positions a short time after the start; raises SpecError if drivers are inconsistent there."""
        places: list[_Place] = []
        if not self.compiled.drivers:
            return places
        for latest, part in LATER:
            t = self.t0 + min(latest, part * (self.end - self.t0))
            search = self.at(t)
            q = self.closed(search, start.q + (t - self.t0) * v0)
            if self.gap(search, q) <= CLOSED:
                places.append(self.place_at(search, q, start.spare))
            elif latest <= SMALL_MOVE:
                phi = search.evaluate(q)[0][self.rows] * start.scale
                raise self.contradiction(
                    start, phi, f"at t = {t:g} s their constraints can no longer be satisfied together"
                )
        return places

    # ---- errors --------------------------------------------------------------------------------------------------

    def check_accelerations(self, start: _Place, v0: np.ndarray) -> None:
        """Raise SpecError if redundant rows require accelerations that contradict each other."""
        search, top = self.search, self.compiled.topology
        constraints_at(top, search.scratch, self.t0, with_ground(start.q), with_ground(v0))
        gamma = search.scratch.gamma[self.pair, self.place] * start.scale
        size = max(1.0, float(np.max(np.abs(gamma))))
        if float(np.max(np.abs(np.sum(start.stresses.T * gamma, axis=1)))) > CONTRADICTION * size:
            raise self.contradiction(start, gamma, "they require different accelerations at the start")

    def contradiction(self, start: _Place, residual: np.ndarray, what: str) -> SpecError:
        """Return the error that names the joints with inconsistent residuals, only the drivers if there are several."""
        part = np.sum(start.stresses * np.sum(start.stresses.T * residual, axis=1), axis=1)
        names = self.joints_of(np.abs(part) > 0.1 * np.max(np.abs(part)))
        driven = [name for name in names if name in self.compiled.drivers]
        names = driven if len(driven) > 1 else names
        others = [] if len(driven) > 1 else ["the points and axes of these joints"]
        drivers = driven if len(driven) > 1 else sorted(self.compiled.drivers)
        if drivers:
            others.append(f"the motion{'s' * (len(drivers) > 1)} of {_named(drivers, 'driver')}")
        return SpecError(
            f"{_named(names)} constrain the same motion and contradict each other: {what}; correct "
            f"{listed(others, 'or')}, or remove one of these joints",
            key="model.joints",
        )

    def singular(self, start: _Place) -> SpecError:
        """Return the error that names the joints which are dependent at the start only."""
        names = self.joints_of(np.linalg.norm(start.stresses, axis=1) > 0.1 * np.max(np.abs(start.stresses)))
        return SpecError(
            "the mechanism is in a singular position at the start, where its accelerations have no unique "
            f"solution: {_named(names)} are dependent there, but not in nearby positions; start from another position",
            key="model.joints",
        )

    def joints_of(self, involved: np.ndarray) -> list[str]:
        """Return the names of the joints of the rows selected by `involved` (m',), in the order of the mechanism."""
        return [self.compiled.joints[j] for j in np.unique(self.joint[involved]).tolist()]

    # ---- the independent set -------------------------------------------------------------------------------------

    def reduced(self, places: list[_Place]) -> CompiledMechanism:
        compiled, top = self.compiled, self.compiled.topology
        driven = np.array([compiled.joints[j] in compiled.drivers for j in self.joint.tolist()])
        chosen = choose_spare([position.stresses for position in places], self.pair, self.place, driven)
        angles = np.array([[*position.q[2::3], 0.0] for position in places])
        spares = direction_frames(chosen, top.rows, top.pairs, angles)
        rows = top.rows.copy()
        for spare in spares:
            rows[spare.pair] -= 1
        stresses = np.max([np.linalg.norm(position.stresses, axis=1) for position in places], axis=0)
        return replace(
            compiled,
            topology=top._replace(
                rows=rows,
                spare=np.array([(spare.pair, spare.frame) for spare in spares], dtype=np.int64),
                spare_axes=np.array([spare.axis for spare in spares]),
            ),
            redundancy=Redundancy(rows=len(spares), not_unique=tuple(self.joints_of(stresses > INVOLVED))),
        )


def _named(names: list[str], kind: str = "joint") -> str:
    shown = [*names[:6], "..."] if len(names) > 6 else names
    return f"{kind}{'s' * (len(names) > 1)} {listed(shown, 'and')}"


def require_unique_start(workspace: Workspace) -> None:
    """Raise SpecError if the accelerations at the start are not unique or not finite.

    `workspace`: the mechanism at its start, with independent rows. If its solver is pivoted, it has pivots for the
    start afterwards.
    """
    mechanism = workspace.mechanism
    acc, lam = np.zeros(mechanism.size), np.zeros((len(mechanism.topology.pairs), 2))
    try:
        status = workspace.retry_with_new_pivots(
            lambda: tangents_at(workspace.engine, workspace.t0, workspace.q0, workspace.v0, acc, lam)
        )
        if status != OK:
            raise SingularSystemError
    except SingularSystemError as error:
        refuse_law(workspace)
        where = f", near {mechanism.unknown_name(error.index)}" if error.index >= 0 else ""
        raise SpecError(
            "the mechanism is too close to a singular position at the start: its accelerations have no unique "
            f"solution in double precision{where}",
            key="model.joints",
        ) from None
    if not (np.all(np.isfinite(acc)) and np.all(np.isfinite(lam))):
        refuse_law(workspace)
        raise SpecError("the forces at the start overflow in double precision", key="model")
    # Explicit methods can use a force law with an infinite derivative at the start, so its fault is cleared.
    workspace.scratch.faulty[0] = -1


def refuse_law(workspace: Workspace) -> None:
    """Raise SpecError if a force law returned no finite number at the start, or the friction in a joint locks it."""
    if workspace.locks:
        raise SpecError(f"{workspace.unusable()} at the start", key="model.joints")
    if force := workspace.unusable_law():
        raise SpecError("its law gives no finite number at the start", key=f"model.forces.{quoted(force)}")
