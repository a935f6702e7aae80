"""Generate ``mbdkit_contact/kernels/row_kernels.py`` from the definitions of contact rows.

Run by ``python -m mbdkit_builder contacts``.
"""

from __future__ import annotations

from pathlib import Path

import sympy as sp

from mbdkit.engine.native import machine_code
from mbdkit_builder.element_kernels import Printer
from mbdkit_contact.contact_rows import ARGUMENTS, numbers_of, row_definition

TARGET = machine_code.folder_of("mbdkit_contact") / "kernels/row_kernels.py"
KINDS = ("line", "circles", "hole")

HEADER = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")


class _Printer(Printer):
    """Prints ``choose(x, a, b)`` as a conditional expression."""

    def _print_Function(self, expr: sp.Expr) -> str:
        condition, first, second = map(self._print, expr.args)
        return f"({first} if {condition} > 0.0 else {second})"


def _function(name: str, kind: str, count: int, note: str) -> str:
    definition, printer = row_definition(kind), _Printer()
    wanted = definition.quantities[:count]
    used, steps = set().union(*(quantity.free_symbols for quantity in wanted)), []
    for symbol, expression in reversed(definition.steps):
        if symbol in used:
            used |= expression.free_symbols
            steps.append(f"    {symbol} = {printer.doprint(expression)}")
    given = [(symbol, f"{'ab'[i // 7]}[{i % 7}]") for i, symbol in enumerate(ARGUMENTS)]
    given += [(symbol, f"p[{i}]") for i, symbol in enumerate(numbers_of(kind))]
    lines = [
        "@subkernel",
        f"def {name}(a, b, p{', out' if count > 1 else ''}):",
        f'    """{note}"""',
        *[f"    {symbol} = {place}" for symbol, place in given if symbol in used],
        *steps[::-1],
    ]
    if count == 1:
        return "\n".join([*lines, f"    return {printer.doprint(wanted[0])}"])
    return "\n".join([*lines, *(f"    out[{i}] = {printer.doprint(one)}" for i, one in enumerate(wanted))])


def generated() -> str:
    """Return the source of the module."""
    parts = [HEADER]
    for name in KINDS:
        parts.append(_function(f"{name}_gap", name, 1, "Return the gap."))
        parts.append(_function(f"{name}_row", name, 16, "Compute all quantities."))
    return "\n\n\n".join(parts) + "\n"
