"""The equations of a mechanism, executed by Python from the definitions of the machine code.

Joint coordinates are those of the spanning tree of runs: angles of bodies, travels along slots, and the positions of
bodies that no joint of the tree places. A point mass at a distance from another body has the angle of the line between
them instead of its position. Positions q, velocities v and accelerations a of all bodies follow from them
joint by joint from ground. With T the derivative of v with respect to the rates of the coordinates, the joints of the
tree do no work on T, so that the equations of motion

    T^T (M a + Phi_q^T lam - Q) = 0

contain the multipliers of cut joints only. Those of the tree follow from what remains of the equations of each body,
from the leaves to ground.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence, Set
from typing import Any, NamedTuple

import numpy as np

from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.interpreter import Arithmetic, Interpreter
from mbdkit.engine.kernels import acting, applied_forces, equations, frames, observe, system
from mbdkit.engine.kernels.angles import cosine_and_sine
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.kernels.frames import Reactions
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.table_rows import LAW_ROW, PAIR, SPRING, LawRow
from mbdkit.engine.kernels.tree import BODY, PLACE, TURN, accelerate_coordinates, coordinates_of, place_bodies, turned
from mbdkit.engine.kernels.tree_displacements import accelerate_bodies
from mbdkit.engine.spanning_tree import spanning_tree
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.mechanism import Mechanism


class Motion(NamedTuple):
    """Positions, velocities and accelerations of all bodies or coordinates, arrays of numbers of any kind."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


class Arm(NamedTuple):
    """A point mass, the distance joint that keeps it near another body, and the side of this body in it."""

    mass: int
    pair: int
    side: int


def _arms(top: Topology, tree: np.ndarray, masses: Set[int]) -> tuple[list[Arm], np.ndarray]:
    """Return the arms of point masses that no joint of a tree places, and the tree in an order in which the other body
    of each arm comes before it.
    """
    root = {len(top.mass) - 1: len(top.mass) - 1}
    for body, place, side, *_ in tree.tolist():
        root[body] = body if place < 0 else root[int(top.pairs[place, PAIR.second - side])]
    waiting = [body for body in root if root[body] == body and body in masses]
    order, arms = [body for body in root if root[body] == body and body not in masses], list[Arm]()
    rods = [(k, a, b) for k, (kind, a, b, _) in enumerate(top.pairs.tolist()) if kind == KINDS["distance"]]

    def arm_of(mass: int) -> Arm | None:
        sides = ((k, side, pair[side]) for k, *pair in rods for side in range(2) if pair[1 - side] == mass)
        return next((Arm(mass, k, side) for k, side, other in sides if root[other] in order), None)

    while waiting:
        arm = next(filter(None, map(arm_of, waiting)), None)
        order.append(arm.mass if arm else waiting[0])
        waiting.remove(order[-1])
        arms += [arm] if arm else []
    place_in_order = {body: n for n, body in enumerate(order)}
    return arms, tree[np.argsort([place_in_order[root[body]] for body in tree[:, BODY].tolist()], kind="stable")]


def _end_of_arm(top: Topology, arm: Arm, q: Any, v: Any, a: Any) -> tuple[Any, ...]:
    """Return position, velocity and acceleration of the point of the other body of an arm."""
    b = 3 * top.pairs[arm.pair, PAIR.first + arm.side]
    c, s = cosine_and_sine(q[b + 2])
    x, y = turned(c, s, top.pair_parameters[arm.pair, 2 * arm.side], top.pair_parameters[arm.pair, 2 * arm.side + 1])
    w, d = v[b + 2], a[b + 2]
    return (
        q[b] + x, q[b + 1] + y, v[b] - w * y, v[b + 1] + w * x,
        a[b] - d * y - w * w * x, a[b + 1] + d * x - w * w * y,
    )  # fmt: skip


def _swing(top: Topology, arm: Arm, own: Sequence[Any], q: Any, v: Any, a: Any) -> tuple[Any, ...]:
    """Return position, velocity and acceleration of a point mass, given angle, rate and acceleration of its arm."""
    x, y, vx, vy, ax, ay = _end_of_arm(top, arm, q, v, a)
    c, s = cosine_and_sine(own[0])
    c, s, w, d = top.pair_parameters[arm.pair, 4] * c, top.pair_parameters[arm.pair, 4] * s, own[1], own[2]
    return (x + c, y + s), (vx - w * s, vy + w * c), (ax - d * s - w * w * c, ay + d * c - w * w * s)


def _swung(top: Topology, arm: Arm, q: Any, v: Any, a: Any) -> tuple[Any, Any, Any]:
    """Return angle, rate and acceleration of an arm, given the motion of all bodies."""
    x, y, vx, vy, ax, ay = _end_of_arm(top, arm, q, v, a)
    i = 3 * arm.mass
    x, y, vx, vy, ax, ay = q[i] - x, q[i + 1] - y, v[i] - vx, v[i + 1] - vy, a[i] - ax, a[i + 1] - ay
    square = x * x + y * y
    rate = (x * vy - y * vx) / square
    return math.atan2(y, x), rate, (x * ay - y * ax - 2 * rate * (x * vx + y * vy)) / square


class InterpretedTree:
    """The coordinates of the spanning tree of a mechanism with B bodies, of which `masses` are point masses.

    Attributes
    ----------
    places : (n,) array of int
        Index of each coordinate among the 3 B numbers x, y, angle of the bodies.
    rows : set of int
        Indices of the constraint rows of the joints of the tree, and of those of arms.
    is_arm : (n,) array of bool
        Which coordinates are angles of arms of point masses. They are in the places of the angles of these masses.
    """

    def __init__(self, top: Topology, row_index: np.ndarray, masses: Set[int]):
        self._size = 3 * len(top.mass)
        self._arms, self._tree = _arms(top, spanning_tree(top), masses)
        free, self.rows = np.ones(self._size - 3, dtype=bool), set[int]()
        for body, place, _, turn, _ in self._tree.tolist():
            is_line = place >= 0 and top.rows[place] == 1
            free[3 * body : 3 * body + 3] = [place < 0 or is_line, place < 0, turn < 0]
            self.rows |= {int(row_index[k, r]) - len(free) for k in (place, turn) if k >= 0 for r in range(top.rows[k])}
        for mass, pair, _ in self._arms:
            free[3 * mass : 3 * mass + 2] = False
            self.rows.add(int(row_index[pair, 0]) - len(free))
        self.places = np.flatnonzero(free)
        self.is_arm = np.isin(self.places, [3 * arm.mass + 2 for arm in self._arms])

    def bodies(self, run: Any, top: Topology, w: Any, t: Any, own: Motion) -> Motion:
        """Return the motion (3 B,) of all bodies, given that of the coordinates (n,)."""
        y = self._filled(own)
        angles = {arm: tuple(x[3 * arm.mass + 2] for x in y) for arm in self._arms}
        for arm, x in itertools.product(self._arms, y):
            x[3 * arm.mass + 2] = 0.0
        for arm, angle in angles.items():
            moved = run(_swing)(top, arm, angle, *self._moved(run, top, w, t, y))
            for x, there in zip(y, moved, strict=True):
                x[3 * arm.mass : 3 * arm.mass + 2] = there
        return Motion(*(x[:-3] for x in self._moved(run, top, w, t, y)))

    def _moved(self, run: Any, top: Topology, w: Any, t: Any, y: Motion) -> Motion:
        q, v, a = np.full(self._size, 0.0, dtype=object), np.full(self._size, 0.0, dtype=object), y.a.copy()
        run(place_bodies)(top, w, self._tree, t, y.q, y.v, q, v)
        run(accelerate_bodies)(top, w, self._tree, y.q, y.v, v, a)
        return Motion(q, v, a)

    def coordinates(self, run: Any, top: Topology, w: Any, whole: Motion) -> Motion:
        """Return the motion (n,) of the coordinates, given that of all bodies (3 B,)."""
        q = Motion(*(np.concatenate([x, np.zeros(3)]).astype(object) for x in whole))
        y, rates = (np.full(self._size, 0.0, dtype=object) for _ in range(2))
        angles = [run(_swung)(top, arm, *q) for arm in self._arms]
        run(coordinates_of)(top, self._tree, q.q, q.v, y, rates)
        run(accelerate_coordinates)(top, w, self._tree, y, q.v, q.a)
        for arm, angle in zip(self._arms, angles, strict=True):
            for x, one in zip((y, rates, q.a), angle, strict=True):
                x[3 * arm.mass + 2] = one
        return Motion(*(x[self.places] for x in (y, rates, q.a)))

    def multipliers(self, top: Topology, jac: np.ndarray, left: np.ndarray) -> Iterator[tuple[int, int, Any]]:
        """Yield pair, row and multiplier of the joints of the tree, given the Jacobian of the rows of pairs (P, 12) and
        what is `left` (3 B,) of the equations of motion without these multipliers.
        """
        left = np.concatenate([left, np.zeros(3)])
        rods = {arm.mass: arm.pair for arm in self._arms}
        for n in reversed(self._tree):
            for k, parts in ((rods.get(int(n[BODY]), n[PLACE]), slice(2)), (n[TURN], slice(2, 3))):
                if k < 0:
                    continue
                first, second = (3 * int(top.pairs[k, side]) for side in (PAIR.first, PAIR.second))
                rows, own = jac[k].reshape(2, 2, 3)[: top.rows[k]], 3 * int(n[BODY])
                known = rows[:, int(own == second), parts]
                for r, multiplier in enumerate(_balancing(known, left[own : own + 3][parts])):
                    left[first : first + 3] = left[first : first + 3] + rows[r, 0] * multiplier
                    left[second : second + 3] = left[second : second + 3] + rows[r, 1] * multiplier
                    yield int(k), r, multiplier

    def _filled(self, motion: Motion) -> Motion:
        y = Motion(*(np.full(self._size, 0.0, dtype=object) for _ in motion))
        for whole, x in zip(y, motion, strict=True):
            whole[self.places] = x
        return y


def _balancing(rows: np.ndarray, left: np.ndarray) -> Sequence[Any]:
    """Return the multipliers lam of one or two rows with ``rows^T lam = -left``; by least squares if one row has two
    components.
    """
    if len(rows) == 1:
        return [-(rows[0] @ left) / (rows[0] @ rows[0])]
    (a, b), (c, d) = rows
    return [(c * left[1] - d * left[0]) / (a * d - b * c), (b * left[0] - a * left[1]) / (a * d - b * c)]


class InterpretedMechanism:
    """A mechanism whose equations are evaluated with numbers of another kind, such as symbols.

    ::

        M a + Phi_q^T lam = Q(q, v, lam, z, t),      Phi(q, t) = 0,      z' = rates(q, v, lam, z, t)

    Parameters
    ----------
    mechanism, t0
        The mechanism, and the time of its consistent start [s].
    is_joint
        Whether its coordinates are those of the spanning tree of its joints, if there are such and no friction.

    Attributes
    ----------
    start : MechanismAtStart
        The mechanism at its start.
    places : (n,) array of int
        Index of each coordinate among x, y and angle of all bodies.
    is_arm : (n,) array of bool
        Which coordinates are angles of lines from other bodies to point masses, in the places of the angles of these.
    cut : list of int
        Indices of the independent constraint rows with multipliers; those of the joints of the tree have none.
    """

    def __init__(self, mechanism: Mechanism, t0: float, *, is_joint: bool = False):
        self.start = Starts().at_start(mechanism, t0)
        self.compiled = compiled = self.start.mechanism
        self._work = Workspace(compiled, 0.0, *np.zeros((2, compiled.size)))
        self._tree: InterpretedTree | None = None
        if is_joint and not len(compiled.topology.frictions):
            inertias = [mechanism.bodies[name].inertia for name in compiled.bodies]
            masses = {i for i, inertia in enumerate(inertias) if inertia is None}
            tree = InterpretedTree(compiled.topology, self._work.solver.row_index, masses)
            self._tree = tree if tree.places.size else None
        in_tree = self._tree.rows if self._tree else set()
        self.cut = [k for k in range(len(compiled.solved_rows)) if k not in in_tree]
        self.places = self._tree.places if self._tree else np.arange(3 * len(compiled.bodies))
        self.is_arm = self._tree.is_arm if self._tree else np.zeros(len(self.places), dtype=bool)

    @property
    def is_joint(self) -> bool:
        """Whether the coordinates are those of the spanning tree."""
        return self._tree is not None

    def interpreter(self, numbers: Arithmetic, searching: Sequence[str]) -> Interpreter:
        """Return what executes the kernels with numbers of this kind; see `Interpreter`."""
        self._run = Interpreter(numbers, self.compiled.laws, searching)
        return self._run

    def load(self, topology: Topology, z: Sequence[Any]) -> None:
        """Take the arrays of the mechanism, and first-order states, as numbers of the kind of `interpreter`."""
        scratch = _objects(self._work.scratch)
        scratch.law_values[:] = topology.law_parameters
        self._equations = _objects(equations.new_equations(topology, scratch, self._work.solver))
        self._run(applied_forces.take_states)(topology, scratch, z)

    @property
    def topology(self) -> Topology:
        """The arrays of the mechanism, without gravity."""
        return self._equations.top

    @property
    def law_values(self) -> np.ndarray:
        """Parameters of all laws."""
        return self._equations.w.law_values

    def coordinates(self, t: Any, whole: Motion) -> Motion:
        """Return the motion of the coordinates (n,), given that of all bodies (3 B,)."""
        if self._tree is None:
            return whole
        eq = self._equations
        self._run(system.prepare)(eq.top, eq.w, t, np.append(whole.q, np.zeros(3)))
        return self._tree.coordinates(self._run, eq.top, eq.w, whole)

    def bodies(self, t: Any, own: Motion) -> Motion:
        """Return the motion of all bodies (3 B,), given that of the coordinates (n,)."""
        eq = self._equations
        return own if self._tree is None else self._tree.bodies(self._run, eq.top, eq.w, t, own)

    def residual(self, t: Any, whole: Motion, lam: np.ndarray) -> np.ndarray:
        """Return ``M a + Phi_q^T lam - Q`` (3 B,)."""
        residual = _zeros(len(whole.q))
        self._run(equations.residual_of)(self._equations, t, *whole, lam, True, residual)
        return residual

    def state_rates(self, *, renew: bool = False) -> np.ndarray:
        """Return the rates (Z,) of the first-order states in the state that was evaluated last.

        `renew`: evaluate the applied forces there first.
        """
        eq, rates = self._equations, _zeros(len(self.compiled.states))
        if renew:
            self._run(applied_forces.applied_forces)(eq.top, eq.w, eq.q, eq.v)
        self._run(applied_forces.state_rates)(eq.top, eq.w, eq.v, rates)
        return rates

    def constraints(self, t: Any, whole: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return Phi (m,) and its first and second derivatives with respect to time, of all independent rows."""
        eq, run = self._equations, self._run
        position, velocity, gamma, acceleration = _zeros(4, len(self.compiled.solved_rows))
        run(equations.rows_of)(eq, t, whole.q, whole.v, position, velocity, gamma)
        eq.a[: len(whole.a)] = whole.a
        for k, row in np.ndindex(*eq.w.phi.shape):
            if row < eq.top.rows[k]:
                index = eq.solver.row_index[k, row] - len(whole.q)
                no_rates = _zeros(*eq.w.phi_t.shape)
                by_acceleration = run(system.constraint_rate)(eq.top.pairs, eq.w.jac, no_rates, eq.a, k, row)
                acceleration[index] = by_acceleration - gamma[index]
        return position, velocity, acceleration

    def add_multipliers(self, residual: np.ndarray, lam: np.ndarray) -> None:
        """Write the multipliers of the joints of the tree into `lam` (m,), given the `residual` without them."""
        eq = self._equations
        if self._tree is not None:
            for k, row, multiplier in self._tree.multipliers(eq.top, eq.w.jac, residual):
                lam[eq.solver.row_index[k, row] - len(residual)] = multiplier

    def observed(self, t: Any, whole: Motion, lam: np.ndarray) -> tuple[np.ndarray, np.ndarray, Observed]:
        """Return positions and velocities (3 (B + 1),), ground last, and what is recorded of one state."""
        eq, run = self._equations, self._run
        top, w = eq.top._replace(gravity=eq.gravity), eq.w  # the equations subtract gravity apart
        of_time = (np.array([x], dtype=object) for x in (t, whole.q, whole.v, lam))
        forces = _objects(Reactions.zeros(1, len(top.pairs)))
        self.residual(t, whole, lam)
        run(frames.reactions_in_frames)(eq, *of_time, forces)
        observed = _objects(Observed.zeros(1, self.compiled.topology))
        observed.lam[:], observed.acc[0, : len(whole.a)] = forces.lam, whole.a
        observed.state_rates[0] = self.state_rates()
        run(observe.describe)(top, w, eq.q, eq.v, observed, 0)
        run(acting.joint_values)(top, w, eq.q, forces.lam[0], observed.reactions[0], observed.joints[0])
        return eq.q, eq.v, observed

    def force_element(self, kind: str, name: str) -> tuple[Any, Mapping[str, Any]]:
        """Return the length of the force element of an element of a plugin, in the state that was evaluated last [m],
        and the parameters of its law by name.
        """
        known, w, index = self.compiled, self._equations.w, self._segment(kind, name)
        law = int(known.topology.springs[index, SPRING.law])
        names = [parameter for parameter, _ in known.laws[law][1].parameters]
        first = int(known.topology.laws[law, LAW_ROW.parameters]) + 1
        return w.s[index, 0], dict(zip(names, w.law_values[first:], strict=False))

    def give_force(self, kind: str, name: str, force: Any) -> None:
        """Take the force of an element of a plugin as given, so that its law is not evaluated."""
        top = self._equations.top
        law = int(top.springs[self._segment(kind, name), SPRING.law])
        address, begin, _, program = LawRow(*map(int, top.laws[law]))
        self._run.known_forces[address, program, begin] = force

    def _segment(self, kind: str, name: str) -> int:
        """Return the index of the force element among the springs."""
        top = self.compiled.topology
        (place,) = (one.place for one in self.compiled.extensions[kind] if one.force.name == name)
        leads = top.springs[:, SPRING.segments] > 0
        (index,) = np.flatnonzero((top.force_place[: len(leads)] == place) & leads).tolist()
        return int(index)


def _zeros(*shape: int) -> np.ndarray:
    return np.full(shape, 0.0, dtype=object)


def _objects(bundle: Any) -> Any:
    """Return a bundle with its numbers, not integers, as objects."""
    return type(bundle)(
        *(x.astype(object) if isinstance(x, np.ndarray) and x.dtype == np.float64 else x for x in bundle)
    )
