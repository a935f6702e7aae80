"""Measures, events and expressions: programs, their derivatives, functionals over time."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.events.event_expression import RunExpression as RunExpression
    from mbdkit.expressions.operations import OPERATIONS as OPERATIONS
    from mbdkit.measures.measure_compiler import MeasureCompiler as MeasureCompiler
    from mbdkit.measures.measure_expression import MeasureExpression as MeasureExpression
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
