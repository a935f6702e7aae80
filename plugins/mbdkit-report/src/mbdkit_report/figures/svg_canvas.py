"""Lines, circles and arrows of a drawing as SVG, with the points that they cover."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from mbdkit_report.figures.plane_geometry import Array
from mbdkit_report.figures.quantity_text import length

_ROOM = (80.0, 52.0)  # margin around the mechanism, for names and arrows [px]
_INK_STEP = 5.0  # distance of the points that represent lines [px]
_MOST_INK = 1000  # points of a line; a body of a run that diverged may be far outside


@dataclass
class Canvas:
    """The parts of a drawing, and the points on its lines."""

    width: float
    height: float
    scale: float
    origin: Array  # global point [m] in the middle of the canvas
    parts: list[Markup] = field(default_factory=list)
    drawn: list[Array] = field(default_factory=list)

    @classmethod
    def fitted(cls, points: Array, width: float) -> Canvas:
        """Return an empty canvas for global points (P, 2) [m]."""
        low, high = points.min(axis=0), points.max(axis=0)
        most = float(np.max(high - low))
        size = np.maximum(high - low, 1e-3 * most) if most else np.array([1.0, 1e-3])
        room = np.array(_ROOM) * (1.0 if width > 500 else 0.7)
        highest = 0.55 * width if width > 500 else 1.1 * width
        scale = float(np.min((np.array([width, highest]) - 2 * room) / size))
        return cls(width, float(max(160.0, size[1] * scale + 2 * room[1])), scale, (low + high) / 2)

    @property
    def ink(self) -> Array:
        """(N, 2) points on the lines, within the canvas [px]."""
        ink = np.concatenate([np.empty((0, 2)), *self.drawn])
        return ink[np.all((ink >= 0.0) & (ink <= (self.width, self.height)), axis=1)]

    def svg(self) -> Markup:
        """Return the drawing."""
        return svg_of(self.parts, self.width, self.height)

    def px(self, points: npt.ArrayLike) -> Array:
        """Return global points (..., 2) [m] in pixels."""
        away = (np.asarray(points, dtype=float) - self.origin) * self.scale
        return np.asarray(away * (1.0, -1.0) + (self.width / 2, self.height / 2))

    def line(self, points: Array, look: str, *, closed: bool = False, color: str = "") -> None:
        """Add a line through points (K, 2) [px] with the style class `look`; if `closed`, an area.

        `color` is the name of a colour of the page's style, or a mixture of such colours by `shade`.
        """
        path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + ("Z" if closed else "")
        style = Markup(' style="--own:{}"').format(color if "(" in color else f"var(--{color})") if color else ""
        self.parts.append(Markup('<path class="{}"{} d="{}"/>').format(look, style, path))
        for start, end in pairwise(np.vstack([points, points[:1]]) if closed else points):
            count = 2 + int(min(math.dist(start, end) / _INK_STEP, _MOST_INK))
            self.drawn.append(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))

    def dot(self, point: Array, look: str, radius: float, color: str = "") -> None:
        """Add a circle around a point [px]."""
        style = Markup(' style="--own:var(--{})"').format(color) if color else ""
        x, y = (f"{value:.1f}" for value in point)
        self.parts.append(Markup('<circle class="{}"{} cx="{}" cy="{}" r="{:g}"/>').format(look, style, x, y, radius))
        turn = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
        self.drawn.append(point + 0.7 * radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1))

    def box(self, point: Array, look: str, half: float) -> None:
        """Add a square around a point [px]."""
        self.line(point + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), look, closed=True)

    def arrow(self, end: Array, along: Array, size: float, look: str) -> None:
        """Add an arrow of `size` pixels that ends at a point [px]; `along` is its direction on the canvas."""
        unit = along / float(np.hypot(*along) or 1.0)
        across = np.array([-unit[1], unit[0]])
        self.line(np.array([end - size * unit, end]), look)
        self.line(np.array([end - 8 * unit + 4 * across, end, end - 8 * unit - 4 * across]), look)

    def turn(self, centre: Array, radius: float, look: str) -> None:
        """Add an arrow around a point [px], counter-clockwise."""
        angle = np.linspace(-0.3, 1.4 * np.pi, 16)
        arc = centre + radius * np.stack([np.cos(angle), -np.sin(angle)], axis=-1)
        self.line(arc, look)
        tangent = arc[-1] - arc[-3]
        self.arrow(arc[-1] + 0.01 * tangent, tangent, 1.0, look)

    def scale_bar(self) -> None:
        """Draw a bar of a round length in the lower left corner."""
        most = 0.2 * self.width / self.scale
        power = 10.0 ** math.floor(math.log10(most))
        size = next(digit * power for digit in (5.0, 2.0, 1.0) if digit * power <= most)
        y, end = self.height - 10.0, 10.0 + size * self.scale
        self.line(np.array([[10.0, y - 4], [10.0, y], [end, y], [end, y - 4]]), "faint thin")
        self.parts.append(
            Markup('<text class="faint" x="{:.1f}" y="{:.1f}">{}</text>').format(end + 6.0, y + 1.0, length(size))
        )
        self.drawn.append(np.array([[end + 6.0 + 6.0 * step, y - 4.0] for step in range(8)]))


def svg_of(parts: Iterable[Markup], width: float, height: float) -> Markup:
    """Return an SVG drawing for a page; the text beside it on the page describes it."""
    return Markup('<svg viewBox="0 0 {:.0f} {:.0f}" aria-hidden="true">{}</svg>').format(
        width, height, Markup("").join(parts)
    )


def shade(share: float) -> str:
    """Return the colour of a bending moment, given as a share of the largest one, between -1 and 1."""
    return f"color-mix(in srgb, var(--{'c0' if share < 0 else 'c1'}) {100.0 * abs(share):.0f}%, var(--edge))"
