"""The arrays of mechanisms whose specs differ only in a few numbers, by formulas that were recorded once.

The model is built, checked and compiled once with numbers that record how code computes with them
(`mbdkit.base.traced_numbers`). The formulas of the entries of the compiled arrays that these numbers reach are then
evaluated for other values, with the same bits as by building and compiling. They hold for values with which all
comparisons have the same outcome; for other values, the model is built and recorded again, and some have no formulas.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import Path, canonical
from mbdkit.base.traced_numbers import Formulas, Trace, UntraceableError, float_array, is_traced
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.lanes.lane_mechanisms import topology_of
from mbdkit.mechanism.checks import check_centers, check_springs
from mbdkit.mechanism.impure_items import impure_item_of
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import names_in, parameter_values
from mbdkit.mechanism.size import size_at_given_positions
from mbdkit.mechanism.traced_elements import with_numbers
from mbdkit.runs.corners import check_jumps
from mbdkit.runs.findings import StateWatchers, criteria, findings
from mbdkit.runs.law_ranges import has_ranges
from mbdkit.runs.preparation import timetable
from mbdkit.spec.reading import put
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.finding import Finding

MOST_VARIANTS = 8  #: Largest number of times that formulas are recorded, for other outcomes of comparisons.

STATE = ("q", "v", "tolerance", "longest", "size")  #: Arrays of a mechanism besides those of its topology.


@dataclass(frozen=True, eq=False)
class Stacks:
    """Numbers of M mechanisms that differ in nothing else.

    - `members`: (M,) indices of the mechanisms among those that were asked for.
    - `topology`: arrays (M, ...) of those fields of `Topology` that differ between the mechanisms.
    - `q`, `v`: (M, 3 (B + 1)) initial positions and velocities before assembly, ground last.
    - `tolerance`: (M, 1) tolerance of assembly.
    - `longest`: (M, 1) characteristic length [m].
    - `size`: (M, 1) size of the mechanism at its start [m]; see `mbdkit.mechanism.size`.
    """

    members: np.ndarray
    topology: Mapping[str, np.ndarray]
    q: np.ndarray
    v: np.ndarray
    tolerance: np.ndarray
    longest: np.ndarray
    size: np.ndarray


@dataclass(frozen=True, eq=False)
class Variant:
    """The formulas of the arrays for one outcome of all comparisons.

    - `base`: arrays with the numbers for which the formulas were recorded, by name; see `STATE` and `Topology`.
    - `places`: for each of these arrays that varies, the indices in the flat array, and those of the results.
    - `formulas`: the formulas.
    - `compiled`, `table`: the compiled mechanism for these numbers, and the timetable without limits on states.
    - `findings`: what criteria of specs find, which is equal for all numbers.
    - `watched`: whether criteria look at the recorded states of each run, or at its spec at the end.
    """

    base: Mapping[str, np.ndarray]
    places: Mapping[str, tuple[np.ndarray, np.ndarray]]
    formulas: Formulas
    compiled: CompiledMechanism
    table: Timetable
    findings: tuple[Finding, ...]
    watched: bool

    @classmethod
    def of(
        cls, spec: RunSpec, paths: Sequence[Path], measures: Sequence[str] = (), *, keeps_texts: bool = False
    ) -> Variant:
        """Record the formulas of a valid spec for the numbers at some key paths, also of those in functions of the
        state if the trace `keeps_texts`.

        Raises an error, mostly UntraceableError, if the numbers are used in a way that cannot be recorded, or if code
        of others takes part that is not `pure`.
        """
        if (other := impure_item_of(spec)) is not None:
            raise UntraceableError(f"{other.id} is not pure")
        compiled, table = compile_mechanism(spec.mechanism()), timetable(spec, None)
        base = arrays_of(spec.mechanism(), compiled)
        trace = Trace(keeps_texts=keeps_texts)
        with trace.recording():
            varied = _with_traced_numbers(spec, paths, trace)
            mechanism = varied.mechanism()
            check_jumps(varied)
            found = () if keeps_texts else tuple(findings("spec", varied, measures))
            recorded = compile_mechanism(mechanism)
            check_springs(mechanism.forces, mechanism.bodies.__getitem__)
            check_centers(mechanism.joints, mechanism.bodies.__getitem__)
            # `passive-laws` looks at the laws of forces only
            watched = any(isinstance(force, Law) for force in mechanism.forces.values())
            watched |= any(criterion.name != "passive-laws" for _, criterion in criteria("end", varied))
            if not keeps_texts:  # their texts have numbers
                watched |= StateWatchers(varied, recorded, 1.0).of_many is None or has_ranges(mechanism)
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
        return cls(base, places, trace.formulas(results), compiled, table, found, watched)

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Key that is equal for variants that differ only in floating-point numbers."""
        return topology_of(self.compiled), self.table, self.findings, self.watched, self.compiled.well_scaled

    def rows(self, name: str, results: np.ndarray) -> np.ndarray:
        """Return an array of M members (M, ...) from the results of their formulas (M, R)."""
        base = self.base[name]
        rows = base.reshape(1, -1).repeat(len(results), axis=0)
        if name in self.places:
            entries, columns = self.places[name]
            rows[:, entries] = results[:, columns]
        return rows.reshape(len(results), *base.shape)


class VariedNumbers:
    """Arrays of the mechanisms of specs that differ only in the numbers at some key paths.

    - `paths`: key paths of numbers of the model, or of named parameters.
    - `spec`: function that returns the valid spec with other numbers, in the order of `paths`.
    - `measures`: see `LaneRuns`.
    - `keeps_texts`: see `Variant.of`; the arrays are then all that may be used of the mechanisms.
    """

    def __init__(
        self, paths: Sequence[Path], spec: Callable[[Sequence[float]], RunSpec], measures: Sequence[str] = (), *,
        keeps_texts: bool = False,
    ):  # fmt: skip
        self.paths, self.spec, self._measures, self._keeps_texts = paths, spec, measures, keeps_texts
        self.variants: list[Variant] = []
        self._recorded = 0

    def results(self, numbers: Sequence[float]) -> tuple[Variant, tuple[float, ...]] | None:
        """Return the results of the formulas for some numbers; None if there are no formulas for them."""
        if not all(map(math.isfinite, numbers)):  # validation rejects them
            return None
        for variant in self.variants:
            if (results := variant.formulas(*numbers)) is not None:
                return variant, results
        made = self._new_variant(numbers)
        return None if made is None else (made, made.formulas(*numbers) or ())

    def variant(self, numbers: Sequence[float]) -> Variant | None:
        """Return the formulas for some numbers, without their results; None if there are none."""
        found = self.results(numbers) if self.variants else (self._new_variant(numbers),)
        return None if found is None else found[0]

    def stacks(self, values: np.ndarray) -> Stacks | None:
        """Return the arrays of N mechanisms with other numbers (N, K); None if there are formulas for none of them."""
        parts: dict[Variant, list[tuple[np.ndarray, np.ndarray]]] = defaultdict(list)
        left = np.arange(len(values))
        if len(values) > 1:
            self.results(values[0].tolist())  # which records formulas if there are none
            for variant in self.variants:
                known, results = variant.formulas.of_columns(values[left])
                parts[variant].append((left[known], results[known]))
                left = left[~known]
        for member in left.tolist():
            if (found := self.results(values[member].tolist())) is not None:
                parts[found[0]].append((np.array([member]), np.array([found[1]])))
        joined = {variant: [*map(_concatenated, zip(*some, strict=True))] for variant, some in parts.items()}
        if not (known_parts := {variant: part for variant, part in joined.items() if len(part[0])}):
            return None
        members = _concatenated([part[0] for part in known_parts.values()])
        names = {name for variant in known_parts for name in self._varying(variant)}
        arrays = {
            name: _concatenated([variant.rows(name, results) for variant, (_, results) in known_parts.items()])
            for name in (*STATE, *names.difference(STATE))
        }
        if len(members) > 1:
            order = np.argsort(members)
            members, arrays = members[order], {name: array[order] for name, array in arrays.items()}
        return Stacks(members=members, topology=arrays, **{name: arrays.pop(name) for name in STATE})

    def _varying(self, variant: Variant) -> Iterator[str]:
        """Yield the names of the arrays that differ between the mechanisms of this variant and the first one."""
        first = self.variants[0].base
        for name, array in variant.base.items():
            is_own = array is first[name] or array.tobytes() == first[name].tobytes()
            if name in variant.places or not is_own:
                yield name

    def _new_variant(self, numbers: Sequence[float]) -> Variant | None:
        """Record formulas for some numbers; None if that is not possible, or if there are many variants already."""
        if self._recorded >= MOST_VARIANTS:
            return None
        self._recorded += 1
        try:
            variant = Variant.of(self.spec(numbers), self.paths, self._measures, keeps_texts=self._keeps_texts)
        except (Exception, SystemExit):  # the spec is not valid, or code computes in a way that cannot be recorded
            return None
        if self.variants and variant.key != self.variants[0].key:
            return None
        self.variants.append(variant)
        return variant


def _concatenated(parts: Sequence[np.ndarray]) -> np.ndarray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def arrays_of(mechanism: Mechanism, compiled: CompiledMechanism) -> dict[str, np.ndarray]:
    """Return the arrays of a mechanism by name: those of its topology and of `STATE`."""
    bodies = mechanism.bodies.values()
    return {
        **compiled.topology._asdict(),
        "q": float_array([*(x for body in bodies for x in (*body.position, body.angle)), 0.0, 0.0, 0.0]),
        "v": float_array([*(x for body in bodies for x in (*body.velocity, body.angular_velocity)), 0.0, 0.0, 0.0]),
        "tolerance": float_array([mechanism.assembly.tolerance]),
        "longest": float_array([compiled.length]),
        "size": float_array([size_at_given_positions(mechanism)]),
    }


def _with_traced_numbers(spec: RunSpec, paths: Sequence[Path], trace: Trace) -> RunSpec:
    """Return a spec with traced numbers at some key paths, and in the expressions that contain them."""
    parameters: dict[str, Any] = dict(spec.parameters)
    data = {"model": canonical(spec.model)}
    for path in paths:
        holder: Any = None
        value: Any = {**data, "parameters": parameters}
        own: Path = ()
        for key in path:
            holder, own = value, (*own, int(key) if isinstance(value, list) else key)
            value = holder[own[-1]]
        if own in spec.written or not isinstance(value, int | float) or isinstance(value, bool):
            raise UntraceableError("the value is not a number")
        holder[own[-1]] = trace.input(float(value))
    numbers = parameter_values(parameters)
    traced = {name for name, value in numbers.items() if is_traced(value)}
    for path, written in spec.written.items():
        if not traced.isdisjoint(names_in(written)):
            put(data, path, written.value(numbers, path))
    return spec.with_model(with_numbers(spec.model, data["model"]), parameters, numbers)
