"""Kinds of joints under test: the joints of their packaged example, each alone between its two bodies."""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mbdkit.base.errors import PluginError, StepError
from mbdkit.base.strict_model import description
from mbdkit.base.units import described_units, read_unit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.expressions.recorded import Recorder
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.joint_base import FunctionJoint, Pose, PoseFunction
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.element_items import JointKind
from mbdkit.spec.run_spec import RunSpec
from mbdkit_testing.example_under_test import ExampleUnderTest

#: Displacements of the states at which rows are compared, relative to the size of the joint, and in rad.
NEAR = 0.01
STEPS = 2e-3, 2e-4, 2e-5, 2e-6  #: Steps of differences, in the same parts.
#: Angle of a step of a walk [rad], turns of a walk, largest row after a step relative to the size of the joint, and how
#: often a step is halved until the row is smaller.
STRIDE, TURNS, SMOOTH, HALVINGS = np.pi / 24, 1.25, 0.25, 6


class JointUnderTest(ExampleUnderTest[JointKind]):
    """A kind of joints under test."""

    @property
    def what(self) -> str:
        """What the example must have, in the plural."""
        return f"joints of the type '{self.plugin.name}'"

    @cached_property
    def model(self) -> type[FunctionJoint]:
        """Class of the joints."""
        result: Any = self.plugin.model()
        if not (isinstance(result, type) and issubclass(result, FunctionJoint)):
            raise PluginError(f"its `model` is {result!r}, not a class derived from FunctionJoint")
        return result

    def members(self, spec: RunSpec) -> Mapping[str, Any]:
        """Return the joints of this type in a spec, by name."""
        return {name: joint for name, joint in spec.mechanism().joints.items() if isinstance(joint, self.model)}

    @cached_property
    def pairs(self) -> dict[str, Pair]:
        """Each joint of the example alone, by name."""
        compiled, places = self.workspace.mechanism, self.workspace.q0.reshape(-1, 3).tolist()
        at = dict(zip(compiled.bodies, places, strict=False))
        data = self.spec.mechanism().to_spec()["joints"]
        length, start = compiled.length, self.spec.time.start
        return {name: Pair.of(name, joint, data[name], at, length, start) for name, joint in self.elements.items()}


@dataclass(frozen=True)
class Pair:
    """A joint alone: its bodies at the start of the example, without forces.

    Attributes
    ----------
    name, joint, data
        The joint, and its keys in a spec.
    places
        Position and angle (x, y, angle) of each body but the ground [m, rad].
    size
        Distance of the points at the start, or the length of the example's mechanism where they coincide [m].
    time
        Start time [s].
    """

    name: str
    joint: FunctionJoint
    data: dict[str, Any]
    places: dict[str, tuple[float, float, float]]
    size: float
    time: float

    @classmethod
    def of(
        cls, name: str, joint: FunctionJoint, data: dict[str, Any], at: Mapping[str, Any], length: float, time: float
    ) -> Pair:
        """Return a joint with its bodies at given places; `length` is that of the mechanism."""
        pair = cls(name, joint, data, {body: tuple(at[body]) for body in joint.bodies if body != GROUND}, length, time)
        apart = float(np.hypot(pair.start.x, pair.start.y))
        return replace(pair, size=apart) if apart > 1e-3 * length else pair

    @cached_property
    def mechanism(self) -> Mechanism:
        """The mechanism of the joint and its bodies."""
        bodies = {
            body: {"mass": 1.0, "inertia": self.size**2, "position": [x, y], "angle": angle}
            for body, (x, y, angle) in self.places.items()
        }
        return Mechanism.from_spec({"gravity": [0.0, 0.0], "bodies": bodies, "joints": {self.name: self.data}})

    @cached_property
    def equations(self) -> EquationsOfMotion:
        """The equations of this mechanism."""
        return EquationsOfMotion.of(self.mechanism, self.time)

    @property
    def start(self) -> Pose:
        """The relative pose at the start."""
        return self.mechanism.relative_pose(self.joint)

    @property
    def q(self) -> np.ndarray:
        """The positions at the start, (n,)."""
        return np.array([self.places[body] for body in self.equations.bodies]).ravel()

    @property
    def scales(self) -> np.ndarray:
        """What counts as a displacement of one, (n,): the size of the joint [m], or one radian."""
        return np.tile([self.size, self.size, 1.0], len(self.places))

    @property
    def units(self) -> np.ndarray:
        """What counts as a change of one of each row, (m,): the size of the joint [m], or one radian."""
        return np.array([self.size if unit == "m" else 1.0 for unit in self.joint.units])

    @cached_property
    def of_first(self) -> bool:
        """Whether a function depends on the absolute angle of the first body."""
        return any("first" in recorded(function).variables for function in self.joint.functions(self.start))

    def rows_at(self, q: np.ndarray) -> np.ndarray:
        """Return the values of the rows, (m,); NaN where they are not finite numbers."""
        try:
            return self.equations.constraints(self.time, q)
        except StepError:
            return np.full(self.equations.m, np.nan)

    def curvature_at(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the second derivatives of the rows along `v`, (m,), relative to their units; NaN if not finite."""
        try:
            return np.asarray(self.equations.gamma(self.time, q, v) / self.units)
        except StepError:
            return np.full(self.equations.m, np.nan)

    def states(self) -> Iterator[np.ndarray]:
        """Yield positions near the start."""
        random = np.random.default_rng(1)
        yield from (self.q + NEAR * self.scales * random.uniform(-1.0, 1.0, len(self.q)) for _ in range(4))

    def walk(self, *, around: bool) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
        """Yield turns, rows and positions on a way that the joint admits: the second body turns, or moves around `a`.

        Rows are those after a step along their tangents, before they are corrected; they are small where functions are
        smooth. The way ends where rows are no finite numbers, or cannot be satisfied.
        """
        q, turned = self.q, 0.0
        moved = len(q) - 3
        while turned < TURNS * 2 * np.pi:
            direction = np.zeros(len(q))
            direction[moved + 2] = 1.0
            pivot = self.point(q, 0 if around else 1)
            direction[moved : moved + 2] = pivot[1] - q[moved + 1], q[moved] - pivot[0]
            jac = self._scaled_jacobian(q)
            if not np.all(np.isfinite(jac)):
                return
            scaled = direction / self.scales
            scaled -= np.linalg.lstsq(jac, jac @ scaled, rcond=None)[0]
            step = STRIDE
            for _ in range(HALVINGS):
                rows = self.rows_at(q + step * scaled * self.scales) / self.units
                if not np.max(np.abs(rows)) > SMOOTH:
                    break
                step /= 2
            q = q + step * scaled * self.scales
            turned += step
            yield turned / (2 * np.pi), rows * self.units, q
            for _ in range(20):
                rows = self.rows_at(q) / self.units
                jac = self._scaled_jacobian(q)
                if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(jac))):
                    return
                if np.max(np.abs(rows)) < 1e-12:
                    break
                q = q - np.linalg.lstsq(jac, rows, rcond=None)[0] * self.scales
            else:
                return

    def differences(self, function: Callable[[np.ndarray], np.ndarray], q: np.ndarray) -> np.ndarray:
        """Return the derivatives of a vector with respect to positions, each of which counts in `scales`."""

        def along(direction: np.ndarray) -> Callable[[float], np.ndarray]:
            return lambda s: function(q + s * direction)

        return np.stack([slope(along(direction)) for direction in np.diag(self.scales)], axis=-1)

    def point(self, q: np.ndarray, which: int) -> np.ndarray:
        """Return the joint's point on the first or second body in the global frame."""
        x, y = self.joint.flat_points[2 * which : 2 * which + 2]
        body = self.joint.bodies[which]
        if body == GROUND:
            return np.array([x, y])
        k = 3 * self.equations.bodies.index(body)
        c, s = np.cos(q[k + 2]), np.sin(q[k + 2])
        return np.array([q[k] + c * x - s * y, q[k + 1] + s * x + c * y])

    def _scaled_jacobian(self, q: np.ndarray) -> np.ndarray:
        try:
            jac = self.equations.constraint_jacobian(self.time, q).toarray()
        except StepError:
            return np.full((self.equations.m, len(q)), np.nan)
        return np.asarray(jac * self.scales / self.units[:, None])

    def with_points_moved(self, which: int, by: tuple[float, float]) -> Pair:
        """Return the same joint with the origin of the frame of a body moved in this frame, (x, y) [m]."""
        points = [list(point) for point in self.joint.points]
        points[which] = [points[which][0] - by[0], points[which][1] - by[1]]
        body = self.joint.bodies[which]
        x, y, angle = self.places[body]
        c, s = np.cos(angle), np.sin(angle)
        place = (x + float(c * by[0] - s * by[1]), y + float(s * by[0] + c * by[1]), angle)
        data = {**self.data, "points": points}
        joint = self.joint.model_copy(update={"points": tuple(map(tuple, points))})
        return replace(self, joint=joint, data=data, places={**self.places, body: place})

    def enlarged(self, factor: float) -> Pair | None:
        """Return the joint with all lengths times a factor; None if its keys do not tell which numbers are lengths."""
        data = deepcopy(self.data)
        for key in type(self.joint).model_fields:
            value = self.data.get(key, getattr(self.joint, key))
            if key in ("type", "bodies") or value is None or isinstance(value, bool):
                continue
            units = ("m",) if key == "points" else described_units(description(type(self.joint), key))
            if isinstance(value, dict) or (isinstance(value, str) and not _is_choice(type(self.joint), key)):
                return None
            powers = {read_unit(unit).exponents for unit in units}  # one of lengths alone: 1 of m, -1 of 1/m
            if len(powers) == 1 and not any((power := powers.pop())[1:]):
                data[key] = _times(value, factor ** int(power[0]))
        places = {body: (factor * x, factor * y, angle) for body, (x, y, angle) in self.places.items()}
        again = replace(self, data=data, places=places, size=factor * self.size)
        joint: Any = again.mechanism.joints[self.name]
        return replace(again, joint=joint)


def _is_choice(model: type[FunctionJoint], key: str) -> bool:
    annotation = model.model_fields[key].annotation
    return any(typing.get_origin(one) is typing.Literal for one in (annotation, *typing.get_args(annotation)))


def _times(value: Any, factor: float) -> Any:
    return [_times(one, factor) for one in value] if isinstance(value, (list, tuple)) else factor * value


def slope(function: Callable[[float], np.ndarray]) -> np.ndarray:
    """Return the derivative of a function at 0 by extrapolated central differences.

    Of several steps, each entry takes that which changes least if it is halved; so tables may have knots nearby.
    """
    values, least = np.zeros(()), np.array(np.inf)
    for step in STEPS:
        coarse, fine = ((function(h) - function(-h)) / (2 * h) for h in (step, step / 2))
        change = np.abs(fine - coarse)
        values = np.where(change < least, (4 * fine - coarse) / 3, values)
        least = np.fmin(change, least)
    return values


class Record(NamedTuple):
    """A recorded function: its terms, tables and value, which are equal for equal functions, and those entries of
    `Pose` on which the value depends.
    """

    terms: tuple[Any, ...]
    variables: frozenset[str]


def recorded(function: PoseFunction) -> Record:
    """Return the record of a function, which is called for it."""
    recorder = Recorder()
    pose = Pose(*(recorder.input(name) for name in Pose._fields))
    given = {name: recorder.input(f"parameter {name}") for name, _ in function.parameters}
    value = recorder.constant(function.function(pose, given))
    needed = set(recorder.ancestors([value]))
    variables = frozenset(name for name, one in zip(Pose._fields, pose, strict=True) if one.index in needed)
    return Record((tuple(recorder.terms), tuple(recorder.tables), value.index), variables)
