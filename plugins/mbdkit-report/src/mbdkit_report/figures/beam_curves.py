"""Beams as smooth curves: cubic Bezier curves between nodes. The tangent at a node has the angle of the node.

The control points are fixed to the nodes, so that they move like all other points of a drawing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit_report.figures.plane_geometry import Array

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_STEPS = 6  # number of straight pieces between two nodes in a picture


@dataclass(frozen=True)
class BeamCurve:
    """A beam in a drawing, with K intervals between its nodes.

    Parameters
    ----------
    nodes
        Indices of the beam's nodes among the bodies of the drawing, shape (K + 1,).
    corners
        Control points, by their indices among the points of the drawing, shape (3 K + 1,): every third one is a node.
    elements
        Number of elements; an element has one or two intervals.
    """

    name: str
    nodes: tuple[int, ...]
    corners: tuple[int, ...]
    elements: int

    @property
    def points(self) -> tuple[int, ...]:
        """Indices of the points at the nodes."""
        return self.corners[::3]

    @property
    def elements_of_intervals(self) -> list[int]:
        """Index of the element to which each interval belongs."""
        count = len(self.nodes) - 1
        return [interval * self.elements // count for interval in range(count)]


def bezier_polylines(corners: Array) -> Array:
    """Return a polyline of seven points for each of K consecutive Bezier curves, shape (K, 7, 2), from their control
    points (3 K + 1, 2).
    """
    t = np.linspace(0.0, 1.0, _STEPS + 1)[:, None]
    weights = ((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3)
    ends = (corners[:-1:3], corners[1::3], corners[2::3], corners[3::3])
    return np.asarray(sum(weight * end[:, None] for weight, end in zip(weights, ends, strict=True)))


def bending_moments(run: Run, beams: tuple[BeamCurve, ...]) -> Array | None:
    """Return the bending moments of all elements of the beams of a drawing, (T, E) [N m]; None if not recorded."""
    if not beams or not has_beams(run):
        return None
    known = run.beams
    if any(beam.name not in known for beam in beams):
        return None
    return np.concatenate([known[beam.name].moment for beam in beams], axis=1)


def largest_moment(moments: Array | None) -> float:
    """Return the largest finite magnitude of bending moments, which limits the colour scale; 0 if there is none."""
    if moments is None:
        return 0.0
    size = np.abs(moments)
    return float(np.max(size[np.isfinite(size)], initial=0.0))


def distributed_loads(run: Run) -> frozenset[str]:
    """Return the names of the force elements that represent the distributed loads of the beams of a run."""
    if not has_beams(run):
        return frozenset()
    return frozenset(f"{node}.load" for beam in run.beams.values() for node in beam.nodes)


def has_beams(run: Run) -> bool:
    """Return whether a run has beams, and recorded their internal forces."""
    return run.records("beams/moment") and bool(run.beams)
