"""Takes the rows of one run from the recorder; subclasses write them to a file, or keep them in memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.fingerprint import line, text_bytes
from mbdkit.archive.layout import Array
from mbdkit.archive.measured_values import Integrals
from mbdkit.trust.criteria import Judgement

#: Keys accepted by the `append` methods.
_KEYS = frozenset(array.key for array in layout.LAYOUT)

UNJUDGED = Judgement("unknown")


@dataclass(frozen=True)
class Ending:
    """How a run has ended.

    Parameters
    ----------
    status
        ``complete``, ``failed`` or ``interrupted``.
    reason
        Code and sentence saying why the run is not complete, such as ``newton-failed: the step at t = ...``. For
        a complete run, the event that ended it, or an empty string.
    stats
        Attributes of ``/stats``: counters (integers) and ``setup_s``, ``wall_s``, ``cpu_s``.
    misalignment_max
        (J,) largest misalignment of each joint over all steps [m].
    judgement
        The verdict on the run; ``unknown`` by default.
    warnings
        Warnings about the spec and the run, as sentences.
    accuracy
        Estimated errors of the rows, if they were checked.
    integrals
        Time integrals by their integrands, numbers or pairs of numbers, in SI units.
    """

    status: str
    reason: str
    stats: Mapping[str, int | float]
    misalignment_max: np.ndarray
    judgement: Judgement = UNJUDGED
    warnings: Sequence[str] = ()
    accuracy: Accuracy | None = None
    integrals: Integrals = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.status not in layout.STATUSES[1:]:
            raise ValueError(f"a run ends as complete, failed or interrupted, not {self.status!r}")


@dataclass(frozen=True)
class ArchiveNames:
    """Names along the axes of an archive.

    Parameters
    ----------
    bodies, joints
        Names, in the order of the engine.
    constraints
        ``joint.row`` for every constraint row, such as ``J1.x``.
    constraint_units
        Unit of the constraint function of every constraint row, ``m`` or ``rad``.
    joint_bodies
        First and second body of every joint.
    joint_units
        Unit of the coordinate of every joint, ``rad`` or ``m``; by default, ``rad``.
    forces, force_bodies
        Names of the force elements, and first and second body of each.
    force_units
        Unit of the length of every force element, ``m`` or ``rad``.
    markers, marker_bodies
        Names of the markers, and the body of each.
    elements, element_beams
        Names of the elements of beams, and the beam of each.
    observed, observed_units
        Names of the observed quantities of a measured motion, and the unit of each, ``m`` or ``rad``.
    actuators, actuator_units
        Names of the actuators, and the unit of the value of each, ``N`` or ``N m``.
    loads, load_bodies
        Names of the measured loads, and the body of each.
    """

    bodies: Sequence[str]
    joints: Sequence[str]
    constraints: Sequence[str]
    constraint_units: Sequence[str]
    joint_bodies: Sequence[tuple[str, str]]
    joint_units: Sequence[str] = ()
    forces: Sequence[str] = ()
    force_bodies: Sequence[tuple[str, str]] = ()
    force_units: Sequence[str] = ()
    markers: Sequence[str] = ()
    marker_bodies: Sequence[str] = ()
    elements: Sequence[str] = ()
    element_beams: Sequence[str] = ()
    observed: Sequence[str] = ()
    observed_units: Sequence[str] = ()
    actuators: Sequence[str] = ()
    actuator_units: Sequence[str] = ()
    loads: Sequence[str] = ()
    load_bodies: Sequence[str] = ()

    @property
    def sizes(self) -> dict[str, int]:
        """Lengths of the axes that do not grow, by name."""
        return {
            "body": len(self.bodies),
            "coordinate": len(layout.COORDINATES),
            "joint": len(self.joints),
            "axis": len(layout.AXES),
            "constraint": len(self.constraints),
            "force": len(self.forces),
            "marker": len(self.markers),
            "element": len(self.elements),
            "observed": len(self.observed),
            "actuator": len(self.actuators),
            "load": len(self.loads),
        }

    def present(self, quantities: frozenset[str]) -> frozenset[str]:
        """Return the `quantities` without the groups of elements that the mechanism does not have."""
        there = {"forces": self.forces, "markers": self.markers, "beams": self.elements}
        return frozenset(group for group in quantities if group not in layout.ELEMENTS or there[group])


@dataclass(frozen=True)
class SharedForces:
    """Attributes of the archive of a mechanism with redundant joints.

    Parameters
    ----------
    redundancy
        Description, such as ``1 redundant row: joint D``.
    joints
        The joints whose reactions are not unique.
    length
        Characteristic length [m]. Of all reactions that produce the same motion, the recorded ones minimize the sum
        over joints of ``|force|^2 + (torque / length)^2``.
    drivers
        The drivers among these joints, whose powers are not unique.
    """

    redundancy: str
    joints: Sequence[str]
    length: float
    drivers: Sequence[str] = ()


class RunWriter(ABC):
    """Takes the rows of one run: appends them, and finishes or abandons the run.

    Parameters
    ----------
    names
        Names of bodies, joints and constraint rows.
    quantities
        Which of `layout.QUANTITIES` are recorded.
    extra_datasets
        Paths of the optional arrays to record, such as ``constraints/method_multiplier``.
    arrays
        The arrays of the layout to record, instead of what the two arguments before choose.

    Attributes
    ----------
    arrays
        The arrays of the layout that the run records.
    """

    def __init__(
        self,
        names: ArchiveNames,
        quantities: frozenset[str],
        extra_datasets: Iterable[str],
        arrays: tuple[Array, ...] | None = None,
    ):
        self.names = names
        chosen = layout.recorded(names.present(quantities), frozenset(extra_datasets))
        self.arrays = chosen if arrays is None else arrays

    @property
    @abstractmethod
    def row_keys(self) -> frozenset[str]:
        """Keys that `append` requires; it ignores other keys of the layout."""

    @property
    def path(self) -> Path | None:
        """Final name of the archive; None in memory."""
        return None

    @abstractmethod
    def rows(self, dim: str) -> int:
        """Return the number of rows taken along a growing axis of the layout."""

    @abstractmethod
    def take(self, dim: str, rows: Mapping[str, np.ndarray]) -> None:
        """Copy rows of the arrays that grow along `dim`, by key."""

    @abstractmethod
    def flush_if_due(self) -> None:
        """Write the buffered rows and flush the file, if there is one, from time to time."""

    @abstractmethod
    def abandon(self) -> None:
        """Discard the run; no effect once it is finished."""

    @abstractmethod
    def finish(self, ending: Ending, *, measured: Callable[[h5py.File], str] | None = None) -> h5py.File | None:
        """End the run.

        Parameters
        ----------
        ending
            What is known at the end. This method adds ``finish_s`` to its `stats`, the time that it takes itself up to
            the renaming.
        measured
            Takes the measures of the run from the file, in which all else is written, and returns the attribute
            ``measures``; not called without a file.

        Returns
        -------
        h5py.File or None
            The open archive if it is in memory; None for a file, which this method closes.

        Raises
        ------
        ResourceError
            If the archive cannot be written or renamed.
        """

    def append(self, rows: Mapping[str, np.ndarray]) -> None:
        """Append recorded rows; the values are copied.

        Parameters
        ----------
        rows
            An array with T rows for every key of `row_keys`: paths such as ``trajectory/position`` (T, B, 3), and
            ``time`` (T,) for the times of all groups.

        Raises
        ------
        ResourceError
            If the archive cannot be written, as on a full disk.
        """
        self._append("time", rows)

    def append_steps(self, rows: Mapping[str, np.ndarray]) -> None:
        """Append the statistics of recorded intervals; the values are copied.

        Parameters
        ----------
        rows
            ``time``, ``steps``, ``size``, ``iterations``, ``iterations_max``, ``rejected``, and the corrections of a
            stabilized run, each (N,).
        """
        keyed = {f"steps/{name}": values for name, values in rows.items()}
        self._append("interval", {**keyed, "steps/interval": self._numbers("interval", len(rows["time"]))})

    def append_events(self, rows: Mapping[str, np.ndarray]) -> None:
        """Append crossings of events; the values are copied.

        Parameters
        ----------
        rows
            ``name`` (strings), ``time`` and ``direction``, each (E,), and ``position`` and ``velocity`` (E, B, 3).
        """
        keyed = {f"events/{name}": values for name, values in rows.items()}
        self._append("event", {**keyed, "events/event": self._numbers("event", len(rows["name"]))})

    def _numbers(self, dim: str, count: int) -> np.ndarray:
        first = self.rows(dim) + 1
        return np.arange(first, first + count)

    def _append(self, dim: str, rows: Mapping[str, np.ndarray]) -> None:
        unknown = rows.keys() - _KEYS
        if unknown:
            raise ValueError(f"the layout has no {', '.join(sorted(unknown))}")
        self.take(dim, rows)


def name_texts(names: ArchiveNames) -> dict[str, Sequence[str]]:
    """Return the values of the arrays of names and units, by path."""
    units = names.constraint_units
    rates = [f"{unit}/s" for unit in ("m", "m", "rad")]
    return {
        **{f"{group}/body": names.bodies for group in ("trajectory", "events")},
        **{f"{group}/coordinate": layout.COORDINATES for group in ("trajectory", "events")},
        **{f"{group}/row_units": ("m", "m", "rad") for group in ("trajectory", "events")},
        **{f"{group}/velocity_row_units": rates for group in ("trajectory", "events")},
        "trajectory/acceleration_row_units": [f"{rate}^2" for rate in rates],
        **{f"{group}/joint": names.joints for group in ("joints", "motion")},
        **{f"{group}/axis": layout.AXES for group in ("joints", "markers", "loads")},
        "joints/first_body": [first for first, _ in names.joint_bodies],
        "joints/second_body": [second for _, second in names.joint_bodies],
        "joints/angle_row_units": names.joint_units or ["rad"] * len(names.joints),
        "forces/force": names.forces,
        "forces/first_body": [first for first, _ in names.force_bodies],
        "forces/second_body": [second for _, second in names.force_bodies],
        "forces/row_units": names.force_units,
        "forces/rate_row_units": [layout.RATE_UNITS[unit] for unit in names.force_units],
        "forces/value_row_units": [layout.MULTIPLIER_UNITS[unit] for unit in names.force_units],
        "markers/marker": names.markers,
        "markers/body": names.marker_bodies,
        "beams/element": names.elements,
        "beams/beam": names.element_beams,
        "motion/observed": names.observed,
        "motion/row_units": names.observed_units,
        "actuators/actuator": names.actuators,
        "actuators/row_units": names.actuator_units,
        "loads/load": names.loads,
        "loads/body": names.load_bodies,
        "constraints/constraint": names.constraints,
        "constraints/row_units": units,
        "constraints/velocity_row_units": [layout.RATE_UNITS[unit] for unit in units],
        "constraints/multiplier_row_units": [layout.MULTIPLIER_UNITS[unit] for unit in units],
    }


@lru_cache(maxsize=256)
def name_line(path: str, text: tuple[str, ...]) -> str:
    """Return the line of an array of names for `data_sha256`; runs of one mechanism have the same."""
    return line(path, layout.TEXT, (len(text),), sha256(text_bytes(text)).hexdigest())
