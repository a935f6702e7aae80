"""The plan of a run for the compiled step loop: times, recording, step-size control, projection, stabilization.

A plan does not change during a run. Data that change are in `mbdkit.integrators.run.run_state`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.stabilization import NONE
from mbdkit.integrators.interface import Guards, Timetable
from mbdkit.integrators.run.step_control import ControlData, control_data
from mbdkit.trust.criteria import ENERGY_JUMP

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.stabilization import Stabilization
    from mbdkit.integrators.run.step_control import Control

#: Projection modes: none, after each step, symmetrically before and after it, or after steps near singular positions.
#:
#: `NEAR_SINGULARITY` applies to controlled steps without stabilization. With drift, the path through a singular
#: position is deformed into a sharp but smooth bend onto another branch (another possible motion), which small steps
#: follow; if the constraints are satisfied, there is no such bend.
NO_PROJECTION, PLAIN, SYMMETRIC, NEAR_SINGULARITY = range(4)

#: Share of the largest distance to singularity so far below which controlled steps are projected; chosen.
#:
#: The share matters little. When it was chosen, with an earlier pivoted solver, 23 of 40 adaptive runs of linkages
#: through singular (flat) positions were correct with 0.1, 25 with 0.5, and 27 if every step was projected. Guards
#: detect the wrong runs.
NEAR = 0.2

#: Number of iterations of a symmetric projection after which the approximation of its matrix begins anew; chosen. The
#: iterations converge in about ten, or do not converge.
CHANGES = 20

#: Smallest controlled step size, relative to the largest time of the run: a few rounding errors of the time.
MIN_SIZE = 16 * float(np.finfo(float).eps)


class Times(NamedTuple):
    """Start and end of a run and its steps; each array has one element."""

    start: np.ndarray
    end: np.ndarray
    step: np.ndarray  #: Size of a fixed step [s].
    last_step: np.ndarray  #: Size of the last fixed step [s].
    steps: np.ndarray  #: Number of fixed steps.
    stops: np.ndarray  #: (S,) times at which steps end, in order [s].
    margins: np.ndarray  #: (S,) margin of each stop [s]; see `Timetable`.
    impacts: np.ndarray  #: (S,) whether an impulse changes the velocities at a stop.


class Recording(NamedTuple):
    """Which states are recorded; each array has one element."""

    every: np.ndarray  #: Number k: every k-th step and the end are recorded; 0 if states are recorded by `interval`.
    interval: np.ndarray  #: Distance of recorded states in time [s]; the end is recorded as well.
    start_of_step: np.ndarray  #: Whether the state at the start of the last step is stored in ``before_q, before_v``.


class ProjectionPlan(NamedTuple):
    """When states are projected onto the constraints; each array has one element."""

    mode: np.ndarray  #: NO_PROJECTION, PLAIN, SYMMETRIC or NEAR_SINGULARITY.
    every: np.ndarray  #: Project after every k-th step.
    bound: np.ndarray  #: Project only if a constraint is violated by more than this; 0 means always.
    near: np.ndarray  #: Share of the largest distance to singularity so far below which NEAR_SINGULARITY projects.
    #: (K, 2, P, 2) work array: changes of the multipliers in the iterations of a symmetric projection; else no rows.
    changes: np.ndarray


#: Share of rounding errors that no change of the energy balance exceeds; zero times infinity would not be a limit.
LARGEST = 1e300


class GuardLimits(NamedTuple):
    """Limits at which a run stops."""

    squared_misalignment: np.ndarray  #: (P,) largest squared misalignment of each pair of constraint rows [m^2, rad^2].
    #: (1,) change of the energy balance in a step, as a share of the largest kinetic energy so far; infinite: off.
    energy_jump: np.ndarray
    #: (1,) change of the energy balance, in the same form, above which step size control rejects a step.
    rejected_jump: np.ndarray


class RunPlan(NamedTuple):
    """The plan of a run."""

    times: Times
    recording: Recording
    control: ControlData
    projection: ProjectionPlan
    baumgarte: np.ndarray  #: (1,) whether Baumgarte's terms are part of the equations, so that their size is recorded.
    limits: GuardLimits


def _real(x: float) -> np.ndarray:
    return np.array([x], dtype=np.float64)


def _whole(x: int) -> np.ndarray:
    return np.array([x], dtype=np.int64)


def projection_mode(stabilization: Stabilization, *, controlled: bool) -> int:
    """Return the projection mode of a stabilization, with controlled or with fixed steps."""
    if stabilization.kind == "none" and controlled:
        return NEAR_SINGULARITY
    if stabilization.kind != "projection":
        return NO_PROJECTION
    return SYMMETRIC if stabilization.symmetric else PLAIN


def guard_limits(mechanism: CompiledMechanism, guards: Guards) -> GuardLimits:
    """Return the limits at which a run of a mechanism stops, as the kernels read them."""
    largest = np.full(len(mechanism.topology.pairs), guards.misalignment)
    for row in mechanism.rows:
        if row.unit == "rad":
            largest[row.pair] = guards.angle_misalignment
    with np.errstate(over="ignore"):  # an infinite limit is never exceeded
        squared = largest**2
    if mechanism.is_locked:
        return GuardLimits(squared, _real(np.inf), _real(LARGEST))
    return GuardLimits(squared, _real(guards.energy_jump), _real(ENERGY_JUMP))


def smallest_step(table: Timetable) -> float:
    """Return the size below which a controlled step stops the run [s]."""
    return MIN_SIZE * max(abs(table.start), abs(table.end), table.end - table.start)


def new_plan(
    timetable: Timetable, control: Control | None, stabilization: Stabilization, limits: GuardLimits
) -> RunPlan:
    """Return the plan of a run; `control` is None for fixed steps."""
    table, mode = timetable, projection_mode(stabilization, controlled=control is not None)
    step = table.step or 0.0
    last = step if control is not None else table.last_step
    return RunPlan(
        times=Times(
            _real(table.start),
            _real(table.end),
            _real(step),
            _real(last),
            _whole(table.steps),
            np.array(table.stops, dtype=np.float64),
            np.array(table.stop_margins, dtype=np.float64),
            np.array([stop in table.impacts for stop in table.stops], dtype=np.int64),
        ),
        recording=Recording(
            every=_whole(0 if table.interval is not None else table.every),
            interval=_real(table.interval or 0.0),
            start_of_step=_whole(table.single),
        ),
        control=control_data(control, smallest_step(table)),
        projection=ProjectionPlan(
            mode=_whole(mode),
            every=_whole(stabilization.every),
            bound=_real(stabilization.bound or 0.0),
            near=_real(NEAR),
            changes=np.zeros((CHANGES if mode == SYMMETRIC else 0, 2, len(limits.squared_misalignment), 2)),
        ),
        baumgarte=_whole(stabilization.kind == "baumgarte"),
        limits=limits,
    )


def single_step(plan: RunPlan, t: float, h: float, *, projected: bool) -> RunPlan:
    """Return the plan of a run of one fixed step of size `h` from `t` with the projection of `plan`."""
    never = 2  # of one step
    no_stops = np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64)
    return RunPlan(
        times=Times(_real(t), _real(t + h), _real(h), _real(h), _whole(1), *no_stops),
        recording=Recording(every=_whole(never), interval=_real(0.0), start_of_step=_whole(0)),
        control=control_data(None, 0.0),
        projection=plan.projection._replace(every=_whole(1 if projected else never)),
        baumgarte=_whole(0),
        limits=plan.limits,
    )


def _example() -> RunPlan:
    no_limits = GuardLimits(np.zeros(0), _real(np.inf), _real(np.inf))
    return new_plan(Timetable(0.0, 1.0, step=1.0, steps=1), None, NONE, no_limits)


load_plan = bundle_loader(_example)
