"""Generate ``mbdkit/engine/kernels/element_kernels.py`` from the definitions of elements.

Run by ``python -m mbdkit_builder elements``.

The generated module contains one kernel for each kind of constraint and each level (position, acceleration, tangent),
and for each level a loop that calls the kernel of the right kind for every pair of constraint rows. Each kind of
pathway has a kernel for its length and gradient and, unless they are zero, one for the second derivatives.
Cross-sections of beams have a kernel for their forces and one for the tangents. Common subexpressions are eliminated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from mbdkit.engine.native import machine_code
from mbdkit_statics import element_definitions as d

TARGET = machine_code.PACKAGE / "engine/kernels/element_kernels.py"

HEADER = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")

#: By level: the arguments of a constraint kernel after ``k, a, b, m``, and the docstring of the loop over all pairs of
#: rows.
_LEVELS = {
    "position": ("q, cs, p, u, phi, phi_t", "Evaluate Phi and Phi_t of every pair: (P, 2) arrays."),
    "acceleration": (
        "q, v, cs, p, u, jac, gamma",
        "Evaluate the Jacobian (P, 12) and the right-hand side gamma (P, 2) of every pair.",
    ),
    "tangent": (
        "q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q",
        "Evaluate d(Phi_q^T lam)/dq (P, 36), d gamma/dv (P, 12) and d(Phi_q a - gamma)/dq (P, 12) of every pair.",
    ),
}

#: Array of which kernels also write the zeros, because other kernels store right-hand sides in it or add to it.
ALWAYS_WRITTEN = "gamma"

#: The array element from which a kernel reads each symbol.
_READS = {
    **{name: f"q[3*a+{i}]" for i, name in enumerate(("xa", "ya", "tha"))},
    **{name: f"q[3*b+{i}]" for i, name in enumerate(("xb", "yb", "thb"))},
    **{name: f"v[3*a+{i}]" for i, name in enumerate(("vxa", "vya", "wa"))},
    **{name: f"v[3*b+{i}]" for i, name in enumerate(("vxb", "vyb", "wb"))},
    **{name: f"acc[3*a+{i}]" for i, name in enumerate(("axa", "aya", "ala"))},
    **{name: f"acc[3*b+{i}]" for i, name in enumerate(("axb", "ayb", "alb"))},
    "ca": "cs[a, 0]",
    "sa": "cs[a, 1]",
    "cb": "cs[b, 0]",
    "sb": "cs[b, 1]",
    **{name: f"u[m, {i}]" for i, name in enumerate(("u_value", "u_dot", "u_ddot"))},
    **{f"cx{i}": f"u[m, {i}]" for i in range(3)},
    **{f"cy{i}": f"u[m + 2, {i}]" for i in range(3)},
    **{str(symbol): f"u[m + {i // 3}, {i % 3}]" for i, symbol in enumerate(d.FUNCTION.values())},
    **{str(symbol): f"guide[m, {i}]" for i, symbol in enumerate(d.GUIDE)},
    "cx3": "u[m + 1, 2]",
    "cy3": "u[m + 3, 2]",
    **{f"p{i}": f"p[k, {i}]" for i in range(6)},
    **{f"lam{i}": f"lam[k, {i}]" for i in range(2)},
    **{str(symbol): f"z[k, {i}]" for i, symbol in enumerate((*d.SECTION, *d.SECTION_RATES, d.c, d.s))},
    **{
        str(symbol): f"p[k, {6 + i}]"
        for i, symbol in enumerate((d.SECTION_LENGTH, *d.SECTION_STIFFNESS, *d.SECTION_REFERENCE, *d.SECTION_DAMPING))
    },
}


class Printer(PythonCodePrinter):
    """Prints function names without a module, and small powers as products and square roots.

    Only powers that are expected in an element definition are printed; any other power raises ValueError.
    """

    def __init__(self) -> None:
        super().__init__({"fully_qualified_modules": False})

    def _print_Pow(self, expr: sp.Pow, rational: bool = False, sqrt: str = "math.sqrt") -> str:
        base, exponent = expr.as_base_exp()
        text = self.parenthesize(base, 100)
        if exponent == sp.Rational(1, 2):
            return f"sqrt({self._print(base)})"
        if exponent == -sp.Rational(1, 2):
            return f"(1.0/sqrt({self._print(base)}))"
        if exponent.is_Integer and 1 < abs(exponent) <= 4:
            product = "*".join([text] * abs(int(exponent)))
            return f"({product})" if exponent > 0 else f"(1.0/({product}))"
        if exponent == -1:
            return f"(1.0/{text})"
        if exponent == sp.Rational(3, 2):
            return f"({text}*sqrt({self._print(base)}))"
        if exponent == -sp.Rational(3, 2):
            return f"(1.0/({text}*sqrt({self._print(base)})))"
        raise ValueError(f"no plain form for the power {expr}")

    def _print_Rational(self, expr: sp.Rational) -> str:
        return f"({float(expr.p)!r}/{float(expr.q)!r})"


def _kernel(name: str, arguments: str, note: str, outputs: Sequence[tuple[str, sp.Matrix]]) -> str:
    """Return the source of a kernel that writes `outputs`, which are pairs of array name and matrix.

    Entries that are identically zero are not written, except those of `ALWAYS_WRITTEN`.
    """
    targets: list[str] = []
    expressions: list[sp.Expr] = []
    for array, matrix in outputs:
        for index, entry in enumerate(matrix):
            if array == ALWAYS_WRITTEN or not _vanishes(entry):
                targets.append(f"{array}[k, {index}]")
                expressions.append(entry)
    temporaries, reduced_all = sp.cse(expressions, symbols=sp.numbered_symbols("t", real=True), optimizations="basic")
    printer = Printer()
    lines = ["@subkernel", f"def {name}({arguments}):", f'    """{note}"""']
    lines += _reads([e for _, e in temporaries] + list(reduced_all), printer)
    lines += [f"    {symbol} = {printer.doprint(expr)}" for symbol, expr in temporaries]
    equal: dict[str, list[str]] = {}  # tangents are symmetric, so that most values are written twice
    for target, expr in zip(targets, reduced_all, strict=True):
        equal.setdefault(repr(float(expr)) if expr.is_Integer else printer.doprint(expr), []).append(target)
    lines += [f"    {' = '.join(written)} = {value}" for value, written in equal.items()]
    return "\n".join(lines)


def _reads(expressions: Iterable[sp.Expr], printer: Printer) -> list[str]:
    """Return the lines that load the symbols and compute the intermediate quantities in `expressions`, in order."""
    used = set().union(*(e.free_symbols for e in expressions))
    inner = []
    for symbol, expr in reversed(d.INTERMEDIATES.items()):
        if symbol in used:
            used |= expr.free_symbols
            inner.append((str(symbol), printer.doprint(expr)))
    names = {str(s) for s in used}
    vectors = groupby(inner[::-1], lambda element: element[0][:-1] if element[0][-1] in "xy" else element[0])
    read = [(name, text) for name, text in _READS.items() if name in names]
    by_array = groupby(read, lambda element: element[1].partition("[")[0])
    parts = (zip(*elements, strict=True) for groups in (by_array, vectors) for _, elements in groups)
    return [f"    {', '.join(own)} = {', '.join(texts)}" for own, texts in parts]


def _vanishes(entry: sp.Expr) -> bool:
    return bool(sp.expand(entry) == 0)


def _mask(matrix: sp.Matrix) -> tuple[int, ...]:
    return tuple(i for i, entry in enumerate(matrix) if not _vanishes(entry))


def _masks(name: str, kinds: Iterable[tuple[str, sp.Matrix]]) -> str:
    rows = "\n".join(f'    "{kind}": {_mask(matrix)!r},' for kind, matrix in kinds)
    return f"{name} = {{\n{rows}\n}}"


def generated() -> str:
    """Return the source of the module."""
    parts = [HEADER]
    constraints = {kind.name: (kind, d.derive_constraint(kind)) for kind in d.CONSTRAINTS}
    pathways = {kind.name: (kind, d.derive_pathway(kind)) for kind in d.PATHWAYS}
    parts.append("CONSTRAINT_KINDS = " + repr(tuple(constraints)))
    parts.append("PATHWAY_KINDS = " + repr(tuple(pathways)))
    parts += [
        _masks(f"{key.upper()}_ENTRIES", ((name, terms[key]) for name, (_, terms) in constraints.items()))
        for key in ("jacobian", "stiffness", "gamma_v", "residual_q")
    ]
    parts += [
        _masks(f"{key.upper()}_ENTRIES", ((name, terms[key]) for name, (_, terms) in pathways.items()))
        for key in ("gradient", "hessian")
    ]
    for name, (kind, terms) in constraints.items():
        parts += _constraint_kernels(name, kind.note, terms)
    parts += [_loop_over_pairs(level, tuple(constraints)) for level in _LEVELS]
    for name, (path, terms) in pathways.items():
        parts += _pathway_kernels(name, path.note, terms)
    parts += _section_kernels(d.derive_section())
    return "\n\n\n".join(parts) + "\n"


def _constraint_kernels(name: str, note: str, terms: dict[str, sp.Matrix]) -> list[str]:
    contents = {
        "position": (f"{note}, and Phi_t.", [("phi", terms["phi"]), ("phi_t", terms["phi_t"])]),
        "acceleration": (
            "Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma.",
            [("jac", terms["jacobian"]), ("gamma", terms["gamma"])],
        ),
        "tangent": (
            "d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq.",
            [("stiff", terms["stiffness"]), ("gamma_v", terms["gamma_v"]), ("res_q", terms["residual_q"])],
        ),
    }
    return [
        _kernel(f"{name}_{level}", f"k, a, b, m, {_LEVELS[level][0]}", text, outputs)
        for level, (text, outputs) in contents.items()
    ]


def _loop_over_pairs(level: str, kinds: Sequence[str]) -> str:
    """Return the source of the function that calls the kernel of the right kind for every pair of rows.

    Numba cannot index a tuple of functions by a run-time number without losing inlining. The kind is therefore selected
    by a chain of comparisons, in the order of the codes.
    """
    arguments, note = _LEVELS[level]
    outer = ["pairs", "p", *(name for name in arguments.split(", ") if name != "p")]
    lines = ["@subkernel", f"def constraint_{level}s({', '.join(outer)}):", f'    """{note}"""']
    lines += ["    for k in range(len(pairs)):"]
    lines += ["        kind, a, b = pairs[k, PAIR.kind], pairs[k, PAIR.first], pairs[k, PAIR.second]"]
    lines += ["        m = pairs[k, PAIR.motion]"]
    for code, kind in enumerate(kinds):
        if code == len(kinds) - 1:
            lines.append("        else:")
        else:
            lines.append(f"        {'elif' if code else 'if'} kind == {code}:")
        lines.append(f"            {kind}_{level}(k, a, b, m, {arguments})")
    return "\n".join(lines)


def _pathway_kernels(name: str, note: str, terms: dict[str, sp.Matrix]) -> list[str]:
    outputs = [("s", terms["length"]), ("grad", terms["gradient"])]
    given = "k, a, b, m, q, cs, p, guide" if terms["length"].has(*d.GUIDE) else "k, a, b, q, cs, p"
    kernels = [_kernel(f"{name}_gradient", f"{given}, s, grad", f"Length {note} and its gradient.", outputs)]
    if _mask(terms["hessian"]):
        bend = [("hess", terms["hessian"])]
        kernels.append(_kernel(f"{name}_hessian", f"{given}, hess", f"Second derivatives of the length {note}.", bend))
    return kernels


def _section_kernels(terms: dict[str, sp.Matrix]) -> list[str]:
    forces = [(name, terms[name]) for name in ("force", "stress", "energy")]
    tangents = [(name, terms[name]) for name in ("stiffness", "damping")]
    note = "Force conjugate to the state of a cross-section, its stress, its strain energy and its dissipated power."
    return [
        _kernel("section_forces", "k, z, p, force, stress, energy", note, forces),
        _kernel("section_tangents", "k, z, p, stiffness, damping", "Derivatives of the force.", tangents),
    ]
