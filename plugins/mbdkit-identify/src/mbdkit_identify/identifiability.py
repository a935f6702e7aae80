"""Which parameters, and which combinations of parameters, measured data determine.

Parameters are not determined if they can change together without any change of the residuals: along the null vectors of
the sensitivities, at every point of a curve. What is determined are functions that do not change on any such curve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import sympy as sp

from mbdkit.plugin import MbdkitError, RunError, RunSpec, listed
from mbdkit_identify.base_parameters import base_parameters, symbol
from mbdkit_identify.invariants import NullVectors, blocks, cost, invariants, reduced_basis

MARGIN = 10.0  #: Singular values and components count as zero below this many times their error.
#: Range of the relative error of null vectors; unequal ones differ by about `WALK` between points.
TOLERANCES = (1e-7, 1e-2)
WALK = 0.08  #: Largest relative change of a parameter between points.
ATTEMPTS = 5  #: Steps that are tried, each half as long as the one before, where the model cannot be evaluated.


@dataclass(frozen=True)
class Combination:
    """Parameters of which none is determined, but possibly combinations of them.

    Attributes
    ----------
    names : tuple of str
        The parameters (n).
    formulas : tuple of str
        The combinations that are determined, such as ``k/m``; none if they have no known form.
    directions : (D, n) array
        Changes of the parameters that together change no residual, to first order, in the units of the parameters. The
        largest change of each row is 1 % of the size of the parameter.
    text : str
        What is determined, in words.
    """

    names: tuple[str, ...]
    formulas: tuple[str, ...]
    directions: np.ndarray
    text: str


@dataclass(frozen=True)
class Identifiability:
    """What data determine about K parameters.

    Attributes
    ----------
    names : tuple of str
        The parameters.
    identifiable : (K,) array of bool
        Whether each parameter is determined.
    combinations : tuple of Combination
        The parameters that are not determined, in groups.
    rank : int
        Number of independent combinations of parameters that are determined.
    """

    names: tuple[str, ...]
    identifiable: np.ndarray
    combinations: tuple[Combination, ...]
    rank: int


def combinations(
    names: Sequence[str],
    values: Sequence[float] | np.ndarray,
    sensitivity: Callable[[np.ndarray], np.ndarray],
    *,
    spec: RunSpec | None = None,
    error: float = 1e-9,
    sizes: Sequence[float] | np.ndarray | None = None,
    units: Mapping[str, str] | None = None,
) -> Identifiability:
    """Return which of K parameters, and which combinations of them, data determine.

    A direction counts as not determined only if the derivatives of the residuals vanish all along the curve that starts
    in this direction; it is followed by two steps of up to 8 % of the parameters, with re-projection.

    Parameters
    ----------
    names
        Names of the parameters, including initial states and other nuisance parameters.
    values : (K,) array
        Their values.
    sensitivity
        Function that returns the derivatives (R, K) of the residuals, in standard deviations of their noise, at given
        parameters (K,). Priors should not be among the residuals. It is called about eight times, or once if all
        parameters are determined.
    spec
        Spec with the parameters, from which base inertial parameters and the names of known numbers follow.
    error
        Relative error of the derivatives, for example 1e-6 for central differences. Directions with relative effects
        below ten times this error cannot be told from null vectors.
    sizes : (K,) array, optional
        Sizes of the parameters; by default, their absolute values, and 1 for zeros.
    units
        Units of the parameters, for texts.

    Returns
    -------
    Identifiability

    Raises
    ------
    RunError
        If the derivatives are not finite at the given values.
    """
    start = np.asarray(values, dtype=float)
    size = np.where(start == 0, 1.0, np.abs(start)) if sizes is None else np.asarray(sizes, dtype=float)
    local = partial(_local, sensitivity, size, error)
    first = local(start)
    points = [first, *_curve(local, first, size)]
    nullity = min(point.nullity for point in points)
    points = [point for point in points if point.nullity == nullity]
    is_free = points[0].involved
    groups: tuple[Combination, ...] = ()
    if nullity:
        moved = [_moved(local, points[0], step) for step in (*(_steps(3, size) * is_free), *_steps(2, size))]
        near, distant = ([p for p in part if p and p.nullity == nullity] for part in (moved[:3], moved[3:]))
        known = {symbol(name): x for name, x in spec.numbers.items() if name not in names} if spec else {}
        every, tolerance = [*points, *near, *distant], max(one.tolerance for one in (*points, *near, *distant))
        nulls = NullVectors(
            [symbol(name) for name in names], np.array([one.values for one in every]),
            np.array([one.null for one in every]), points[0].units, tolerance, len(points) + len(near), known,
        )  # fmt: skip
        groups = _groups(nulls, is_free, spec, size, units or {})
    return Identifiability(tuple(names), ~is_free, groups, len(start) - nullity)


@dataclass(frozen=True, eq=False)
class _Point:
    """Null vectors (K, m) at given parameters (K,).

    - `units` (K,): changes of single parameters that have effects of equal size.
    - `tolerance`: relative error of the null vectors.
    """

    values: np.ndarray
    null: np.ndarray
    units: np.ndarray
    tolerance: float

    @property
    def nullity(self) -> int:
        return int(self.null.shape[1])

    @property
    def involved(self) -> np.ndarray:
        """Whether each parameter (K,) takes part in a null vector."""
        return np.asarray(np.any(np.abs(self.null / self.units[:, None]) > self.tolerance, axis=1))


def _local(
    sensitivity: Callable[[np.ndarray], np.ndarray], size: np.ndarray, error: float, values: np.ndarray
) -> _Point:
    matrix = np.asarray(sensitivity(values), dtype=float) * size
    if not np.all(np.isfinite(matrix)):
        raise RunError("the derivatives of the residuals with respect to the parameters are not finite")
    # Columns of equal norm, because the effects of parameters may differ by many orders of magnitude.
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms <= error * norms.max(initial=0.0)] = np.inf
    _, singular, rows = np.linalg.svd(np.linalg.qr(np.vstack([matrix / norms, np.zeros(2 * norms.shape)]), mode="r"))
    rank = int(np.sum(singular > MARGIN * error))
    units = size / np.where(np.isinf(norms), 1.0, norms)
    tolerance = float(np.clip(MARGIN * error / singular[rank - 1] if rank else 0.0, *TOLERANCES))
    return _Point(values, units[:, None] * rows[rank:].T, units, tolerance)


def _moved(local: Callable[[np.ndarray], _Point], start: _Point, change: np.ndarray) -> _Point | None:
    """Return a point at a distance, which is halved and reversed while the model cannot be evaluated there."""
    for attempt in range(ATTEMPTS):
        try:
            return local(start.values + change * (-0.5) ** attempt)
        except MbdkitError:
            continue
    return None


def _steps(number: int, size: np.ndarray) -> np.ndarray:
    """Return steps (number, K) of parameters in no special directions, always the same."""
    generator, shape = np.random.default_rng(1), (number, len(size))
    return np.asarray(WALK * size * generator.uniform(0.5, 1.0, shape) * generator.choice([-1, 1], shape))


def _curve(local: Callable[[np.ndarray], _Point], first: _Point, size: np.ndarray) -> list[_Point]:
    """Return two points on a curve along all null vectors, the second by a step along those of the first one."""
    if not first.nullity:
        return []
    basis = reduced_basis(first.null / first.units[:, None]) * first.units[:, None]
    change = basis @ _steps(1, 1 / np.max(np.abs(basis) / size[:, None], axis=0))[0]
    change *= WALK / max(float(np.max(np.abs(change) / size)), WALK)
    middle = _moved(local, first, 0.5 * change)
    if middle is None or not middle.nullity:
        return [middle] if middle else []
    tangents = np.linalg.qr(middle.null / first.units[:, None])[0]
    end = _moved(local, first, first.units * (tangents @ (tangents.T @ (change / first.units))))
    return [middle, end] if end else [middle]


def _groups(
    nulls: NullVectors, is_free: np.ndarray, spec: RunSpec | None, size: np.ndarray, units: Mapping[str, str]
) -> tuple[Combination, ...]:
    """Return the parameters that are not determined in groups, with what is determined of each group."""
    free = [s for s, is_unknown in zip(nulls.symbols, is_free, strict=True) if is_unknown]
    formulas: list[sp.Expr] = []
    if nulls.near > 2:  # fewer points do not show which null vectors are the same everywhere
        formulas = invariants(nulls, free)
        base = base_parameters(spec, [s.name for s in free]) if spec else []
        if base:
            formulas = min(formulas, invariants(nulls, _coordinates(nulls, base, free)), key=cost)
    reduced = reduced_basis(nulls.vectors[0] / nulls.units[:, None])
    groups = []
    for rows in blocks(reduced, nulls.tolerance):
        members = [nulls.symbols[row] for row in rows]
        basis = reduced[rows][:, np.any(np.abs(reduced[rows]) > nulls.tolerance, axis=0)]
        directions = (np.where(np.abs(basis) > nulls.tolerance, basis, 0.0) * nulls.units[rows, None]).T
        directions *= 0.01 / np.max(np.abs(directions) / size[rows], axis=1, keepdims=True)
        texts = tuple(_text(formula, free) for formula in formulas if formula.free_symbols & {*members})
        if len(texts) + len(directions) < len(rows):
            texts = ()
        names = tuple(member.name for member in members)
        groups.append(Combination(names, texts, directions, _sentence(names, texts, directions, units)))
    return tuple(groups)


def _coordinates(nulls: NullVectors, base: Sequence[sp.Expr], free: Sequence[sp.Symbol]) -> list[sp.Expr]:
    """Return independent functions of the free parameters: base parameters, and as many parameters as are missing.

    Of these, the ones on which no base parameter depends come first.
    """
    inertial = {s for formula in base for s in formula.free_symbols}
    candidates = [*base, *sorted(free, key=lambda s: s in inertial)]
    slopes = nulls.evaluate(candidates)[1][0] * nulls.units * [s in free for s in nulls.symbols]
    slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)
    rows: list[int] = []
    for row in range(len(candidates)):
        if np.linalg.matrix_rank(slopes[[*rows, row]], tol=TOLERANCES[0]) > len(rows):
            rows.append(row)
    return [candidates[row] for row in rows]


def _text(formula: sp.Expr, free: Sequence[sp.Symbol]) -> str:
    """Return the shortest form of a formula, without known terms and factors."""
    forms = [formula, sp.together(formula), *([] if formula.has(sp.Float) else [sp.factor(formula)])]
    shortest = min(forms, key=sp.count_ops)
    varying = shortest.as_independent(*free, as_Add=shortest.is_Add)[1]
    numbers = varying.atoms(sp.Float) | {number for number in varying.atoms(sp.Rational) if number.q > 12}
    return str(sp.sstr(varying.xreplace({number: sp.Float(number, 4) for number in numbers}), full_prec=False))


def _sentence(names: Sequence[str], formulas: Sequence[str], directions: np.ndarray, units: Mapping[str, str]) -> str:
    """Return what is determined of a group of parameters, in words."""
    if len(names) == 1:
        return f"{names[0]} is not determined: no residual depends on it"
    if formulas:
        kinds = {f"{names[0]}/{names[1]}": "the ratio ", "*".join(sorted(names)): "the product "}
        kind = (kinds | {" + ".join(sorted(names)): "the sum "}).get(formulas[0], "") if len(formulas) == 1 else ""
        return f"only {kind}{listed([*formulas], 'and')} {'is' if len(formulas) == 1 else 'are'} determined"
    changes = [
        " and ".join(
            f"{name} by {change:+.3g} {units.get(name, '')}".rstrip()
            for name, change in zip(names, direction, strict=True)
            if change
        )
        for direction in directions
    ]
    change = f"changing {', or '.join(changes)} together changes no residual"
    return f"of {listed([*names], 'and')}, only combinations are determined: {change}"
