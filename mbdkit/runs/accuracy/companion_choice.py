"""Chooses the comparison runs of a run: two finer runs, and *guards*, which are runs by other methods.

The finer runs use the method of the run if possible. `Companion` says how they are evaluated at the recorded times of
the run; `compared_measures` carries them out as runs of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit.base.frozen import dataclass, replace
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.integrators.interface import Timetable
from mbdkit.mechanism.element_kinds import ChosenTreatment
from mbdkit.methods import radau_iia
from mbdkit.methods.kinds import Method, Tolerances
from mbdkit.runs.accuracy.companion import NEVER, Companion, Comparison, finer, row_interval, until
from mbdkit.runs.preparation import RunSetup, timetable
from mbdkit.runs.run_seams import treatment_guards
from mbdkit.spec import RunSpec

HALVINGS = (2, 4)  #: Factors by which the steps of a fixed-step run are divided for its companions.

TENTHS = (10, 100)  #: Factors by which the tolerances of an adaptive run are divided for its companions.

#: The factors, as in `TENTHS`, for companions whose method is not that of the run.
#:
#: They are larger, because SciPy's Radau is up to 100 times more accurate than its tolerance.
OTHER_TENTHS = (1_000, 100_000)

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


def choose_companions(setup: RunSetup, times: np.ndarray, steps: int) -> Chosen:
    """Choose the companions of a run.

    `times`: (T,) times of the recorded rows [s]. `steps`: number of steps of the run.
    """
    spec, is_fixed = setup.spec, not setup.spec.claims.adaptive
    within, plan = _steps_within(spec, times), timetable(spec, None)
    first_step = spec.time.step if has_tolerances(setup) else None
    companions = []
    for run in finer_runs(setup):
        most = spec.limits.max_steps * run.factor
        table = finer(plan, times, run.factor) if is_fixed else replace(within, max_steps=most, step=first_step)
        companions.append(Companion(run, table, within_steps=not is_fixed))
    first, second = companions
    guards = []
    is_treated = guards_of_treatment(spec, setup.method) is not None
    # Rows at intervals are computed in machine code. Rows at stops may show the state on either side of the stop; with
    # impacts, these states differ.
    is_dense = is_fixed and not within.impacts
    for run in other_runs(setup, within.end, is_limited=not is_dense or steps < LOOKS):
        if is_treated:
            table = finer(plan, times, run.factor) if is_fixed else within
            guards.append(Companion(run, table, within_steps=not is_fixed))
        elif is_dense and run.item.name == "dop853":
            most = most_steps(steps) if steps < LOOKS else GUARD_STEPS[0] + GUARD_STEPS[1] * steps
            table = replace(within, every=1, interval=row_interval(plan), single=False, max_steps=most)
            guards.append(Companion(run, table, within_steps=False))
        else:
            guards.append(Companion(run, replace(within, max_steps=most_steps(steps)), within_steps=True))
    what = "step" if is_fixed else "tolerance"
    return Chosen((first, second), tuple(guards), second.run.factor / first.run.factor, what)


def most_steps(steps: int) -> int:
    """Return the largest number of steps of a guard of a run with this number of steps."""
    return LOOKS + SINGLE_STEPS[0] + SINGLE_STEPS[1] * steps


def guards_of_treatment(spec: RunSpec, method: Method) -> tuple[ChosenTreatment, Mapping[str, int]] | None:
    """Return the treatment in guards of a run that determines reactions of elements, the names of the methods, and the
    factors of their steps; None for other runs.
    """
    if (chosen := spec.reacting) is None or chosen.item.guards is None:
        return None
    return chosen.replaced(chosen.item.guarded_by), treatment_guards.of(chosen.item.guards)(method)


def finer_runs(setup: RunSetup) -> list[Comparison]:
    """Return two runs with smaller steps or tighter tolerances.

    For adaptive methods of SciPy and of plugins, they use the adaptive Radau IIA method. Dense output of SciPy's
    methods is less accurate than the ends of their steps, and plugins may name their tolerances differently.
    """
    spec = setup.spec
    own = Comparison("", spec.integrator_item, spec.integrator)
    if not spec.claims.adaptive:
        assert spec.time.step is not None
        step, chosen = spec.time.step, spec.reacting
        factors = (None if chosen is None else chosen.item.factors) or HALVINGS
        return [replace(own, name=f"step {step / factor:.4g} s", factor=factor) for factor in factors]
    given, runs = _tolerances(setup), []
    is_own = has_tolerances(setup)
    for factor in TENTHS if is_own else OTHER_TENTHS:
        rtol = max(given.rtol / factor, TIGHTEST)
        atol = None if given.by_size else max(given.atol / factor, TIGHTEST * given.atol / given.rtol)
        tolerances = {"rtol": rtol, "atol": atol}
        if is_own:
            run = replace(own, name=f"tolerance {rtol:.2g}", options=spec.integrator.model_copy(update=tolerances))
        else:
            name, projected = f"adaptive radau-iia with tolerance {rtol:.2g}", _projected(setup)
            run = Comparison.of_other("radau-iia", name, "index-1", projected, stages=5, adaptive=True, **tolerances)
        runs.append(replace(run, factor=factor))
    return runs


def _tolerances(setup: RunSetup) -> Tolerances:
    if setup.method.traits.tolerances is not None:
        return setup.method.traits.tolerances
    rtol, atol = (getattr(setup.spec.integrator, name, None) for name in ("rtol", "atol"))
    return Tolerances(rtol or 1e-6, atol or rtol or 1e-6, by_size=atol is None)


def has_tolerances(setup: RunSetup) -> bool:
    """Return whether the tolerance of the method of a run can be divided for its comparison runs."""
    return "rtol" in type(setup.spec.integrator).model_fields and setup.method.traits.tableau is not None


def other_runs(setup: RunSetup, end: float, *, is_limited: bool = True) -> list[Comparison]:
    """Return runs up to `end` [s] with other methods than the run: explicit first, then implicit.

    They solve the index-1 equations and are projected onto the constraints, so that they also differ in drift, and pass
    singular positions on the right branch. If the method of the run is for stiff mechanisms, the last run solves the
    index-2 equations: index-1 accelerations of stiff beams are dominated by round-off, which would make adaptive steps
    ever smaller. This run may be of the same family as the method of the run, but has another order.

    If the run determines reactions of elements, the runs have fixed steps if the run has. `is_limited`: whether steps
    by DOP853 have the largest size that `LOOKS` says.
    """
    spec, method = setup.spec, setup.method
    adaptive: dict[str, Any] = {"adaptive": True, "rtol": GUARD_TOLERANCE}
    if (treated := guards_of_treatment(spec, method)) is not None:
        treatment, factors = treated
        word, options = ("adaptive ", adaptive) if spec.claims.adaptive else ("", {})
        kind = f"{word}{treatment.section.treatment}"
        others = {name: Comparison.of_other(name, f"{kind} {name}", "index-1", NONE, **options) for name in factors}
        return [replace(run, factor=factors[name], treatment=treatment) for name, run in others.items()]
    tableau, stiff, projected = method.traits.tableau, method.traits.suits_stiff, _projected(setup)
    family, longest = "" if tableau is None else tableau.name, (end - spec.time.start) / LOOKS
    loose = adaptive | {"stages": 5, "rtol": IMPLICIT_GUARD_TOLERANCE, "max_step": longest}
    runs = [
        Comparison.of_other(name, f"adaptive {description}", "index-1", projected, **options)
        for name, description, options in (
            ("dop853", "dop853", adaptive | {"max_step": longest if is_limited else None}),
            ("radau-iia", "radau-iia of order 9", loose),
            ("gauss", "gauss of order 10", loose),
        )
        if not family.startswith(name) and (name != "gauss" or stiff)
    ]
    if stiff and setup.workspace.mechanism.rows and family != radau_iia.tableau(5).name:
        name = "adaptive radau-iia of order 9 and index 2"
        runs.append(Comparison.of_other("radau-iia", name, "index-2", NONE, **loose))
    return runs


def _projected(setup: RunSetup) -> Stabilization:
    """Return projection after every step if the mechanism has constraints; with reactions of elements, steps project
    themselves.
    """
    mechanism = setup.workspace.mechanism
    return Stabilization("projection") if len(mechanism.rows) and mechanism.reacting is None else NONE


def _steps_within(spec: RunSpec, times: np.ndarray) -> Timetable:
    """Return the timetable of an adaptive run over `times` that returns after each step."""
    run = until(timetable(spec, None, all_knots=True), float(times[-1]))
    return replace(run, step=None, steps=0, every=NEVER, interval=None, single=True)
