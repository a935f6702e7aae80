"""Butcher tableaus with exact coefficients, whose order conditions are checked on construction, and embedded pairs."""

from __future__ import annotations

import ast
import hashlib
import json
import operator
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from functools import cache, cached_property, lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbdkit.base.errors import MbdkitError
from mbdkit.base.frozen import dataclass
from mbdkit.base.lazy_names import LazyModule

if TYPE_CHECKING:
    import mpmath
    import numpy as np
    import sympy as sp
else:
    mpmath = LazyModule("mpmath")


#: An exact number (text such as ``"1/4 - sqrt(3)/6"``, int, Fraction, SymPy or mpmath number) or a rounded float.
Coefficient = int | float | Fraction | str | Any

_DIGITS = 60
_EXACT = "1e-50"
_ROUNDED = "1e-13"
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


class TableauError(MbdkitError, ValueError):
    """A tableau is malformed or does not have the claimed properties."""


def _read(text: str, number: Callable[[str], Any], root: Callable[[Any], Any]) -> Any:
    def visit(node: ast.expr) -> Any:
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            return _OPERATORS[type(node.op)](visit(node.left), visit(node.right))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return -visit(node.operand)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "sqrt":
            if len(node.args) == 1 and not node.keywords:
                return root(visit(node.args[0]))
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return number(ast.get_source_segment(text, node) or str(node.value))
        raise TableauError(f"cannot read the coefficient {text!r}: use numbers, + - * / ** and sqrt")

    try:
        return visit(ast.parse(text, mode="eval").body)
    except SyntaxError as error:
        raise TableauError(f"cannot read the coefficient {text!r}: {error.msg}") from None
    except (ZeroDivisionError, RecursionError, ValueError) as error:
        raise TableauError(f"cannot read the coefficient {text!r}: {error}") from None


def _precise(value: Coefficient) -> mpmath.mpf:
    if isinstance(value, bool):
        raise TableauError(f"a coefficient should be a number, not {value!r}")
    if isinstance(value, str):
        return _read(value, mpmath.mpf, mpmath.sqrt)
    if isinstance(value, Fraction):
        return mpmath.mpf(value.numerator) / value.denominator
    if hasattr(value, "_to_mpmath"):
        return value._to_mpmath(mpmath.mp.prec)
    return mpmath.mpf(value)


def _exact(value: Coefficient) -> sp.Expr:
    import sympy as sp

    if isinstance(value, str):
        return _read(value, sp.Number, sp.sqrt)
    if isinstance(value, mpmath.mpf):
        return sp.Float(value, _DIGITS)
    return sp.sympify(value) if isinstance(value, Fraction | int | float) else value


@cache
def coefficients(module: str) -> dict[str, Any]:
    """Return the coefficients in the JSON file beside a module, which has the name of the module."""
    numbers: dict[str, Any] = json.loads(Path(module).with_suffix(".json").read_text("utf-8"))
    return numbers


def _stored(compute: Callable[[ButcherTableau], Any]) -> Callable[[ButcherTableau], Any]:
    """Decorate a method of a tableau whose values for packaged tableaus lie in ``tableau.json``.

    That file is written by ``python -m tests.integrators.stored_tableaus``, and spares most runs the import of mpmath.
    """

    @wraps(compute)
    def value(self: ButcherTableau) -> Any:
        known = coefficients(__file__).get(self._key, {})
        if compute.__name__ not in known:
            return compute(self)
        import numpy as np

        stored = known[compute.__name__]
        is_arrays = isinstance(stored, list)
        return tuple(np.array(x).view(kind).reshape(shape) for kind, shape, x in stored) if is_arrays else stored

    return value


Tree = tuple["Tree", ...]


@lru_cache(maxsize=16)
def rooted_trees(order: int) -> tuple[Tree, ...]:
    """Return all rooted trees with `order` vertices; a tree is the sorted tuple of its root's subtrees."""
    if order == 1:
        return ((),)
    trees: set[Tree] = set()

    def forests(vertices: int, largest: int) -> Iterator[Tree]:
        if vertices == 0:
            yield ()
        for size in range(min(vertices, largest), 0, -1):
            for first in rooted_trees(size):
                for rest in forests(vertices - size, size):
                    yield (first, *rest)

    for children in forests(order - 1, order - 1):
        trees.add(tuple(sorted(children, key=repr)))
    return tuple(sorted(trees, key=repr))


@dataclass(frozen=True)
class ButcherTableau:
    """Coefficients of a Runge-Kutta method. Row sums and the order conditions up to the claimed order are checked.

    Parameters
    ----------
    name
        Name of the method.
    a
        (s, s) matrix, row by row. For an explicit method, the zeros on and above the diagonal may be omitted.
    b
        (s,) weights.
    c
        (s,) nodes.
    order
        Claimed order, 1 or more.
    reference
        Source of the coefficients, as a BibTeX entry.

    Raises
    ------
    TableauError
        If sizes are inconsistent, the order is not a positive integer, a coefficient cannot be read or is not a finite
        real number, the sum of a row differs from its node, or an order condition fails. In the last two cases, the
        message contains the defect.

    Notes
    -----
    The conditions are evaluated with 60 digits. The tolerance is 1e-50 for exact coefficients, and 1e-13 if the tableau
    contains rounded floats. Order p is proved by the simplifying assumptions B(p), C(eta), D(zeta) with
    p <= eta + zeta + 1 and p <= 2 eta + 2 (Butcher 1964), or else by the conditions of all rooted trees up to order p.

    Examples
    --------
    >>> from mbdkit import ButcherTableau
    >>> heun = ButcherTableau("heun", a=((), (1,)), b=("1/2", "1/2"), c=(0, 1), order=2)
    >>> ButcherTableau("heun", a=((), (1,)), b=("1/2", "1/2"), c=(0, 1), order=3)
    Traceback (most recent call last):
        ...
    mbdkit.methods.tableau.TableauError: ...
    """

    name: str
    a: tuple[tuple[Coefficient, ...], ...]
    b: tuple[Coefficient, ...]
    c: tuple[Coefficient, ...]
    order: int
    reference: str = ""

    def __init__(
        self,
        name: str,
        a: Sequence[Sequence[Coefficient]],
        b: Sequence[Coefficient],
        c: Sequence[Coefficient],
        order: int,
        reference: str = "",
    ):
        stages = len(b)
        if any(len(row) > stages for row in a) or len(a) != stages or len(c) != stages or stages == 0:
            raise TableauError(
                f"{name}: a, b and c have inconsistent sizes: {len(a)} rows, {stages} weights, {len(c)} nodes"
            )
        if isinstance(order, bool) or not isinstance(order, int) or order < 1:
            raise TableauError(f"{name}: the order should be a positive integer, not {order!r}")
        padded = tuple(tuple(row) + (0,) * (stages - len(row)) for row in a)
        for field, value in (("name", name), ("a", padded), ("b", tuple(b)), ("c", tuple(c)), ("order", order)):
            object.__setattr__(self, field, value)
        object.__setattr__(self, "reference", reference)
        self._check()

    @property
    def stages(self) -> int:
        """Number of stages s."""
        return len(self.b)

    @cached_property
    def _key(self) -> str:
        """Key of the tableau in ``tableau.json``."""
        return hashlib.sha256(repr((self.a, self.b, self.c, self.order)).encode()).hexdigest()

    @cached_property
    def _numbers(self) -> tuple[list[list[mpmath.mpf]], list[mpmath.mpf], list[mpmath.mpf]]:
        with mpmath.workdps(_DIGITS):
            return (
                [[_precise(x) for x in row] for row in self.a],
                [_precise(x) for x in self.b],
                [_precise(x) for x in self.c],
            )

    @cached_property
    def _tolerance(self) -> mpmath.mpf:
        rounded = any(isinstance(x, float) for row in (*self.a, self.b, self.c) for x in row)
        return mpmath.mpf(_ROUNDED if rounded else _EXACT)

    @cached_property
    @_stored
    def is_explicit(self) -> bool:
        """Whether each stage depends on earlier stages only."""
        a, _, _ = self._numbers
        return all(a[i][j] == 0 for i in range(self.stages) for j in range(i, self.stages))

    @property
    @_stored
    def is_diagonally_implicit(self) -> bool:
        """Whether each stage depends on itself and on earlier stages only, and at least one on itself."""
        a, _, _ = self._numbers
        return not self.is_explicit and all(a[i][j] == 0 for i in range(self.stages) for j in range(i + 1, self.stages))

    @cached_property
    def is_diagonalisable(self) -> bool:
        """Whether ``a`` has a well-conditioned basis of eigenvectors; ``a`` may be singular, as for Lobatto IIIA."""
        import numpy as np

        _, vectors = np.linalg.eig(self.floats()[0])
        return bool(np.linalg.cond(vectors) < 1e8)

    @property
    @_stored
    def is_first_same_as_last(self) -> bool:
        """Whether the last stage is the first stage of the next step: its row of ``a`` equals ``b``, its node is 1."""
        a, b, c = self._numbers
        return bool(self.stages > 1 and c[-1] == 1 and a[-1] == b)

    @cached_property
    @_stored
    def is_collocation(self) -> bool:
        """Whether the method is a collocation method.

        The nodes are distinct and ``sum_j a_ij c_j^(k-1) = c_i^k / k``, ``sum_j b_j c_j^(k-1) = 1 / k`` for k <= s.
        """
        a, b, c = self._numbers
        s = range(self.stages)
        with mpmath.workdps(_DIGITS):
            if any(c[i] == c[j] for i in s for j in range(i)):
                return False
            weights = [(row, node) for row, node in zip([*a, b], [*c, mpmath.mpf(1)], strict=True)]
            defects = [
                abs(mpmath.fsum(row[j] * c[j] ** k for j in s) - node ** (k + 1) / (k + 1))
                for row, node in weights
                for k in s
            ]
            return bool(max(defects) < self._tolerance)

    @property
    @_stored
    def is_stiffly_accurate(self) -> bool:
        """Whether the last stage is the end of the step and ``a`` is regular.

        Both are required for constraints that are imposed on the stages.
        """
        import numpy as np

        a, b, c = self._numbers
        ends = c[-1] == 1 and all(x == y for x, y in zip(a[-1], b, strict=True))
        return bool(ends and np.linalg.cond(self.floats()[0]) < 1e8)

    @property
    def is_symmetric(self) -> bool:
        """Whether a step of size -h reverses a step of size h: ``a[s-1-i][s-1-j] + a[i][j] = b[j]``."""
        a, b, _ = self._numbers
        s = self.stages
        with mpmath.workdps(_DIGITS):
            defects = [abs(a[s - 1 - i][s - 1 - j] + a[i][j] - b[j]) for i in range(s) for j in range(s)]
            return bool(max(defects) < self._tolerance)

    @property
    def is_symplectic(self) -> bool:
        """Whether quadratic invariants are conserved: ``b_i a_ij + b_j a_ji = b_i b_j``."""
        a, b, _ = self._numbers
        s = self.stages
        with mpmath.workdps(_DIGITS):
            defects = [abs(b[i] * a[i][j] + b[j] * a[j][i] - b[i] * b[j]) for i in range(s) for j in range(s)]
            return bool(max(defects) < self._tolerance)

    def floats(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``a`` (s, s), ``b`` (s,) and ``c`` (s,), each coefficient rounded once."""
        a, b, c = self._rounded
        return a.copy(), b.copy(), c.copy()

    @cached_property
    @_stored
    def _rounded(self) -> tuple[np.ndarray, ...]:
        import numpy as np

        return tuple(np.array(x, dtype=float) for x in self._numbers)

    @_stored
    def second_order_floats(self) -> tuple[np.ndarray, np.ndarray]:
        """Return ``A A`` (s, s) and ``A^T b`` (s,), the weights of accelerations in positions, each rounded once."""
        import numpy as np

        a, b, _ = self._numbers
        s = range(self.stages)
        with mpmath.workdps(_DIGITS):
            squared = [[mpmath.fsum(a[i][k] * a[k][j] for k in s) for j in s] for i in s]
            weights = [mpmath.fsum(b[i] * a[i][j] for i in s) for j in s]
        return np.array(squared, dtype=float), np.array(weights, dtype=float)

    @_stored
    def eigensystem(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return eigenvalues (s,) and eigenvectors of ``a``, and the inverse of their matrix, rounded once; complex.

        The eigenvectors are the columns of the second array (s, s); their norm is 1, and their last element is real.
        The matrix must be diagonalisable.
        """
        import numpy as np

        s = self.stages
        with mpmath.workdps(_DIGITS):
            values, vectors = mpmath.eig(mpmath.matrix(self._numbers[0]))
            for j in range(s):
                column = vectors[:, j]
                last = column[s - 1]
                factor = (mpmath.conj(last) / abs(last) if last else 1) / mpmath.norm(column)
                for i in range(s):
                    vectors[i, j] *= factor
            inverse = vectors**-1
        return tuple(np.array(x, dtype=complex) for x in (values, vectors.tolist(), inverse.tolist()))  # type: ignore[return-value]

    def to_sympy(self) -> tuple[sp.Matrix, sp.Matrix, sp.Matrix]:
        """Return ``a`` (s, s), ``b`` (s, 1) and ``c`` (s, 1) as SymPy matrices; exact coefficients stay exact."""
        import sympy as sp

        return (
            sp.Matrix([[_exact(x) for x in row] for row in self.a]),
            sp.Matrix([_exact(x) for x in self.b]),
            sp.Matrix([_exact(x) for x in self.c]),
        )

    def check_trees(self, order: int) -> None:
        """Raise TableauError if the order condition of a rooted tree with at most `order` vertices fails."""
        a, b, _ = self._numbers
        s = range(self.stages)
        weights: dict[Tree, list[mpmath.mpf]] = {}

        def stage_weights(tree: Tree) -> list[mpmath.mpf]:
            if tree not in weights:
                product = [mpmath.mpf(1)] * self.stages
                for child in tree:
                    inner = stage_weights(child)
                    product = [product[i] * mpmath.fsum(a[i][j] * inner[j] for j in s) for i in s]
                weights[tree] = product
            return weights[tree]

        def size(tree: Tree) -> int:
            return 1 + sum(size(child) for child in tree)

        def density(tree: Tree) -> int:
            result = size(tree)
            for child in tree:
                result *= density(child)
            return result

        with mpmath.workdps(_DIGITS):
            for vertices in range(1, order + 1):
                for tree in rooted_trees(vertices):
                    inner = stage_weights(tree)
                    defect = mpmath.fsum(b[i] * inner[i] for i in s) - mpmath.mpf(1) / density(tree)
                    if abs(defect) > self._tolerance:
                        raise TableauError(
                            f"{self.name} claims order {order}, but an order condition of order {vertices} "
                            f"has the defect {mpmath.nstr(defect, 3)}"
                        )

    @_stored
    def _check(self) -> None:
        a, b, c = self._numbers
        if not all(mpmath.isfinite(x) for row in (*a, b, c) for x in row):
            raise TableauError(f"{self.name}: every coefficient should be a finite real number")
        with mpmath.workdps(_DIGITS):
            for i, row in enumerate(a):
                defect = mpmath.fsum(row) - c[i]
                if abs(defect) > self._tolerance:
                    raise TableauError(
                        f"{self.name}: row {i + 1} of a sums to its node plus {mpmath.nstr(defect, 3)}, "
                        f"it should sum to the node c{i + 1}"
                    )
            if not self._simplified_order_reaches(a, b, c):
                self.check_trees(self.order)

    def _simplified_order_reaches(self, a: list[list[mpmath.mpf]], b: list[mpmath.mpf], c: list[mpmath.mpf]) -> bool:
        """Return whether B(p), C(eta) and D(zeta) imply the claimed order."""
        s, p = range(self.stages), self.order

        def holds(defects: Iterator[mpmath.mpf]) -> bool:
            return all(abs(d) <= self._tolerance for d in defects)

        if not holds(mpmath.fsum(b[i] * c[i] ** (k - 1) for i in s) - mpmath.mpf(1) / k for k in range(1, p + 1)):
            return False
        eta = zeta = 0
        while eta < p and holds(
            mpmath.fsum(a[i][j] * c[j] ** eta for j in s) - c[i] ** (eta + 1) / (eta + 1) for i in s
        ):
            eta += 1
        while zeta < p and holds(
            mpmath.fsum(b[i] * c[i] ** zeta * a[i][j] for i in s) - b[j] * (1 - c[j] ** (zeta + 1)) / (zeta + 1)
            for j in s
        ):
            zeta += 1
        return p <= eta + zeta + 1 and p <= 2 * eta + 2


def collocation(name: str, nodes: Sequence[Coefficient], order: int, reference: str = "") -> ButcherTableau:
    """Return the collocation method with the given nodes.

    Parameters
    ----------
    name
        Name of the method.
    nodes
        (s,) distinct nodes in [0, 1].
    order
        Claimed order.
    reference
        Source of the method, as a BibTeX entry.

    Returns
    -------
    ButcherTableau
        The tableau, with ``a_ij`` and ``b_j`` the integrals of the Lagrange polynomials from 0 to ``c_i`` and to 1.
    """
    with mpmath.workdps(_DIGITS + 15):
        c = [_precise(node) for node in nodes]
        integrals = []
        for j in range(len(c)):
            poly = [mpmath.mpf(1)]
            for m, cm in enumerate(c):
                if m != j:
                    shifted = [mpmath.mpf(0), *poly]
                    poly = [(x - cm * y) / (c[j] - cm) for x, y in zip(shifted, [*poly, mpmath.mpf(0)], strict=True)]
            integrals.append([mpmath.mpf(0)] + [x / (k + 1) for k, x in enumerate(poly)])
        values = [[mpmath.polyval(poly[::-1], x) for poly in integrals] for x in [*c, mpmath.mpf(1)]]
    return ButcherTableau(name, values[:-1], values[-1], c, order, reference)


@dataclass(frozen=True, eq=False)
class EmbeddedPair:
    """Error estimates and dense output of an explicit tableau with S stages; objects are compared by identity.

    Parameters
    ----------
    error
        (0, 1 or 2, S) weights of the stages in the estimates of the local error divided by h, higher order first.
    estimate_order
        Order of the estimate, as a power of h; with two estimates, the order of their combination; 0 without any.
    a, c
        (E, E) and (E,) coefficients and nodes, including the additional stages of dense output, E >= S.
    dense
        (E, degree) dense output: the weight of stage i at theta is ``sum_k dense[i, k] theta^(k + 1)``.
    """

    error: np.ndarray
    estimate_order: int
    a: np.ndarray
    c: np.ndarray
    dense: np.ndarray

    @classmethod
    def without_error(cls, tableau: ButcherTableau, dense: Sequence[Sequence[float]]) -> EmbeddedPair:
        """Return dense output (S, degree) of the stages of an explicit tableau, without an error estimate.

        Raises
        ------
        TableauError
            If the number of rows is not that of the stages, or the weights at theta = 1 are not those of the tableau.
        """
        import numpy as np

        a, b, c = tableau.floats()
        if len(dense) != len(b) or len({len(row) for row in dense}) != 1:
            raise TableauError(f"the dense output of {tableau.name} should have {len(b)} rows of equal length")
        weights = np.array(dense, dtype=float)
        gap = float(np.max(np.abs(weights.sum(axis=1) - b)))
        if not gap < 1e-12:
            raise TableauError(
                f"the dense output of {tableau.name} does not end where the step ends: at theta = 1 its weights should "
                f"be b, but they differ by {gap:.3g}"
            )
        return cls(np.zeros((0, len(b))), 0, a, c, weights)


def nested_polynomials(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Expand dense output given as ``theta (F_0 + (1 - theta) (F_1 + theta (F_2 + (1 - theta) (...))))``.

    `parts`: F_0, F_1, ...: weights of the stages, (E,) each. Returns coefficients of theta, theta^2, ...
    """
    import numpy as np

    theta, rest = np.polynomial.Polynomial([0.0, 1.0]), np.polynomial.Polynomial([1.0, -1.0])
    out = np.zeros((len(parts[0]), len(parts)))
    for i in range(len(parts[0])):
        value = np.polynomial.Polynomial([0.0])
        for k in reversed(range(len(parts))):
            value = (value + parts[k][i]) * (theta if k % 2 == 0 else rest)
        out[i, : len(value.coef) - 1] = value.coef[1:]
    return out
