"""Closed contacts in the iteration of implicit steps.

The matrices of `mbdkit.integrators.stages.simplified_newton` contain the bodies, their forces and joints. Without the
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
from mbdkit.integrators.run.run_state import JACOBIANS, load_run_state
from mbdkit.integrators.stages.collocation_stages import load_stages
from mbdkit.integrators.stages.simplified_newton import one_of
from mbdkit_contact.kernels.contact_forces import find_directions
from mbdkit_contact.kernels.contact_modes import collect_closed
from mbdkit_contact.kernels.event_bundle import load_events
from mbdkit_contact.kernels.kinematics import place

WORN = 1e-9  #: Pivots below this share of the largest entry belong to redundant contacts; their forces are left out.


@subkernel
def _along(x, j, n, y):
    """Return the product of the derivatives of constraint `j` and a vector (n,) or longer, without ground."""
    a, b, total = x.sites[j, 0], x.sites[j, 1], 0.0 * y[0]
    for d in range(3):
        if a < n:
            total += x.held[j, d] * y[a + d]
        if b < n:
            total += x.held[j, 3 + d] * y[b + d]
    return total


@separate
def _invert(a, inverse, count):
    """Write the inverse of the matrix (count, count), which is overwritten; return nothing.

    Rows and columns of the inverse whose pivots vanish are zero.
    """
    largest = 0.0
    for i in range(count):
        for j in range(count):
            largest = max(largest, abs(a[i, j]))
            inverse[i, j] = 1.0 if i == j else 0.0
    for k in range(count):
        pivot = k
        for i in range(k + 1, count):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        if not abs(a[pivot, k]) > WORN * largest:
            for i in range(count):
                a[i, k] = a[k, i] = inverse[k, i] = 0.0
            continue
        for j in range(count):
            a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            inverse[k, j], inverse[pivot, j] = inverse[pivot, j], inverse[k, j]
        scale = 1.0 / a[k, k]
        for j in range(count):
            a[k, j] *= scale
            inverse[k, j] *= scale
        for i in range(count):
            factor = a[i, k]
            if i != k and factor != 0.0:
                for j in range(count):
                    a[i, j] -= factor * a[k, j]
                    inverse[i, j] -= factor * inverse[k, j]


@subkernel
def _independent(events, count):
    """Write the places of independent constraints, or of all if unknown, to ``s.order``; return their number."""
    order, basis = events.closed.order, events.known.basis
    few = basis[0] if 0 < basis[0] < count else count
    for i in range(few):
        order[i] = min(basis[1 + i], count - 1) if few < count else i
    return few


@separate
def _prepare(events, y, tangent, e, n):
    """Solve the system of eigenvalue `e` for unit forces of closed contacts, and write the inverse matrix of the
    equations of the forces; return the number of forces.
    """
    s, x = events.closed, events.newton
    k = collect_closed(events)
    if k <= 0:
        return 0
    place(s.shapes, tangent.q, tangent.v)
    count = _independent(events, find_directions(s, k))
    for i in range(count):
        j = s.order[i]
        a, b = s.sites[j, 0], s.sites[j, 1]
        x.sites[i, 0], x.sites[i, 1] = a, b
        for d in range(6):
            x.held[i, d] = s.held[j, d]
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
        for j in range(count):
            x.matrix[i, j] = _along(x, i, n, x.answers[j])
    _invert(x.matrix, x.inverse, count)
    return count


@entry
def constrain(run, stages, number, unused, none):
    """Let the solution for an eigenvalue satisfy the constraints of closed contacts; see `constrain_solution`.

    The solutions for unit forces are kept while the matrix of the eigenvalue stays the same.
    """
    c, m = load_run_state(run), load_stages(stages)
    events = load_events(c.w.reacting.elements[0])
    x, n, y, e = events.newton, len(c.q) - 3, m.systems, int(number)
    if x.key[0] != c.counts[JACOBIANS] or x.key[1] != e:
        x.key[2] = _prepare(events, y, m.tangent, e, n)
        x.key[0], x.key[1] = c.counts[JACOBIANS], e
    count = x.key[2]
    for i in range(count):
        if e >= 0:
            x.right[i] = _along(x, i, n, y.x_real) - _along(x, i, n, y.z_real)
        else:
            x.right[i] = _along(x, i, n, y.x_complex) - _along(x, i, n, y.z_complex)
    for j in range(count):
        force = 0.0 * x.right[0]
        for i in range(count):
            force += x.inverse[j, i] * x.right[i]
        for d in range(len(x.real)):
            if e >= 0:
                y.x_real[d] -= force.real * x.answers[j, d].real
            else:
                y.x_complex[d] -= force * x.answers[j, d]
    return OK
