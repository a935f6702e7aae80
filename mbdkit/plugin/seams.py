"""Decorators for functions of plugins: what mbdkit passes to them, and what they return."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.archive.headlines import excluded_words as excluded_words, run_headlines as run_headlines
    from mbdkit.archive.result_seams import (
        exported_files as exported_files, file_problems as file_problems, run_attribute as run_attribute,
        summary_lines as summary_lines,
    )
    from mbdkit.engine.compile_forces import expression_lowering as expression_lowering, lowering as lowering
    from mbdkit.engine.compile_mechanism import recorded_members as recorded_members
    from mbdkit.engine.consistent_start import start_values as start_values
    from mbdkit.engine.law_conditions import (
        LawCondition as LawCondition, gradient_doubts as gradient_doubts, law_sides as law_sides,
    )
    from mbdkit.integrators.loop.failed_steps import (
        obstacle_clause as obstacle_clause, stiffness_clause as stiffness_clause,
    )
    from mbdkit.integrators.start import treatment_method as treatment_method
    from mbdkit.measures.take import measure_function as measure_function
    from mbdkit.mechanism.element_kinds import (
        ElementsByName as ElementsByName, element_check as element_check, element_files as element_files,
        element_forces as element_forces,
    )
    from mbdkit.mechanism.mechanism_seams import (
        element_lines as element_lines, mechanism_attribute as mechanism_attribute, member_names as member_names,
        model_builder as model_builder, model_extension as model_extension, run_check as run_check,
    )
    from mbdkit.methods.kinds import integrator_method as integrator_method
    from mbdkit.methods.step_filter import step_filter as step_filter
    from mbdkit.registry.items import integrator_claims as integrator_claims
    from mbdkit.runs.followers import follower as follower
    from mbdkit.runs.run_seams import (
        computed_run as computed_run, end_criterion as end_criterion,
        repeated_run as repeated_run, rows_criterion as rows_criterion, spec_criterion as spec_criterion,
        start_criterion as start_criterion, treatment_condition as treatment_condition,
        treatment_guards as treatment_guards, treatment_start as treatment_start,
    )
    from mbdkit.spec.spec_kinds import (
        Source as Source, packaged_spec as packaged_spec, spec_check as spec_check, spec_loader as spec_loader,
        spec_schema as spec_schema,
    )
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
