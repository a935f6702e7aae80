"""Closed contacts in the iteration of implicit steps.

The matrices of `mbdkit.integrators.simplified_newton` contain the bodies, their forces and joints. Without the
constraints of closed contacts, the iteration would converge slowly where stiff forces act against them. With the matrix
S of an eigenvalue, the directions D of the forces of contacts, and the derivatives G of their constraints, the change x
for a residual r satisfies

    S x + D p = [M r, Phi_q r],    G x = G r

so that x is the solution without contacts, less the part of ``S^-1 D`` with ``G S^-1 D p = G (x - r)``.
"""

from __future__ import annotations

from mbdkit.engine.kernels.lu import substitute
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.native.functions import entry, separate, subkernel
from mbdkit.integrators.collocation_stages import load_stages
from mbdkit.integrators.run_state import load_run_state
from mbdkit.integrators.simplified_newton import one_of
from mbdkit_contact.kernels.contact_forces import find_directions
from mbdkit_contact.kernels.contact_modes import collect_closed
from mbdkit_contact.kernels.event_bundle import load_events
from mbdkit_contact.kernels.kinematics import place

WORN = 1e-9
"""Pivots below this share of the largest entry belong to redundant contacts; their forces are left out."""


@subkernel
def _along(s, j, n, x):
    """Return the product of the derivatives of constraint `j` and a vector (n,) or longer, without ground."""
    a, b, total = s.sites[j, 0], s.sites[j, 1], 0.0 * x[0]
    for d in range(3):
        if a < n:
            total += s.held[j, d] * x[a + d]
        if b < n:
            total += s.held[j, 3 + d] * x[b + d]
    return total


@separate
def _solve(matrix, count):
    """Eliminate the unknowns of the equations (count, count + 1) in place, with row pivots; return nothing.

    The solution is in the last column; unknowns whose pivots vanish are zero.
    """
    largest = 0.0
    for i in range(count):
        for j in range(count):
            largest = max(largest, abs(matrix[i, j]))
    for k in range(count):
        pivot = k
        for i in range(k + 1, count):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > WORN * largest:
            for i in range(count):
                matrix[i, k] = 0.0
            for j in range(count + 1):
                matrix[k, j] = 0.0
            matrix[k, k] = 1.0
            continue
        for j in range(count + 1):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for i in range(k + 1, count):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, count + 1):
                matrix[i, j] -= factor * matrix[k, j]
    for k in range(count - 1, -1, -1):
        for j in range(k + 1, count):
            matrix[k, count] -= matrix[k, j] * matrix[j, count]
        matrix[k, count] /= matrix[k, k]


@subkernel
def _independent(events, count):
    """Write the places of independent constraints, or of all if unknown, to ``s.order``; return their number."""
    order, basis = events.closed.order, events.known.basis
    few = basis[0] if 0 < basis[0] < count else count
    for i in range(few):
        order[i] = min(basis[1 + i], count - 1) if few < count else i
    return few


@entry
def constrain(run, stages, number, unused, none):
    """Let the solution for an eigenvalue satisfy the constraints of closed contacts; see `constrain_solution`."""
    c, m = load_run_state(run), load_stages(stages)
    events = load_events(c.w.reacting[3])
    s, x, n = events.closed, events.newton, len(c.q) - 3
    k = collect_closed(events)
    if k <= 0:
        return OK
    place(s.shapes, m.tangent.q, m.tangent.v)
    count = find_directions(s, k)
    e = int(number)
    y = m.systems
    count = _independent(events, count)
    for i in range(count):
        j = s.order[i]
        a, b = s.sites[j, 0], s.sites[j, 1]
        for d in range(len(x.real)):
            x.real[d], x.right[d] = 0.0, 0.0
        for d in range(3):
            if a < n:
                x.real[a + d] += s.pushed[j, d]
            if b < n:
                x.real[b + d] += s.pushed[j, 3 + d]
        if e >= 0:
            substitute(y.pattern, one_of(y.real, e), x.real, x.solved)
            for d in range(len(x.real)):
                x.answers[i, d] = x.solved[d]
        else:
            for d in range(n):
                x.right[d] = x.real[d]
            substitute(y.pattern, one_of(y.cplx, -1 - e), x.right, x.answers[i])
    for i in range(count):
        at = s.order[i]
        for j in range(count):
            x.matrix[i, j] = _along(s, at, n, x.answers[j])
        if e >= 0:
            x.matrix[i, count] = _along(s, at, n, y.x_real) - _along(s, at, n, y.z_real)
        else:
            x.matrix[i, count] = _along(s, at, n, y.x_complex) - _along(s, at, n, y.z_complex)
    _solve(x.matrix, count)
    for j in range(count):
        force = x.matrix[j, count]
        for d in range(len(x.real)):
            if e >= 0:
                y.x_real[d] -= force.real * x.answers[j, d].real
            else:
                y.x_complex[d] -= force * x.answers[j, d]
    return OK
