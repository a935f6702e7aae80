"""Tableaus: exact data that check themselves, against order conditions, quadrature and what the registry claims."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

from mbdkit.methods import INTEGRATORS, gauss, radau_iia, rk4, rk_gill, tableau
from mbdkit.methods.kinds import ExplicitRungeKutta, Tolerances
from mbdkit.methods.tableau import ButcherTableau, EmbeddedPair, TableauError, collocation, rooted_trees
from tests.integrators import stored_tableaus

SHIPPED = {"rk4": rk4.tableau(), "rk-gill": rk_gill.tableau()} | {f"gauss-{s}": gauss.tableau(s) for s in range(1, 7)}
SHIPPED |= {f"radau-iia-{s}": radau_iia.tableau(s) for s in (2, 3, 5)}
shipped = pytest.mark.parametrize("name", SHIPPED)
stages = pytest.mark.parametrize("s", range(1, 7))


def test_stored_results_of_packaged_tableaus_are_those_that_mpmath_computes() -> None:
    stored = Path(tableau.__file__).with_suffix(".json").read_text("utf-8")
    assert stored == stored_tableaus.text(), "run `python -m tests.integrators.stored_tableaus`"


def test_a_tableau_with_other_coefficients_is_checked_whatever_its_name() -> None:
    with pytest.raises(TableauError, match="order 3"):
        replace(rk4.tableau(), b=("1/6", "1/2", "1/6", "1/6"))


@pytest.mark.parametrize(("order", "number"), list(enumerate([1, 1, 2, 4, 9, 20, 48, 115, 286], start=1)))
def test_there_are_as_many_rooted_trees_as_cayley_counted(order: int, number: int) -> None:
    # expected: OEIS A000081
    assert len(rooted_trees(order)) == number


@shipped
def test_a_shipped_tableau_meets_the_order_conditions_of_all_rooted_trees(name: str) -> None:
    # expected: Butcher's conditions to the claimed order, at most 8
    SHIPPED[name].check_trees(min(SHIPPED[name].order, 8))


@shipped
def test_a_shipped_tableau_has_no_higher_order_than_it_claims(name: str) -> None:
    if SHIPPED[name].order < 9:
        with pytest.raises(TableauError, match=f"order {SHIPPED[name].order + 1}"):
            SHIPPED[name].check_trees(SHIPPED[name].order + 1)


@shipped
def test_what_the_registry_claims_is_what_the_tableau_is(name: str) -> None:
    plugin_name, _, count = name.rpartition("-") if name[-1].isdigit() and "-" in name else (name, "", "")
    plugin = next(p for p in INTEGRATORS if p.name == plugin_name)
    options = plugin.options(**({"stages": int(count)} if count else {}))
    claims, tableau = plugin.claims(options), SHIPPED[name]
    assert claims.order == tableau.order
    assert claims.stages == tableau.stages
    assert claims.symmetric == tableau.is_symmetric
    assert claims.symplectic == claims.quadratic_invariants == tableau.is_symplectic
    assert tableau.is_explicit == (not count)
    assert plugin.create(options).tableau == tableau


@stages
def test_gauss_nodes_and_weights_are_those_of_numpy(s: int) -> None:
    # expected: numpy.polynomial.legendre.leggauss, moved from [-1, 1] to [0, 1]
    nodes, weights = np.polynomial.legendre.leggauss(s)
    _, b, c = gauss.tableau(s).floats()
    np.testing.assert_allclose(c, (1 + nodes) / 2, rtol=0, atol=1e-15)
    np.testing.assert_allclose(b, weights / 2, rtol=0, atol=1e-15)


@stages
def test_gauss_collocates_polynomials_exactly(s: int) -> None:
    # expected: sum_j a_ij c_j^k = c_i^(k+1)/(k+1) for k < s, the definition of collocation
    a, _, c = gauss.tableau(s).floats()
    for k in range(s):
        np.testing.assert_allclose(a @ c**k, c ** (k + 1) / (k + 1), rtol=0, atol=1e-15)


@pytest.mark.parametrize("s", [1, 2, 3])
def test_closed_forms_are_the_collocation_on_the_roots_of_legendre(s: int) -> None:
    nodes = [sp.Rational(1, 2) + x / 2 for x in sorted(sp.real_roots(sp.legendre_poly(s, sp.Symbol("x"))))]
    built = collocation("by nodes", [sp.N(node, 60) for node in nodes], order=2 * s)
    for given, found in zip(gauss.tableau(s).floats(), built.floats(), strict=True):
        np.testing.assert_array_equal(given, found)


@shipped
def test_floats_are_the_exact_coefficients_rounded_once(name: str) -> None:
    exact = SHIPPED[name].to_sympy()
    for given, found in zip(exact, SHIPPED[name].floats(), strict=True):
        np.testing.assert_array_equal(np.array(sp.N(given, 40), dtype=float).reshape(found.shape), found)


@shipped
def test_weights_of_the_second_order_form_are_products_rounded_once(name: str) -> None:
    # expected: A A and A^T b in 40 digits
    a, b, _ = (sp.N(x, 40) for x in SHIPPED[name].to_sympy())
    squared, weights = SHIPPED[name].second_order_floats()
    np.testing.assert_allclose(np.array(a * a, dtype=float), squared, rtol=0, atol=1e-30)
    np.testing.assert_allclose(np.array(a.T * b, dtype=float).ravel(), weights, rtol=0, atol=1e-30)


def test_to_sympy_keeps_exact_coefficients_exact() -> None:
    a, b, c = gauss.tableau(2).to_sympy()
    assert a[0, 1] == sp.Rational(1, 4) - sp.sqrt(3) / 6
    assert list(b) == [sp.Rational(1, 2)] * 2
    assert sp.simplify(sum(a[1, :]) - c[1]) == 0


PAPER_S3: dict[str, Any] = {
    "a": [
        ["5/36", "2/9 + sqrt(15)/15", "5/36 + sqrt(15)/30"],
        ["5/36 + sqrt(15)/24", "2/9", "5/36 - sqrt(15)/24"],
        ["5/36 + sqrt(15)/30", "2/9 + sqrt(15)/15", "5/36"],
    ],
    "b": ["5/18", "4/19", "5/18"],
    "c": ["1/2 - sqrt(15)/10", "1/2", "1/2 + sqrt(15)/10"],
}


def test_the_printed_tableau_of_the_paper_is_refused_by_its_first_row() -> None:
    # expected: the source paper's Table 4 misprints a_12, a_13 and b_2 of the method with three stages
    with pytest.raises(TableauError, match=r"row 1 of a .* should sum to the node c1"):
        ButcherTableau("s3IRK as printed", order=6, **PAPER_S3)


def test_its_weights_alone_are_refused_too() -> None:
    right = gauss.tableau(3)
    with pytest.raises(TableauError, match="claims order 6, but an order condition of order 1"):
        ButcherTableau("s3IRK with b_2 as printed", right.a, PAPER_S3["b"], right.c, order=6)


def test_dense_output_without_an_error_estimate_ends_at_the_step_and_controls_none() -> None:
    # expected: Hairer, Norsett and Wanner (1993), II.6.10-6.11: dense output of order 3 of the method of order 4
    t = SHIPPED["rk4"]
    dense = [[1, -3 / 2, 2 / 3], [0, 1, -2 / 3], [0, 1, -2 / 3], [0, -1 / 2, 2 / 3]]
    pair = EmbeddedPair.without_error(t, dense)
    assert len(pair.error) == 0
    with pytest.raises(TableauError, match="rk4 has no error estimate"):
        ExplicitRungeKutta(t, pair, Tolerances(1e-6, 1e-6))
    with pytest.raises(TableauError, match="should have 4 rows of equal length"):
        EmbeddedPair.without_error(t, dense[:3])
    with pytest.raises(TableauError, match=r"does not end where the step ends.* by 0.667"):
        EmbeddedPair.without_error(t, [[*row[:2], 0.0] for row in dense])


def test_rounded_coefficients_are_held_to_round_off_and_not_to_less() -> None:
    a, b, c = (x.tolist() for x in gauss.tableau(2).floats())
    rounded = ButcherTableau("rounded", a, b, c, order=4)
    assert rounded.is_symmetric
    assert rounded.is_symplectic
    b[0] += 1e-9
    with pytest.raises(TableauError, match="order condition of order 1"):
        ButcherTableau("off", a, b, c, order=4)


def test_coefficients_may_be_fractions_integers_or_text() -> None:
    t = ButcherTableau("Heun", [[], [1]], [Fraction(1, 2), "1/2"], [0, 1], order=2)
    assert t.stages == 2
    assert t.a == ((0, 0), (1, 0))
    assert t.is_explicit
    assert not t.is_symmetric


UNREADABLE = ["sin(1)", "__import__('os')", "1/", "x", "1 if 1 else 2", "sqrt(2).real", "True", "sqrt()", "1/0"]
UNEVEN: list[tuple[Any, Any, Any]] = [
    ([[0, 0, 0], []], [1, 0], [0, 0]), ([[]], [1, 0], [0, 0]), ([[]], [1], [0, 0]), ([], [], []),
]  # fmt: skip


@pytest.mark.parametrize(
    ("a", "b", "c", "order", "words"),
    [
        *(([[]], [text], [0], 1, "cannot read the coefficient") for text in UNREADABLE),
        *((*cells, 1, "have inconsistent sizes") for cells in UNEVEN),
        *(([[]], [value], [0], 1, "") for value in (float("nan"), float("inf"))),
        *(([[]], [2], [0], order, "") for order in (0, -1)),
    ],
)
def test_coefficients_that_make_no_method_are_refused(a: Any, b: Any, c: Any, order: int, words: str) -> None:
    with pytest.raises(TableauError, match=words or None):
        ButcherTableau("bad", a, b, c, order=order)
