"""Distances between measured markers, compared with the model, to find wrong units of tables of markers."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mbdkit.base import elementary
from mbdkit.mechanism.mechanism_quantities import Point
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured

#: The unit is doubtful if distances between markers of one body differ from the model by more than this factor.
#:
#: Wrong units cause factors of 10, 100 or 1000.
UNLIKE = 5.0

#: Markers that are closer to each other in the model than this share of the longest link are not compared.
LEAST_DISTANCE = 0.05

#: The unit is suspicious if markers are farther apart than this multiple of the sum of all links, each counted with the
#: length of the longest one.
APART = 20.0


def unlike_distances(measured: Measured, length: float) -> str | None:
    """Return a sentence if the distances between markers of the same body contradict the model by a large factor.

    The distances do not depend on the pose, so that they can be compared even if no pose fits the data.

    Parameters
    ----------
    length
        Longest link of the mechanism [m].
    """
    ratios = []
    for (one, (first, at)), (other, (second, there)) in combinations(_markers(measured).items(), 2):
        expected = float(elementary.hypot(one.x - other.x, one.y - other.y))
        if one.body == other.body and expected > LEAST_DISTANCE * length:
            apart = float(np.median(np.linalg.norm(at - there, axis=1)))
            ratios.append((apart / expected, f"{first} and {second} are {apart:.3g} m apart, but {expected:.3g} m"))
    if not ratios:
        return None
    ratio = float(np.median([one for one, _ in ratios]))
    if 1 / UNLIKE <= ratio <= UNLIKE:
        return None
    words = min(ratios, key=lambda one: abs(one[0] - ratio))[1]
    return (
        f"markers {words} in the model, and the distances between markers of one body are {ratio:.3g} times those of "
        f"the model (median; doubtful above {UNLIKE:g} or below {1 / UNLIKE:g}): check the unit of the markers."
    )


def far_apart(measured: Measured, length: float) -> str | None:
    """Return a sentence if markers are much farther apart than a connected mechanism can reach.

    Parameters
    ----------
    length
        Longest link of the mechanism [m].
    """
    markers = _markers(measured)
    if len(markers) < 2:
        return None
    spread = float(np.max(np.ptp(np.array([at for _, at in markers.values()]), axis=0)))
    reach = length * (1 + len({marker.body for marker in markers}))
    if spread <= APART * reach:
        return None
    return (
        f"the markers are up to {spread:.3g} m apart, but the longest link of the mechanism is {length:.3g} m long: "
        "check the unit of the markers."
    )


def marker_columns(measured: Measured) -> dict[Point, list[int]]:
    """Return the columns of x and y of each marker whose x and y are measured."""
    columns: dict[Point, dict[int, int]] = {}
    for index, quantity in enumerate(measured.quantities.quantities):
        if quantity.marker is not None:
            point, axis = quantity.marker
            columns.setdefault(point, {})[axis] = index
    return {point: [axes[0], axes[1]] for point, axes in columns.items() if len(axes) == 2}


def _markers(measured: Measured) -> dict[Point, tuple[str, np.ndarray]]:
    """Return the name and the measured positions (T, 2) of each marker whose x and y are measured."""
    return {
        point: (measured.names[columns[0]].removesuffix(".x"), measured.values[:, columns])
        for point, columns in marker_columns(measured).items()
    }
