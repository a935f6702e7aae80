"""Matplotlib artists of a mechanism, created once and moved from pose to pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_hex
from matplotlib.lines import Line2D
from matplotlib.path import Path
from numpy.typing import NDArray

from mbdkit_report.figures.beam_curves import bezier_polylines
from mbdkit_report.figures.drawing_geometry import Drawing
from mbdkit_report.figures.mechanism_drawing import Tag
from mbdkit_report.figures.palette import FAINT, INK, MUSCLE, PALETTE, PAPER, SPRING, body_colors
from mbdkit_report.figures.plane_geometry import Array, spiral, zigzag

_BENDING = LinearSegmentedColormap.from_list("bending", [PALETTE[0], "#BDBDBD", PALETTE[1]])
#: Colours of bending moments from the smallest to the largest.
BENDING_SHADES = tuple(to_hex(_BENDING(place)) for place in np.linspace(0.0, 1.0, 49))
_GROUND_MARK = Path(
    [(0, 0), (-0.6, -1), (0.6, -1), (0, 0)]
    + [(-1, -1), (1, -1)]
    + [point for x in (-0.9, -0.45, 0.0, 0.45, 0.9) for point in ((x, -1), (x - 0.35, -1.45))],
    [Path.MOVETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY] + [Path.MOVETO, Path.LINETO] * 6,
)
#: Matplotlib styles of the points of a drawing.
_MARKS: dict[str, dict[str, object]] = {
    "ground": {"marker": _GROUND_MARK, "markersize": 14, "color": FAINT, "fillstyle": "none", "zorder": 2},
    "centre": {"marker": r"$\oplus$", "markersize": 7, "color": INK, "markeredgewidth": 0, "zorder": 6},
    "pin": {"marker": "o", "markersize": 5.5, "color": INK, "markerfacecolor": PAPER, "zorder": 7},
    "slider": {"marker": "s", "markersize": 8, "color": INK, "markerfacecolor": PAPER, "zorder": 6.5},
    "weld": {"marker": "s", "markersize": 5, "color": INK, "zorder": 7},
}


class PoseArtists:
    """Artists of a mechanism.

    Parameters
    ----------
    size
        Size of the mechanism [m], for the width of the springs.
    alpha
        Opacity; less than 1 for a mechanism in the background.
    largest_moment
        Largest bending moment of the colour scale of beams [N m]; 0 if each beam has a single colour.
    tags
        Names to write.
    """

    def __init__(
        self,
        axes: Axes,
        drawing: Drawing,
        colors: Sequence[str],
        size: float,
        alpha: float = 1.0,
        largest_moment: float = 0.0,
        tags: Sequence[Tag] = (),
    ):
        self.drawing = drawing
        self.artists: list[Artist] = []
        self._tooth = 0.018 * size
        self._fills: list[tuple[PolyCollection, tuple[int, ...]]] = []
        self._lines: list[tuple[Line2D, NDArray[np.intp]]] = []
        crowd = drawing.is_crowd
        weight = 1.2 if crowd else 3.0

        def curve(**look: Any) -> Line2D:
            (artist,) = axes.plot([], [], alpha=alpha, **look)
            self.artists.append(artist)
            return artist

        def line(points: Sequence[int], **look: Any) -> None:
            self._lines.append((curve(**look), np.asarray(points, dtype=np.intp)))

        def mark(points: Sequence[int], kind: str) -> None:
            if points:
                line(points, linestyle="", **_MARKS[kind])

        mark(drawing.grounds, "ground")
        for index, outline in enumerate(drawing.outlines):
            if len(outline) > 2:
                fill = PolyCollection([], facecolors=colors[index], alpha=0.25 * alpha, linewidths=0, zorder=3)
                axes.add_collection(fill, autolim=False)
                self.artists.append(fill)
                self._fills.append((fill, outline))
        for color in dict.fromkeys(colors):
            own = [outline for outline, mine in zip(drawing.outlines, colors, strict=True) if mine == color]
            discs = [outline[0] for outline in own if len(outline) == 1]
            line(self._strokes(own), color=color, linewidth=weight, solid_capstyle="round", zorder=4)
            if discs:
                line(discs, linestyle="", color=color, marker="o", markersize=3 if crowd else 9, zorder=4)
        self._bending = ScalarMappable(Normalize(-largest_moment, largest_moment), _BENDING) if largest_moment else None
        self._beams = LineCollection([], linewidths=weight, alpha=alpha, zorder=4.2, capstyle="butt")
        self._beams.set_color([colors[beam.nodes[0]] for beam in drawing.beams for _ in beam.nodes[1:]])
        axes.add_collection(self._beams, autolim=False)
        self.artists.append(self._beams)
        if drawing.guides:
            line(self._strokes(drawing.guides), color=FAINT, linewidth=1.2, zorder=2.2)
        if drawing.bars:
            line(self._strokes(drawing.bars), color=INK, linewidth=1.2, zorder=4)
        gap = len(drawing.owner)  # the index after the last point
        for paths, color in ((drawing.shapes, INK), (drawing.muscles, MUSCLE)):
            if paths:
                line([index for points in paths for index in (*points, gap)], color=color, linewidth=1.3, zorder=4.5)
        self._springs = curve(color=SPRING, linewidth=1.3, zorder=5, solid_joinstyle="round")
        self._coils = [(curve(color=SPRING, linewidth=1.2, zorder=7.5), index) for index in drawing.coils]
        rim = [patheffects.withStroke(linewidth=2.5, foreground=PAPER)]
        self._tags = [
            (tag, axes.annotate(tag.text, (0.0, 0.0), (0.72 * tag.beside[0], -0.72 * tag.beside[1]), size=8.0,
                                color=tag.color, textcoords="offset points", va="center", zorder=9, path_effects=rim,
                                parse_math=False, annotation_clip=False))
            for tag in tags
        ]  # fmt: skip
        self.artists += [text for _, text in self._tags]
        if crowd:
            return
        outlines = zip(drawing.centres, drawing.outlines, strict=True)
        mark([centre for centre, outline in outlines if len(outline) > 1], "centre")
        mark(drawing.pins, "pin")
        mark(drawing.sliders, "slider")
        mark(drawing.welds, "weld")

    def _strokes(self, strokes: Sequence[Sequence[int]]) -> list[int]:
        """Return the point indices of one polyline through all strokes. Strokes are separated by the index after the
        last point, which stands for a gap.
        """
        gap = len(self.drawing.owner)
        points: list[int] = []
        for stroke in strokes:
            if len(stroke) > 1:
                points += [*stroke, *([stroke[0]] if len(stroke) > 2 else []), gap]
        return points

    def show_scale(self, axes: Axes, when: str = "") -> None:
        """Show the scale of the bending moments beside the axes, if beams are coloured by bending moment."""
        if self._bending is None:
            return
        bar = axes.figure.colorbar(
            self._bending, ax=axes, location="bottom", shrink=0.4, aspect=30, pad=0.02, format="%.3g"
        )
        bar.outline.set_visible(False)
        bar.set_label(f"bending moment of beams {when} [N m]".replace("  ", " "), size=8.5, color=INK)
        bar.ax.tick_params(colors=FAINT, labelcolor=INK, labelsize=8)

    def move(self, world: Array, moments: Array | None = None) -> None:
        """Move the mechanism.

        Parameters
        ----------
        world
            Global coordinates of the points of the drawing [m], shape (P, 2).
        moments
            Bending moments of the elements of the beams [N m], shape (E,).
        """
        if self.drawing.beams:
            self._move_beams(world, moments)
        points = np.vstack([world, [[np.nan, np.nan]]])
        for artist, indices in self._lines:
            artist.set_data(points[indices].T)
        for fill, outline in self._fills:
            fill.set_verts([world[list(outline)]])
        if self.drawing.springs:
            ends = world[np.asarray(self.drawing.springs)]
            coils = zigzag(ends[:, 0], ends[:, 1], self._tooth)
            gaps = np.full((len(coils), 1, 2), np.nan)
            self._springs.set_data(np.concatenate([coils, gaps], axis=1).reshape(-1, 2).T)
        for coil, index in self._coils:
            coil.set_data(spiral(world[index], 1.1 * self._tooth).T)
        for tag, text in self._tags:
            first, second, share = tag.anchor
            text.xy = tuple(world[first] + share * (world[second] - world[first]))
            text.set_visible(bool(np.all(np.isfinite(text.xy))))

    def _move_beams(self, world: Array, moments: Array | None) -> None:
        beams = self.drawing.beams
        self._beams.set_segments([line for beam in beams for line in bezier_polylines(world[list(beam.corners)])])
        if moments is None or self._bending is None:
            return
        first, elements = 0, []
        for beam in beams:
            elements += [first + element for element in beam.elements_of_intervals]
            first += beam.elements
        self._beams.set_color([tuple(color) for color in self._bending.to_rgba(moments[elements]).tolist()])


def draw_pose(
    axes: Axes, drawing: Drawing, points: Array, size: float, *, alpha: float, is_faint: bool = False
) -> None:
    """Draw a mechanism on axes: its `points` (P, 2) and `size` in metres, in the colours of its bodies or in grey."""
    colors = [FAINT] * len(drawing.bodies) if is_faint else body_colors(drawing)
    PoseArtists(axes, drawing, colors, size, alpha=alpha).move(points)
