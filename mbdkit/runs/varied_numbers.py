"""The arrays of mechanisms whose specs differ only in a few numbers, by formulas that were recorded once.

The model is built, checked and compiled once with numbers that record how code computes with them
(`mbdkit.base.traced_numbers`). The formulas of the entries of the compiled arrays that these numbers reach are then
evaluated for other values, with the same bits as by building and compiling. They hold for values with which all
comparisons have the same outcome; for other values, the model is built and recorded again, and some have no formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mbdkit.base.plain_data import Path, canonical
from mbdkit.base.traced_numbers import Formulas, Trace, UntraceableError, float_array, is_traced
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.lanes.lane_mechanisms import topology_of
from mbdkit.mechanism.checks import check_centers, check_springs
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import names_in, parameter_values
from mbdkit.mechanism.size import joint_points, sizes_of
from mbdkit.mechanism.traced_elements import with_numbers
from mbdkit.runs.corners import check_jumps
from mbdkit.runs.findings import findings
from mbdkit.runs.law_ranges import has_ranges
from mbdkit.runs.preparation import timetable
from mbdkit.runs.state_watchers import StateWatchers
from mbdkit.spec.reading import put
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.finding import Finding

MOST_VARIANTS = 8  #: Largest number of times that formulas are recorded, for other outcomes of comparisons.

STATE = ("q", "v", "tolerance", "length", "points")  #: Arrays of a mechanism besides those of its topology.


@dataclass(frozen=True, eq=False)
class Stacks:
    """Numbers of M mechanisms that differ in nothing else.

    - `members`: (M,) indices of the mechanisms among those that were asked for.
    - `topology`: arrays (M, ...) of those fields of `Topology` that differ between the mechanisms.
    - `q`, `v`: (M, 3 (B + 1)) initial positions and velocities before assembly, ground last.
    - `tolerance`: (M,) tolerance of assembly.
    - `length`: (M,) characteristic length [m].
    - `points`: (M, P, 2) joint points in the frames of the bodies `point_bodies` (P,) [m].
    """

    members: np.ndarray
    topology: Mapping[str, np.ndarray]
    q: np.ndarray
    v: np.ndarray
    tolerance: np.ndarray
    length: np.ndarray
    points: np.ndarray
    point_bodies: Sequence[int]

    def sizes(self) -> np.ndarray:
        """Return the sizes of the mechanisms at their starts (M,) [m]; see `mbdkit.mechanism.size`."""
        return sizes_of(self.point_bodies, self.points, self.q.reshape(len(self.q), -1, 3)[:, :-1])


@dataclass(frozen=True, eq=False)
class Variant:
    """The formulas of the arrays for one outcome of all comparisons.

    - `base`: arrays with the numbers for which the formulas were recorded, by name; see `STATE` and `Topology`.
    - `places`: for each of these arrays that varies, the indices in the flat array, and those of the results.
    - `formulas`: the formulas.
    - `compiled`, `table`: the compiled mechanism for these numbers, and the timetable without limits on states.
    - `points`: bodies of the joint points; see `mbdkit.mechanism.size.joint_points`.
    - `findings`: what criteria of specs find, which is equal for all numbers.
    - `watched`: whether recorded states are watched, by criteria that need the spec or for the ranges of laws.
    """

    base: Mapping[str, np.ndarray]
    places: Mapping[str, tuple[np.ndarray, np.ndarray]]
    formulas: Formulas
    compiled: CompiledMechanism
    table: Timetable
    points: Sequence[int]
    findings: tuple[Finding, ...]
    watched: bool

    @classmethod
    def of(cls, spec: RunSpec, paths: Sequence[Path], measures: Sequence[str] = ()) -> Variant:
        """Record the formulas of a valid spec for the numbers at some key paths.

        Raises an error, mostly UntraceableError, if the numbers are used in a way that cannot be recorded.
        """
        compiled, table = compile_mechanism(spec.mechanism()), timetable(spec, None)
        base = arrays_of(spec.mechanism(), compiled)
        trace = Trace()
        with trace.recording():
            varied = _with_traced_numbers(spec, paths, trace)
            mechanism = varied.mechanism()
            check_jumps(varied)
            found = tuple(findings("spec", varied, measures))
            recorded = compile_mechanism(mechanism)
            check_springs(mechanism.forces, mechanism.bodies.__getitem__)
            check_centers(mechanism.joints, mechanism.bodies.__getitem__)
            watched = bool(StateWatchers(varied, recorded, 1.0)) or has_ranges(mechanism)
            is_equal = timetable(varied, None) == table
            arrays = arrays_of(mechanism, recorded)
        is_equal &= all(array.tobytes() == base[name].tobytes() for name, array in arrays.items())
        if not is_equal or topology_of(compiled) != topology_of(recorded):
            raise UntraceableError("recording has changed numbers")
        places, results = {}, list[Any]()
        for name, array in arrays.items():
            if traced := trace.arrays.get(id(array), (array, {}))[1]:
                places[name] = np.array([*traced]), len(results) + np.arange(len(traced))
                results += traced.values()
        points = joint_points(spec.mechanism())[0]
        return cls(base, places, trace.formulas(results), compiled, table, points, found, watched)

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Key that is equal for variants that differ only in floating-point numbers."""
        return topology_of(self.compiled), self.table, self.findings, self.watched, self.compiled.well_scaled

    def rows(self, name: str, results: np.ndarray) -> np.ndarray:
        """Return an array of M members (M, ...) from the results of their formulas (M, R)."""
        base = self.base[name]
        rows = np.tile(base.ravel(), (len(results), 1))
        if name in self.places:
            entries, columns = self.places[name]
            rows[:, entries] = results[:, columns]
        return rows.reshape(len(results), *base.shape)


class VariedNumbers:
    """Arrays of the mechanisms of specs that differ only in the numbers at some key paths.

    - `paths`: key paths of numbers of the model, or of named parameters.
    - `spec`: function that returns the valid spec with other numbers, in the order of `paths`.
    - `measures`: see `LaneRuns`.
    """

    def __init__(self, paths: Sequence[Path], spec: Callable[[Sequence[float]], RunSpec], measures: Sequence[str] = ()):
        self.paths, self._spec, self._measures = paths, spec, measures
        self.variants: list[Variant] = []
        self._recorded = 0

    def stacks(self, values: np.ndarray) -> Stacks | None:
        """Return the arrays of N mechanisms with other numbers (N, K); None if there are formulas for none of them."""
        numbers, left = values.tolist(), list(range(len(values)))
        parts: list[tuple[Variant, list[int], np.ndarray]] = []
        for variant in self._variants_for(numbers, left):
            results = {member: result for member in left if (result := variant.formulas(*numbers[member])) is not None}
            if results:
                parts.append((variant, [*results], np.array([*results.values()]).reshape(len(results), -1)))
                left[:] = [member for member in left if member not in results]
        if not parts:
            return None
        order = np.argsort(np.concatenate([members for _, members, _ in parts]), kind="stable")
        names = {name for variant in self.variants for name in self._varying(variant)}
        arrays = {
            name: np.concatenate([variant.rows(name, results) for variant, _, results in parts])[order]
            for name in (*STATE, *names.difference(STATE))
        }
        members = np.concatenate([members for _, members, _ in parts])[order]
        state = {name: arrays.pop(name) for name in STATE}
        return Stacks(members=members, topology=arrays, point_bodies=parts[0][0].points, **state)

    def _varying(self, variant: Variant) -> Iterator[str]:
        """Yield the names of the arrays that differ between the mechanisms of this variant and the first one."""
        first = self.variants[0].base
        for name, array in variant.base.items():
            if name in variant.places or array.tobytes() != first[name].tobytes():
                yield name

    def _variants_for(self, numbers: Sequence[Sequence[float]], left: Sequence[int]) -> Iterator[Variant]:
        """Yield the known variants, and new ones for the first of the members that are left, until none is left."""
        yield from self.variants
        tried = 0
        while len(left) > tried and self._recorded < MOST_VARIANTS:
            self._recorded += 1
            try:
                variant = Variant.of(self._spec(numbers[left[tried]]), self.paths, self._measures)
            except (Exception, SystemExit):  # the spec is not valid, or a plugin computes in another way
                tried += 1
                continue
            if self.variants and variant.key != self.variants[0].key:
                tried += 1
                continue
            self.variants.append(variant)
            yield variant


def arrays_of(mechanism: Mechanism, compiled: CompiledMechanism) -> dict[str, np.ndarray]:
    """Return the arrays of a mechanism by name: those of its topology and of `STATE`."""
    bodies = mechanism.bodies.values()
    return {
        **compiled.topology._asdict(),
        "q": float_array([*(x for body in bodies for x in (*body.position, body.angle)), 0.0, 0.0, 0.0]),
        "v": float_array([*(x for body in bodies for x in (*body.velocity, body.angular_velocity)), 0.0, 0.0, 0.0]),
        "tolerance": float_array([mechanism.assembly.tolerance]),
        "length": float_array([compiled.length]),
        "points": float_array(joint_points(mechanism)[1], 2),
    }


def _with_traced_numbers(spec: RunSpec, paths: Sequence[Path], trace: Trace) -> RunSpec:
    """Return a spec with traced numbers at some key paths, and in the expressions that contain them."""
    parameters: dict[str, Any] = dict(spec.parameters)
    data = {"model": canonical(spec.model)}
    for path in paths:
        holder: Any = {**data, "parameters": parameters}
        for key in path[:-1]:
            holder = holder[key]
        value = holder[path[-1]]
        if path in spec.written or not isinstance(value, int | float) or isinstance(value, bool):
            raise UntraceableError("the value is not a number")
        holder[path[-1]] = trace.input(float(value))
    numbers = parameter_values(parameters)
    traced = {name for name, value in numbers.items() if is_traced(value)}
    for path, written in spec.written.items():
        if not traced.isdisjoint(names_in(written)):
            put(data, path, written.value(numbers, path))
    return spec.with_model(with_numbers(spec.model, data["model"]), parameters, numbers)
