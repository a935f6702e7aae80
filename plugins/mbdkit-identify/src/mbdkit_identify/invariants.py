"""Functions of parameters that do not change along given directions, such as ``k/m`` or ``1/k1 + 1/k2``.

Parameters of which only combinations are determined can move along a curve, or on a surface, without any effect. Its
tangents, the null vectors, differ from point to point. If a null vector is the same at all points once each parameter p
is replaced by one of log(p), p, 1/p and p**2, the combinations orthogonal to it do not change along it: products of
powers for the logarithm, sums for the others. These replace the parameters, and the procedure is repeated with the null
vectors that remain. So k1/m and k2/m follow from k1, k2 and m, and then (k1 + k2)/m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import combinations, islice, product

import numpy as np
import sympy as sp
from scipy.linalg import qr
from scipy.sparse.csgraph import connected_components

LARGEST = 4  #: Largest numerator and denominator of recognized fractions.
#: Largest relative change of a combination along the null vectors at points with other known numbers.
MISFIT = 1e-2
#: Largest numbers of choices: of different transformations of coordinates, and of terms or coefficients.
MOST_MIXED, MOST_TRIALS = 256, 4000
LOGARITHM = 0  #: Transformation of a coordinate by the logarithm; other transformations are powers.
#: What a coefficient may be: the rank, 0 for the most likely; the formula; its values at the points (P,).
Candidate = tuple[int, sp.Expr, np.ndarray]


@dataclass(frozen=True)
class NullVectors:
    """Directions at P points in which K parameters change without any effect.

    - `symbols` (K): the parameters.
    - `points` (P, K): their values; the first point is the reference.
    - `vectors` (P, K, m): bases of the directions.
    - `units` (K,): changes of single parameters that have effects of equal size.
    - `tolerance`: relative error of the directions.
    - `near`: number of points, the first ones, at which determined parameters have the values of the reference. The
      others show whether a coefficient that equals a determined parameter is this parameter.
    - `known`: numbers besides the determined parameters that coefficients may equal, by symbol.
    """

    symbols: Sequence[sp.Symbol]
    points: np.ndarray
    vectors: np.ndarray
    units: np.ndarray
    tolerance: float
    near: int
    known: Mapping[sp.Symbol, float]

    def evaluate(self, formulas: Sequence[sp.Expr]) -> tuple[np.ndarray, np.ndarray]:
        """Return the values (P, n) and derivatives (P, n, K) of functions."""
        column = sp.Matrix([formula.subs(self.known) for formula in formulas])
        function = sp.lambdify([*self.symbols], [column, column.jacobian([*self.symbols])], modules="numpy")
        values, slopes = zip(*(function(*point) for point in self.points), strict=True)
        return np.array(values, dtype=float)[:, :, 0], np.array(slopes, dtype=float)

    @cached_property
    def products(self) -> list[tuple[sp.Expr, np.ndarray]]:
        """Products of up to two known numbers and their values at the points (P,), the simplest first."""
        is_free = np.any(np.abs(self.vectors / self.units[:, None]) > self.tolerance, axis=(0, 2))
        names = {s: column for s, column, free in zip(self.symbols, self.points.T, is_free, strict=True) if not free}
        names |= {symbol: np.full(len(self.points), value) for symbol, value in self.known.items()}
        numbers = [(symbol, column) for symbol, column in names.items() if np.all(column)]
        powers = [(symbol**e, column**e) for e in (1, 2, -1, -2) for symbol, column in numbers]
        pairs = [(s * t**e, a * b**e) for e in (1, -1) for (s, a), (t, b) in product(numbers, numbers) if s != t]
        return [(sp.S.One, np.ones(len(self.points))), *powers, *pairs]


def reduced_basis(basis: np.ndarray) -> np.ndarray:
    """Return the basis of the same space (n, m) that has an identity matrix in m of its rows."""
    pivots = qr(basis.T, pivoting=True, mode="r")[1][: basis.shape[1]]
    return np.asarray(basis @ np.linalg.inv(basis[pivots]))


def blocks(basis: np.ndarray, tolerance: float) -> list[np.ndarray]:
    """Return the finest partition of the non-zero rows of a basis (n, m) for which the space is a direct sum."""
    if not basis.shape[1]:
        return []
    is_used = (np.abs(reduced_basis(basis)) > tolerance).astype(int)
    number, labels = connected_components(is_used @ is_used.T)
    return [np.flatnonzero(labels == label) for label in range(number) if np.any(is_used[labels == label])]


def cost(formulas: Sequence[sp.Expr]) -> tuple[int, int, int]:
    """Return what to minimize among sets of formulas: missing ones, unrecognized coefficients, operations."""
    floats = sum(len(formula.atoms(sp.Float)) for formula in formulas)
    return -len(formulas), floats, sum(int(sp.count_ops(formula)) for formula in formulas)


def invariants(nulls: NullVectors, formulas: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Return independent combinations of independent functions that do not change along the directions.

    These are fewer than exist if the form of some is not known.
    """
    if not formulas:
        return []
    values, slopes = nulls.evaluate(formulas)
    units = np.max(np.abs(slopes[0]) * nulls.units, axis=1)
    changes = slopes @ nulls.vectors / units[:, None]
    left, sizes, _ = np.linalg.svd(changes[0], full_matrices=False)
    parts = blocks(left[:, sizes > nulls.tolerance * max(1.0, sizes[0])], nulls.tolerance)
    combined = [formula for row, formula in enumerate(formulas) if not any(row in part for part in parts)]
    for part in parts:
        left, sizes, _ = np.linalg.svd(changes[:, part], full_matrices=False)
        vectors = left[:, :, : int(np.sum(sizes[0] > nulls.tolerance * sizes[0, 0]))]
        combined += _of_block(nulls, [formulas[row] for row in part], values[:, part], vectors, units[part])
    return combined


def _of_block(
    nulls: NullVectors, formulas: Sequence[sp.Expr], values: np.ndarray, vectors: np.ndarray, units: np.ndarray
) -> list[sp.Expr]:
    """Return the combinations of functions (n), all of which change along the directions (P, n, m), in `units` (n,)."""
    best: list[sp.Expr] = []
    rank = len(formulas) - vectors.shape[2]
    for powers in _transformations(len(formulas)) if rank else ():
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = np.where(powers == LOGARITHM, 1, powers) * values ** (powers - 1.0)
        if not (np.all(np.isfinite(slopes)) and np.all(slopes)):
            continue
        bases = np.linalg.qr((slopes / slopes[0])[:, :, None] * vectors)[0]
        gaps = np.eye(len(formulas)) - bases @ bases.transpose(0, 2, 1)
        _, sizes, rows = np.linalg.svd(np.vstack(gaps[: nulls.near]))
        shared = rows[sizes < nulls.tolerance * math.sqrt(nulls.near)].T
        circuits = _circuits(shared, nulls.tolerance) if shared.shape[1] else []
        if not circuits or len(circuits) + shared.shape[1] < len(formulas):
            continue
        scales = slopes[0] * units
        options = [[*_coefficients(nulls, powers, circuit / scales)] for circuit in circuits]
        choices = sorted(
            islice(product(*options), MOST_TRIALS), key=lambda rows: sum(rank for row in rows for rank, _, _ in row)
        )
        for choice in choices:
            if _hold(choice, scales, gaps[nulls.near :], nulls.near):
                combined = invariants(nulls, [_formula(formulas, powers, row) for row in choice])
                best = min(best, combined, key=cost)
                break
        if len(best) == rank and not cost(best)[1]:
            break
    return best


def _transformations(n: int) -> Iterator[np.ndarray]:
    """Yield exponents (n,) of transformations of coordinates, first those that are the same for all."""
    kinds = (LOGARITHM, 1, -1, 2)
    yield from (np.full(n, kind) for kind in kinds)
    if len(kinds) ** n <= MOST_MIXED:
        yield from (np.array(choice) for choice in product(kinds, repeat=n) if len(set(choice)) > 1)


def _circuits(shared: np.ndarray, tolerance: float) -> list[np.ndarray]:
    """Return a basis of the vectors (n,) orthogonal to all given ones (n, c): those with the fewest terms."""
    n, c = shared.shape
    basis: list[np.ndarray] = []
    for size in range(1, c + 2):
        circuits = []
        for support in map(list, islice(combinations(range(n), size), MOST_TRIALS)):
            left, sizes, _ = np.linalg.svd(shared[support])
            sizes = np.append(sizes, np.zeros(size))[:size]
            if np.sum(sizes < tolerance) == 1 and np.all(np.abs(left[:, -1]) > tolerance):
                circuits.append(np.zeros(n))
                circuits[-1][support] = left[:, -1] * np.sign(left[0, -1])
        for circuit in sorted(circuits, key=lambda vector: int(np.sum(vector < 0))):
            if np.linalg.matrix_rank(np.array([*basis, circuit]), tol=tolerance) > len(basis):
                basis.append(circuit)
    return basis


def _coefficients(nulls: NullVectors, powers: np.ndarray, combination: np.ndarray) -> Iterator[tuple[Candidate, ...]]:
    """Yield what the coefficients of a combination (n,) of transformed functions may be, divided by one of them."""
    support = np.flatnonzero(combination)
    for pivot in support[: 1 if np.all(powers[support] == LOGARITHM) else None]:
        ratios = combination / combination[pivot]
        yield from product(
            *(_equal(nulls, ratio, power == LOGARITHM) for ratio, power in zip(ratios, powers, strict=True))
        )


def _equal(nulls: NullVectors, value: float, is_exponent: bool) -> list[Candidate]:
    """Return formulas that equal a number: products of known numbers, a small fraction, and, but not for exponents, the
    number itself.
    """
    ones, error = np.ones(len(nulls.points)), 3 * nulls.tolerance * abs(value)
    if value == 0:
        return [(0, sp.S.Zero, 0 * ones)]
    signed = ((sign * e, sign * column) for e, column in nulls.products for sign in (1, -1))
    equal = [(e, column) for e, column in signed if abs(column[0] - value) < error][:3]
    fraction = Fraction(value).limit_denominator(LARGEST)
    if abs(fraction - value) < error and abs(fraction.numerator) <= LARGEST:
        equal.insert(0 if is_exponent else len(equal), (sp.Rational(fraction), float(fraction) * ones))
    candidates = [(rank, e, column) for rank, (e, column) in enumerate(equal)]
    return candidates if is_exponent else [*candidates, (100, sp.Float(value), value * ones)]


def _hold(choice: Sequence[tuple[Candidate, ...]], scales: np.ndarray, gaps: np.ndarray, first: int) -> bool:
    """Return whether all directions orthogonal to the combinations are null vectors at the points from `first` on.

    `gaps` (P, n, n): projections to what is orthogonal to the null vectors of transformed functions, in `scales` (n,).
    """
    for point, gap in enumerate(gaps, first):
        _, _, rows = np.linalg.svd(np.array([[column[point] for _, _, column in row] for row in choice]) * scales)
        if np.any(np.abs(rows[len(choice) :] @ gap) > MISFIT):
            return False
    return True


def _formula(formulas: Sequence[sp.Expr], powers: np.ndarray, coefficients: Sequence[Candidate]) -> sp.Expr:
    """Return a sum of transformed functions; its exponential if there are logarithms; a single function as it is."""
    terms = [(f, int(power), c) for f, power, (_, c, _) in zip(formulas, powers, coefficients, strict=True) if c != 0]
    if len(terms) == 1:
        return terms[0][0]
    total = sp.Add(*(c * f**power for f, power, c in terms if power != LOGARITHM))
    factors = [(f, c) for f, power, c in terms if power == LOGARITHM]
    whole = math.lcm(*(int(sp.denom(c)) for _, c in factors if c.is_number)) if total == 0 else 1
    return sp.Mul(*(f ** (whole * c) for f, c in factors), sp.exp(total) if factors else total)
