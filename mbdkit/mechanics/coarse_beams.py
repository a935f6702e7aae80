"""Warnings about beams at rest whose elements are too coarse for the curvature of the beam."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mbdkit.mechanism.beams import Beam

TURN = 0.75
"""Largest angle [rad] by which bending may turn a node relative to its neighbour without a warning.

Measured at clamped cantilevers with a force across their tip: the moment at the clamp has errors of 1 % (elements of
two nodes) and 1.5 % (three nodes) at this angle, and of 2 % and 4 % at 1 rad.
"""

SPACING = 0.7
"""Recommended distance between nodes, relative to ``sqrt(EI / F)`` for a bending stiffness EI and a force F.

A force F bends a beam within about this length. At this distance, a clamped cantilever turns by `TURN` between two
nodes.
"""


def coarse_beams(beams: dict[str, Beam], angles: dict[str, np.ndarray], forces: dict[str, np.ndarray]) -> Iterator[str]:
    """Yield a warning for each beam whose elements are too coarse.

    Parameters
    ----------
    beams
        The beams by name.
    angles
        Angles of the nodes of each beam (K,) [rad].
    forces
        Internal forces of each beam; see `mbdkit.mechanics.equilibrium.Equilibrium.beams`.
    """
    for name, beam in beams.items():
        turns = np.abs(np.diff(angles[name]) - np.diff([place.angle for place in beam.places]))
        most = float(np.max(turns))
        if most <= TURN:
            continue
        node = int(np.argmax(turns))
        largest = float(np.max(np.hypot(forces[name][:, 1], forces[name][:, 2])))
        nodes = beam.length * math.sqrt(largest / beam.section_stiffness.bending) / SPACING
        count = math.ceil(max(nodes / (beam.nodes - 1), beam.elements * most / TURN))
        yield (
            f"the elements of beam '{name}' are too coarse: bending turns '{name}.{node + 1}' by {most:.2g} rad "
            f"against '{name}.{node}', so that its forces and moments may be wrong by more than 1 %; use about "
            f"{_rounded(count)} elements"
        )


def _rounded(count: int) -> int:
    """Return a number rounded up to two digits."""
    unit: int = 10 ** max(0, len(str(count)) - 2)
    return -(-count // unit) * unit
