"""The plot `energy`: the energies over time, and their balance in a separate panel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.run_views import Names
from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed
from mbdkit_report.figures.curves import Array, bands
from mbdkit_report.figures.page_model import TIME, Axis, Figure, Line
from mbdkit_report.figures.palette import INK, PALETTE
from mbdkit_report.plot.charts import HeadedChart

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

COLORS = {
    "kinetic": PALETTE[1],
    "potential": PALETTE[0],
    "dissipated": PALETTE[3],
    "work": PALETTE[2],
    "total": INK,
    "balance": PALETTE[4],
}
#: Energies that a chart shows, the most important first.
TERMS = ("total", "kinetic", "potential", "dissipated", "work")


def charts(run: Run) -> list[Figure]:
    """Return the charts of the energies and of their balance."""
    if not run.records("energy/balance"):
        return []
    values = _read(run)
    energies, base = _relative(values)
    about = f"Potential and total energy are relative to the potential energy at the start, {base:.4g} J."
    of_balance = "Total + dissipated - work, minus its value at the start. Without numerical error it is zero."
    lines = tuple(_line(run, name, curve, name) for name, curve in energies.items())
    balance = (_line(run, "balance", values["balance"], "balance"),)
    largest, kinetic = (float(np.nanmax(np.abs(values[name]), initial=0.0)) for name in ("balance", "kinetic"))
    share = f", {largest / kinetic:.2g} of the largest kinetic energy" if kinetic > 0 else ""
    heads = (
        (f"energy (potential and total relative to the potential at the start, {base:.4g} J)", ""),
        (f"balance (total + dissipated - work - start): largest {largest:.3g} J{share}", ""),
    )
    return [
        HeadedChart("energy", "Energy", about, TIME, Axis("energy", "J"), lines, headline=heads[0]),
        HeadedChart("balance", "Energy balance", of_balance, TIME, Axis("balance", "J"), balance, headline=heads[1]),
    ]


def _line(run: Run, name: str, values: Array, label: str) -> Line:
    return Line(label, *bands(run.time, values[:, None]).curve(0), group=name, color=COLORS[name])


def chart(run: Run, *, terms: Names = None, most: int = len(TERMS)) -> Figure:
    """Return the chart of some energies; the options are those of `RunPlots.energy`. Raises SpecError if there is no
    such energy.
    """
    names = [terms] if isinstance(terms, str) else list(terms or ())
    for name in names:
        if name not in COLORS:
            hint = did_you_mean(name, COLORS)
            raise SpecError(f"terms of the energy are {listed(COLORS, 'and')}, not {name!r}{hint}")
    values = _read(run)
    relative, base = _relative(values)
    if terms is None:
        names = [name for name in TERMS if name in relative][:most]
    shown = {name: relative.get(name, values[name]) for name in COLORS if name in names}
    labels = {"potential": "potential, 0 at the start", "total": "total, minus potential at the start"} if base else {}
    lines = (_line(run, name, curve, labels.get(name, name)) for name, curve in shown.items())
    label = "energy balance" if names == ["balance"] else "energy"
    return Figure("energy", "Energy", "", TIME, Axis(label, "J"), tuple(lines))


def _read(run: Run) -> dict[str, Array]:
    return {name: np.asarray(run.dataset(f"energy/{name}")[:], dtype=np.float64) for name in COLORS}


def _relative(values: dict[str, Array]) -> tuple[dict[str, Array], float]:
    """Return the energies to draw, and the potential energy at the start, which is subtracted from the potential and
    the total energy.

    The balance is left out, as are dissipated energy and work if they are zero.
    """
    base = float(values["potential"][0]) if len(values["potential"]) else 0.0
    results = {}
    for name, curve in values.items():
        if name == "balance" or (name in ("dissipated", "work") and not np.any(np.nan_to_num(curve))):
            continue
        results[name] = curve - base if name in ("potential", "total") else curve
    return results, base
