"""How runs conclude: their status, their verdict and its reasons, from what is known at their end.

A conclusion depends on nothing else, so that it is the same for simulated runs, runs in lanes, and computed motions.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import numpy as np

from mbdkit.archive.run_writer import Ending
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.logs import logger_of
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.counters import Counters
from mbdkit.integrators.interface import StepEvidence
from mbdkit.quantities.states import States
from mbdkit.spec import RunSpec
from mbdkit.trust.criteria import EstimatedErrors, Evidence, judge
from mbdkit.trust.energy_record import EnergyRecord, gravity_level
from mbdkit.trust.finding import Doubts

_LOG = logger_of("mbdkit.runs.simulation")  # the start and the end of a run go to the same logger

NO_STEPS = StepEvidence(0.0, 0.0, 0.0)  #: Evidence of a run whose method could not start.


@dataclass(frozen=True, eq=False)
class Extremes:
    """What was largest in a run of a mechanism with J joints.

    - `end`: time of the last recorded state [s].
    - `misalignment`: (J,) largest misalignment of each joint over all steps [m].
    - `angle_misalignment`: (J,) largest angle misalignment of the recorded states [rad].
    - `energies`: largest energies and energy errors of the recorded states.
    - `steps`: quantities observed over all steps, recorded or not.
    """

    end: float
    misalignment: np.ndarray
    angle_misalignment: np.ndarray
    energies: EnergyRecord
    steps: StepEvidence

    @classmethod
    def of_states(cls, states: States) -> Extremes:
        """Return those of a motion that was not integrated, so that it has no energy errors."""
        gaps = states.misalignment.max(axis=0, initial=0.0)
        return cls(float(states.time[-1]), gaps, np.zeros_like(gaps), EnergyRecord(), NO_STEPS)


@dataclass(frozen=True, eq=False, kw_only=True)
class EndedRun:
    """What is known of a run that has ended, besides what was largest in it.

    - `mechanism`: the compiled mechanism. `size`: its size [m].
    - `doubts`: doubts about the spec and the run. `warnings`: all warnings about them, as sentences.
    - `status`, `reason`: see `Ending`.
    - `counters`, `pivotings`: work of the steps, and how often pivots were chosen, which takes one factorization each.
    - `timings`: wall and processor times, as in `Ending.stats` [s].
    - `errors`: estimated errors; None if they were not estimated.
    - `finer`: see `mbdkit.spec.run_spec.RunSpec.finer`. `coarse`: see `Evidence`.
    """

    mechanism: CompiledMechanism
    size: float
    doubts: Doubts
    warnings: tuple[str, ...] = ()
    status: str = "complete"
    reason: str = ""
    counters: Counters = field(default_factory=Counters)
    pivotings: int = 0
    timings: Mapping[str, float] = field(default_factory=dict)
    errors: EstimatedErrors | None = None
    finer: str = "smaller steps"
    coarse: Callable[[], str] = str


def conclude(run: EndedRun, extremes: Extremes) -> Ending:
    """Return how a run has ended: its status, its verdict with the reasons, its warnings and its work."""
    (gap, joint), (angle, angle_joint) = (_largest(x) for x in (extremes.misalignment, extremes.angle_misalignment))
    energies, steps = extremes.energies, extremes.steps
    topology, joints, is_locked = run.mechanism.topology, (*run.mechanism.joints, ""), run.mechanism.is_locked
    level = gravity_level(topology.mass[:-1, 0], topology.mass[:-1, 2], topology.gravity)
    evidence = Evidence(
        status=run.status,
        status_reason=run.reason,
        end=extremes.end,
        size=run.size,
        misalignment=gap,
        joint=joints[joint],
        angle_misalignment=angle,
        angle_joint=joints[angle_joint],
        kinetic=max(energies.kinetic, steps.kinetic),
        energy=float(np.maximum(energies.energy, level)),  # nan if the energies are not known
        balance=0.0 if is_locked else energies.balance,
        energy_jump=0.0 if is_locked else steps.energy_jump,
        energy_jump_time=steps.energy_jump_time,
        branch=steps.branch,
        warnings=run.doubts.open,
        accepted=run.doubts.accepted,
        faults=run.doubts.faults,
        finer=run.finer,
        coarse=run.coarse,
    )
    stats = {**vars(run.counters), **run.timings}
    stats["factorizations"] += run.pivotings
    return Ending(run.status, run.reason, stats, extremes.misalignment, judge(evidence, run.errors), run.warnings)


def logs_ends() -> bool:
    """Return whether `log_end` may log anything."""
    return _LOG.isEnabledFor(logging.INFO)


def log_end(spec: RunSpec, ending: Ending) -> None:
    """Log status and verdict of a run, and its work."""
    message = f"{ending.status}: {ending.reason.removeprefix('interrupted: ')}" if ending.reason else ending.status
    level = logging.WARNING if ending.status == "failed" else logging.INFO
    if _LOG.isEnabledFor(level):
        _LOG.log(level, "run %s ends: %s, verdict %s", spec.run_id(), message, ending.judgement.level)
    _LOG.debug("counters and timings: %s", ending.stats)


def _largest(values: np.ndarray) -> tuple[float, int]:
    """Return the largest of the values (J,) of joints, at least 0, and the number of its joint, -1 without joints; nan
    counts as largest.
    """
    if not len(values):
        return 0.0, -1
    joint = int(values.argmax())
    largest = float(values[joint])
    return (0.0 if largest <= 0.0 else largest), joint
