"""A quantity of every joint over time, drawn in a panel or returned as lines of a chart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from mbdkit.analysis.verdict import Line
from mbdkit.plot.downsampling import Array, Bands, bands, evenly
from mbdkit.plot.error_bands import UNKNOWN, band_over_time, errors_at
from mbdkit.plot.panel import dress_over_time, panel_title, single_row_marker
from mbdkit.plot.style import FAINT, INK, PALETTE, PAPER, legend, powers_of_ten

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

SMALLEST = 1e-18
"""Lowest floor of a logarithmic axis; the round-off of a length of 1 m is a hundred times larger."""


@dataclass(frozen=True)
class JointQuantity:
    """A quantity of every joint over time.

    Parameters
    ----------
    name, unit
        Name and unit for labels.
    joints
        Names of the J joints.
    data
        One curve for each joint.
    errors
        (K, J) estimated errors at the times of `data`, nan where unknown; None if they were not estimated.
    known_until
        Time until which the errors are known [s]; nan if they are known to the end, or were not estimated.
    """

    name: str
    unit: str
    joints: Sequence[str]
    data: Bands
    errors: Array | None = None
    known_until: float = math.nan

    @property
    def zero(self) -> bool:
        """Whether every value is zero."""
        return not np.any(np.nan_to_num(self.data.peaks) > 0)

    @property
    def largest(self) -> tuple[int, float]:
        """Column of the joint with the largest magnitude, and that magnitude."""
        column = int(np.argmax(np.nan_to_num(self.data.peaks, nan=-1.0)))
        return column, float(self.data.peaks[column])

    @property
    def nonzero_columns(self) -> list[int]:
        """Columns of the joints with values other than zero; nan counts as such a value."""
        return [int(column) for column in np.flatnonzero(np.nan_to_num(self.data.peaks, nan=1.0))]

    def only(self, columns: list[int]) -> JointQuantity:
        """Return the same quantity of some of the joints."""
        data = self.data
        part = Bands(data.time, data.low[:, columns], data.high[:, columns], data.peaks[columns], data.exact)
        errors = None if self.errors is None else self.errors[:, columns]
        joints = [self.joints[column] for column in columns]
        return JointQuantity(self.name, self.unit, joints, part, errors, self.known_until)


def joint_quantity(
    run: Run, name: str, path: str, unit: str, values: Callable[[Array], Array] = np.asarray
) -> JointQuantity:
    """Read an array of the archive group /joints.

    Parameters
    ----------
    path
        Path of the array, of shape (T, J, ...).
    values
        Maps a block of rows to one value for each row and joint, such as the norm over the last axis.
    """
    return JointQuantity(name, unit, tuple(run.joint_names), bands(np.asarray(run.time), run.dataset(path), values))


def joint_misalignment(run: Run) -> JointQuantity:
    """Return the misalignment of every joint [m]."""
    return joint_quantity(run, "misalignment", "joints/misalignment", "m")


def velocity_misalignment(run: Run) -> JointQuantity:
    """Return the velocity misalignment of every joint [m/s]."""
    return joint_quantity(run, "velocity misalignment", "joints/velocity_misalignment", "m/s")


def angle_misalignment(run: Run) -> JointQuantity:
    """Return the angle misalignment of every joint [rad]; zero for joints that do not constrain an angle."""
    return joint_quantity(run, "angle misalignment", "joints/angle_misalignment", "rad")


def reaction_force(run: Run) -> JointQuantity:
    """Return the magnitude of the reaction force of every joint [N], with its estimated error."""
    force = joint_quantity(
        run, "reaction force", "joints/reaction_force", "N", lambda force: np.hypot(force[..., 0], force[..., 1])
    )
    return _with_errors(run, force, "reaction_error")


def reaction_torque(run: Run) -> JointQuantity:
    """Return the reaction torque of every joint [N m], with its estimated error."""
    return _with_errors(run, joint_quantity(run, "reaction torque", "joints/reaction_torque", "N m"), "torque_error")


def _with_errors(run: Run, quantity: JointQuantity, name: str) -> JointQuantity:
    """Add the estimated errors of a run to a quantity, if they were estimated."""
    accuracy = run.accuracy
    if accuracy is None:
        return quantity
    errors = errors_at(accuracy, getattr(accuracy, name), quantity.data.time)
    until = math.nan if accuracy.is_complete else accuracy.known_until
    return replace(quantity, errors=errors, known_until=until)


def joint_lines(quantity: JointQuantity) -> tuple[Line, ...]:
    """Return lines for a chart: all non-zero joints or, of many, the two largest and some others evenly spread."""
    columns = quantity.nonzero_columns or [0]
    if len(columns) > len(PALETTE):
        worst = sorted(columns, key=lambda column: -np.nan_to_num(quantity.data.peaks[column], nan=np.inf))[:2]
        spread = [columns[place] for place in evenly(len(columns), len(PALETTE) - 2)]
        columns = sorted({*worst, *spread})
    time, high = quantity.data.time, quantity.data.high
    return tuple(Line(quantity.joints[k], time, high[:, k], band=_band(quantity, k)) for k in columns)


def _band(quantity: JointQuantity, column: int) -> Array | None:
    """Return the outline of the estimated error of one joint; None if it is unknown or was not estimated."""
    if quantity.errors is None:
        return None
    data = quantity.data
    return band_over_time(data.time, data.low[:, column], data.high[:, column], quantity.errors[:, column])


def draw_joints(axes: Axes, quantity: JointQuantity, *, log: bool = False, title: str = "") -> None:
    """Draw a quantity of the joints over time.

    Up to as many joints as there are colours are drawn individually. Of more joints, the largest value of all, the
    joint with the largest value and four others are drawn.

    Parameters
    ----------
    title
        Title of the panel; by default it states the largest value.
    """
    joints, data = quantity.joints, quantity.data
    dress_over_time(axes, f"{quantity.name}\n[{quantity.unit}]")
    if not joints:
        panel_title(axes, f"{quantity.name}: there are no joints")
        return
    column, most = quantity.largest
    told = f"{value_text(most, quantity.unit)}{_known_to(quantity, column)}"
    panel_title(axes, title or f"{quantity.name}: largest {told} ({joints[column]})")
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
        (line,) = axes.plot(time, values, color=color, linewidth=1.1, marker=single_row_marker(time))
        handles.append(line)
        labels.append(joints[chosen])
        if (band := _band(quantity, chosen)) is not None:
            axes.fill(*band.T, color=color, alpha=0.25, linewidth=0)
    if np.isfinite(quantity.known_until):
        axes.axvline(quantity.known_until, color=FAINT, linewidth=1.0, linestyle=":")
        late = quantity.known_until > (data.time[0] + data.time[-1]) / 2
        axes.annotate(
            UNKNOWN,
            (quantity.known_until, 0.98),
            xycoords=("data", "axes fraction"),
            xytext=(-3 if late else 3, 0),
            textcoords="offset points",
            size=7.5,
            color=FAINT,
            ha="right" if late else "left",
            va="top",
        )
    legend(axes, handles, labels)
    if log:
        axes.set_yscale("log")
        _show_floor(axes, floor, data.high, quantity.unit)
    else:
        powers_of_ten(axes)
        if np.nanmin(data.low, initial=0.0) >= 0.0:
            axes.set_ylim(bottom=0.0)


def _known_to(quantity: JointQuantity, column: int) -> str:
    """Return the estimated error of the largest value of a joint, such as `` ± 0.3 N``; empty if not estimated."""
    if quantity.errors is None:
        return ""
    data, errors = quantity.data, quantity.errors[:, column]
    largest = np.nan_to_num(np.maximum(np.abs(data.low[:, column]), np.abs(data.high[:, column])))
    if not np.isfinite(errors[int(np.argmax(largest))]):
        return ", error unknown"
    return f" ± {np.nanmax(errors):.2g} {quantity.unit}"


def value_text(value: float, unit: str) -> str:
    """Return a value with its unit, or ``not finite``."""
    return f"{value:.3g} {unit}" if np.isfinite(value) else "not finite"


def _floor(values: Array) -> float:
    """Return a power of ten below 99.5 % of the non-zero values."""
    positive = values[values > 0]
    if not positive.size:
        return SMALLEST
    return float(max(SMALLEST, 10.0 ** np.floor(np.log10(np.quantile(positive, 0.005)))))


def _show_floor(axes: Axes, floor: float, values: Array, unit: str) -> None:
    """Set the lower limit of a logarithmic axis, with a note if smaller values are drawn at it."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set_ylim(floor * 0.8, max(top * 2.0, floor * 10.0))
    if np.any(values < floor):
        axes.text(
            0.995, 0.02, f"values below {floor:.0e} {unit} are drawn there", transform=axes.transAxes,
            size=7.5, color=FAINT, ha="right", va="bottom",
            bbox={"facecolor": PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )  # fmt: skip
