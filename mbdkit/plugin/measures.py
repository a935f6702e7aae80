"""Measures, events and expressions: programs, their derivatives, functionals over time."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.events.event_expression import RunExpression as RunExpression
    from mbdkit.events.state_program import state_program as state_program
    from mbdkit.events.watch import Found as Found, Watch as Watch, Watched as Watched
    from mbdkit.expressions.operations import (
        OF_PARTS as OF_PARTS, OPERATIONS as OPERATIONS, REDUCE as REDUCE, arity_of as arity_of,
    )
    from mbdkit.expressions.parser import Compiler as Compiler
    from mbdkit.expressions.program import (
        MAX_DEPTH as MAX_DEPTH, Program as Program, execute as execute, value_of as value_of,
    )
    from mbdkit.measures.measure_compiler import MeasureCompiler as MeasureCompiler
    from mbdkit.measures.measure_expression import MeasureExpression as MeasureExpression
    from mbdkit.measures.measured_quantities import recorded as recorded, unit_of as unit_of
    from mbdkit.measures.natural_size import natural_scales as natural_scales, natural_size as natural_size
    from mbdkit.measures.reductions import Functional as Functional, REDUCTIONS as REDUCTIONS
    from mbdkit.measures.take import (
        Description as Description, check_measures as check_measures, describe as describe, error_of as error_of,
        take as take, take_all as take_all,
    )
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
