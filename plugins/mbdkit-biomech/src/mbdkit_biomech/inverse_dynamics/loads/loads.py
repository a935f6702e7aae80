"""Measured loads: forces with a moving point of application, and free torques, in the frames of a motion."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from difflib import SequenceMatcher
from typing import Literal, TypeAlias

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.mechanism_quantities import Point
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable, cited
from mbdkit_biomech.inverse_dynamics.motion.measured import (
    GivenUnit,
    contradicted_units,
    si_values,
    source_table,
    times_of,
    unit_factor,
)
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Motion
from mbdkit_biomech.inverse_dynamics.signals.interpolating_splines import interpolating_spline
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import ColumnOfTable, Load, TimeColumn
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

#: Forces below the first limit [N] and below this share of the largest force of a plate are too small to determine a
#: centre of pressure.
UNLOADED, UNLOADED_SHARE = 10.0, 0.05

#: The axis and the number of a plate at the end of a heading in lower case.
AXIS = re.compile(r"([xyz])(\d*)$")

#: Headings in lower case of points of application, such as ``ground_force_px``, ``plate1.point.x`` and ``COPx1``.
LIKE_POINT = re.compile(r"(?:^|[^a-z])(?:p|cp|cop|point|position|pressure)[^a-z0-9]?" + AXIS.pattern)

#: A component of a `LoadSeries`: name of the array, and index along its last axis.
Component: TypeAlias = tuple[Literal["force", "point", "torque"], int | None]


@dataclass(frozen=True)
class LoadSeries:
    """A load as measured, at its own times (R,).

    Attributes
    ----------
    time
        (R,) [s].
    body
        Index of the body on which the load acts.
    force
        (R, 2) force in the global frame [N].
    point
        (R, 2) point of application in the frame of the body `frame` [m]; None for the centre of mass of `body`.
    frame
        Index of the body in whose frame the point is given, `GROUND` for the global frame.
    torque
        (R,) free torque [N m].
    is_cubic
        Whether values between these times are interpolated by a cubic spline instead of straight lines.
    deviation
        Standard deviations of the noise in SI units, for the components with noise. The keys are components, such as
        ("force", 0) for the x component of the force and ("torque", None) for the torque.
    like_point
        If there is no point, headings of columns that are not used and look like the point of application.
    contradictions
        Sentences, without full stops, on units in the spec that differ from those in the file.
    """

    time: np.ndarray
    body: int
    force: np.ndarray
    point: np.ndarray | None
    frame: int
    torque: np.ndarray
    is_cubic: bool
    deviation: Mapping[Component, float] = field(default_factory=dict)
    like_point: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()

    def moved(self, component: Component, by: float | np.ndarray) -> LoadSeries:
        """Return the load with a component changed by a number, or by numbers, at all times at which it acts."""
        name, axis = component
        values = getattr(self, name).copy()
        values[self.acts, ... if axis is None else axis] += by
        return replace(self, **{name: values})

    def with_noise(self, random: np.random.Generator) -> LoadSeries:
        """Return the load with Gaussian noise of its components at all times at which it acts."""
        moved = self
        for component, deviation in self.deviation.items():
            noise = deviation * random.standard_normal(len(self.time))
            moved = moved.moved(component, noise[self.acts])
        return moved

    @property
    def acts(self) -> np.ndarray:
        """(R,) whether the load acts, that is, whether its force or torque is not zero."""
        return np.asarray(np.any(self.force != 0, axis=1) | (self.torque != 0))

    def at(self, times: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return values (R, ...) of the load interpolated to `times` (T,)."""
        if np.array_equal(times, self.time):
            return values
        if self.is_cubic:
            return interpolating_spline(self.time, values, 3)(times)
        columns = values.reshape(len(self.time), -1)
        found = np.column_stack([np.interp(times, self.time, column) for column in columns.T])
        return found.reshape(len(times), *values.shape[1:])


@dataclass(frozen=True)
class Loads:
    """L loads in T frames.

    Attributes
    ----------
    names, bodies
        Names of the loads, and of the bodies on which they act.
    force, point, torque
        (T, L, 2) forces [N], (T, L, 2) points of application in the global frame [m], and (T, L) free torques [N m].
    generalized
        (T, n) sum of the generalized forces.
    power
        (T, L) power that each load supplies to its body [W].
    """

    names: tuple[str, ...]
    bodies: tuple[str, ...]
    force: np.ndarray
    point: np.ndarray
    torque: np.ndarray
    generalized: np.ndarray
    power: np.ndarray


def read_loads(spec: InverseSpec, names: QuantityNames, of_motion: MeasuredTable | None) -> dict[str, LoadSeries]:
    """Return the loads of a spec by name.

    Parameters
    ----------
    of_motion
        The table of the motion. Loads without their own `file` or `data` are read from it.

    Raises
    ------
    SpecError
        If a load has no table, if the table lacks a column or has a gap where a value is needed, or if a name or unit
        is wrong.
    """
    return {name: _series(spec, names, f"loads.{quoted(name)}", load, of_motion) for name, load in spec.loads.items()}


def _series(
    spec: InverseSpec, names: QuantityNames, key: str, load: Load, of_motion: MeasuredTable | None
) -> LoadSeries:
    body = names.body(load.body, f"{key}.body")
    frame = names.body(load.point_frame, f"{key}.point_frame", may_be_ground=True)
    own = source_table(load, spec.folder, key)
    table = of_motion if own is None else own
    if table is None:
        raise SpecError(
            "is missing: the motion is not a table, so that the load needs a `file` or `data`", key=f"{key}.file"
        )
    time = times_of(table, load.time or (spec.motion.time if own is None else TimeColumn()), f"{key}.time")
    force, torque, point = np.zeros((len(time), 2)), np.zeros(len(time)), None
    deviation: dict[Component, float] = {}
    if load.force is not None:
        for axis, column in enumerate(load.force):
            force[:, axis] = _required(table, column, "N", f"{key}.force[{axis}]")
            deviation["force", axis] = _deviation(table, column, "N")
    if load.torque is not None:
        torque = _required(table, load.torque, "N m", f"{key}.torque")
        deviation["torque", None] = _deviation(table, load.torque, "N m")
    if load.point is not None:
        acts = np.any(force != 0, axis=1)
        if load.is_plate:
            unloaded = acts & _without_point(table, load.point, force, key)
            force[unloaded], torque[unloaded] = 0.0, 0.0
            acts &= ~unloaded
        point = np.empty_like(force)
        for axis, column in enumerate(load.point):
            point[:, axis] = _required(table, column, "m", f"{key}.point[{axis}]", acts)
            deviation["point", axis] = _deviation(table, column, "m")
    noisy = {component: value for component, value in deviation.items() if value > 0}
    like_point = _like_point(spec, names, load, table) if point is None else ()
    units = tuple(contradicted_units(table, _given_units(load, key)))
    return LoadSeries(time, body, force, point, frame, torque, load.interpolation == "cubic", noisy, like_point, units)


def _given_units(load: Load, key: str) -> Iterator[GivenUnit]:
    """Yield key, heading, unit and SI unit of each column of a load and of its times, if they have a unit."""
    if load.time is not None and "unit" in load.time.model_fields_set:
        yield f"{key}.time", load.time.column, load.time.unit, "s"
    columns = {"torque": (load.torque, "N m")}
    for name, pair, unit in (("force", load.force, "N"), ("point", load.point, "m")):
        columns |= {f"{name}[{axis}]": (column, unit) for axis, column in enumerate(pair or ())}
    for name, (column, unit) in columns.items():
        if isinstance(column, ColumnOfTable) and column.unit is not None:
            yield f"{key}.{name}", column.column, column.unit, unit


def _like_point(spec: InverseSpec, names: QuantityNames, load: Load, table: MeasuredTable) -> tuple[str, ...]:
    """Return the headings of unused columns that look like the point of application of a load without one.

    If several plates share the table, they are those whose names are most like that of the force.
    """
    forces = [one.column for one in load.force or () if not isinstance(one, float)]
    points = [one.column for other in spec.loads.values() for one in other.point or () if not isinstance(one, float)]
    used = {*points, *(one.column for one in (spec.motion.columns or {}).values())}
    found = [
        (SequenceMatcher(None, heading, force).ratio(), heading)
        for force in forces
        for heading in table.headings
        if heading not in used
        and not names.knows(heading)
        and (point := LIKE_POINT.search(heading.lower()))
        and (own := AXIS.search(force.lower()))
        and point.groups() == own.groups()
    ]
    most = max((alike for alike, _ in found), default=0.0)
    return tuple(heading for alike, heading in found if alike == most)


def _without_point(
    table: MeasuredTable, point: tuple[ColumnOfTable | float, ...], force: np.ndarray, key: str
) -> np.ndarray:
    """Return the rows (R,) in which a plate gives no point of application because its force is too small."""
    missing = np.zeros(len(force), dtype=bool)
    for axis, column in enumerate(point):
        if not isinstance(column, float):
            missing |= np.isnan(si_values(column, table, "m", f"{key}.point[{axis}]"))
    size = np.linalg.norm(np.nan_to_num(force), axis=1)
    return np.asarray(missing & (size < min(UNLOADED, UNLOADED_SHARE * np.max(size, initial=0.0))))


def _deviation(table: MeasuredTable, column: ColumnOfTable | float, unit: str) -> float:
    """Return the standard deviation of the noise of a column in the SI `unit`; 0 if none is stated."""
    if isinstance(column, float) or column.deviation is None:
        return 0.0
    return abs(unit_factor(column, table, unit, "loads")) * column.deviation


def _required(
    table: MeasuredTable, column: ColumnOfTable | float, unit: str, key: str, needed: np.ndarray | None = None
) -> np.ndarray:
    """Return the values of a load, (R,), in the SI `unit`; raise SpecError if one is missing.

    Parameters
    ----------
    needed
        (R,) rows in which the value is needed; all by default. A point of application, for example, is not needed where
        the force is zero. Missing values in other rows are interpolated.
    """
    if isinstance(column, float):
        return np.full(len(table), column)
    values = si_values(column, table, unit, key)
    absent = np.isnan(values)
    missing = np.flatnonzero(absent if needed is None else absent & needed)
    if missing.size:
        told = "the value of the load is missing"
        if needed is not None:
            told = (
                "the point of application is missing, although a force acts; give the point, or set the force to zero "
                f"in this row (for `kind: plate`, mbdkit does so below {UNLOADED:g} N and {UNLOADED_SHARE:.0%} of the "
                "largest force)"
            )
        raise table.error(f"column '{cited(column.column)}': {told}", row=int(missing[0]))
    known = np.flatnonzero(~absent)
    return np.interp(np.arange(len(values)), known, values[known]) if known.size else np.zeros(len(values))


def loads_on(motion: Motion, series: Mapping[str, LoadSeries], bodies: tuple[str, ...]) -> Loads:
    """Return the loads in the frames of a motion.

    Raises
    ------
    SpecError
        If the data of a load do not cover the whole motion.
    """
    time, q, v = motion.time, motion.q, motion.v
    count = len(series)
    force, point = np.zeros((2, len(time), count, 2))
    torque, power = np.zeros((2, len(time), count))
    generalized = np.zeros_like(q)
    for index, (name, one) in enumerate(series.items()):
        slack = 1e-9 * max(abs(time[0]), abs(time[-1]))
        if one.time[0] > time[0] + slack or one.time[-1] < time[-1] - slack:
            raise SpecError(
                f"is known from {one.time[0]:.6g} to {one.time[-1]:.6g} s, but the motion lasts from {time[0]:.6g} to "
                f"{time[-1]:.6g} s; cut the motion with `time.start` and `time.end`, or, if the times of the two "
                "files are shifted against each other, correct those of one file",
                key=f"loads.{quoted(name)}",
            )
        force[:, index], torque[:, index] = one.at(time, one.force), one.at(time, one.torque)
        point[:, index] = global_point(one, time, q)
        body = 3 * one.body
        arm = point[:, index] - q[:, body : body + 2]
        own = np.zeros_like(q)
        own[:, body : body + 2] = force[:, index]
        own[:, body + 2] = arm[:, 0] * force[:, index, 1] - arm[:, 1] * force[:, index, 0] + torque[:, index]
        generalized += own
        power[:, index] = np.sum(own * v, axis=1)
    on = tuple(bodies[one.body] for one in series.values())
    return Loads(tuple(series), on, force, point, torque, generalized, power)


def global_point(one: LoadSeries, time: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the point of application (T, 2) in the global frame."""
    if one.point is None:
        return q[:, 3 * one.body : 3 * one.body + 2]
    return np.column_stack(Point(one.frame, *one.at(time, one.point).T).position(q))
