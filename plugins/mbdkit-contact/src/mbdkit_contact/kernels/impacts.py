"""Impacts of rigid contacts: impulses by the laws of Newton, Poisson or Stronge, with Coulomb friction."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.bundle_types import IntVector, RealVector
from mbdkit.engine.native.functions import subkernel
from mbdkit_contact.kernels.pivoting import Cones, new_cones, solve_cones

NEWTON, POISSON = range(2)
LAWS = ("newton", "poisson")  #: Laws of impact, by their numbers.
#: Results of an impact: no impulses satisfy the law, the impulses satisfy it, or it would have created energy.
UNSOLVED, AS_ASKED, OTHER_LAW = range(3)
#: If an impact would gain energy, the coefficients of restitution are reduced in steps of 10 %; values up to this are
#: set to 0.
SMALL_RESTITUTION = 1e-3
#: Velocities of contacts, relative to the largest before an impact: differences above the first depend on the order of
#: impacts, and approach below the second ends a sequence of impacts.
ORDER_MATTERS, STOPPED = 1e-6, 1e-9
MOST_STRIKES = 100  #: Largest number of impacts, for each contact, in a sequence of single impacts.


class Strike(NamedTuple):
    """An impact of up to K contacts; vectors (2 K,) have the k normal components first."""

    cones: Cones  #: The contacts; `Cones.response` and `Cones.friction` are input.
    before: RealVector  #: (2 K,) velocities before the impact.
    #: (K,) coefficients of restitution; smaller ones are written if the impact would gain energy.
    restitution: RealVector
    impulses: RealVector  #: (2 K,) result.
    pressed: RealVector  #: (2 K,) work array: impulses of compression.


class ImpactBundle(NamedTuple):
    """An impact of up to K contacts, and sequences of impacts of one contact each."""

    all: Strike
    alone: Strike
    restitution: RealVector  #: (K,) coefficients of restitution, as given.
    u: RealVector  #: (2 K,) work arrays: velocities in a sequence, and after the impact of all.
    together: RealVector
    ordered: IntVector  #: (K,) result: whether the velocities of a contact depend on the order of impacts.


def new_strike(most: int) -> Strike:
    """Return arrays for up to `most` contacts."""
    return Strike(new_cones(most), np.zeros(2 * most), np.zeros(most), np.zeros(2 * most), np.zeros(2 * most))


def new_impacts(most: int) -> ImpactBundle:
    """Return arrays for up to `most` contacts."""
    u, together, ordered = np.zeros(2 * most), np.zeros(2 * most), np.zeros(most, dtype=np.int64)
    return ImpactBundle(new_strike(most), new_strike(1), np.zeros(most), u, together, ordered)


@subkernel
def stronge(s):
    """Write the impulses of one contact by Stronge's law, which never gains energy.

    The normal impulse p grows from 0. Its work in restitution is -e^2 times that in compression, and the friction
    impulse follows Coulomb's law at every p (W. J. Stronge, Impact Mechanics, 2000, chapter 5).
    """
    r, friction, e = s.cones.response, s.cones.friction[0], s.restitution[0]
    normal, slip, p, tangential, work, goal = s.before[0], s.before[1], 0.0, 0.0, 0.0, np.inf
    for _ in range(8):  # slip ends at most once, and so does compression
        ratio = -friction if slip > 0.0 else friction
        # friction holds a contact that sticks if its limit permits, else it slips on with the smallest friction against
        # it
        if slip == 0.0:
            ratio = min(max(-r[1, 0] / r[1, 1], -friction), friction)
        along, across = r[0, 0] + r[0, 1] * ratio, r[1, 0] + r[1, 1] * ratio
        ends = -slip / across if slip * across < 0.0 else np.inf
        turns = -normal / along if normal < 0.0 < along else np.inf
        rises = np.inf
        if normal >= 0.0 and along > 0.0:  # the remaining work, v0 dp + slope dp^2 / 2
            rises = (sqrt(normal**2 + 2.0 * along * max(goal - work, 0.0)) - normal) / along
        more = min(ends, turns, rises)
        if not more < np.inf:
            break
        work += more * (normal + 0.5 * along * more)
        p, tangential = p + more, tangential + ratio * more
        normal, slip = normal + along * more, slip + across * more
        # set exactly: a rounding error would let the slip end again and again
        if more == ends:
            slip = 0.0
        if more == turns:
            normal, goal, work = 0.0, -e * e * work, 0.0
        elif more == rises:
            break
    s.impulses[0], s.impulses[1] = p, tangential


@subkernel
def _by_law(s, k, law):
    """Write the impulses by the law of Newton or of Poisson; return whether there are such impulses."""
    c = s.cones
    for i in range(k):
        c.sliding[i] = c.pressed[i] = 0.0
        c.free[i], c.free[k + i] = s.before[i], s.before[k + i]
        if law == NEWTON and s.before[i] < 0.0:
            c.free[i] += s.restitution[i] * s.before[i]
    if not solve_cones(c, k):
        return False
    for i in range(2 * k):
        s.impulses[i] = c.forces[i]
    if law == NEWTON:
        return True
    # Poisson: in restitution, each contact gets a share of its impulse of compression, and what the laws of contact
    # need beyond that
    for i in range(k):
        c.pressed[i] = s.restitution[i] * c.forces[i]
        s.impulses[i] += c.pressed[i]
    for i in range(2 * k):
        c.free[i] = s.before[i]
        for j in range(2 * k):
            c.free[i] += c.response[i, j] * s.impulses[j]
    if not solve_cones(c, k):
        return False
    for i in range(2 * k):
        s.impulses[i] += c.forces[i]
    return True


@subkernel
def _gains(s, k):
    gain = size = 0.0
    for i in range(2 * k):
        moved = 0.0
        for j in range(2 * k):
            moved += s.cones.response[i, j] * s.impulses[j]
        gain += s.impulses[i] * (s.before[i] + 0.5 * moved)
        size += abs(s.impulses[i] * s.before[i])
    return gain > 1e-12 * size


@subkernel
def strike(s, k, law):
    """Write the impulses of k contacts; return `UNSOLVED`, `AS_ASKED` or `OTHER_LAW`.

    If the law would create energy, another one is used: that of Stronge for one contact, else that of Poisson with
    smaller coefficients of restitution.
    """
    if not _by_law(s, k, law):
        return UNSOLVED
    if not _gains(s, k):
        return AS_ASKED
    # the law of Stronge is one for a single contact; several are reduced until no energy is gained, with plastic
    # impacts at the latest
    if k == 1:
        stronge(s)
    while _gains(s, k):
        any_left = False
        for i in range(k):
            any_left |= s.restitution[i] != 0.0
            s.restitution[i] = 0.9 * s.restitution[i] if s.restitution[i] > SMALL_RESTITUTION else 0.0
        if not any_left:
            break
        if not _by_law(s, k, POISSON):
            return UNSOLVED
    return OTHER_LAW


@subkernel
def _is_coupled(response, k):
    largest = others = 0.0
    for i in range(k):
        for j in range(k):
            size = max(
                abs(response[i, j]), abs(response[i, k + j]), abs(response[k + i, j]), abs(response[k + i, k + j])
            )
            largest = max(largest, size)
            if i != j:
                others = max(others, size)
    return others > STOPPED * largest


@subkernel
def _strike_in_turn(x, k, law, start, step, size):
    """Strike approaching contacts one by one, the first in a cyclic order each time; return whether that succeeded."""
    r, s = x.all.cones.response, x.alone
    for _ in range(MOST_STRIKES * k):
        first = -1
        for j in range(k):
            i = (start + step * j) % k
            if x.u[i] < -STOPPED * size:
                first = i
                break
        if first < 0:
            return True
        s.cones.response[0, 0], s.cones.response[0, 1] = r[first, first], r[first, k + first]
        s.cones.response[1, 0], s.cones.response[1, 1] = r[k + first, first], r[k + first, k + first]
        s.before[0], s.before[1], s.restitution[0] = x.u[first], x.u[k + first], x.restitution[first]
        s.cones.friction[0] = x.all.cones.friction[first]
        if strike(s, 1, law) == UNSOLVED:
            return False
        for i in range(2 * k):
            x.u[i] += r[i, first] * s.impulses[0] + r[i, k + first] * s.impulses[1]
    return True


@subkernel
def find_ordered(x, k, law):
    """Find contacts whose velocities differ between impacts one after another and one impact of all.

    In a sequence, the first approaching contact in a given order is struck alone, by the same law, until none
    approaches. The orders are the cyclic ones in both directions: all orders of up to three contacts.
    """
    size = 0.0
    for i in range(k):
        x.ordered[i] = 0
        x.all.restitution[i] = x.restitution[i]
        size = max(size, abs(x.all.before[i]), abs(x.all.before[k + i]))
    if k < 2 or not _is_coupled(x.all.cones.response, k) or strike(x.all, k, law) == UNSOLVED:
        return
    for i in range(2 * k):
        x.together[i] = x.all.before[i]
        for j in range(2 * k):
            x.together[i] += x.all.cones.response[i, j] * x.all.impulses[j]
    for turn in range(2 * k):
        start, step = (turn, 1) if turn < k else (turn - 1, -1)
        for i in range(2 * k):
            x.u[i] = x.all.before[i]
        if not _strike_in_turn(x, k, law, start, step, size):
            return
        # a sequence that is cut off has not reached its end, so that this much of a difference means nothing
        unfinished, any_differs = 0.0, False
        for i in range(k):
            unfinished = max(unfinished, -x.u[i])
        for i in range(2 * k):
            if abs(x.u[i] - x.together[i]) > ORDER_MATTERS * size + MOST_STRIKES * unfinished:
                x.ordered[i % k] = 1
                any_differs = True
        if any_differs:
            return
