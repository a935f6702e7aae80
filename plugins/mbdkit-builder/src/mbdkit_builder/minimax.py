"""Compute the coefficients of the polynomials in `mbdkit.engine.kernels.elementary`, in the order of the sources.

Each entry of `FITS` is a function f(x) on an interval and a weight w(x): the polynomial p of a degree minimizes the
largest |f(x) - p(x)| w(x) (Remez's algorithm, with 80 digits). Its coefficients are rounded to doubles one after the
other, the lowest power first, and the rest is fitted again after each one, so that the others compensate the rounding
of the large coefficients. If the interval contains zero, all coefficients are rounded at once.

``python -m mbdkit_builder.minimax`` prints the coefficients and the largest weighted error, as a power of two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mpmath import mp, mpf

Function = Callable[[Any], Any]
mp.dps = 80


def _polynomial(coefficients: Sequence[Any], x: Any) -> Any:
    total = mpf(0)
    for one in reversed(coefficients):
        total = total * x + one
    return total


def minimax(f: Function, weight: Function, low: Any, high: Any, powers: Sequence[int]) -> tuple[list[Any], Any]:
    """Return the coefficients of these powers, and the largest weighted error, by Remez's algorithm."""
    count = len(powers)
    middle, half = (low + high) / 2, (high - low) / 2
    nodes = [middle - half * mp.cos(mp.pi * (i + mpf(1) / 2) / (count + 1)) for i in range(count + 1)]
    for _ in range(30):
        system = mp.matrix(count + 1, count + 1)
        for i, x in enumerate(nodes):
            for j, power in enumerate(powers):
                system[i, j] = x**power
            system[i, count] = (-1) ** i / weight(x)
        solution = list(mp.lu_solve(system, mp.matrix([f(x) for x in nodes])))
        coefficients, level = solution[:-1], abs(solution[-1])

        def error(x: Any, c: Sequence[Any] = coefficients) -> Any:
            return (f(x) - sum(a * x**power for a, power in zip(c, powers, strict=True))) * weight(x)

        nodes, largest = _extrema(error, nodes, low, high)
        if largest < level * (1 + mpf(10) ** -6):
            break
    return coefficients, largest


def _extrema(error: Function, nodes: Sequence[Any], low: Any, high: Any) -> tuple[list[Any], Any]:
    """Return the places of the largest errors between the sign changes of the error, and the largest one."""
    steps = 40
    grid = [low]
    for a, b in zip(nodes, [*nodes[1:], high], strict=True):
        grid += [a + (b - a) * k / steps for k in range(steps + (b == high))]
    grid = sorted({x for x in grid if low <= x <= high} | {high})
    values = [error(x) for x in grid]
    groups: list[list[int]] = []
    for i, value in enumerate(values):
        if groups and values[groups[-1][-1]] * value > 0:
            groups[-1].append(i)
        else:
            groups.append([i])
    best = [max(group, key=lambda i: abs(values[i])) for group in groups]
    while len(best) > len(nodes):
        best.remove(best[0] if abs(values[best[0]]) < abs(values[best[-1]]) else best[-1])
    return [grid[i] for i in best], max(abs(values[i]) for i in best)


def rounded(f: Function, weight: Function, low: Any, high: Any, count: int) -> tuple[list[float], Any]:
    """Return coefficients of the powers 0 to ``count - 1`` as doubles, and the largest weighted error."""
    fixed: list[float] = []
    if low < 0 < high:  # where all other powers vanish inside the interval
        fixed = [float(c) for c in minimax(f, weight, low, high, range(count))[0]]
    for power in range(len(fixed), count):

        def rest(x: Any, known: Sequence[float] = tuple(fixed)) -> Any:
            return f(x) - _polynomial(known, x)

        coefficients, _ = minimax(rest, weight, low, high, range(power, count))
        fixed.append(float(coefficients[0]))
    grid = [low + (high - low) * i / 1000 for i in range(1001)]
    return fixed, max(abs(f(x) - _polynomial(fixed, x)) * weight(x) for x in grid)


_TINY = mpf(10) ** -12
_EIGHTH = (mp.pi / 4) ** 2 * (1 + mpf(10) ** -4)


def _away(x: Any) -> Any:
    """Return `x`, or a small number instead of zero, where quotients of small differences are not defined."""
    return x if abs(x) > mpf(10) ** -18 else mpf(10) ** -18


def _scaled_erfc(r: Any) -> Any:
    """Return ``(1 + 2 x) exp(x^2) erfc(x)`` at ``r = 1 / (1 + 2 x)``."""
    x = (1 / r - 1) / 2
    return mp.exp(x * x) * mp.erfc(x) / r


def _erfc_fit(start: Any, end: Any, center: float, count: int) -> Any:
    first = mpf(float(_scaled_erfc(mpf(center))))
    first += float(_scaled_erfc(mpf(center)) - first)
    margin = mpf(10) ** -3
    return (
        f"(G(r) - G(c)) / (r - c), c = {center}, as a polynomial in r - c; see error_function.py",
        lambda u: (_scaled_erfc(_away(u) + center) - first) / _away(u),
        lambda u: 1,
        1 / mpf(1 + 2 * end) * (1 - margin) - center, 1 / mpf(1 + 2 * start) * (1 + margin) - center, count,
    )  # fmt: skip


def _gamma_fit(zero: int, count: int) -> Any:
    slope = -mp.euler if zero == 1 else 1 - mp.euler
    return (
        f"(log(Gamma({zero} + t)) / t - log(Gamma)'({zero})) / t",
        lambda t: (mp.loggamma(zero + _away(t)) / _away(t) - slope) / _away(t),
        lambda t: 1,
        mpf("-0.1251"), mpf("0.1251"), count,
    )  # fmt: skip


def _stirling_rest(z: Any) -> Any:
    x = 1 / mp.sqrt(z)
    return ((mp.loggamma(x) - (x - mpf(1) / 2) * mp.log(x) + x - mp.log(2 * mp.pi) / 2) * x - mpf(1) / 12) / z


def _odd_fit(
    name: str, function: Function, high: Any, count: int, weight: Function | None = None, slope: Any = 1
) -> Any:
    """Return the fit of an odd function f with a slope at 0, by a polynomial in ``z = x^2`` up to `high`.

    Without a `weight`, errors are relative to f.
    """

    def relative(z: Any) -> Any:
        return z * mp.sqrt(z) / function(mp.sqrt(z))

    text = f"(f(x) / x - f'(0)) / z, z = x^2, f = {name}"
    return text, lambda z: (function(mp.sqrt(z)) / mp.sqrt(z) - slope) / z, weight or relative, _TINY, high, count


_MORE = 1 + mpf(10) ** -4
_HALF_LN2 = mp.log(2) / 2 * _MORE
_PART = mp.log(2) / 256 * _MORE
#: What a polynomial approximates, as text; the function, its weight, the interval, and the number of coefficients.
FITS: Sequence[tuple[str, Function, Function, Any, Any, int]] = (
    _odd_fit("sin", mp.sin, _EIGHTH, 6),
    (
        "(cos(y) - 1 + z / 2) / z^2, z = y^2, relative to cos(y)",
        lambda z: (mp.cos(mp.sqrt(z)) - 1 + z / 2) / z**2,
        lambda z: z**2 / mp.cos(mp.sqrt(z)),
        _TINY, _EIGHTH, 6,
    ),
    _odd_fit("atan, |x| <= 1 / 4", mp.atan, mpf(1) / 16 * _MORE, 9),
    _odd_fit("asin, |x| <= 1 / 2", mp.asin, mpf(1) / 4 * _MORE, 13),
    _odd_fit("sinh, for expm1, sinh, cosh and tanh", mp.sinh, _HALF_LN2**2, 5, lambda z: z * mp.sqrt(z)),
    (
        "(cosh(r) - 1 - z / 2) / z^2, z = r^2, for the same functions",
        lambda z: (mp.cosh(mp.sqrt(z)) - 1 - z / 2) / z**2,
        lambda z: z**2,
        _TINY, _HALF_LN2**2, 5,
    ),
    (
        "(exp(r) - 1 - r) / r^2, for exp with a table",
        lambda r: (mp.exp(_away(r)) - 1 - _away(r)) / _away(r) ** 2,
        lambda r: _PART**2,
        -_PART, _PART, 4,
    ),
    (
        "(log(1 + r) - r + r^2 / 2) / r^3, for log with a table",
        lambda r: (mp.log(1 + _away(r)) - _away(r) + _away(r) ** 2 / 2) / _away(r) ** 3,
        lambda r: mpf("0.00427") ** 2,
        mpf("-0.00427"), mpf("0.00427"), 6,
    ),
    _odd_fit("erf", mp.erf, mpf(1) / 4 * _MORE, 9, lambda z: z, 2 / mp.sqrt(mp.pi)),
    _erfc_fit(mpf(1) / 2, mpf(5) / 4, 0.40625, 16),
    _erfc_fit(mpf(5) / 4, 3, 0.21875, 16),
    _erfc_fit(3, 28, 0.078125, 17),
    (
        "(x S - 1 / 12) / z, z = 1 / x^2; see gamma.py",
        _stirling_rest,
        lambda z: z * mp.sqrt(z),
        mpf(10) ** -8, mpf(1) / 64, 6,
    ),
    _gamma_fit(1, 14),
    _gamma_fit(2, 11),
    _odd_fit("sin(pi x), for lgamma", lambda x: mp.sin(mp.pi * x), mpf(1) / 4, 8, lambda z: z, mp.pi),
)  # fmt: skip


def main() -> None:
    """Print the coefficients of all polynomials."""
    for text, f, weight, low, high, count in FITS:
        coefficients, largest = rounded(f, weight, low, high, count)
        print(f"{text}: error 2^{float(mp.log(largest, 2)):.1f}")
        for power, value in enumerate(coefficients):
            print(f"  {power:2} {value!r}")


if __name__ == "__main__":
    main()
