"""Which combinations of parameters are determined, against the equations of models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from tests.identify.models import IDENTIFIABLE, SIMULATED, UNIDENTIFIABLE, Case, T, swing

import mbdkit
from mbdkit import RunError
from mbdkit_identify.identifiability import Identifiability, combinations
from tests.margins import assert_within

UNNAMED = {"motor, speed measured"}
"""Cases whose combinations have no form that is looked for."""


def identify(case: Case, *, exact: bool) -> Identifiability:
    sensitivity, error = (case.exact, 1e-11) if exact else (case.differences, 1e-6)
    return combinations([*case.values], [*case.values.values()], sensitivity, spec=case.spec, error=error)


def gradients(case: Case, texts: list[str], *, moved: bool = False) -> np.ndarray:
    """Return the relative derivatives of formulas at the values, or beside them, in rows of unit length."""
    values = dict(case.spec.numbers) if case.spec else {}
    values |= {
        name: value * (1.1 if moved else 1) + 0.01 * i * moved for i, (name, value) in enumerate(case.values.items())
    }
    symbols = {name: sp.Symbol(name) for name in values}
    formulas = sp.Matrix([sp.sympify(text, locals=symbols) for text in texts])
    slopes = formulas.jacobian([symbols[name] for name in case.values]).subs(values).evalf()
    rows = np.array(slopes.tolist(), dtype=float) * [abs(value) or 1.0 for value in case.values.values()]
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def check(case: Case, result: Identifiability) -> None:
    """Check that the formulas are functions of the right combinations, and these of the formulas."""
    undetermined = {name for group in result.combinations for name in group.names}
    assert undetermined == {name for name, known in zip(result.names, result.identifiable, strict=True) if not known}
    determined = case.determined.split(";")
    assert result.rank == len(determined)
    for group in result.combinations:
        columns = [result.names.index(name) for name in group.names]
        relative = group.directions / [abs(case.values[name]) or 1.0 for name in group.names]
        assert np.max(np.abs(relative), axis=1) == pytest.approx(0.01)
        assert_within(gradients(case, determined)[:, columns] @ relative.T, 1e-5)
    if case.name not in UNNAMED:
        texts = [
            *(set(result.names) - undetermined),
            *(text for group in result.combinations for text in group.formulas),
        ]
        right, named = gradients(case, determined, moved=True), gradients(case, texts, moved=True)
        ranks = [np.linalg.matrix_rank(rows, tol=1e-6) for rows in (right, named, np.vstack([right, named]))]
        assert ranks == [result.rank] * 3
        assert len(texts) == result.rank


@pytest.mark.parametrize("exact", [True, False], ids=["exact", "differences"])
@pytest.mark.parametrize("case", UNIDENTIFIABLE, ids=lambda case: case.name)
def test_right_combinations_are_named_and_nothing_else_has_an_interval(case: Case, exact: bool) -> None:
    check(case, identify(case, exact=exact))


@pytest.mark.parametrize("case", UNIDENTIFIABLE, ids=lambda case: case.name)
def test_combinations_do_not_depend_on_the_values(case: Case) -> None:
    factors = np.random.default_rng(len(case.name)).uniform(0.7, 1.4, len(case.values))
    moved = {name: value * factor for (name, value), factor in zip(case.values.items(), factors, strict=True)}
    check(case := replace(case, values=moved), identify(case, exact=True))


@pytest.mark.parametrize("case", SIMULATED, ids=lambda case: case.name)
def test_base_parameters_of_mechanisms_are_named(case: Case) -> None:
    check(case, identify(case, exact=False))


@pytest.mark.parametrize("case", IDENTIFIABLE, ids=lambda case: case.name)
def test_badly_determined_parameters_are_not_called_undetermined(case: Case) -> None:
    result = identify(case, exact=case.spec is None)
    assert result.rank == len(case.values)
    assert result.identifiable.all()
    assert not result.combinations


def test_texts() -> None:
    cases = [case for case in UNIDENTIFIABLE if len(case.values) < 5]
    texts = {case.name: [group.text for group in identify(case, exact=True).combinations] for case in cases}
    assert texts["oscillator without force"] == ["only the ratio m/k is determined"]
    assert texts["springs in parallel"] == ["only the sum k1 + k2 is determined"]
    assert texts["gain of a sensor and length"] == ["only the product gain*l is determined"]
    assert texts["inertia and mass on an arm"] == ["only J + l**2*m is determined"]
    assert texts["friction never active"][1] == "mu is not determined: no residual depends on it"
    assert texts["free damped oscillator"] == ["only m/c and m/k are determined"]


def test_unknown_forms_are_directions_with_units() -> None:
    case = Case("", {"a": 1.0, "b": 0.4}, lambda a, b: np.cos(T * (a**3 + np.sin(a * b))))
    (group,) = combinations(["a", "b"], [1.0, 0.4], case.exact, units={"a": "N/m"}).combinations
    slope = -np.cos(0.4) / (3 + 0.4 * np.cos(0.4))  # da/db at constant a**3 + sin(a b)
    assert group.formulas == ()
    assert group.directions[0, 0] / group.directions[0, 1] == pytest.approx(slope)
    assert "only combinations are determined: changing a by" in group.text
    assert "N/m and b by" in group.text


def test_parameters_may_be_key_paths() -> None:
    path = "model.bodies.a.mass"
    spec = SIMULATED[0].spec
    assert spec is not None
    run = mbdkit.prepare(spec).run
    case = Case("", {path: 1.2, "J": 0.05, "c": 0.3}, lambda *p: run(
        parameters=dict(zip((path, "J", "c"), map(float, p), strict=True))).bodies["a"].angle[:])  # fmt: skip
    result = combinations([*case.values], [*case.values.values()], case.differences, spec=spec, error=1e-6)
    assert [group.formulas for group in result.combinations] == [(f"c*{path}", f"J + c**2*{path}")]


def test_derivatives_that_are_not_finite_are_refused() -> None:
    with pytest.raises(RunError, match="not finite"):
        combinations(["a"], [1.0], lambda p: np.full((3, 1), np.nan))


def test_points_where_the_model_fails_are_avoided() -> None:
    """A spring whose stiffness cannot exceed 1 % of its value."""

    def sensitivity(values: np.ndarray) -> np.ndarray:
        if np.any(values > [3.03, 5.05]):
            raise RunError("the run failed")
        return UNIDENTIFIABLE[0].exact(values)

    (group,) = combinations(["k1", "k2"], [3.0, 5.0], sensitivity, error=1e-11).combinations
    assert group.formulas == ("k1 + k2",)


def test_at_rest_only_the_start_is_determined() -> None:
    """At rest, stiffness and mass have no effect at any values; the start has."""
    case = Case("", {"k": 3.0, "m": 2.0, "x0": 0.0}, lambda k, m, x0: swing(k / m, 0.0, x0), "x0")
    result = identify(case, exact=True)
    check(case, result)
    assert [group.names for group in result.combinations] == [("k",), ("m",)]
