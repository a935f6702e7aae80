"""Remarks on stated standard deviations of noise that are much too large; error bars are then too wide."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.base.text import listed
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.errors.error_bars import LOAD_UNITS, ResultBars

TINY = np.finfo(float).tiny

#: A stated deviation is too large if it exceeds this many times the noise seen in the residuals, and if the
#: residuals that all deviations lead to expect exceed this many times the actual ones.
LARGE = 5.0

#: Columns are not examined if the correlation of consecutive residuals exceeds this number.
#:
#: Such data were smoothed before, and their residuals do not show the noise of the measurement. The correlation is
#: below 0.1 for independent noise, and 0.77 to 0.93 in the example `walking`, whose data are filtered.
CORRELATED = 0.5

NAMED = 4  #: Largest number of columns that are named.


def large_deviations(result: Inverse, bars: ResultBars | None) -> Iterator[str]:
    """Yield sentences on stated deviations that are much larger than the noise of the data, or than the data."""
    if bars is None:
        return
    told = [*_above_noise(result, bars)]
    if told:
        yield (
            f"stated deviations are more than {LARGE:g} times the noise seen in the data, so that error bars are too "
            f"wide: {listed(told, 'and', NAMED)}. Check their units."
        )
    told = [*_above_values(result, bars)]
    if told:
        yield f"stated deviations exceed the data themselves: {listed(told, 'and', NAMED)}. Check their units."


def _above_noise(result: Inverse, bars: ResultBars) -> Iterator[str]:
    measured, noise = result.fitted.measured, bars.noise
    left = measured.raw - measured.quantities.values(result.motion.q)
    correlation = np.nanmean(left[1:] * left[:-1], axis=0) / np.maximum(np.nanmean(left**2, axis=0), TINY)
    for index in np.flatnonzero((noise.excess > LARGE) & (correlation < CORRELATED)).tolist():
        stated = float(measured.deviation[index])
        if stated > LARGE * noise.seen[index]:
            unit = measured.quantities.quantities[index].unit
            yield f"{measured.names[index]} {stated:.3g} {unit} (seen {noise.seen[index]:.2g} {unit})"


def _above_values(result: Inverse, bars: ResultBars) -> Iterator[str]:
    """Yield columns whose noise cannot be seen, and loads, which are not smoothed, whose deviations exceed the values.

    Angles and coordinates are compared with their ranges, forces and torques with their root mean squares, and points
    of application with the longest link.
    """
    measured, size = result.fitted.measured, result.problem.fitter.manifold.length
    spans = np.nanmax(measured.raw, axis=0) - np.nanmin(measured.raw, axis=0)
    for index, stated in enumerate(measured.deviation.tolist()):
        if np.isnan(bars.noise.seen[index]) and stated > spans[index] > 0:
            unit = measured.quantities.quantities[index].unit
            yield f"{measured.names[index]} {stated:.3g} {unit} (range {spans[index]:.2g} {unit})"
    for name, series in result.problem.loads.items():
        for (array, axis), stated in series.deviation.items():
            label = f"{name}.{array}{'' if axis is None else '.' + 'xy'[axis]} {stated:.3g} {LOAD_UNITS[array]}"
            values = getattr(series, array)[series.acts]
            rms = float(np.sqrt(np.mean(np.sum(values.reshape(len(values), -1) ** 2, axis=1)))) if len(values) else 0.0
            if array == "point" and stated > size:
                yield f"{label} (longest link {size:.2g} m)"
            elif array != "point" and stated > rms > 0:
                yield f"{label} (root mean square {rms:.2g} {LOAD_UNITS[array]})"
