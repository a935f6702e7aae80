"""The smoothed motion of a mechanism in independent coordinates, consistent with its constraints to round-off.

As many quantities as there are degrees of freedom are chosen as independent coordinates. Their fitted values are
smoothed and differentiated. Positions, velocities and accelerations of all bodies follow from these values and the
constraints.

Measured quantities are preferred: the coordinates are observed quantities if enough of these are independent in all
frames, even if they are badly scaled. Other coordinates would pass the errors of smoothing on to the measured
quantities, often enlarged. If there are not enough, coordinates are chosen that determine the motion well in all
frames. If no choice does, as for the cyclic motion of a linkage in which no link rotates fully, different coordinates
are used in different intervals of the motion.

The independence of coordinates in a frame is a number that is zero where they do not determine the motion. The gradient
of each coordinate along the free directions of the mechanism is scaled, and reduced to its part perpendicular to the
gradients of the coordinates chosen before. The independence is the smallest norm of these parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.engine.linear_systems import products, singular_values
from mbdkit.mechanism.mechanism_quantities import Quantity
from mbdkit_biomech.inverse_dynamics.motion.fit import FitTarget, Fitter
from mbdkit_biomech.inverse_dynamics.motion.manifold import Manifold, Quantities
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured
from mbdkit_biomech.inverse_dynamics.motion.smoothing import Smoothed

#: If the observed quantities alone do not suffice, an observed quantity with at least this independence is preferred to
#: a quantity that is not observed, even if the latter is more independent.
PREFERRED = 0.2

#: The motion passes near a fold if the independence of the observed quantities falls below this share of its largest
#: value.
#:
#: At a fold, such as the dead centre of a measured rocker, these quantities do not determine the motion.
FOLD = 0.05

#: Observed quantities do not determine the motion if their independence is below this, even without a fold.
#:
#: The limit is low because quantities of many bodies in series have a small independence, such as 1 / 580 for the
#: relative angles of 100 links.
LEAST = 1e-4

ENOUGH = 0.05  #: Smallest independence that the coordinates of an interval must have in all of its frames.


@dataclass(frozen=True)
class Motion:
    """States of a mechanism in T frames.

    Attributes
    ----------
    time
        (T,) [s].
    q, v, a
        (T, n) positions, velocities and accelerations that satisfy the constraints.
    coordinates
        For each interval, its first frame and the names of its independent coordinates; empty if derivatives were
        given.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    coordinates: tuple[tuple[int, tuple[str, ...]], ...] = ()


def motion_of_derivatives(manifold: Manifold, measured: Measured, q: np.ndarray) -> Motion:
    """Return the motion with given positions whose velocities and accelerations fit the measured derivatives best."""
    assert measured.derivatives is not None
    return _derived(manifold, measured.target, q, *measured.derivatives)


@dataclass(frozen=True)
class Independent:
    """The independent coordinates of a motion.

    Attributes
    ----------
    names
        Names of the U coordinates that are used in any interval.
    quantities
        The coordinates.
    intervals
        For each interval, its first frame, the frame after its last one, and the indices of its coordinates.
    """

    names: tuple[str, ...]
    quantities: Quantities
    intervals: tuple[tuple[int, int, tuple[int, ...]], ...]


def independent_coordinates(
    fitter: Fitter, measured: Measured, q: np.ndarray, candidates: Mapping[str, Quantity]
) -> Independent:
    """Choose the independent coordinates of a motion.

    Parameters
    ----------
    q
        (T, n) fitted poses.
    candidates
        Quantities that may serve as independent coordinates, by name.
    """
    observed = dict(zip(measured.names, measured.quantities.quantities, strict=True))
    exactly = len(observed) == fitter.manifold.freedoms
    preferred = [name for name, one in observed.items() if exactly or one in candidates.values()]
    named = {name: observed[name] for name in preferred} | {
        name: one for name, one in candidates.items() if one not in [observed[name] for name in preferred]
    }
    rows = _rates(fitter.manifold, measured.time, q, Quantities(list(named.values())))
    if len(preferred) >= rows.shape[2]:
        places, independence = _greedy(rows[:, : len(preferred)], len(preferred))
        if _determine(independence):
            return _independent(named, [(0, places)], len(q))
    return _independent(named, _chosen(rows, len(preferred)), len(q))


def other_coordinates(
    fitter: Fitter, measured: Measured, q: np.ndarray, candidates: Mapping[str, Quantity], chosen: Independent
) -> Independent | None:
    """Return other quantities whose smoothing also gives the motion, for a comparison with the chosen ones.

    If the observed quantities determine the motion well, all of them are returned; the motion is then the best fit to
    their smoothed values. Otherwise, independent coordinates other than the chosen ones are returned.

    Returns
    -------
    Independent or None
        None if the observed quantities were chosen, or if nothing else determines the motion well.
    """
    observed = dict(zip(measured.names, measured.quantities.quantities, strict=True))
    rows = _rates(fitter.manifold, measured.time, q, measured.quantities)
    if _determine(_greedy(rows, len(observed))[1]):
        every = [(0, range(len(observed)))]
        return None if set(observed) == set(chosen.names) else _independent(observed, every, len(q))
    others = {name: one for name, one in candidates.items() if one not in chosen.quantities.quantities}
    rows = _rates(fitter.manifold, measured.time, q, Quantities(list(others.values())))
    if len(others) < rows.shape[2] or np.min(singular_values(rows), initial=np.inf) < ENOUGH:
        return None
    return _independent(others, _chosen(rows, 0), len(q))


def _rates(manifold: Manifold, time: np.ndarray, q: np.ndarray, quantities: Quantities) -> np.ndarray:
    """Return the derivatives (T, K, f) of K quantities along the f free directions.

    They are divided by the `scale` of the quantity, and by the characteristic length (lengths) or 1 rad (angles).
    """
    rows = products(quantities.jacobian(q) * manifold.scale, manifold.directions_at(time, q).free)
    return np.asarray(rows / quantities.sizes(manifold.length)[:, None])


def _determine(independence: np.ndarray) -> bool:
    """Return whether observed quantities with this independence (T,) determine the motion in all frames."""
    return bool(np.min(independence, initial=np.inf) >= max(LEAST, FOLD * np.max(independence, initial=0.0)))


def _independent(
    named: Mapping[str, Quantity], chosen: Sequence[tuple[int, Sequence[int]]], frames: int
) -> Independent:
    """Return independent coordinates from named quantities, given the first frame and the indices for each interval."""
    names, quantities = list(named), Quantities(list(named.values()))
    used = sorted({place for _, places in chosen for place in places})
    ends = [*(begin for begin, _ in chosen[1:]), frames]
    intervals = tuple(
        (begin, end, tuple(used.index(place) for place in places))
        for (begin, places), end in zip(chosen, ends, strict=True)
    )
    return Independent(tuple(names[place] for place in used), quantities.only(used), intervals)


def motion_of_series(
    fitter: Fitter, independent: Independent, time: np.ndarray, q: np.ndarray, series: Smoothed
) -> Motion:
    """Return the motion of a mechanism for a series of its independent coordinates.

    Parameters
    ----------
    q
        (T, n) poses close to the motion.
    series
        The coordinates (T, U) and their derivatives.
    """
    parts = []
    for begin, end, places in independent.intervals:
        rows, columns = slice(begin, end), list(places)
        value, rate, acceleration = (x[rows][:, columns] for x in series)
        target = FitTarget(time[rows], independent.quantities.only(columns), value, np.ones(len(columns)))
        parts.append(_derived(fitter.manifold, target, fitter.refined(target, q[rows]), rate, acceleration))
    q, v, a = (np.concatenate([getattr(part, name) for part in parts]) for name in ("q", "v", "a"))
    told = tuple(
        (begin, tuple(independent.names[place] for place in places)) for begin, _, places in independent.intervals
    )
    return Motion(time, q, v, a, told)


def _derived(
    manifold: Manifold, target: FitTarget, q: np.ndarray, rate: np.ndarray, acceleration: np.ndarray
) -> Motion:
    """Return the motion at positions `q`, given the derivatives (T, K) of the quantities of a target."""
    at_rest = manifold.frames(target.time, q)
    directions = manifold.directions(at_rest.jacobian)
    observed = target.quantities.jacobian(q) * target.root_weight[:, None]

    def solved(rows: np.ndarray, values: np.ndarray) -> np.ndarray:
        x = directions.least_squares(rows, observed, values * target.root_weight)
        left = rows - products(at_rest.jacobian, x)  # rounding errors of the first solution
        return np.asarray(x + directions.displacement(left) * manifold.scale)

    v = solved(-at_rest.rate, rate)
    gamma = manifold.frames(target.time, q, v).gamma
    return Motion(target.time, q, v, solved(gamma, acceleration - target.quantities.curvature(q, v)))


def _chosen(rows: np.ndarray, preferred: int) -> Sequence[tuple[int, list[int]]]:
    """Return the first frame and the indices of the independent coordinates of each interval of the motion.

    Parameters
    ----------
    rows, preferred
        See `_greedy`.
    """
    places, independence = _greedy(rows, preferred)
    if np.min(independence, initial=np.inf) >= ENOUGH:
        return [(0, places)]
    found: list[tuple[int, list[int]]] = []
    begin = 0
    while begin < len(rows):
        places, _ = _greedy(rows[begin : begin + 1], 0)
        low = np.flatnonzero(_independence(rows[begin:, places]) < ENOUGH)
        found.append((begin, places))
        begin += max(1, int(low[0])) if low.size else len(rows)
    return found


def _greedy(rows: np.ndarray, preferred: int) -> tuple[list[int], np.ndarray]:
    """Return the indices of chosen quantities, one for each free direction, and their independence in each frame, (T,).

    Parameters
    ----------
    rows
        (T, K, f) rates of the quantities along the free directions, see `_rates`.
    preferred
        The first `preferred` quantities are preferred to others if they are independent enough.
    """
    left, chosen = rows.copy(), []
    independence = np.full(len(rows), np.inf)
    for _ in range(rows.shape[2]):
        worst = np.min(np.linalg.norm(left, axis=2), axis=0)
        first = int(np.argmax(worst[:preferred])) if preferred else 0
        index = first if preferred and worst[first] >= PREFERRED else int(np.argmax(worst))
        chosen.append(index)
        left, pivot = _without(left, index)
        independence = np.minimum(independence, pivot)
    return chosen, independence


def _independence(rows: np.ndarray) -> np.ndarray:
    """Return the independence (T,) of the chosen quantities, whose rows are in the order of the choice."""
    left, independence = rows.copy(), np.full(len(rows), np.inf)
    for index in range(rows.shape[1]):
        left, pivot = _without(left, index)
        independence = np.minimum(independence, pivot)
    return independence


def _without(rows: np.ndarray, place: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the components of all rows perpendicular to one row, and the norm of that row in each frame, (T,)."""
    own = rows[:, place]
    pivot = np.linalg.norm(own, axis=1)
    unit = own / np.where(pivot > 0, pivot, 1.0)[:, None]
    return rows - products(rows, unit)[..., None] * unit[:, None, :], pivot
