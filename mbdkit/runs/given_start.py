"""Initial states in which given quantities have given values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.units import number_in
from mbdkit.engine.assembly import search_for
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.linear_systems import least_norm, product
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_quantities import Coordinate, Quantity, RelativeAngle
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.spec.run_spec import RunSpec

#: Coordinates of bodies and markers, by the name of their velocity.
RATES = {"vx": "x", "vy": "y", "angular_velocity": "angle"}
#: Largest change of a given value in one iteration: angles in rad, lengths as a share of the length of the mechanism.
#:
#: The given values are approached in small steps, so that closed loops stay in their configuration.
LONGEST = 0.2
#: A quantity is independent of others if its gradient deviates from theirs by more than this share.
INDEPENDENT = 1e-6
DEPENDENT = 1e-12  #: Rows that depend on others to this share are redundant.

MOST_ITERATIONS = 30
#: Residuals of given values and joints [m, rad, m/s, rad/s] up to this share of the largest coordinate or velocity,
#: or of 1 if it is smaller, count as zero.
MET = 1e-12

_Given = dict[str, tuple[Quantity, float]]  #: Quantities with their values, by name.


class GivenStart:
    """Finds states of a mechanism in which quantities have given values, near the start of a spec.

    Of all states that satisfy the joints and the given values, the state is the one nearest to the start of the spec in
    the mass metric. It is found along a path on which the values change gradually.
    """

    def __init__(self, mechanism: Mechanism, spec: RunSpec, starts: Starts | None = None):
        if mechanism.beams:
            raise SpecError("initial values cannot be given for mechanisms with beams", key="initial")
        self.start = (starts or Starts()).at_start(mechanism, spec.time.start, spec.time.final)
        self.names = QuantityNames(mechanism)
        self._find = cache(self.names.find)  # derivatives of starts look up each name often
        self.length = self.start.mechanism.length
        self.search = search_for(mechanism, self.start.mechanism, spec.time.start)
        self.n = self.search.n
        free = np.zeros(self.n)
        free[self.search.free] = 1.0
        free[[3 * place + 2 for place, body in enumerate(mechanism.bodies.values()) if body.inertia is None]] = 0.0
        self.light = free / np.sqrt(self.search.mass)

    def state(self, values: Mapping[str, float | str], near: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities (n,) at which joints are closed and quantities have the given `values`.

        If the values and the joints determine the positions, these are found from the positions `near` (n,), if given.
        """
        q = self.positions(values, near)
        return q, self._velocities(q, self.start.v0[: self.n].copy(), self._given(values)[1])

    def positions(self, values: Mapping[str, float | str], near: np.ndarray | None = None) -> np.ndarray:
        """Return the positions (n,) of `state`."""
        held, q = self._given(values)[0], self.start.q0[: self.n].copy()
        return self._positions(q, held, near) if held else q

    def equations(
        self, values: Mapping[str, float | str], q: np.ndarray, v: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Return residuals (R,) and matrix (R, n) of the equations of positions, and those of velocities.

        At the `state`, the residuals of joints and given `values` are zero, and each matrix has the derivatives of the
        residuals with respect to q (n,) or v (n,).
        """
        moving = [*self._given(values)[1].values()]
        rate_rows, _, phi_t = self._rows(q, [one for one, _ in moving])
        aim = np.concatenate([-phi_t, [value for _, value in moving]])
        return self.position_equations(values, q), (product(rate_rows, v) - aim, rate_rows)

    def position_equations(self, values: Mapping[str, float | str], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (R,) and matrix (R, n) of the equations of positions; see `equations`."""
        held = [*self._given(values)[0].values()]
        rows, phi, _ = self._rows(q, [one for one, _ in held])
        lack = self._values([one for one, _ in held], q) - np.array([value for _, value in held])
        return np.concatenate([phi, lack]), rows

    def depend_on_coordinates_alone(self, values: Mapping[str, float | str]) -> bool:
        """Return whether the quantities that have `values` are coordinates of bodies or differences of angles."""
        given = [quantity for kind in self._given(values) for quantity, _ in kind.values()]
        return all(isinstance(one, Coordinate | RelativeAngle) for one in given)

    def _given(self, values: Mapping[str, float | str]) -> tuple[_Given, _Given]:
        """Return the positional quantities that have values, and those whose rates have."""
        held: _Given = {}
        moving: _Given = {}
        for name, given in values.items():
            element, _, axis = name.rpartition(".")
            kind, of = (moving, f"{element}.{RATES[axis]}") if axis in RATES else (held, name)
            quantity = self._find(of, "initial")
            with SpecError.locate(f"initial.{quoted(name)}"):
                value = number_in(given, f"{quantity.unit}/s" if axis in RATES else quantity.unit)
            if not math.isfinite(value):
                raise SpecError(f"the value of '{name}' should be a finite number, not {value!r}", key="initial")
            kind[name] = quantity, value
        return held, moving

    def independent(self, names: Iterable[str]) -> list[str]:
        """Return those names of positional quantities, in order, that are independent of each other and of the joints.

        If the names of all coordinates of bodies are among them, their values determine the positions. Names of other
        quantities are left out.
        """
        joints, _, _ = self._rows(self.start.q0[: self.n], [])
        basis: list[np.ndarray] = []
        found = []
        for name, rows in [*(("", row[None]) for row in joints), *self._named_rows(names)]:
            row = (rows * self.light)[0]
            size = float(np.sqrt(product(row, row)))
            for _ in range(2):
                for other in basis:
                    row = row - product(other, row) * other
            rest = float(np.sqrt(product(row, row)))
            if rest > INDEPENDENT * size > 0.0:
                basis.append(row / rest)
                found += [name] if name else []
        return found

    def _named_rows(self, names: Iterable[str]) -> Iterator[tuple[str, np.ndarray]]:
        for name in names:
            with suppress(SpecError):
                rows = np.zeros((1, self.n))
                self.names.find(name, "initial").add_gradient(self.start.q0[: self.n][None], rows)
                yield name, rows

    def value(self, name: str) -> float:
        """Return the value of a quantity at the start, such as ``crank.angle`` or ``crank.angular_velocity``."""
        element, _, axis = name.rpartition(".")
        q, v = self.start.q0[: self.n], self.start.v0[: self.n]
        if axis not in RATES:
            return float(self._values([self.names.find(name, "initial")], q)[0])
        rows = np.zeros((1, self.n))
        self.names.find(f"{element}.{RATES[axis]}", "initial").add_gradient(q[None], rows)
        return float(product(rows, v)[0])

    def _positions(self, q: np.ndarray, held: _Given, near: np.ndarray | None) -> np.ndarray:
        quantities = [quantity for quantity, _ in held.values()]
        if near is not None and self._are_determining(near, quantities):
            q = near
        goal, here = np.array([value for _, value in held.values()]), self._values(quantities, q)
        unit = np.array([1.0 if quantity.unit == "rad" else self.length for quantity in quantities])
        parts = max(1, math.ceil(float(np.max(np.abs(goal - here) / unit)) / LONGEST))
        for part in range(1, parts + 1):
            values = here + (goal - here) * (part / parts) if part < parts else goal
            if (closed := self._closed(q, quantities, values)) is None:
                told = self._told(list(held), goal)
                raise SpecError(f"the joints cannot be assembled with these initial values: {told}", key="initial")
            q = closed
        for quantity, value in held.values():
            if isinstance(quantity, Coordinate):
                q[3 * quantity.body + quantity.axis] = value  # set exactly, without rounding errors
        return q

    def _are_determining(self, q: np.ndarray, quantities: list[Quantity]) -> bool:
        """Return whether no movement at positions `q` keeps the joints closed and the quantities constant."""
        rows, _, _ = self._rows(q, quantities)
        return bool(np.linalg.matrix_rank(rows * self.light, INDEPENDENT) == np.count_nonzero(self.light))

    def _closed(self, q: np.ndarray, quantities: list[Quantity], values: np.ndarray) -> np.ndarray | None:
        """Return positions with closed joints in which the quantities have the given values; None if none are found."""
        for _ in range(MOST_ITERATIONS):
            rows, phi, _ = self._rows(q, quantities)
            lack = np.concatenate([phi, self._values(quantities, q) - values])
            q = q - self.light * least_norm(rows * self.light, lack, DEPENDENT)
            # the step taken after this residual was evaluated reduces it further
            if np.max(np.abs(lack)) <= MET * max(1.0, float(np.max(np.abs(q)))):
                return q
        return None

    def _velocities(self, q: np.ndarray, v: np.ndarray, moving: _Given) -> np.ndarray:
        rows, _, phi_t = self._rows(q, [one for one, _ in moving.values()])
        values = np.array([value for _, value in moving.values()])
        aim = np.concatenate([-phi_t, values])
        for _ in range(2):  # the second solution removes the rounding errors of the first
            v = v - self.light * least_norm(rows * self.light, product(rows, v) - aim, DEPENDENT)
        largest = max(1.0, float(np.max(np.abs(v), initial=0.0))) * self.search.reach
        if not np.max(np.abs(product(rows, v) - aim), initial=0.0) <= MET * largest:
            told = self._told(list(moving), values) or "zero"
            raise SpecError(f"no velocities satisfy the joints with these initial values: {told}", key="initial")
        return v

    def _rows(self, q: np.ndarray, quantities: list[Quantity]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the dense Jacobian of joints and quantities (m + K, n), the constraint functions Phi (m,), and their
        partial derivatives with respect to time Phi_t (m,).
        """
        phi, (row, column, value), phi_t = self.search.evaluate(q)
        rows = np.zeros((len(phi) + len(quantities), self.n))
        np.add.at(rows, (row, column), value)
        for place, one in enumerate(quantities, len(phi)):
            one.add_gradient(q[None], rows[place : place + 1])
        return rows, phi, phi_t

    def _values(self, quantities: list[Quantity], q: np.ndarray) -> np.ndarray:
        return np.array([float(quantity.value(q[None])[0]) for quantity in quantities])

    def _told(self, names: list[str], values: np.ndarray) -> str:
        return ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, values, strict=True))
