"""Figures over time: drift of the joints, energy, and reactions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mbdkit.plot.caption import caption
from mbdkit.plot.series import Array, Bands, bands, evenly
from mbdkit.plot.style import FAINT, INK, PALETTE, PAPER, dress, legend, new_figure, powers_of_ten

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

TIME = "time [s]"
SMALLEST = 1e-18
"""Smallest value that a logarithmic axis shows; round-off of a length of 1 m is a hundred times larger."""

ENERGIES = {
    "kinetic": PALETTE[1],
    "potential": PALETTE[0],
    "dissipated": PALETTE[3],
    "work": PALETTE[2],
    "total": INK,
    "balance": PALETTE[0],
}


@dataclass(frozen=True)
class Quantity:
    """A quantity of each joint: what it is called, its unit, and its curves."""

    name: str
    unit: str
    joints: Sequence[str]
    data: Bands

    @property
    def zero(self) -> bool:
        """Nothing of it differs from zero."""
        return not np.any(np.nan_to_num(self.data.peaks) > 0)

    @property
    def largest(self) -> tuple[int, float]:
        """The joint with the largest value, and that value."""
        column = int(np.argmax(np.nan_to_num(self.data.peaks, nan=-1.0)))
        return column, float(self.data.peaks[column])


def joint_quantity(
    run: Run, name: str, path: str, unit: str, values: Callable[[Array], Array] = np.asarray
) -> Quantity:
    """Read one array of the group /joints as curves."""
    return Quantity(name, unit, tuple(run.joint_names), bands(np.asarray(run.time), run.dataset(path), values))


def drift_figure(run: Run) -> Figure:
    """Return the figure of misalignments over time, positions above, velocities (and driven angles) below."""
    found = [
        joint_quantity(run, "misalignment", "joints/misalignment", "m"),
        joint_quantity(run, "velocity misalignment", "joints/velocity_misalignment", "m/s"),
    ]
    angle = joint_quantity(run, "angle misalignment", "joints/angle_misalignment", "rad")
    if not angle.zero:
        found.append(angle)
    figure, panels = _panels(run, len(found))
    for axes, quantity in zip(panels, found, strict=True):
        moved = np.flatnonzero(np.nan_to_num(quantity.data.peaks, nan=1.0)).tolist()  # elsewhere it does not apply
        _joint_panel(axes, _only(quantity, moved) if moved else quantity, log=True)
    if run.joint_names:
        largest = {name: joint.misalignment_max for name, joint in run.joints.items()}
        worst = max(largest, key=lambda name: np.nan_to_num(largest[name], nan=np.inf))
        _heading(panels[0], f"misalignment: largest over every step {_number(largest[worst], 'm')} ({worst})")
    return figure


def reactions_figure(run: Run) -> Figure:
    """Return the figure of the joints' reaction forces, and of their torques where there are any."""
    force = joint_quantity(
        run, "reaction force", "joints/reaction_force", "N", lambda f: np.hypot(f[..., 0], f[..., 1])
    )
    torque = joint_quantity(run, "reaction torque", "joints/reaction_torque", "N m")
    largest = np.nan_to_num(torque.data.peaks)
    size = float(np.max(largest, initial=0.0))
    turning = size > 1e-10 * np.nanmax(force.data.peaks, initial=0.0)  # not mere round-off
    figure, panels = _panels(run, 2 if turning else 1)
    _joint_panel(panels[0], force, log=False)
    if turning:
        _joint_panel(panels[1], _only(torque, np.flatnonzero(largest > 1e-10 * size).tolist()), log=False)
    return figure


def energy_figure(run: Run) -> Figure:
    """Return the figure of the energies, with their balance on a scale of its own."""
    time = np.asarray(run.time)
    values = {name: np.asarray(run.dataset(f"energy/{name}")[:], dtype=np.float64) for name in ENERGIES}
    base = float(values["potential"][0]) if len(time) else 0.0
    for name in ("potential", "total"):
        values[name] = values[name] - base
    figure, panels = _panels(run, 2)
    handles, labels = [], []
    for name, color in ENERGIES.items():
        if name == "balance" or (name in ("dissipated", "work") and not np.any(np.nan_to_num(values[name]))):
            continue
        curve = bands(time, values[name][:, None]).curve(0)
        (line,) = panels[0].plot(*curve, color=color, linewidth=1.8 if name == "total" else 1.2, marker=_mark(curve[0]))
        handles.append(line)
        labels.append(name)
    legend(panels[0], handles, labels)
    _heading(panels[0], f"energy (potential and total counted from the potential at the start, {base:.4g} J)")
    curve = bands(time, values["balance"][:, None]).curve(0)
    panels[1].plot(*curve, color=ENERGIES["balance"], linewidth=1.1, marker=_mark(curve[0]))
    off = float(np.nanmax(np.abs(values["balance"]), initial=0.0))
    most = float(np.nanmax(values["kinetic"], initial=0.0))
    share = f", {off / most:.2g} of the largest kinetic energy" if most > 0 else ""
    _heading(panels[1], f"balance (total + dissipated - work - start): largest {off:.3g} J{share}")
    for axes, name in zip(panels, ("energy", "balance"), strict=True):
        axes.set_ylabel(f"{name} [J]")
        powers_of_ten(axes)
    return figure


def _panels(run: Run, count: int) -> tuple[Figure, list[Axes]]:
    figure = new_figure(caption(run), 7.2, 2.1 + 1.85 * count)
    first = figure.add_subplot(count, 1, 1)
    panels = [first] + [figure.add_subplot(count, 1, row, sharex=first) for row in range(2, count + 1)]
    for row, axes in enumerate(panels):
        dress(axes, TIME if row == count - 1 else "")
        axes.tick_params(labelbottom=row == count - 1)
        axes.margins(x=0.01)
    return figure, panels


def _heading(axes: Axes, text: str) -> None:
    axes.set_title(text, size=8.5, color=INK, loc="left", parse_math=False)


def _mark(time: Array) -> str:
    """Marker of a curve: a line through a single row would not be seen."""
    return "o" if len(time) == 1 else ""


def _number(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if np.isfinite(value) else "not finite"


def _only(quantity: Quantity, columns: list[int]) -> Quantity:
    data = quantity.data
    part = Bands(data.time, data.low[:, columns], data.high[:, columns], data.peaks[columns], data.exact)
    return Quantity(quantity.name, quantity.unit, [quantity.joints[column] for column in columns], part)


def _joint_panel(axes: Axes, quantity: Quantity, *, log: bool) -> None:
    """Draw a quantity of all joints, or of many joints their largest and a handful of them."""
    joints, data = quantity.joints, quantity.data
    axes.set_ylabel(f"{quantity.name}\n[{quantity.unit}]")
    if not joints:
        _heading(axes, f"{quantity.name}: there are no joints")
        return
    column, most = quantity.largest
    _heading(axes, f"{quantity.name}: largest {_number(most, quantity.unit)} ({joints[column]})")
    columns = list(range(len(joints)))
    handles, labels = [], []
    floor = _floor(data.high) if log else -np.inf
    if len(joints) > len(PALETTE):
        columns = sorted({column, *evenly(len(joints), 4).tolist()})
        top = np.max(np.nan_to_num(np.maximum(np.abs(data.low), np.abs(data.high))), axis=1)
        (line,) = axes.plot(data.time, np.maximum(top, floor), color=INK, linewidth=2.2, alpha=0.45)
        handles.append(line)
        labels.append(f"largest of {len(joints)}")
    for color, chosen in zip(PALETTE, columns, strict=False):
        time, values = (data.time, np.maximum(data.high[:, chosen], floor)) if log else data.curve(chosen)
        (line,) = axes.plot(time, values, color=color, linewidth=1.1, marker=_mark(time))
        handles.append(line)
        labels.append(joints[chosen])
    legend(axes, handles, labels)
    if log:
        axes.set_yscale("log")
        _show_floor(axes, floor, data.high, quantity.unit)
    else:
        powers_of_ten(axes)
        if np.nanmin(data.low, initial=0.0) >= 0.0:
            axes.set_ylim(bottom=0.0)


def _floor(values: Array) -> float:
    """Return the power of ten below almost all values that are not zero."""
    positive = values[values > 0]
    if not positive.size:
        return SMALLEST
    return float(max(SMALLEST, 10.0 ** np.floor(np.log10(np.quantile(positive, 0.005)))))


def _show_floor(axes: Axes, floor: float, values: Array, unit: str) -> None:
    """Set the lower limit of a logarithmic axis and say what was lifted to it."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set_ylim(floor * 0.8, max(top * 2.0, floor * 10.0))
    if np.any(values < floor):
        axes.text(
            0.995, 0.02, f"values below {floor:.0e} {unit} are drawn there", transform=axes.transAxes,
            size=7.5, color=FAINT, ha="right", va="bottom",
            bbox={"facecolor": PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )  # fmt: skip
