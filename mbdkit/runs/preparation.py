"""Preparation of a run: method, workspace, timetable, optional arrays and disk space."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from mbdkit.archive.disk_space import check_room, row_bytes
from mbdkit.archive.layout import CORRECTIONS, EVENTS, FRICTION, IMPACTS, SAMPLES, SETTINGS, of_elements, recorded_by
from mbdkit.base.called_functions import function_at, may_call, returned_before
from mbdkit.base.errors import PluginError, SpecError, StepError, blaming, with_place
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.plain_data import canonical, quoted
from mbdkit.base.text import listed
from mbdkit.engine.assembly import AssembledState
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.consistent_start import MechanismAtStart, Starts, within_double_precision, workspace_at_start
from mbdkit.engine.formulation import FORMULATIONS
from mbdkit.engine.kernels.table_rows import STATE_ROW
from mbdkit.engine.python_controllers import PythonControllers
from mbdkit.engine.redundancy import require_unique_start
from mbdkit.engine.workspace import Workspace
from mbdkit.expressions.program import Program
from mbdkit.integrators.interface import Failure, Guards, Stepper, Timetable
from mbdkit.integrators.start import start_method
from mbdkit.measures.take import check_measures
from mbdkit.mechanism.size import mechanism_size
from mbdkit.methods.kinds import Method
from mbdkit.methods.step_controls import controlled
from mbdkit.methods.step_methods import ExternalMethod
from mbdkit.methods.tableau import TableauError
from mbdkit.quantities.array import Array
from mbdkit.quantities.names import archive_names
from mbdkit.runs.corners import stops_of
from mbdkit.runs.findings import findings
from mbdkit.runs.run_seams import treatment_condition, treatment_start
from mbdkit.spec import RunSpec
from mbdkit.trust.finding import Finding


def caution(spec: RunSpec, measures: Sequence[str] = ()) -> list[Finding]:
    """Return what is doubtful or worth a note in a spec before its run.

    `measures`: expressions that are evaluated for the run, in addition to the measures of the spec. Raises PluginError
    if the plugin fails to create the method.
    """
    make_method(spec)
    return findings("spec", spec, measures)


def build(spec: RunSpec, starts: Starts | None = None) -> tuple[Workspace, AssembledState]:
    """Compile the mechanism of a spec and make its initial state consistent.

    `starts`: cache of compiled mechanisms for further runs, if given. Returns workspace for the integration, and
    consistent initial state, and its change by assembly. Raises SpecError if the joints cannot be assembled, the
    initial accelerations are not unique, or a measure is not valid.
    """
    mechanism = spec.mechanism()
    check_measures(spec)
    try:
        workspace, start = workspace_at_start(
            mechanism,
            spec.time.start,
            spec.time.final,
            formulation=spec.formulated.name,
            stabilization=spec.stabilized,
            starts=starts,
        )
        with within_double_precision():
            require_unique_start(workspace)
            workspace.mechanism.length**2  # step guards divide by this
            workspace.schedules, workspace.python = spec.schedules(), _functions(workspace.mechanism)
            chosen = workspace.mechanism.reacting
            if chosen is not None and (begin := chosen.item.begin) is not None:
                workspace = treatment_start.of(begin)(workspace)
    except SpecError as error:
        raise spec.placed(error) from error
    except StepError as error:
        assert chosen is not None
        raise spec.placed(SpecError(f"{error}, at the start", key=f"model.{chosen.key}")) from error
    return workspace, start


def _functions(mechanism: CompiledMechanism) -> PythonControllers | None:
    """Return what calls the functions of controllers, or repeats what they returned; None if neither is asked for."""
    before = returned_before()
    if not mechanism.in_python or not (may_call() or before is not None):
        return None
    functions = {}
    for controller in mechanism.in_python if may_call() else ():
        try:
            functions[controller.name] = function_at(controller.python)
        except SpecError as error:
            raise error.located(prefix=f"model.controllers.{quoted(controller.name)}.python") from error
    return PythonControllers(functions, before or {})


def check_calls(spec: RunSpec) -> None:
    """Check that the functions of controllers may be called, or that what they returned is known.

    Raises SpecError if not, or if the spec needs several runs in which functions would return different values.
    """
    for name, controller in spec.mechanism().controllers.items():
        if controller.python is None:
            continue
        key = f"model.controllers.{quoted(name)}.python"
        if not may_call() and returned_before() is None:
            message = f"runs '{controller.python}', code that is called only with --call (call=True in Python)"
            raise spec.placed(SpecError(message, key=key))
        if spec.is_to_be_chosen:
            message = "method and step are chosen by trial runs, each of which would call the functions of controllers"
            raise spec.placed(SpecError(f"{message}; give `integrator` and `time.step` instead", key="accuracy"))


def check_disk_space(spec: RunSpec, mechanism: CompiledMechanism, path: Path | None) -> None:
    """Check that the archive will fit on its disk or in memory.

    The check is skipped if the number of rows is not known in advance, because wall time is limited, or because an
    adaptive method records its steps.

    Raises SpecError if the archive is larger than the whole disk or memory. Raises ResourceError if the archive is
    larger than the space that is free now.
    """
    if (rows := rows_expected(spec)) is None or spec.limits.wall_time is not None:
        return
    row = row_bytes(archive_names(mechanism), spec.output.recorded)
    with SpecError.place_by(spec.placed):
        check_room(path, rows, row, spec.output.every)


def rows_expected(spec: RunSpec) -> int | None:
    """Return the number of rows that a run records; None if it depends on step-size control."""
    time, output = spec.time, spec.output
    if output.interval is not None:
        return math.ceil((time.final - time.start) / output.interval) + 1
    if time.count is not None and not spec.claims.adaptive:
        return math.ceil(min(time.count, spec.limits.max_steps) / (output.every or 1)) + 1
    return None


def make_method(spec: RunSpec) -> Method:
    """Create the method of a spec.

    Raises PluginError if the plugin fails to create a method that matches its claims. Raises SpecError if the method or
    other settings do not suit the treatment of elements.
    """
    try:
        with blaming(f"integrator {spec.integrator_item.id} failed to start"):
            method = spec.integrator_plugin.create(spec.integrator)
    except SpecError as error:
        raise PluginError(f"integrator {spec.integrator_item.id}: {error}") from error
    if not isinstance(method, Method):
        raise PluginError(
            f"integrator {spec.integrator_item.id} created an object of type {type(method).__name__}; it must "
            "create an ExplicitRungeKutta, an ImplicitRungeKutta, a SciPySolver, or an instance of a subclass of "
            "StepMethod or ExternalMethod"
        )
    with SpecError.place_by(spec.placed):
        method = controlled(method, spec.integrator, spec.integrator_item.name)
    if (chosen := spec.reacting) is not None and (require := chosen.item.require) is not None:
        with SpecError.place_by(spec.placed):
            treatment_condition.of(require)(spec, method)
    if spec.stabilized.symmetric and isinstance(method, ExternalMethod):
        raise PluginError(
            f"integrator {spec.integrator_item.id} claims to support symmetric projection, which libraries with a loop "
            "of their own do not, because it repeats their steps: it should claim "
            '`stabilizations=("none", "baumgarte", "projection")`'
        )
    return method


def recorded_arrays(spec: RunSpec, method: Method, mechanism: CompiledMechanism) -> tuple[Array, ...]:
    """Return the arrays of the layout that a run records."""
    names = archive_names(mechanism)
    carries_multipliers = method.traits.carries_multipliers(spec.formulated)
    optional = [
        *(["constraints/method_multiplier"] if carries_multipliers else []),
        *of_elements(names),
        *(FRICTION if mechanism.friction else ()),
        *(IMPACTS if mechanism.reacting is not None or spec.impacts == "allow" else ()),
        *(["constraints/singularity_distance"] if mechanism.solved_rows else []),
        *CORRECTIONS[spec.stabilized.kind],
        *(EVENTS if spec.events else ()),
        *(SETTINGS if mechanism.inputs else ()),
        *(SAMPLES if mechanism.in_python else ()),
    ]
    return recorded_by(names, spec.output.recorded, frozenset(optional))


def size_at_start(spec: RunSpec, start: Workspace | MechanismAtStart) -> float:
    """Return the size of the mechanism at its start [m]; its characteristic length if all points coincide."""
    return mechanism_size(spec.mechanism(), start.q0[:-3].reshape(-1, 3)) or start.mechanism.length


def timetable(
    spec: RunSpec,
    size: float | None,
    *,
    all_knots: bool = False,
    nodes: bool = False,
    ends: bool = False,
    integrands: Sequence[Program] = (),
    share: float | None = None,
) -> Timetable:
    """Return the timetable of a run: start, end, steps, stops (see `stops_of`), recorded states, nodes and limits.

    `size` of the mechanism [m]: misalignments are limited relative to it; None for a run without limits on its states.
    With `all_knots`, points of tables close to the grid are stops as well. With `nodes`, states at the stages of steps
    are stored. With `ends`, the stepper returns after each step unless all steps are recorded, so that the states at
    the ends of all steps are available. `integrands`, `share`: see `stops_of`.
    """
    stops, limits = stops_of(spec, all_knots=all_knots, integrands=integrands, share=share), spec.limits
    table = Timetable(
        start=spec.time.start,
        end=spec.time.final,
        step=spec.time.step,
        steps=spec.time.count or 0,
        every=spec.output.every or 1,
        interval=spec.output.interval,
        max_steps=limits.max_steps,
        nodes=nodes,
        single=bool(spec.events),
        guards=Guards() if size is None else guards_of(spec, size),
        stops=stops.times,
        stop_margins=stops.margins,
        impacts=tuple(stops.impacts),
        samples=stops.samples,
        step_limits=stops.step_limits,
    )
    reacts = spec.reacting is not None
    return replace(table, single=table.single or reacts or not rows_are_ends(table)) if ends else table


def guards_of(spec: RunSpec, size: float) -> Guards:
    """Return the limits on the states of a run; `size` of the mechanism [m]."""
    limits = spec.limits
    jump = math.inf if limits.energy_jump is None else limits.energy_jump
    return Guards(limits.misalignment * size, limits.misalignment, jump)


@dataclass(frozen=True, eq=False)
class RunSetup:
    """A spec that is ready to be integrated.

    - `spec`, `method`: the spec, and the method of its integrator.
    - `workspace`, `start`: the mechanism at its consistent start, and the changes made by assembly.
    """

    spec: RunSpec
    method: Method
    workspace: Workspace
    start: AssembledState

    @classmethod
    def of(cls, spec: RunSpec, starts: Starts | None = None, *, method: Method | None = None) -> RunSetup:
        """Return the setup of a spec; `starts` and errors: see `build`. `method` is created if omitted."""
        return cls(spec, method or make_method(spec), *build(spec, starts))

    @cached_property
    def size(self) -> float:
        """Size of the mechanism at its start [m]."""
        return size_at_start(self.spec, self.workspace)

    def timetable(self, **wanted: Any) -> Timetable:
        """Return the timetable of the run; for the arguments, see the function of this name."""
        return timetable(self.spec, self.size, **wanted)

    def stepper(self, table: Timetable | None = None) -> Stepper:
        """Return a stepper at the start, with another timetable if one is given; for errors, see `start_method`."""
        return start_method(self.method, self.workspace, table or self.timetable())

    def findings(self, measures: Sequence[str] = ()) -> list[Finding]:
        """Return what is doubtful or worth a note in the spec and at the start; for `measures`, see `caution`."""
        return [*findings("spec", self.spec, measures), *findings("start", self.spec, self.start)]

    def require_support(self) -> None:
        """Check before a run that its method supports the formulation and the mechanism.

        Raises SpecError if the method takes its steps in Python and its claims do not include the first-order states of
        the mechanism. Raises UnsupportedMechanismError if the method itself refuses the mechanism. Raises PluginError
        if the method cannot be used with a formulation that it claims.
        """
        spec, method, mechanism = self.spec, self.method, self.workspace.mechanism
        try:
            method.require_formulation(FORMULATIONS[spec.formulated.name])
        except TableauError as error:
            raise PluginError(
                f"integrator {spec.integrator_item.id} claims {spec.formulated.name}, but {error}"
            ) from error
        method.require_mechanism(mechanism)
        changing = mechanism.topology.states[:, STATE_ROW.rate] >= 0
        own = [
            state.name
            for state, changes in zip(mechanism.states, changing, strict=True)
            if not state.by_method and (changes or not method.traits.holds_states)
        ]
        integrates = method.traits.integrates_states
        if own and not (spec.claims.states if integrates is None else integrates):
            unclaimed = ", because it does not claim `states`" if integrates is None else ""
            message = (
                f"the integrator {spec.integrator_item.name} does not integrate first-order states "
                f"({listed(own, 'and')}){unclaimed}; gauss and dop853 do"
            )
            raise spec.placed(SpecError(message, key="integrator"))


def rows_are_ends(table: Timetable) -> bool:
    """Return whether a run records the end of every step."""
    return table.every == 1 and table.interval is None and not table.stops


def plugin_failure(spec: RunSpec, error: BaseException) -> Failure:
    """Return the failure of a run whose third-party integrator has raised an exception.

    Exceptions of other integrators are raised again.
    """
    item = spec.integrator_item
    if item.origin.distribution == "mbdkit":
        raise error
    return Failure("plugin-error", f"integrator {item.id} raised {with_place(error)}.")


def written_forces(spec: RunSpec, names: Iterable[str]) -> list[str]:
    """Return the keys of forces with these names, with the loads that are expressions of the state."""
    forces = canonical(spec.sections()["model"]).get("forces", {})
    values = {f"model.forces.{quoted(name)}": forces.get(name, {}).get("value") for name in names}
    return [key if value is None else f"{key}.value, {value}," for key, value in values.items()]
