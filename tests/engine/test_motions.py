"""Jets of motions, evaluated in compiled code, against SymPy's derivatives in 40 digits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, make_interp_spline

from mbdkit.base.errors import SpecError
from mbdkit.engine.assembly import assemble
from mbdkit.engine.kernels.table_rows import LOAD
from mbdkit.expressions.parser import Expression
from mbdkit.mechanism.mechanism import Mechanism

from .compiled import Compiled

T = sp.Symbol("t", real=True)

OPERATIONS = ["3.25", "t", "t + 2.5", "2.5 - t", "0.3*t*t", "t/(1 + t*t)", "(1 + t)/(2 - 0.3*t)", "-t"]
OPERATIONS += ["t**2", "t**3", "t**7", "t**-1", "t**-3", "t**0", "t**1", "t**0.5", "t**2.5", "t**-1.5", "(1 + t)**t"]
OPERATIONS += ["2**t", "2.5**(0.3*t)", "t**(sin(t) + 2)", "sin(3*t)", "cos(0.7*t + 1)", "tan(0.3*t)", "asin(0.2*t)"]
OPERATIONS += ["acos(0.2*t - 0.3)", "atan(2*t)", "atan2(t, 2)", "atan2(t*t - 3, t - 2)", "atan2(sin(t), cos(t) - 2)"]
OPERATIONS += ["exp(-0.4*t)", "log(1 + t)", "sqrt(1 + t)", "abs(t - 9)", "abs(sin(3*t))", "tanh(t - 1)", "min(t, t*t)"]
OPERATIONS += ["max(sin(t), cos(t))", "min(t, 0.5, t*t - 1)", "max(2*t, 3 - t, exp(t)/4)", "0.5*sin(2*pi*t)"]
OPERATIONS += ["sin(t)**2 + cos(t)**2", "exp(sin(t**2))*log(2 + cos(t))/(1 + t**4)"]
TIMES = (0.15, 0.83, 1.7, 2.9)


def jets(texts: list[Any], times: tuple[float, ...]) -> np.ndarray:
    """Return value, first and second derivative (times, texts, 3) as the compiled kernel has them."""
    m = Mechanism()
    body = m.body("body", mass=1.0, inertia=1.0)
    for i, text in enumerate(texts):
        m.torque(f"m{i}", body, value=text)
    c = Compiled(m)
    found = []
    for t in times:
        c.constraints(c.q, t=t)
        found.append(c.scratch.u[c.top.loads[:, LOAD.x]].copy())
    return np.array(found)


def expected_jet(text: str, t: float) -> list[float]:
    expression = Expression.parse(text).to_sympy()
    derivatives = [expression, expression.diff(T), expression.diff(T, 2)]
    return [float(d.subs(T, sp.Float(t, 40)).evalf(40).replace(sp.DiracDelta, lambda *_: 0)) for d in derivatives]


@pytest.fixture(scope="module")
def all_jets() -> np.ndarray:
    return jets(OPERATIONS, TIMES)


@pytest.mark.parametrize("text", OPERATIONS)
def test_every_operation_has_the_value_rate_and_acceleration_of_sympy(text: str, all_jets: np.ndarray) -> None:
    found = all_jets[:, OPERATIONS.index(text)]
    expected = np.array([expected_jet(text, t) for t in TIMES])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=2e-15 * max(1.0, np.abs(expected).max()))


AT_ZERO = {
    "t**0": (1.0, 0.0, 0.0),
    "t**1": (0.0, 1.0, 0.0),
    "t**2": (0.0, 0.0, 2.0),
    "t**3": (0.0, 0.0, 0.0),
    "3*t**2 - t**3 + t": (0.0, 1.0, 6.0),
    "(t - 1)**2": (1.0, -2.0, 2.0),
    "(t + 2)**-1": (0.5, -0.25, 0.25),
    "(t + 1)**-2": (1.0, -2.0, 6.0),
    "t*t": (0.0, 0.0, 2.0),
    "abs(t)": (0.0, 1.0, 0.0),
    "sin(t)/cos(t)": (0.0, 1.0, 0.0),
}


@pytest.mark.parametrize("text", AT_ZERO)
def test_powers_are_right_at_time_zero(text: str) -> None:
    # expected: differentiated by hand
    np.testing.assert_allclose(jets([text], (0.0,))[0, 0], AT_ZERO[text], rtol=1e-14, atol=1e-15)


def test_a_negative_power_of_zero_is_not_finite() -> None:
    assert not np.isfinite(jets(["t**-1"], (0.0,))[0, 0, 0])


def test_negative_bases_keep_their_sign_in_whole_powers() -> None:
    np.testing.assert_allclose(jets(["(t - 3)**3"], (1.0,))[0, 0], (-8.0, 12.0, -12.0), rtol=1e-14)


TABLES = {
    "seven points": ([-1.0, -0.4, 0.1, 0.2, 1.4, 1.5, 3.0], [0.3, 2.0, -1.0, -1.1, 0.0, 4.0, 4.5]),
    "four points": ([0.0, 0.5, 1.0, 3.0], [1.0, -2.0, 0.5, 0.25]),
    "three points": ([0.0, 1.0, 3.0], [1.0, -2.0, 0.5]),
    "two points": ([0.0, 3.0], [1.0, -2.0]),
    "many points": (np.linspace(0.0, 3.0, 400).tolist(), np.sin(np.linspace(0.0, 7.0, 400) ** 2).tolist()),
}


@pytest.mark.parametrize("table", TABLES)
def test_a_table_has_the_value_rate_and_acceleration_of_the_spline_of_scipy(table: str) -> None:
    # expected: CubicSpline with its own default ends, at the points, between them and a little outside
    columns = TABLES[table]
    spline = CubicSpline(*columns)
    times = tuple(np.concatenate([columns[0], np.linspace(columns[0][0] - 1e-9, columns[0][-1] + 1e-9, 101)]))
    found = jets([{"table": columns}], times)[:, 0]
    for order in range(3):
        expected = spline(times, order)
        np.testing.assert_allclose(found[:, order], expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())


NO_DERIVATIVES = {"natural": [(3, 0.0), (4, 0.0)], "clamped": [(1, 0.0), (2, 0.0)]}
"""Derivatives of a quintic spline that vanish at either end."""


def spline_of_scipy(columns: Any, interpolation: str, ends: str) -> Any:
    """Return the spline of SciPy for a table with these options."""
    if interpolation == "cubic":
        return CubicSpline(*columns, bc_type=ends)
    return make_interp_spline(*columns, k=5, bc_type=(NO_DERIVATIVES[ends],) * 2 if ends in NO_DERIVATIVES else ends)


@pytest.mark.parametrize("table", ["seven points", "two points"])
@pytest.mark.parametrize("ends", ["natural", "clamped", "periodic", "not-a-knot"])
@pytest.mark.parametrize("interpolation", ["cubic", "quintic"])
def test_splines_with_other_ends_are_those_of_scipy(table: str, ends: str, interpolation: str) -> None:
    # expected: SciPy's splines at the points, between them, a little outside, and for periodic ones far outside
    columns = [list(column) for column in TABLES[table]]
    if ends == "periodic":
        columns[1][-1] = columns[1][0]
    elif interpolation == "quintic" and ends == "not-a-knot" and len(columns[0]) < 6:
        return
    first, last = columns[0][0], columns[0][-1]
    spline = spline_of_scipy(columns, interpolation, ends)
    beyond = 2.3 * (last - first) if ends == "periodic" else 1e-9
    times = tuple(np.concatenate([columns[0][:-1], np.linspace(first - beyond, last + beyond, 301)]))
    found = jets([{"table": columns, "interpolation": interpolation, "ends": ends}], times)[:, 0]
    pieces = 1.0 / np.min(np.diff(columns[0]))
    for order in range(3):
        expected = spline(times, order)
        rounding = 1e-13 * max(np.abs(expected).max(), pieces**order * np.abs(columns[1]).max())
        np.testing.assert_allclose(found[:, order], expected, rtol=0, atol=rounding)


def test_lines_repeat_if_they_are_periodic() -> None:
    # expected: a sawtooth, by hand
    table = {"table": [[1.0, 2.0, 4.0], [0.5, 2.5, 0.5]], "interpolation": "linear", "ends": "periodic"}
    found = jets([table], (0.5, 1.25, 3.0, 4.5, 7.0, -2.0))[:, 0]
    np.testing.assert_allclose(found[:, 0], (1.0, 1.0, 1.5, 1.5, 0.5, 0.5), rtol=1e-15)
    np.testing.assert_allclose(found[:5, 1], (-1.0, 2.0, -1.0, 2.0, 2.0))


def test_tables_stand_beside_expressions_and_each_other_and_equal_ones_are_kept_once() -> None:
    first, second = ({"table": TABLES[name]} for name in ("seven points", "four points"))
    mixed = ["0.3*t*t", first, 2.5, second, "sin(3*t)", first]
    together = jets(mixed, (1.3,))[0]
    np.testing.assert_array_equal(together, [jets([motion], (1.3,))[0, 0] for motion in mixed])
    m = Mechanism()
    body = m.body("body", mass=1.0, inertia=1.0)
    for i, motion in enumerate(mixed):
        m.torque(f"m{i}", body, value=motion)
    assert len(Compiled(m).compiled.motions) == 5


@pytest.mark.parametrize(
    "table", [[[0.0, 5e-324, 1.0, 2.0], [0.0, 1.0, 0.0, 1.0]], [[0.0, 1.0, 2.0, 3.0], [0.0, 1e308, -1e308, 1e308]]]
)
def test_a_table_whose_spline_overflows_is_refused_at_the_start(table: list[list[float]]) -> None:
    m = Mechanism()
    m.torque("push", m.body("body", mass=1.0, inertia=1.0), value={"table": table})
    with pytest.raises(SpecError, match=r"forces\.push\.value: the spline through this table is not finite"):
        assemble(m)


LEAF = st.sampled_from(["t", "0.7", "2", "1.5", "(t - 1.3)", "(0.4*t + 2)"])


def _nested(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    smooth = ["sin({})", "cos({})", "tanh({})", "atan({})", "exp(tanh({}))", "log(2 + sin({}))", "sqrt(1 + ({})**2)"]
    inverse = ["asin(tanh({})/2)", "acos(tanh({})/2)", "tan(tanh({}))"]
    powers = ["-({})", "({})**2", "({})**3", "(2 + cos({}))**-2", "(2 + cos({}))**1.5"]
    arithmetic = ["({}) + ({})", "({}) - ({})", "({}) * ({})", "({}) / (2 + cos({}))"]
    binary = st.sampled_from([*arithmetic, "(2 + sin({}))**tanh({})", "atan2({}, 3 + sin({}))"])
    unary = st.builds(str.format, st.sampled_from([*smooth, *inverse, *powers]), inner)
    return st.one_of(unary, st.builds(str.format, binary, inner, inner))


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(text=st.recursive(LEAF, _nested, max_leaves=5), t=st.sampled_from([0.3, 1.1, 2.7]))
def test_nested_expressions_have_the_derivatives_of_sympy(text: str, t: float) -> None:
    # expected: SymPy in 40 digits; round-off of nested operations grows with the sizes of the jet's entries
    found, expected = jets([text], (t,))[0, 0], np.array(expected_jet(text, t))
    size = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11 * size)
