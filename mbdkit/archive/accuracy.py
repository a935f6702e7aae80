"""Estimated errors of a run: the group ``/accuracy``, and the numbers derived from it for summary and verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from mbdkit.archive.hdf5 import create, set_text
from mbdkit.archive.measured_values import ComparedMeasures, compared_from_json, compared_json
from mbdkit.archive.result_table import TableColumn, axes_first
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.html_view import HtmlView
from mbdkit.quantities.array import COORDINATE_UNITS
from mbdkit.quantities.names import COORDINATES
from mbdkit.quantities.registered_kinds import kind_of_group

#: Errors of the force of a joint are divided by its largest force, but at least by this share of the largest force of
#: all joints. Otherwise, an error that is negligible in the mechanism would be large in a joint that carries almost
#: nothing.
SMALL_FORCE = 1e-3


@dataclass(frozen=True)
class JointAccuracy:
    """Accuracy of the reaction force of one joint.

    - `name`: name of the joint.
    - `peak`: largest reaction force over the run [N].
    - `peak_known`: largest reaction force up to `Accuracy.known_until` [N]; nan if nothing is known.
    - `error`: largest estimated error of the reaction force up to `Accuracy.known_until` [N]; nan if nothing is known.
    - `missed`: by how much the largest force between recorded rows exceeds `peak` [N]; 0 if every step is recorded, nan
      if it is unknown.
    - `share`: sum of two shares: `error` divided by the sum of `peak_known` and `missed`, and `missed` divided by the
      sum of `peak` and `missed`. Sums below the share `SMALL_FORCE` of the largest sum of all joints are replaced by
      this share.
    """

    name: str
    peak: float
    peak_known: float
    error: float
    missed: float
    share: float


@dataclass(frozen=True)
class AccuracyFigures:
    """The figures on which a verdict on a run is based.

    `known_until`, `end`: time until which the errors are known [s], nan if no error is known; time of the last row [s],
    nan without rows. `joints`: accuracy of the reaction force of each joint.
    """

    known_until: float
    end: float
    joints: tuple[JointAccuracy, ...]

    @property
    def is_complete(self) -> bool:
        """Whether the errors of all rows are known."""
        return self.known_until == self.end

    @property
    def worst_joint(self) -> JointAccuracy | None:
        """The joint with the largest `JointAccuracy.share`; None without joints."""
        return max(self.joints, key=lambda joint: math.inf if math.isnan(joint.share) else joint.share, default=None)


@dataclass(frozen=True, eq=False)
class Accuracy(HtmlView):
    """Estimated errors of the T recorded rows; nan where unknown.

    After a check of a run, the errors are envelopes, which never decrease with time. In inverse dynamics, each error is
    a bound that holds at its time with a probability of 95 %.

    - `time`: (T,) time of the rows [s].
    - `position_error`, `velocity_error`: (T, B, 3) errors of x, y [m] and angle [rad] of the bodies, and of their
      rates.
    - `reaction_error`: (T, J) norm of the error of the reaction forces [N].
    - `torque_error`: (T, J) error of the reaction torques [N m].
    - `known_until`: time until which all errors are known [s]; nan if no error is known.
    - `order_observed`: observed order of convergence of the positions with the step or, for adaptive methods, with the
      tolerance; nan if the comparison runs differed by rounding errors only.
    - `method`: how the estimates were made.
    - `check_s`: duration of the check [s].
    - `asked`: requested accuracy of positions (`accuracy` of the spec), as a share of the mechanism's size; nan if
      none.
    - `reached`: largest estimated error of positions up to `known_until`, as a share of the mechanism's size; nan if
      unknown, or if no accuracy was requested.
    - `chosen`, `why`: method and step that were chosen for the requested accuracy, and the reason; empty if none was
      requested.
    - `compared_measures`: values of the expressions of measures in the comparison runs.
    - `measured_parameters`: errors of these values by the estimates of parameters: bounds of 95 %.
    - `unknown`: why errors are unknown after `known_until`, as a clause; empty if all are known.
    - `further`: further arrays of the group ``/accuracy`` by name, such as the parts of `reaction_error`; empty for
      most runs.
    """

    time: np.ndarray
    position_error: np.ndarray
    velocity_error: np.ndarray
    reaction_error: np.ndarray
    torque_error: np.ndarray
    known_until: float
    order_observed: float
    method: str
    check_s: float
    asked: float = math.nan
    reached: float = math.nan
    chosen: str = ""
    why: str = ""
    compared_measures: ComparedMeasures = field(default_factory=dict)
    measured_parameters: ComparedMeasures = field(default_factory=dict)
    unknown: str = ""
    further: Mapping[str, TableColumn] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return method, observed order, and largest errors as lines of text; the arrays are not printed."""
        lines = [f"method          {self.method}", f"known until     {self._until}"]
        if not math.isnan(self.order_observed):
            lines.append(f"observed order  {self.order_observed:.3g}")
        if count := self.rows_known:
            errors = [(self.position_error_max, "m", "position"), (self.angle_error_max, "rad", "angle")]
            for values, unit, what in (
                (self.reaction_error, "N", "reaction force"),
                (self.torque_error, "N m", "reaction torque"),
            ):
                if values.shape[1]:
                    errors.append((largest_known(values[:count]), unit, what))
            largest = ", ".join(f"{what} {size:.2g} {unit}" for size, unit, what in errors)
            arrays = (self.position_error, self.reaction_error, self.torque_error)
            partly = any(np.any(np.isnan(values[:count])) for values in arrays)
            lines.append(f"largest errors  {largest}{', where they are known' if partly else ''}")
        return "\n".join(lines)

    @property
    def _until(self) -> str:
        if math.isnan(self.known_until):
            return "no error is known"
        return f"{self.known_until:.6g} s, the end" if self.is_complete else f"{self.known_until:.6g} s"

    @property
    def is_reached(self) -> bool:
        """Whether an accuracy was requested, and the estimates confirm it for all rows."""
        return self.is_complete and self.reached <= self.asked

    @property
    def is_complete(self) -> bool:
        """Whether the errors of all rows are known."""
        return len(self.time) > 0 and self.known_until == self.time[-1]

    @property
    def rows_known(self) -> int:
        """Number of leading rows whose errors are all known."""
        return 0 if math.isnan(self.known_until) else int(np.searchsorted(self.time, self.known_until, side="right"))

    @property
    def position_error_max(self) -> float:
        """Largest error of the position of a body [m] up to `known_until`; nan if nothing is known."""
        count = self.rows_known
        return largest_known(np.linalg.norm(self.position_error[:count, :, :2], axis=-1)) if count else math.nan

    @property
    def angle_error_max(self) -> float:
        """Largest error of the angle of a body [rad] up to `known_until`; nan if nothing is known."""
        count = self.rows_known
        return largest_known(self.position_error[:count, :, 2]) if count else math.nan

    def of_joints(
        self, names: Sequence[str], force: np.ndarray, missed: np.ndarray | None = None
    ) -> tuple[JointAccuracy, ...]:
        """Return the accuracy of each joint.

        `names`: names of the J joints. `force`: (T, J, 2) reaction forces [N]. `missed`: (J,) by how much the largest
        forces between rows exceed those in the rows [N], nan where unknown; None if every step is recorded.
        """
        count, size = self.rows_known, np.linalg.norm(force, axis=-1)
        beyond = np.zeros(len(names)) if missed is None else missed
        peaks = np.max(size, axis=0, initial=0.0)
        known = np.max(size[:count], axis=0) if count else np.full(len(names), np.nan)
        errors = np.max(self.reaction_error[:count], axis=0) if count else np.full(len(names), np.nan)
        scales = _scales(known + np.nan_to_num(beyond)), _scales(peaks + np.nan_to_num(beyond))
        shares = _shares(errors, scales[0]) + _shares(beyond, scales[1])
        figures = []
        for index, name in enumerate(names):
            numbers = peaks[index], known[index], errors[index], beyond[index], shares[index]
            figures.append(JointAccuracy(name, *map(float, numbers)))
        return tuple(figures)

    def figures(self, names: Sequence[str], force: np.ndarray, missed: np.ndarray | None = None) -> AccuracyFigures:
        """Return the figures for a verdict; see `of_joints` for the arguments."""
        end = float(self.time[-1]) if len(self.time) else math.nan
        return AccuracyFigures(self.known_until, end, self.of_joints(names, force, missed))

    @property
    def position_error_parameters(self) -> np.ndarray | None:
        """(T, B, 3) errors of x, y [m] and angle [rad] at each time by the estimates of parameters: bounds of 95 %, nan
        where unknown. None if the spec has no `estimates`, or `check` is false.
        """
        return self.parts.get("position_error_parameters")

    @property
    def reaction_error_parameters(self) -> np.ndarray | None:
        """(T, J) norm of the error of the reaction forces [N]; see `position_error_parameters`."""
        return self.parts.get("reaction_error_parameters")

    @property
    def parts(self) -> Mapping[str, np.ndarray]:
        """Values of the further arrays by name."""
        return {name: column.values for name, column in self.further.items()}

    def arrays(self, bodies: Sequence[str], joints: Sequence[str]) -> dict[str, np.ndarray]:
        """Return the arrays of the group ``/accuracy`` by path; `bodies` and `joints` are the names in their order."""
        return {
            "accuracy/coordinate": np.array(COORDINATES, object),
            **{f"accuracy/{name}": np.array(units, object) for name, units in COORDINATE_UNITS.items()},
            "accuracy/body": np.array(bodies, object),
            "accuracy/joint": np.array(joints, object),
            **{f"accuracy/{name}": np.ascontiguousarray(getattr(self, name), np.float64) for name in _VALUES},
            **{f"accuracy/{name}": np.ascontiguousarray(values) for name, values in self.parts.items()},
        }

    def write(self, file: h5py.File, bodies: Sequence[str], joints: Sequence[str]) -> None:
        """Write the group ``/accuracy``. `file`: the archive. `bodies`, `joints`: names, in the order of the arrays."""
        group = file.create_group("accuracy")
        values = self.arrays(bodies, joints)
        for array in sorted(kind_of_group("accuracy").arrays, key=lambda array: not array.is_scale):
            create(file, array, values[array.path])
        for name, column in axes_first(self.further):
            column.write(file, f"accuracy/{name}")
        group.attrs.update({name: np.float64(getattr(self, name)) for name in _NUMBERS})
        for name in _TEXTS:
            set_text(group, name, getattr(self, name))
        for name in _MEASURES:
            if values_of_measures := getattr(self, name):
                set_text(group, name, compared_json(values_of_measures))

    @classmethod
    def read(cls, group: h5py.Group) -> Accuracy:
        """Read the group ``/accuracy`` of an archive."""
        values: dict[str, Any] = {name: group[name][:] for name in _VALUES}
        for array in values.values():
            array.flags.writeable = False
        known = kind_of_group("accuracy").by_path
        further = [name for name in group if f"accuracy/{name}" not in known]
        values["further"] = {name: TableColumn.read(group[name]) for name in further}
        values |= {name: float(group.attrs.get(name, math.nan)) for name in _NUMBERS}
        values |= {name: str(group.attrs.get(name, "")) for name in _TEXTS}
        values |= {name: compared_from_json(str(group.attrs.get(name, "{}"))) for name in _MEASURES}
        return cls(**values)


def _scales(largest: np.ndarray) -> np.ndarray:
    return np.asarray(np.fmax(largest, SMALL_FORCE * np.max(largest, initial=0.0)))


def _shares(errors: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return errors (J,) divided by `scales`; 0 without forces, and nan where an error is unknown."""
    return np.asarray(np.divide(errors, scales, out=0.0 * errors, where=scales > 0))


def largest_known(errors: np.ndarray) -> float:
    """Return the largest error that is known; nan if none is, and 0 without errors."""
    known = errors[~np.isnan(errors)]
    return float(np.max(known, initial=0.0)) if known.size or not errors.size else math.nan


_VALUES = ("time", "position_error", "velocity_error", "reaction_error", "torque_error")
_NUMBERS = ("known_until", "order_observed", "check_s", "asked", "reached")
_TEXTS = ("method", "chosen", "why", "unknown")
_MEASURES = ("compared_measures", "measured_parameters")
