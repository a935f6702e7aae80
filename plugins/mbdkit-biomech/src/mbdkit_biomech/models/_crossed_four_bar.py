"""The crossed four-bar linkage of a knee: pose, angular velocities and range of flexion.

Points are complex numbers x + i y [m], and angles are in radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError

_SCAN = math.radians(1.0)


@dataclass(frozen=True)
class LinkagePose:
    """Positions of the joints in the tibia's frame: origin at A, x forward and y up when the leg is straight."""

    A: complex
    B: complex
    C: complex
    D: complex

    @property
    def crossed(self) -> bool:
        """Whether the rods B-C and D-A intersect between their ends."""
        a, b, c, d = self.A, self.B, self.C, self.D
        return _turn(b, c, d) * _turn(b, c, a) < 0 and _turn(d, a, b) * _turn(d, a, c) < 0

    @property
    def instant_centre(self) -> complex:
        """The instantaneous centre of the tibia relative to the femur: the intersection of the rods."""
        rod, other = self.C - self.B, self.A - self.D
        return self.B + rod * _cross(self.D - self.B, other) / _cross(rod, other)


@dataclass(frozen=True)
class CrossedFourBar:
    """Linkage of a tibial link A-B and a femoral link C-D, joined by crossed rods B-C and D-A; A and C are posterior.

    Parameters
    ----------
    tibial, femoral, acl, pcl
        Lengths of A-B, C-D, B-C and D-A [m].
    tibial_pitch, femoral_pitch
        Angles of A-B and C-D below the forward horizontal when the leg is straight [rad].

    Raises
    ------
    SpecError
        If the linkage of the straight leg cannot be assembled with crossed rods.
    """

    tibial: float
    femoral: float
    acl: float
    pcl: float
    tibial_pitch: float
    femoral_pitch: float

    def __post_init__(self) -> None:
        if self._branch == 0:
            lengths = f"tibial {self.tibial:g}, femoral {self.femoral:g}, acl {self.acl:g}, pcl {self.pcl:g}"
            raise SpecError(
                f"the linkage of the straight leg cannot be assembled with crossed rods; the lengths are {lengths} m, "
                f"the pitches {self.tibial_pitch:g} and {self.femoral_pitch:g} rad",
                key="links",
            )

    def pose(self, flexion: float) -> LinkagePose:
        """Return the pose at a `flexion` [rad] that the linkage reaches from the straight leg.

        Raises
        ------
        SpecError
            If the rods do not stay crossed between the straight leg and this flexion.
        """
        pose = self._solve(flexion, self._branch) if self._is_reached(flexion) else None
        if pose is None:
            low, high = self.range
            raise SpecError(
                f"should be between {low:.3f} and {high:.3f} rad ({math.degrees(low):.1f} and {math.degrees(high):.1f} "
                f"degrees), where the rods stay crossed, not {flexion!r}",
                key="flexion",
            )
        return pose

    def rod_rates(self, pose: LinkagePose, rate: float) -> tuple[float, float]:
        """Return the angular velocities [rad/s] of the rods B-C and D-A if the tibia has the angular velocity `rate`.

        All angular velocities are relative to the femur. The velocity of B relative to A, expressed through the rods
        and through the tibia, gives two equations for the two unknowns.
        """
        acl, pcl, link = pose.B - pose.C, pose.A - pose.D, pose.B - pose.A
        determinant = _cross(acl, pcl)
        return rate * _cross(link, pcl) / determinant, rate * _cross(link, acl) / determinant

    @cached_property
    def range(self) -> tuple[float, float]:
        """The interval of flexions [rad] around the straight leg in which the rods stay crossed."""
        return -self._limit(-1.0), self._limit(1.0)

    @cached_property
    def _branch(self) -> int:
        """Which intersection of circles (1 or -1, see `_solve`) gives crossed rods and a femoral link above the tibial
        link in the straight leg; 0 if neither does.
        """
        for branch in (1, -1):
            pose = self._solve(0.0, branch)
            if pose is not None and pose.crossed and (pose.C + pose.D - pose.A - pose.B).imag > 0:
                return branch
        return 0

    def _is_reached(self, flexion: float) -> bool:
        """Return whether the rods stay crossed up to a flexion; much faster than `range`."""
        scanned = (math.copysign(step * _SCAN, flexion) for step in range(1, 361) if step * _SCAN < abs(flexion))
        return abs(flexion) < 2.0 * math.pi and self._fits(flexion) and all(map(self._fits, scanned))

    def _limit(self, sign: float) -> float:
        """Return the largest flexion in one direction, by a scan in steps of one degree and bisection."""
        steps = next((step for step in range(1, 361) if not self._fits(sign * step * _SCAN)), 361)
        inside, outside = (steps - 1) * _SCAN, steps * _SCAN
        while inside < (middle := 0.5 * (inside + outside)) < outside:
            inside, outside = (middle, outside) if self._fits(sign * middle) else (inside, middle)
        return inside

    def _fits(self, flexion: float) -> bool:
        pose = self._solve(flexion, self._branch)
        return pose is not None and pose.crossed

    def _solve(self, flexion: float, branch: int) -> LinkagePose | None:
        """Return the pose at a flexion; None if the linkage cannot be assembled.

        Joint C is an intersection of the circles about B (radius acl) and about A - (D - C) (radius pcl); `branch`, 1
        or -1, selects one of the two intersections.
        """
        b = self.tibial * elementary.unit_vector(-self.tibial_pitch)
        femur = self.femoral * elementary.unit_vector(flexion - self.femoral_pitch)
        line = -femur - b
        distance = elementary.hypot(line.real, line.imag)
        if distance == 0:
            return None
        along = (self.acl * self.acl - self.pcl * self.pcl + distance * distance) / (2 * distance)
        across_squared = (self.acl - along) * (self.acl + along)
        if across_squared < 0:
            return None
        c = b + line / distance * complex(along, branch * math.sqrt(across_squared))
        return LinkagePose(0j, b, c, c + femur)


def _cross(u: complex, v: complex) -> float:
    return u.real * v.imag - u.imag * v.real


def _turn(p: complex, q: complex, r: complex) -> float:
    return _cross(q - p, r - p)
