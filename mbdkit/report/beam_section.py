"""The section of a report on beams: their largest internal forces, and their shape at the largest bending moment."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.figures.beam_curves import bending_moments, has_beams
from mbdkit.figures.curves import take
from mbdkit.figures.mechanism_drawing import NARROW, WIDE, NamedPose, mechanism_svg
from mbdkit.figures.page_model import Cell, Column, Illustration, Section, Table
from mbdkit.plot.beams_plot import beam_peak

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit.mechanism.mechanism import Mechanism

ROWS = 50
"""Largest number of beams in the table."""


def beam_section(run: Run, mechanism: Mechanism | None) -> Section | None:
    """Return the section on the beams of a run that has rows; None if it recorded none.

    Parameters
    ----------
    mechanism
        The mechanism of its spec; None if its model is not available.
    """
    if not has_beams(run):
        return None
    peaks = {name: beam_peak(run, name, "moment") for name in run.beams}
    worst = max(peaks, key=lambda name: abs(np.nan_to_num(peaks[name].value)))
    peak = peaks[worst]
    sentence = (
        f"The largest bending moment is {abs(peak.value):.4g} N m, in {worst} at {peak.place:.2g} of its length, at "
        f"{peak.time:.4g} s. Values are those in the middle of the elements."
    )
    drawing = _drawing(run, mechanism, peak.row) if np.isfinite(peak.value) else None
    return Section("beams", "Beams", (sentence,), drawing, (_table(run),))


def _drawing(run: Run, mechanism: Mechanism | None, row: int) -> Illustration | None:
    """Return the drawing of the mechanism in a row, its beams coloured by their bending moments."""
    pose = take(run.dataset("trajectory/position"), np.array([row], dtype=np.intp))[0]
    named = NamedPose.of(mechanism, list(run.bodies), pose, np.asarray(run.time)[row : row + 1])
    moments = bending_moments(run, named.drawing.beams)
    if moments is None:
        return None
    shown = replace(named, moments=moments[row])
    caption = f"The mechanism at t = {run.time[row]:.6g} s. Beams are coloured by their bending moments."
    return Illustration(
        mechanism_svg(shown, WIDE),
        mechanism_svg(shown, NARROW),
        "Drawing of the mechanism with its bent beams",
        caption,
    )


def _table(run: Run) -> Table:
    """Return the table of the largest internal forces and strain energy of each beam."""
    columns = [Column("beam")]
    for name, unit in (("bending moment", "N m"), ("shear force", "N"), ("axial force", "N")):
        columns += [Column(f"largest {name}", unit), Column("at a share of the length"), Column("time", "s")]
    columns.append(Column("largest strain energy", "J"))
    rows: list[tuple[Cell, ...]] = []
    for name, beam in list(run.beams.items())[:ROWS]:
        cells: list[Cell] = [name]
        for component in ("moment", "shear", "axial"):
            peak = beam_peak(run, name, component)
            cells += [peak.value, round(peak.place, 4), peak.time]
        rows.append((*cells, float(np.max(beam.strain_energy))))
    note = f"The first {ROWS} of {len(run.beams)} beams." if len(run.beams) > ROWS else ""
    return Table("beams", "Internal forces of the beams", tuple(columns), tuple(rows), note)
