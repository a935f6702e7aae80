"""Cams and slots: points, rollers and flat faces of one body on a curve of another.

The constraint is the signed distance of the follower from the curve, up to higher powers of this distance: for points,
the function of the curve divided by the norm of its gradient; for rollers and flat faces, the distance along the normal
at a point of the curve, the root of an equation. For flat faces, this is where the tangent is parallel. For rollers, it
is where the centre of a roller that touches has the polar angle of the actual one. Where followers fit into all
hollows, both angles increase along the curve, so that there is one such point wherever the follower is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from mbdkit.plugin import FunctionJoint, Point, Pose, PoseFunction, Positive, SpecError, StrictModel, Table
from mbdkit.plugin.mechanisms import Profile
from mbdkit_transmissions.gears import Direction, Lines, circle

if TYPE_CHECKING:
    OfAngle = float | str | Table
    OfX = float | str | Table
else:
    OfAngle = Profile.key("angle")
    OfX = Profile.key("x")

CLOSED = 1e-9  #: Largest jump of a closed curve, relative to its size, where its angle passes 180 degrees.


def check_closed(radius: Profile, key: str) -> np.ndarray:
    """Raise SpecError unless a polar curve is closed and its radius is positive; return points (721,) of the radius."""
    angles = np.linspace(-np.pi, np.pi, 721)
    values = np.asarray(radius.value(angles), dtype=float)
    if not np.all(np.isfinite(values)) or np.min(values) <= 0.0:
        worst = float(angles[np.argmin(np.where(np.isfinite(values), values, -np.inf))])
        raise SpecError(f"the radius is not positive everywhere, for example at the angle {worst:.4g} rad", key=key)
    step = 1e-4
    begin, end = np.array([-np.pi, step - np.pi]), np.array([np.pi, np.pi + step])
    jump = float(np.max(np.abs(np.asarray(radius.value(begin)) - np.asarray(radius.value(end)))))
    if jump > CLOSED * float(np.max(values)):
        raise SpecError(
            f"the curve is not closed: its radius or slope differs by {jump:.3g} m between the angles -pi and pi; "
            "a table needs `ends: periodic` and covers 2*pi",
            key=key,
        )
    return values


#: Bisections of half a turn that lead to the point of contact, and iterations of Newton's method after them.
#:
#: For 100 drawn profiles with up to nine lobes, they find it at all of 2,000 poses if the radius of the roller is 99 %
#: of the least radius of curvature of a hollow, and at 99.98 % of them if it is 99.9 %.
BISECTIONS, ITERATIONS = 12, 4


@dataclass(frozen=True)
class OnClosedCurve:
    """The distance of a point from a polar curve."""

    radius: Profile

    def __call__(self, pose: Pose, p: Mapping[str, Any]) -> Any:
        """Return the distance [m], positive outside."""
        radius, slope = self.radius.with_slope(np.arctan2(pose.y, pose.x))
        ratio = slope / radius
        return (np.sqrt(pose.x * pose.x + pose.y * pose.y) - radius) / np.sqrt(1.0 + ratio * ratio)


@dataclass(frozen=True)
class OnGraph:
    """The distance of a point from the graph of a function y(x)."""

    height: Profile

    def __call__(self, pose: Pose, p: Mapping[str, Any]) -> Any:
        """Return the distance [m], positive above."""
        height, slope = self.height.with_slope(pose.x)
        return (pose.y - height) / np.sqrt(1.0 + slope * slope)


@dataclass(frozen=True)
class RollerOnCurve:
    """The distance of a roller from a polar curve."""

    radius: Profile

    def __call__(self, pose: Pose, p: Mapping[str, Any]) -> Any:
        """Return the distance [m], positive outside."""

        def ahead(s: Any) -> Any:
            x, y, dx, dy = _point_and_tangent(self.radius, s)
            share = p["roller"] / np.sqrt(dx * dx + dy * dy)
            return ((x + share * dy) * pose.y - (y - share * dx) * pose.x) / p["size"] ** 2

        x, y, dx, dy = _point_and_tangent(self.radius, _point_of_contact(ahead, np.arctan2(pose.y, pose.x)))
        return ((pose.x - x) * dy - (pose.y - y) * dx) / np.sqrt(dx * dx + dy * dy) - p["roller"]


@dataclass(frozen=True)
class FaceOnCurve:
    """The distance of a flat face from a polar curve."""

    radius: Profile

    def __call__(self, pose: Pose, p: Mapping[str, Any]) -> Any:
        """Return the distance [m], positive outside."""
        direction = pose.angle + p["normal"]
        nx, ny = np.cos(direction), np.sin(direction)

        def touching(s: Any) -> Any:
            _, _, dx, dy = _point_and_tangent(self.radius, s)
            return (dx * nx + dy * ny) / p["size"]

        x, y, _, _ = _point_and_tangent(self.radius, _point_of_contact(touching, direction))
        return (pose.x - x) * nx + (pose.y - y) * ny


def _point_of_contact(condition: Callable[[Any], Any], near: Any) -> Any:
    """Return the angle on a profile within a quarter turn of `near`, below which a condition is positive.

    The profile turns about its centre in one sense, so that neither the normal at a point nor the centre of a roller
    there is farther than this from the point. Newton's method alone may miss the point in a hollow into which a roller
    hardly fits, or where a profile is almost flat below a face: it moves a hundred times more than the follower.
    """
    half = math.pi / 4
    for _ in range(BISECTIONS):
        near, half = near + np.where(condition(near) > 0.0, half, -half), half / 2
    return Profile.of(condition).root(near, ITERATIONS)


def _point_and_tangent(radius: Profile, s: Any) -> tuple[Any, Any, Any, Any]:
    """Return the point of a polar curve at an angle, and its derivative by the angle."""
    r, slope = radius.with_slope(s)
    c, sine = np.cos(s), np.sin(s)
    return r * c, r * sine, slope * c - r * sine, slope * sine + r * c


class Follower(StrictModel):
    """A follower with an extent: exactly one of `roller` and `flat`."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("roller", "flat")

    roller: Positive | None = None
    """Radius of a roller around the second body's point [m]."""
    flat: Direction | None = None
    """Direction, in b's frame, of the normal of a flat face through the second body's point; it points away from the
    cam."""

    @model_validator(mode="after")
    def _is_one(self) -> Follower:
        if (self.roller is None) == (self.flat is None):
            raise SpecError("give either `roller`, a radius, or `flat`, the normal of a face")
        return self


class Cam(FunctionJoint):
    """A cam of a and a follower of b, which other joints guide. The follower does not lift off.

    A force that pulls the follower to the cam is a doubt about the run: a real follower would lift off.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("points", "follower")

    type: Literal["cam"] = "cam"
    profile: OfAngle
    """Radius of the cam [m] from its centre, a's point, as a function of the `angle` from a's x axis [rad]: a number,
    an expression, or a table with `ends: periodic`."""
    follower: Literal["point"] | Follower = "point"
    """What touches the cam at b's point: the `point` itself, `{roller: radius}`, or `{flat: [x, y]}`, a face with this
    normal in b's frame."""
    rows: ClassVar[tuple[str, ...]] = ("normal",)
    units: ClassVar[tuple[str, ...]] = ("m",)

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        is_flat = self.follower != "point" and self.follower.flat is not None
        return self.places() if is_flat else self.places()[:1]

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row; see `FunctionJoint.functions`."""
        radius, follower = Profile.of(self.profile, "angle"), self.follower
        size = float(np.max(check_closed(radius, "profile")))
        if follower == "point":
            return [PoseFunction(OnClosedCurve(radius))]
        self._check_curvature(radius, follower)
        if follower.flat is not None:
            normal = math.atan2(follower.flat[1], follower.flat[0])
            return [PoseFunction(FaceOnCurve(radius), (("normal", normal), ("size", size)))]
        assert follower.roller is not None
        return [PoseFunction(RollerOnCurve(radius), (("roller", follower.roller), ("size", size)))]

    @staticmethod
    def _check_curvature(radius: Profile, follower: Follower) -> None:
        """Raise SpecError if the follower cannot touch the profile everywhere."""
        step = 2 * np.pi / 7200
        angles = np.arange(-np.pi, np.pi, step)
        before, r, after = (np.asarray(radius.value(angles + shift)) for shift in (-step, 0.0, step))
        slope, bend = (after - before) / (2 * step), (after - 2 * r + before) / step**2
        curvature = (r * r + 2 * slope * slope - r * bend) / (r * r + slope * slope) ** 1.5
        worst = int(np.argmin(curvature))
        if follower.flat is not None and curvature[worst] <= 0.0:
            raise SpecError(
                f"the profile is hollow at the angle {angles[worst]:.4g} rad, where a flat face cannot follow it",
                key="profile",
            )
        if follower.roller is not None and -curvature[worst] * follower.roller >= 1.0:
            raise SpecError(
                f"the profile is hollow at the angle {angles[worst]:.4g} rad with a radius of curvature of "
                f"{-1.0 / curvature[worst]:.4g} m, less than that of the roller, {follower.roller:.4g} m",
                key="follower",
            )

    def lines(self, start: Pose) -> Lines:
        """Return the profile and the follower."""
        profile = _closed_line(Profile.of(self.profile, "angle"), self.points[0])
        (x, y), follower = self.points[1], self.follower
        if follower == "point":
            return [profile]
        if follower.roller is not None:
            return [profile, circle(1, (x, y), follower.roller)]
        assert follower.flat is not None
        length = math.hypot(*follower.flat)
        dx, dy = -follower.flat[1] / length, follower.flat[0] / length
        half = float(np.max(np.asarray(Profile.of(self.profile, "angle").value(np.linspace(-np.pi, np.pi, 181)))))
        return [profile, [(1, (x - half * dx, y - half * dy)), (1, (x + half * dx, y + half * dy))]]


class SlotCurve(StrictModel):
    """A curve in the frame of the first body, with its point as origin: a graph ``y(x)``, or a closed polar curve."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("y", "radius")

    y: OfX | None = None
    """y [m] as a function of `x` [m]: a number, an expression, or a table."""
    radius: OfAngle | None = None
    """Distance from a's point [m] as a function of the `angle` from a's x axis [rad]: a number, an expression, or a
    table with `ends: periodic`; an alternative to `y`."""

    @model_validator(mode="after")
    def _is_one(self) -> SlotCurve:
        if (self.y is None) == (self.radius is None):
            raise SpecError("give either `y`, a function of x, or `radius`, a function of angle, for a closed curve")
        return self


class Slot(FunctionJoint):
    """A point of b that slides along a curve of a, in both directions of the normal; b may turn."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("points", "point")

    type: Literal["slot"] = "slot"
    curve: SlotCurve
    """The curve, with a's point as its origin: ``{y: EXPRESSION of x}``, or ``{radius: EXPRESSION of angle}`` for a
    closed one. Each may also be a table."""
    point: Point | None = None
    """The point in b's frame [m], in place of the second of `points`."""
    rows: ClassVar[tuple[str, ...]] = ("normal",)
    units: ClassVar[tuple[str, ...]] = ("m",)

    @model_validator(mode="after")
    def _point_once(self) -> Slot:
        if self.point is not None and self.points[1] != (0.0, 0.0):
            raise SpecError("give b's point either as `point`, or as the second of `points`", key="point")
        return self

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The points (x_a, y_a, x_b, y_b) [m], each in the frame of its body, to which a `Pose` refers."""
        return (*self.points[0], *(self.points[1] if self.point is None else self.point))

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()[:1]

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row; see `FunctionJoint.functions`."""
        if self.curve.radius is not None:
            radius = Profile.of(self.curve.radius, "angle")
            check_closed(radius, "curve.radius")
            return [PoseFunction(OnClosedCurve(radius))]
        assert self.curve.y is not None
        return [PoseFunction(OnGraph(Profile.of(self.curve.y, "x")))]

    def lines(self, start: Pose) -> Lines:
        """Return the curve, or the part of it near the start."""
        if self.curve.radius is not None:
            return [_closed_line(Profile.of(self.curve.radius, "angle"), self.points[0])]
        assert self.curve.y is not None
        height, (x0, y0) = Profile.of(self.curve.y, "x"), self.points[0]
        half = max(abs(float(start.x)), abs(float(start.y)), 0.1)
        first, last = getattr(self.curve.y, "span", (start.x - half, start.x + half))
        x = np.linspace(first, last, 61)
        return [[(0, (x0 + float(a), y0 + float(b))) for a, b in zip(x, np.asarray(height.value(x)), strict=True)]]


def _closed_line(radius: Profile, center: tuple[float, float]) -> list[tuple[int, tuple[float, float]]]:
    angles = np.linspace(-np.pi, np.pi, 145)
    values = np.asarray(radius.value(angles))
    return [
        (0, (center[0] + float(r) * math.cos(s), center[1] + float(r) * math.sin(s)))
        for r, s in zip(values, angles, strict=True)
    ]
