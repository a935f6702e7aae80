"""Discontinuities of the linear law of compliant contacts, at which steps of runs with derivatives end.

See `mbdkit_gradients.law_corners`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.engine.force_laws import CompiledLaw
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.law_conditions import gradient_doubts, law_sides
from mbdkit_contact.acting_contacts import ActingContact, contact_law, has_sides, pairs_of_shapes
from mbdkit_contact.kernels.contact_laws import STIFFNESS, VALUE, VALUES, contact_rows

#: Largest change of a coordinate, velocity or parameter in the differences that differentiate a `Push` [SI units].
#:
#: For a circle of 0.1 m, their relative errors are about 1e-11.
OFFSET = 3e-4


@dataclass(frozen=True)
class Push:
    """The condition that the linear law of a row of a contact acts: the shapes overlap, and it pushes them apart.

    Here g is the smaller of the overlap and of the force over the stiffness [m].

    Attributes
    ----------
    force, side
        Name of the contact, and index of the parameter with the side; see
        `mbdkit.engine.law_conditions.LawCondition`.
    bodies
        Indices of both bodies.
    law
        Law of the quantities of all rows of the two shapes.
    parameters
        Indices of the number of its parameters and of these in ``Topology.law_parameters`` of the mechanism with sides.
    row, rows
        Index of the row, and number of rows.
    """

    force: str
    side: int
    bodies: tuple[int, int]
    law: CompiledLaw
    parameters: np.ndarray
    row: int
    rows: int

    def values(self, observed: Observed, q: np.ndarray, v: np.ndarray, numbers: np.ndarray) -> list[float]:
        """Return g in T states; see `mbdkit.engine.law_conditions.LawCondition.values`."""
        return np.min(self._overlap_and_force(q, v, numbers), axis=0).tolist()

    def slopes(self, state: tuple[np.ndarray, ...], directions: Sequence[tuple[np.ndarray, ...]]) -> list[float]:
        """Return the derivatives of g in directions of the state: positions (n,), velocities (n,), parameters (L,)."""
        q, v, numbers = state
        smaller = int(np.argmin(self._overlap_and_force(q[None], v[None], numbers)[:, 0]))

        def value(x: float, direction: tuple[np.ndarray, ...]) -> float:
            q, v, numbers = (a + x * da for a, da in zip(state, direction, strict=True))
            return float(self._overlap_and_force(q[None], v[None], numbers)[smaller, 0])

        slopes = []
        for dq, dv, dnumbers in directions:
            largest = max(float(np.max(np.abs(x))) for x in (dq, dv, dnumbers[self.parameters]))
            h, to = OFFSET / (largest or 1.0), (dq, dv, dnumbers)
            near, far = value(h, to) - value(-h, to), value(2.0 * h, to) - value(-2.0 * h, to)
            slopes.append((8.0 * near - far) / (12.0 * h))
        return slopes

    def _overlap_and_force(self, q: np.ndarray, v: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return (2, T) overlaps, and forces of spring and damper over the stiffness."""
        table = np.array([[*self.bodies, self.law.address, self.law.program, 0, 0]], dtype=np.int64)
        own = numbers[self.parameters]
        own[len(own) - self.rows :] = 1.0
        quantities = np.zeros((len(q), self.rows, VALUE))
        contact_rows(table, own, np.ascontiguousarray(q), np.ascontiguousarray(v), quantities)
        return np.array([-quantities[:, self.row, 0], quantities[:, self.row, 1] / own[1 + STIFFNESS]])


@law_sides
def sides(contacts: Sequence[ActingContact], places_of: Callable[[int], np.ndarray]) -> Iterator[Push]:
    """Yield the conditions of the compliant contacts with a linear law; see `law_sides`."""
    for rows in pairs_of_shapes(contacts):
        if has_sides(rows):
            parameters, law = places_of(rows[0].law_place), contact_law(rows, VALUES)
            for i in range(len(rows)):
                side = int(parameters[i - len(rows)])
                yield Push(rows[0].pair.name, side, rows[0].bodies, law, parameters, i, len(rows))


@gradient_doubts
def jumps(contacts: Sequence[ActingContact]) -> list[str]:
    """Return a doubt about each contact of polygons that has the linear law, which has no sides there."""
    rows = (rows[0] for rows in pairs_of_shapes(contacts) if rows[0].force == "linear" and not has_sides(rows))
    return [
        f"steps do not end where the shapes of the contact '{name}' begin to touch. If the run passes such a point, "
        f"the derivatives lack the contribution of the jump of the force; use another law than `linear`"
        for name in dict.fromkeys(contact.pair.key.rpartition(".")[2] for contact in rows)
    ]
