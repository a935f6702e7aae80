"""The plot `energy`: the energies over time, and their balance in a panel of its own."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from mbdkit.archive.run_views import Names
from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed
from mbdkit.figures.curves import Array, bands
from mbdkit.figures.page_model import Axis, Figure, Line
from mbdkit.figures.palette import INK, PALETTE
from mbdkit.plot.panel import Panel, dress_over_time, panel_title, single_row_marker
from mbdkit.plot.style import legend, powers_of_ten

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
TERMS = ("total", "kinetic", "potential", "dissipated", "work")
"""Energies that a chart shows, the most important first."""

_TIME = Axis("time", "s")


def panels(run: Run) -> list[Panel]:
    """Return the panels of the energies and of their balance."""
    values = _read(run, *COLORS)
    largest_kinetic = float(np.nanmax(values["kinetic"], initial=0.0))
    return [
        Panel(partial(_draw_energies, time=np.asarray(run.time), values=values)),
        Panel(
            partial(
                _draw_balance,
                time=np.asarray(run.time),
                balance=values["balance"],
                largest_kinetic=largest_kinetic,
            )
        ),
    ]


def charts(run: Run) -> list[Figure]:
    """Return the charts of the energies and of their balance."""
    if not run.records("energy/balance"):
        return []
    values = _read(run, *COLORS)
    energies, base = _relative(values)
    lines = tuple(Line(name, *bands(run.time, curve[:, None]).curve(0)) for name, curve in energies.items())
    caption = f"Potential and total energy are relative to the potential energy at the start, {base:.4g} J."
    balance = Line("balance", *bands(run.time, values["balance"][:, None]).curve(0))
    return [
        Figure("energy", "Energy", caption, _TIME, Axis("energy", "J"), lines),
        Figure(
            "balance",
            "Energy balance",
            "Total + dissipated - work, minus its value at the start. Without numerical error it is zero.",
            _TIME,
            Axis("balance", "J"),
            (balance,),
        ),
    ]


def chart(run: Run, *, terms: Names = None, most: int = len(TERMS)) -> Figure:
    """Return the chart of some energies, as recorded except for the potential.

    Parameters
    ----------
    terms
        Some of ``kinetic``, ``potential``, ``total``, ``dissipated``, ``work`` and ``balance``; by default all but the
        balance, without those that are zero. Potential and total are relative to the potential at the start.

    Raises
    ------
    SpecError
        There is no such energy.
    """
    names = [terms] if isinstance(terms, str) else list(terms or ())
    for name in names:
        if name not in COLORS:
            raise SpecError(f"there is no energy {name!r}{did_you_mean(name, COLORS)}; there are {listed(COLORS)}")
    values = _read(run, *COLORS)
    relative, base = _relative(values)
    if terms is None:
        names = [name for name in TERMS if name in relative][:most]
    shown = {name: relative.get(name, values[name]) for name in COLORS if name in names}
    labels = {"potential": "potential (0 at the start)"} if base else {}
    lines = (
        Line(labels.get(name, name), *bands(run.time, curve[:, None]).curve(0), group=name)
        for name, curve in shown.items()
    )
    label = "energy balance" if names == ["balance"] else "energy"
    return Figure("energy", "Energy", "", _TIME, Axis(label, "J"), tuple(lines))


def _read(run: Run, *names: str) -> dict[str, Array]:
    return {name: np.asarray(run.dataset(f"energy/{name}")[:], dtype=np.float64) for name in names}


def _relative(values: dict[str, Array]) -> tuple[dict[str, Array], float]:
    """Return the energies to draw, and the potential at the start, which potential and total are relative to.

    Dissipated energy and work are left out where they are zero.
    """
    base = float(values["potential"][0]) if len(values["potential"]) else 0.0
    found = {}
    for name, curve in values.items():
        if name == "balance" or (name in ("dissipated", "work") and not np.any(np.nan_to_num(curve))):
            continue
        found[name] = curve - base if name in ("potential", "total") else curve
    return found, base


def _draw_energies(axes: Axes, time: Array, values: dict[str, Array]) -> None:
    dress_over_time(axes, "energy [J]")
    energies, base = _relative(values)
    handles = []
    for name, values_of_one in energies.items():
        curve = bands(time, values_of_one[:, None]).curve(0)
        width = 1.8 if name == "total" else 1.2
        handles += axes.plot(*curve, color=COLORS[name], linewidth=width, marker=single_row_marker(curve[0]))
    legend(axes, handles, list(energies))
    panel_title(axes, f"energy (potential and total relative to the potential at the start, {base:.4g} J)")
    powers_of_ten(axes)


def _draw_balance(axes: Axes, time: Array, balance: Array, largest_kinetic: float) -> None:
    dress_over_time(axes, "balance [J]")
    curve = bands(time, balance[:, None]).curve(0)
    axes.plot(*curve, color=COLORS["balance"], linewidth=1.1, marker=single_row_marker(curve[0]))
    largest = float(np.nanmax(np.abs(balance), initial=0.0))
    share = f", {largest / largest_kinetic:.2g} of the largest kinetic energy" if largest_kinetic > 0 else ""
    panel_title(axes, f"balance (total + dissipated - work - start): largest {largest:.3g} J{share}")
    powers_of_ten(axes)
