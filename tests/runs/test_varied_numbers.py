"""Formulas of the arrays of mechanisms give what building and compiling each mechanism gives, or nothing."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path
from mbdkit.base.traced_numbers import Trace, UntraceableError, hypot, largest, sqrt
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.consistent_start import Starts
from mbdkit.runs.findings import findings
from mbdkit.runs.varied_numbers import STATE, Stacks, VariedNumbers, arrays_of
from mbdkit.spec.loading import load_spec
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs

KNEE: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": {"k": 100.0, "c": 2.0, "free": 0.3, "m": 3.0},
    "model": {
        "name": "mechanism",
        "bodies": {
            "thigh": {"mass": "2*m + sqrt(k)", "inertia": 0.1, "position": [0.0, -0.2]},
            "shank": {"mass": "m", "inertia": 0.05, "position": [0.0, -0.6]},
        },
        "joints": {
            "hip": {"type": "revolute", "bodies": ["ground", "thigh"], "at": [0, 0]},
            "knee": {"type": "revolute", "bodies": ["thigh", "shank"], "at": [0.0, -0.4]},
        },
        "forces": {
            "strap": {
                "type": "spring-damper", "bodies": ["ground", "shank"], "from": [0.3, 0.0], "to": [0.0, -0.7],
                "stiffness": "k", "damping": "c", "free_length": "free",
            },
            "spring": {"type": "torsion-spring", "bodies": ["thigh", "shank"], "stiffness": 20.0, "free_angle": 0.1},
            "stop": {
                "type": "law", "law": "one-sided", "acts": "tension", "stiffness": 30.0, "free_length": "min(free, m)",
                "pathway": {"type": "two-points", "bodies": ["ground", "thigh"], "from": [0.1, 0.1], "to": [0.0, -0.2]},
            },
        },
    },
    "integrator": {"name": "rk4"},
    "time": {"end": 0.1, "step": 0.01},
}  # fmt: skip
EXAMPLES = ("car-axis", "chain", "double-pendulum", "four-bar", "pendulum", "slider-crank", "spring-pendulum")
DRAWS = int(os.environ.get("MBDKIT_DRAWS", "5"))  #: Pairs of specs of each example.
EXTREME = (0.0, -0.0, -1.0, 1.0, 1e-300, 5e-324, 1e300, -1e300, 7.0, 360.0)


def numbers_in(data: Any, path: Path) -> Iterator[Path]:
    """Yield the key paths of the floats in plain data."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield from numbers_in(value, (*path, key))
    if isinstance(data, float):
        yield path


def paths_of(spec: RunSpec) -> list[Path]:
    """Return the key paths of the numbers of the model that no expression gives, and of the parameters."""
    data = json.loads(spec.canonical_json())
    return [*numbers_in(data["model"], ("model",)), *numbers_in(data.get("parameters", {}), ("parameters",))]


def assert_equal_to_ordinary(spec: RunSpec, paths: list[Path], values: np.ndarray) -> int:
    """Compare the arrays and findings with those of each spec; return the number of members with formulas."""

    def varied(numbers: Any) -> RunSpec:
        return VariedSpecs(spec.canonical_json()).spec([*zip(paths, numbers, strict=True)])

    varied_numbers = VariedNumbers(paths, varied)
    stacks = varied_numbers.stacks(values)
    if stacks is None:
        return 0
    variant = varied_numbers.variants[0]
    for number, member in enumerate(stacks.members.tolist()):
        other = varied(values[member].tolist())  # raises no error
        compiled = compile_mechanism(other.mechanism())
        expected = arrays_of(other.mechanism(), compiled)
        assert len(expected) == len(compiled.topology) + len(STATE)
        for name, array in expected.items():
            assert array.tobytes() == member_array(stacks, variant.base, name, number).tobytes(), (name, values[member])
        assert tuple(findings("spec", other, ())) == variant.findings
        with suppress(SpecError):
            start = Starts().at_start(other.mechanism(), other.time.start, other.time.final)
            if not start.assembled.changed:
                assert start.q0.tobytes() == stacks.q[number].tobytes()
    return len(stacks.members)


def member_array(stacks: Stacks, base: Any, name: str, number: int) -> np.ndarray:
    """Return an array of one member."""
    if name in STATE:
        return np.ascontiguousarray(getattr(stacks, name)[number])
    return np.ascontiguousarray(stacks.topology[name][number]) if name in stacks.topology else base[name]


@pytest.mark.parametrize("example", [*EXAMPLES, "knee"])
def test_formulas_give_the_bits_and_findings_of_building_and_compiling(example: str) -> None:
    spec = load_spec(KNEE if example == "knee" else example, ())
    rng, paths, covered = np.random.default_rng(len(example)), paths_of(spec), 0
    start = json.loads(spec.canonical_json())
    for _ in range(DRAWS):
        some = [paths[k] for k in rng.choice(len(paths), 2, replace=False)]
        given = np.array([float(value_at(start, path)) for path in some])
        covered += assert_equal_to_ordinary(spec, some, given * rng.uniform(0.9, 1.1, (2, 2)))
    assert covered >= DRAWS  # half of the members


@pytest.mark.parametrize("example", ["double-pendulum", "knee"])
def test_numbers_that_change_the_structure_have_right_formulas_or_none(example: str) -> None:
    spec = load_spec(KNEE if example == "knee" else example, ())
    for path in paths_of(spec):
        assert_equal_to_ordinary(
            spec,
            [path],
            np.array([[value_at(json.loads(spec.canonical_json()), path)], *([value] for value in EXTREME)]),
        )


def test_the_order_of_many_angles_needs_no_further_formulas() -> None:
    angles = [("model", "angles", k) for k in range(10)]
    data = {**KNEE, "parameters": {}, "model": {"name": "n-pendulum", "angles": [0.1] * 10}}
    values = np.random.default_rng(1).uniform(-3, 3, (20, 10))
    assert assert_equal_to_ordinary(load_spec(data, ()), angles, values) == 20


def value_at(data: Any, path: Path) -> Any:
    for key in path:
        data = data[key]
    return data


@pytest.mark.parametrize("path", [("a", 0), ("b", 0), ("b", 1), ("stiffness", "bending"), ("mass_per_length",)])
def test_numbers_of_a_beam_reach_all_its_nodes(path: Path) -> None:
    # expected: building and compiling a beam with the other number
    stiffness = {"axial": 100.0, "shear": 50.0, "bending": 2.0}
    beam = {"a": [0.1, 0.0], "b": [1.0, 0.2], "elements": 4, "stiffness": stiffness, "mass_per_length": 3.0}
    joint = {"type": "revolute", "bodies": ["ground", "strip.0"], "at": [0.1, 0.0]}
    model = {"name": "mechanism", "beams": {"strip": beam}, "joints": {"pin": joint}}
    spec = load_spec(
        {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}, ()
    )
    assert_equal_to_ordinary(spec, [("model", "beams", "strip", *path)], np.array([[0.15], [0.3]]))


def test_numbers_that_validation_changes_have_no_formulas() -> None:
    # expected: none for the axis of a cuff, which validation divides by its length
    spec, path = load_spec("knee-orthosis", ()), ("model", "cuffs", "thigh", "axis", 1)
    assert float(value_at(json.loads(spec.canonical_json()), path)) == 1.0
    assert assert_equal_to_ordinary(spec, [path], np.array([[1.5]])) == 0


def test_a_traced_number_that_is_lost_has_no_formulas_even_if_the_error_is_caught() -> None:
    trace = Trace()
    number = trace.input(2.0)
    with suppress(Exception):
        math.sin(number)
    with pytest.raises(UntraceableError):
        trace.formulas([number])


def test_formulas_of_many_numbers_are_those_of_single_ones() -> None:
    # expected: the bits of single calls, and no results where these have none
    trace = Trace()
    x, y = trace.input(0.7), trace.input(0.3)
    with trace.recording():
        quotient = elementary.cos(x) / (y - 0.25)
        powers = hypot(x, quotient) ** 2.0 + sqrt(largest(x, y, -0.0)) + (x - y) ** 0.5
        formulas = trace.formulas([powers, quotient, x if y < x else y])
    rng = np.random.default_rng(3)
    values = np.vstack([rng.uniform(-1.0, 1.0, (300, 2)), rng.uniform(0.0, 9.0, (50, 1)) * [1.0, 0.5]])
    values = np.vstack([values, [[0.5, 0.25], [0.3, 0.3], [math.inf, 1.0], [1e308, -1e308]]])
    known, results = formulas.of_columns(values)
    single = [formulas(*numbers) for numbers in values.tolist()]
    assert 50 <= known.sum() < len(values)
    assert known.tolist() == [found is not None for found in single]
    assert [results[k].tobytes() for k in np.flatnonzero(known)] == [
        np.array(found).tobytes() for found in single if found is not None
    ]


def test_formulas_hold_only_while_comparisons_have_the_same_outcome() -> None:
    trace = Trace()
    x = trace.input(2.0)
    formulas = trace.formulas([1.0 / x if x > 1.0 else x])
    assert formulas(4.0) == (0.25,)
    assert formulas(1.0) is None
    assert formulas(math.inf) is None  # 0 is not told from other numbers that became 0
