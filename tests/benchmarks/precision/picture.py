"""The race as a picture: time against error, the best of every code in bold, its methods behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mbdkit_report import Caption, dress, new_figure, save
from mbdkit_report.figures.palette import INK, PALETTE
from mbdkit_report.plot.style import legend
from tests.benchmarks.timing import duration

from .contender import OURS
from .measure import TARGETS, Curve
from .motions import Motion


def draw(found: Mapping[Motion, Sequence[Curve]], output: Path) -> None:
    """Write one panel for each motion, side by side."""
    figure = new_figure(
        Caption(
            "Time against error",
            "bold: the fastest method of each code; thin: all its methods; error: the largest of any rod's centre",
        ),
        11.0,
        4.6,
    )
    panels = figure.subplots(1, len(found))
    codes = list(dict.fromkeys(curve.contender.code for curves in found.values() for curve in curves))
    looks = dict(zip(codes, (*PALETTE, INK), strict=False))
    handles = {}
    for axes, (motion, curves) in zip(np.atleast_1d(panels), found.items(), strict=True):
        dress(axes, "error [m]", "time of the steps")
        axes.set(xscale="log", yscale="log")
        axes.set_title(motion.title, size=9, loc="left")
        axes.set_xlim(3e-3, TARGETS[-1] / 3)
        for curve in curves:
            if points := [point for point in curve.front if point[0] <= 3e-3]:
                axes.plot(*zip(*points, strict=True), color=looks[curve.contender.code], linewidth=0.6, alpha=0.45)
        fine = np.geomspace(TARGETS[0], TARGETS[-1], 91)
        for code in codes:
            own = [curve for curve in curves if curve.contender.code == code]
            times = [min((s for curve in own if (s := curve.time_at(x)) is not None), default=np.nan) for x in fine]
            width = 3.0 if code == OURS else 1.8
            (handles[code],) = axes.plot(fine, times, color=looks[code], linewidth=width)
        low, high = axes.get_ylim()
        ticks = [10.0**k for k in range(-6, 3) if low <= 10.0**k <= high]
        axes.set_yticks(ticks, [duration(tick) for tick in ticks])
        axes.minorticks_off()
    legend(axes, [handles[code] for code in codes], codes)
    save(figure, output)
