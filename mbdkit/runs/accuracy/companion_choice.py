"""Chooses the companions (comparison runs) of a run: two finer runs, and *guards*, which are runs by other methods.

The finer runs use the method of the run if possible.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np
from pydantic import BaseModel

from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Timetable
from mbdkit.mechanism.element_kinds import ChosenTreatment
from mbdkit.methods import dop853, gauss, radau_iia
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Method, Tolerances
from mbdkit.methods.step_controls import controlled
from mbdkit.registry.items import IntegratorPlugin
from mbdkit.registry.manager import registry
from mbdkit.runs.accuracy.companion import NEVER, Companion, finer, row_interval, until
from mbdkit.runs.preparation import make_method, timetable
from mbdkit.runs.run_seams import treatment_guards
from mbdkit.spec import RunSpec

HALVINGS = (2, 4)  #: Factors by which the steps of a fixed-step run are divided for its companions.

TENTHS = (10.0, 100.0)  #: Factors by which the tolerances of an adaptive run are divided for its companions.

#: The factors, as in `TENTHS`, for companions whose method is not that of the run.
#:
#: They are larger, because SciPy's Radau is up to 100 times more accurate than its tolerance.
OTHER_TENTHS = (1e3, 1e5)

TIGHTEST = 1e-13  #: Smallest tolerance of a companion; below it, rounding errors dominate.

#: Tolerance of the guard run by DOP853. Its error must be small compared with that of the run, or the estimate is too
#: large.
GUARD_TOLERANCE = 1e-13

#: Tolerance of an implicit guard run. It is larger than that of DOP853, because implicit methods of lower order need
#: more steps.
IMPLICIT_GUARD_TOLERANCE = 1e-11

#: Largest number of steps of a guard (a comparison run with another method): the sum of a constant and of a multiple of
#: the number of steps of the run.
#:
#: On stiff problems explicit guards exceed it, and the next guard is tried. A limit on wall time would make the result
#: depend on the machine.
GUARD_STEPS = (20_000, 40)

#: The numbers, as in `GUARD_STEPS`, for companions that return after each step, which takes about 0.1 ms more per step.
SINGLE_STEPS = (5_000, 10)


#: Smallest number of steps of a guard (a comparison run with another method), unless the run itself has at least
#: as many fixed steps.
#:
#: Adaptive steps of a body at rest grow without limit, and then miss a short pulse at any tolerance.
LOOKS = 2_000


@dataclass(frozen=True)
class Chosen:
    """The companions of a run.

    `finer`: two runs of increasing accuracy. `guards`: runs by other methods; the first one that reaches the end is
    used. `refinement`: factor between the steps or tolerances of successive runs; base of the logarithms of the
    observed order. `what`: what is divided by `refinement`: ``step`` or ``tolerance``.
    """

    finer: tuple[Companion, Companion]
    guards: tuple[Companion, ...]
    refinement: float
    what: str


def choose_companions(spec: RunSpec, method: Method, workspace: Workspace, times: np.ndarray, steps: int) -> Chosen:
    """Choose the companions of a run.

    `spec`, `method`, `workspace`: the run. `times`: (T,) times of the recorded rows [s]. `steps`: number of steps of
    the run.
    """
    within = _steps_within(spec, times)
    plan, interval = within, None
    if spec.claims.adaptive:
        what, (first, second) = "tolerance", _tighter(spec, method, workspace, within)
        rough, fine = TENTHS if _has_tolerances(spec, method) else OTHER_TENTHS
    else:
        what, plan = "step", timetable(spec, None)
        interval = row_interval(plan)
        rough, fine = step_factors(spec)
        first, second = (
            Companion(
                f"step {table.step:.4g} s",
                partial(make_method, spec),
                table,
                spec.formulated.name,
                spec.stabilized,
                within_steps=False,
            )
            for table in (finer(plan, times, factor) for factor in step_factors(spec))
        )
    guards = _guards_of_treatment(spec, method, plan, times)
    if guards is None:
        guards = _guards(spec, method, workspace, within, steps, interval)
    return Chosen((first, second), guards, fine / rough, what)


def step_factors(spec: RunSpec) -> tuple[int, int]:
    """Return the factors by which the fixed steps of two comparison runs are smaller than those of the run."""
    chosen = spec.reacting
    return (None if chosen is None else chosen.item.factors) or HALVINGS


def guards_of_treatment(spec: RunSpec, method: Method) -> tuple[ChosenTreatment, Mapping[str, int]] | None:
    """Return the treatment in guards of a run that determines reactions of elements, the names of the methods, and the
    factors of their steps; None for other runs.
    """
    chosen = spec.reacting
    if chosen is None or chosen.item.guards is None:
        return None
    return chosen.replaced(chosen.item.guarded_by), treatment_guards.of(chosen.item.guards)(method)


def _guards_of_treatment(
    spec: RunSpec, method: Method, plan: Timetable, times: np.ndarray
) -> tuple[Companion, ...] | None:
    """Return the guards of a run that determines reactions of elements, with fixed steps if the run has."""
    if (treated := guards_of_treatment(spec, method)) is None:
        return None
    treatment, factors = treated
    kind = treatment.section.treatment
    is_fixed, tight = not spec.claims.adaptive, {"adaptive": True, "rtol": GUARD_TOLERANCE}
    return tuple(
        Companion(
            f"{kind} {name}" if is_fixed else f"adaptive {kind} {name}",
            _created(name, {} if is_fixed else tight),
            finer(plan, times, factor) if is_fixed else plan,
            "index-1",
            NONE,
            within_steps=not is_fixed,
            treatment=treatment,
        )
        for name, factor in factors.items()
    )


def _created(name: str, options: Mapping[str, object]) -> Callable[[], Method]:
    plugin = cast(IntegratorPlugin, registry().get("integrator", name).plugin)
    return cast("Callable[[], Method]", partial(plugin.create, plugin.options(**options)))


def _tighter(spec: RunSpec, method: Method, workspace: Workspace, within: Timetable) -> tuple[Companion, Companion]:
    """Return two companions of an adaptive run with tighter tolerances.

    For methods of SciPy and of plugins, the companions use the adaptive Radau IIA method. Dense output of SciPy's
    methods is less accurate than the ends of their steps, and plugins may name their tolerances differently.
    """
    options = spec.integrator
    own = _has_tolerances(spec, method)
    given = _tolerances(spec, method)
    companions = []
    for factor in TENTHS if own else OTHER_TENTHS:
        rtol, atol = max(given.rtol / factor, TIGHTEST), max(given.atol / factor, TIGHTEST * given.atol / given.rtol)
        tolerances = replace(given, rtol=rtol, atol=atol)
        table = replace(within, max_steps=spec.limits.max_steps * int(factor), step=spec.time.step if own else None)
        if own:
            update = {"rtol": tolerances.rtol, "atol": None if given.by_size else tolerances.atol}
            changed = options.model_copy(update=update)
            create = partial(_own_method, spec, changed)
            name = f"tolerance {tolerances.rtol:.2g}"
            run: tuple[str, Stabilization] = (spec.formulated.name, spec.stabilized)
        else:
            create = partial(_radau, tolerances)
            name = f"adaptive radau-iia with tolerance {tolerances.rtol:.2g}"
            run = ("index-1", _projected(workspace))
        companions.append(Companion(name, create, table, *run, within_steps=True))
    return companions[0], companions[1]


def _own_method(spec: RunSpec, options: BaseModel) -> Method:
    """Return the method of a spec with other options."""
    method = cast(Method, spec.integrator_plugin.create(options))
    return controlled(method, options, spec.integrator_item.name)


def _tolerances(spec: RunSpec, method: Method) -> Tolerances:
    if method.traits.tolerances is not None:
        return replace(method.traits.tolerances, max_step=None, control=None)
    rtol = getattr(spec.integrator, "rtol", None) or 1e-6
    atol = getattr(spec.integrator, "atol", None)
    return Tolerances(rtol, atol or rtol, by_size=atol is None)


def _has_tolerances(spec: RunSpec, method: Method) -> bool:
    return "rtol" in type(spec.integrator).model_fields and method.traits.tableau is not None


def _guards(
    spec: RunSpec, method: Method, workspace: Workspace, within: Timetable, steps: int, interval: float | None
) -> tuple[Companion, ...]:
    """Return guards with other methods than the run: explicit first, then implicit.

    Guards solve the index-1 equations and are projected onto the constraints, so that they also differ in drift, and
    pass singular positions on the right branch. If the method of the run is for stiff mechanisms, the last guard solves
    the index-2 equations: index-1 accelerations of stiff beams are dominated by round-off, which would make adaptive
    steps ever smaller. This guard may be of the same family as the method of the run, but has another order.
    """
    tableau, stiff = method.traits.tableau, method.traits.suits_stiff
    name = "" if tableau is None else tableau.name
    within = replace(within, max_steps=LOOKS + _most(SINGLE_STEPS, steps))
    dense, longest = within, (within.end - within.start) / LOOKS
    tight = Tolerances(GUARD_TOLERANCE, GUARD_TOLERANCE, longest, by_size=True)
    loose = Tolerances(IMPLICIT_GUARD_TOLERANCE, IMPLICIT_GUARD_TOLERANCE, longest, by_size=True)
    # Rows of `dense` at stops may show the state on either side of the stop; with impacts, these states differ.
    if interval is not None and steps >= LOOKS and not within.impacts:
        dense = replace(within, every=1, interval=interval, single=False, max_steps=_most(GUARD_STEPS, steps))
        tight = replace(tight, max_step=None)
    candidates: Sequence[tuple[str, str, Callable[[], Method], Timetable]] = (
        ("dop853", "dop853", partial(_dop853, tight), dense),
        ("radau-iia", "radau-iia of order 9", partial(_radau, loose), within),
        ("gauss", "gauss of order 10", partial(_gauss, loose), within),
    )
    companions = tuple(
        Companion(
            f"adaptive {description}",
            create,
            table,
            "index-1",
            _projected(workspace),
            within_steps=table is within,
        )
        for family, description, create, table in candidates
        if not name.startswith(family) and (family != "gauss" or stiff)
    )
    if not stiff or not workspace.mechanism.rows or name == radau_iia.tableau(5).name:
        return companions
    description = "adaptive radau-iia of order 9 and index 2"
    create = partial(_radau, loose)
    return *companions, Companion(description, create, within, "index-2", NONE, within_steps=True)


def _most(limits: tuple[int, int], steps: int) -> int:
    return limits[0] + limits[1] * steps


def _projected(workspace: Workspace) -> Stabilization:
    """Return projection after every step if the mechanism has constraints; with reactions of elements, steps project
    themselves.
    """
    mechanism = workspace.mechanism
    return Stabilization("projection") if len(mechanism.rows) and mechanism.reacting is None else NONE


def _steps_within(spec: RunSpec, times: np.ndarray) -> Timetable:
    """Return the timetable of an adaptive run over `times` that returns after each step."""
    run = until(timetable(spec, None, all_knots=True), float(times[-1]))
    return replace(run, step=None, steps=0, every=NEVER, interval=None, single=True)


def _dop853(tolerances: Tolerances) -> Method:
    return ExplicitRungeKutta(dop853.tableau(), dop853.pair(), tolerances)


def _radau(tolerances: Tolerances) -> Method:
    return ImplicitRungeKutta(radau_iia.tableau(5), tolerances=tolerances)


def _gauss(tolerances: Tolerances) -> Method:
    return ImplicitRungeKutta(gauss.tableau(5), tolerances=tolerances)
