"""Elementary functions of the machine code against MPFR, at all levels of this processor."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable
from pathlib import Path

import gmpy2
import numpy as np
import pytest
from tests.builder.elementary_cases import CASES, MPFR, largest_error
from tests.builder.elementary_code import LANES, NUMBERS, argument_count, built, evaluate

from mbdkit.base import elementary
from mbdkit.base.errors import MbdkitError
from mbdkit.engine.kernels.elementary import FUNCTIONS
from mbdkit.engine.native.levels import is_able, this_platform

COUNT, COUNT_IN_PYTHON = 100_000, 2_000

LEVELS = [level for level in this_platform().levels if is_able(level)]
names = pytest.mark.parametrize("name", FUNCTIONS)


@pytest.fixture(scope="module")
def codes(tmp_path_factory: pytest.TempPathFactory) -> list[ctypes.CDLL]:
    """Return the libraries of all levels, the best level first, which parallel processes of tests share."""
    pytest.importorskip("ziglang")
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "elementary"
    folder.mkdir(exist_ok=True)
    return built(folder, *LEVELS)


def in_python(name: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function that calls the Python function for each number."""
    count, function = argument_count(name), FUNCTIONS[name]
    return lambda x, y: np.array([function(*pair[:count]) for pair in zip(x.tolist(), y.tolist(), strict=True)])


def assert_same(a: np.ndarray, b: np.ndarray) -> None:
    """Assert that numbers are equal to the bit, except for the bits of NaN."""
    is_number = ~np.isnan(a)
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(np.signbit(a[is_number]), np.signbit(b[is_number]))


def test_each_function_is_tested() -> None:
    assert set(CASES) == set(FUNCTIONS)


def test_machine_code_takes_no_elementary_function_from_the_c_library(codes: list[ctypes.CDLL]) -> None:
    # The test library calls each function of the C library once, for comparison, and none for numbers and lanes.
    from mbdkit_builder.binary_files import check_imports, read

    for code in codes:
        content = Path(code._name).read_bytes()
        assert read(content).imported == set(FUNCTIONS)
        with pytest.raises(MbdkitError, match=r"elementary-.* calls acos, .* of the C library"):
            check_imports(content, "linux", Path(code._name).stem)


@names
def test_the_error_is_below_one_unit_of_the_last_place(name: str, codes: list[ctypes.CDLL]) -> None:
    # expected: MPFR with 150 binary digits
    case = CASES[name]
    x, y = case.arguments(COUNT)
    error, where = largest_error(case, x, y, evaluate(codes[0], NUMBERS, name)(x, y))
    assert error < 1.0, where


def test_the_error_of_lgamma_of_negative_arguments_is_below_its_bound(codes: list[ctypes.CDLL]) -> None:
    # expected: MPFR; near the zeros the error is absolute, as the guide says
    rng = np.random.default_rng(5)
    x = -np.concatenate([rng.uniform(*ends, COUNT // 4) for ends in ((0.0, 30.0), (0.0, 2.0), (2.0, 4.0), (20.0, 1e5))])
    values = evaluate(codes[0], NUMBERS, "lgamma")(x, x)
    with gmpy2.context(MPFR):
        for a, value in zip(x.tolist(), values.tolist(), strict=True):
            exact = gmpy2.lgamma(gmpy2.mpfr(a))[0]
            assert abs(gmpy2.mpfr(value) - exact) <= max(0.9 * math.ulp(float(exact)), 2.0**-57), a


@names
def test_special_values_are_those_of_the_standards(name: str, codes: list[ctypes.CDLL]) -> None:
    special = CASES[name].special
    x, y = np.array([[*arguments, 1.0][:2] for arguments, _ in special for _ in range(8)]).T.copy()
    expected = np.repeat([value for _, value in special], 8)
    for code in codes:
        for kind in (NUMBERS, LANES):
            assert_same(evaluate(code, kind, name)(x, y), expected)
    assert_same(in_python(name)(x, y), expected)


@names
def test_numbers_lanes_and_python_have_the_same_bits_at_all_levels(name: str, codes: list[ctypes.CDLL]) -> None:
    x, y = CASES[name].arguments(COUNT, seed=1)
    x, y = np.random.default_rng(0).permuted([x, y], axis=1)
    first, *others = (evaluate(code, kind, name)(x, y) for code in codes for kind in (NUMBERS, LANES))
    for other in others:
        assert_same(first, other)
    assert_same(in_python(name)(x[:COUNT_IN_PYTHON], y[:COUNT_IN_PYTHON]), first[:COUNT_IN_PYTHON])


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.symmetry])
def test_odd_and_even_functions_are_so_to_the_bit(name: str, codes: list[ctypes.CDLL]) -> None:
    x, y = CASES[name].arguments(COUNT, seed=2)
    function = evaluate(codes[0], NUMBERS, name)
    assert_same(function(-x, y), math.copysign(1.0, CASES[name].symmetry) * function(x, y))


@names
def test_functions_for_python_have_the_bits_of_the_machine_code(name: str, codes: list[ctypes.CDLL]) -> None:
    x, y = CASES[name].arguments(800, seed=3)
    expected = evaluate(codes[0], NUMBERS, name)(x, y)
    function, count = getattr(elementary, name), argument_count(name)
    assert_same(function(*(one.reshape(20, 40) for one in (x, y)[:count])).ravel(), expected)
    assert_same(np.array([function(*pair[:count]) for pair in zip(x.tolist(), y.tolist(), strict=True)]), expected)
