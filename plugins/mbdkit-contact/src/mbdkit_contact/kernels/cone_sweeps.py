"""Sweeps over contacts with Coulomb friction: the nonlinear Gauss-Seidel iteration.

Each contact in turn gets the impulses that satisfy the laws of contact and friction for the present impulses of all
others (M. Jean, Computer Methods in Applied Mechanics and Engineering 177:235-257, 1999; V. Acary and B. Brogliato,
Numerical Methods for Nonsmooth Dynamical Systems, 2008, section 13.7.4).
"""

from __future__ import annotations

from mbdkit.engine.kernels.bundle_types import IntMatrix, IntVector, RealCube, RealMatrix, RealVector
from mbdkit.engine.native.functions import kernel


@kernel
def couple_contacts(
    begin: IntVector, members: IntVector, bodies: IntMatrix, gradients: RealCube, lightness: RealMatrix,
    start: IntVector, other: IntVector, blocks: RealMatrix,
) -> None:  # fmt: skip
    """Write how contacts of bodies that nothing else couples affect each other; see `sweep_contacts`.

    Parameters
    ----------
    begin, members
        (B + 2,) and (2 k,) arrays. The sides of contacts that belong to body b are
        ``members[begin[b]:begin[b + 1]]``, where side s of contact i has the number 2 i + s. The ground is the last
        body.
    bodies
        (k, 2) numbers of the bodies.
    gradients
        (2, k, 6) derivatives of the rates of gap and slip with respect to the velocities of both bodies.
    lightness
        (B + 1, 3) inverse masses and moments of inertia.
    start, other, blocks
        (k + 1,), (E,) and (E, 4) arrays that receive the result; E may be larger than needed.
    """
    last = 0
    for i in range(len(bodies)):
        start[i] = last
        for a in range(2):
            body = bodies[i, a]
            if body == len(lightness) - 1:
                continue
            for place in range(begin[body], begin[body + 1]):
                j, b = members[place] // 2, members[place] % 2
                e = start[i]
                while e < last and other[e] != j:
                    e += 1
                if e == last:
                    other[e] = j
                    last += 1
                for axis in range(3):
                    light = lightness[body, axis]
                    for u in range(2):
                        for w in range(2):
                            blocks[e, 2 * u + w] += (
                                gradients[u, i, 3 * a + axis] * light * gradients[w, j, 3 * b + axis]
                            )
    start[len(bodies)] = last


@kernel
def sweep_contacts(
    start: IntVector, other: IntVector, blocks: RealMatrix, free: RealMatrix, friction: RealVector, tolerance: float,
    most: int, impulses: RealMatrix,
) -> float:  # fmt: skip
    """Update the impulses (k, 2) of contacts, each normal and tangential, until velocities hardly change.

    Returns the largest change, in the last sweep, of the velocity of a contact due to the impulses of this contact.

    Parameters
    ----------
    start, other, blocks
        (k + 1,), (E,) and (E, 4) arrays. For contact i, the items from ``start[i]`` to ``start[i + 1] - 1`` of `other`
        are the contacts that affect it, itself included. The same rows of `blocks` are the changes of its velocities by
        unit impulses of those contacts: normal velocity by the normal and by the tangential impulse, tangential
        velocity by the normal and by the tangential impulse.
    free
        (k, 2) velocities without impulses.
    friction
        (k,) coefficients of friction.
    tolerance
        Largest change of a velocity with which the sweeps end.
    most
        Largest number of sweeps.
    """
    worst = 0.0
    for _ in range(most):
        worst = 0.0
        for i in range(len(friction)):
            normal, tangent = free[i, 0], free[i, 1]
            nn = nt = tn = tt = 0.0
            for e in range(start[i], start[i + 1]):
                j = other[e]
                if j == i:
                    nn, nt, tn, tt = blocks[e, 0], blocks[e, 1], blocks[e, 2], blocks[e, 3]
                else:
                    normal += blocks[e, 0] * impulses[j, 0] + blocks[e, 1] * impulses[j, 1]
                    tangent += blocks[e, 2] * impulses[j, 0] + blocks[e, 3] * impulses[j, 1]
            push = rub = 0.0
            if normal < 0.0 and friction[i] == 0.0:
                push = -normal / nn
            elif normal < 0.0:
                determinant = nn * tt - nt * tn
                push = (nt * tangent - tt * normal) / determinant
                rub = (tn * normal - nn * tangent) / determinant
                if push <= 0.0 or abs(rub) > friction[i] * push:  # it slips, against the impulse of friction
                    ratio = friction[i] if rub > 0.0 else -friction[i]
                    slope = nn + ratio * nt
                    push = -normal / slope if slope > 0.0 else 0.0
                    rub = ratio * push
            worst = max(worst, abs(push - impulses[i, 0]) * nn, abs(rub - impulses[i, 1]) * tt)
            impulses[i, 0], impulses[i, 1] = push, rub
        if worst <= tolerance:
            break
    return worst
