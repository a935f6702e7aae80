"""How runs conclude: their status, their verdict and its reasons, from what is known at their end.

A conclusion depends on nothing else, so that it is the same for simulated runs, runs in lanes, and computed motions.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mbdkit.archive.run_writer import Ending
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
    """What was largest in R runs of mechanisms with the same J joints; a single run is the case R = 1.

    - `end`: (R,) time of the last recorded state [s].
    - `misalignment`: (R, J) largest misalignment of each joint over all steps [m].
    - `angle_misalignment`: (R, J) largest angle misalignment of the recorded states [rad].
    - `energies`: largest energies and energy errors of the recorded states of each run.
    - `steps`: quantities observed over all steps of each run, recorded or not.
    """

    end: np.ndarray
    misalignment: np.ndarray
    angle_misalignment: np.ndarray
    energies: Sequence[EnergyRecord]
    steps: Sequence[StepEvidence]

    @classmethod
    def of_states(cls, states: States) -> Extremes:
        """Return those of one motion that was not integrated, so that it has no energy errors."""
        gaps = states.misalignment.max(axis=0, initial=0.0)[None]
        return cls(states.time[-1:], gaps, np.zeros_like(gaps), [EnergyRecord()], [NO_STEPS])

    def of_runs(self, runs: list[int]) -> Extremes:
        """Return those of some of the runs."""
        energies, steps = [self.energies[run] for run in runs], [self.steps[run] for run in runs]
        return Extremes(self.end[runs], self.misalignment[runs], self.angle_misalignment[runs], energies, steps)


@dataclass(frozen=True, eq=False, kw_only=True)
class EndedRun:
    """What is known of a run that has ended, besides what was largest in it.

    - `mechanism`: the compiled mechanism. `size`: its size [m].
    - `doubts`: doubts about the spec and the run. `warnings`: all warnings about them, as sentences.
    - `status`, `reason`: see `Ending`.
    - `counters`, `pivotings`: work of the steps, and how often pivots were chosen, which takes one factorization each.
    - `timings`: wall and processor times, as in `Ending.stats` [s].
    - `errors`: estimated errors; None if they were not estimated.
    - `finer`: see `mbdkit.spec.run_spec.RunSpec.finer`.
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


def conclude(runs: Sequence[EndedRun], extremes: Extremes) -> list[Ending]:
    """Return how each of R runs has ended: its status, its verdict with the reasons, its warnings and its work."""
    gaps, angles = (_largest(values) for values in (extremes.misalignment, extremes.angle_misalignment))
    endings = []
    for run, end, misalignment, gap, angle, energies, steps in zip(
        runs, extremes.end.tolist(), extremes.misalignment, gaps, angles, extremes.energies, extremes.steps,
        strict=True,
    ):  # fmt: skip
        topology, joints, is_locked = run.mechanism.topology, (*run.mechanism.joints, ""), run.mechanism.is_locked
        level = gravity_level(topology.mass[:-1, 0], topology.mass[:-1, 2], topology.gravity)
        evidence = Evidence(
            status=run.status,
            status_reason=run.reason,
            end=end,
            size=run.size,
            misalignment=gap[0],
            joint=joints[gap[1]],
            angle_misalignment=angle[0],
            angle_joint=joints[angle[1]],
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
        )
        stats = {**vars(run.counters), **run.timings}
        stats["factorizations"] += run.pivotings
        endings.append(Ending(run.status, run.reason, stats, misalignment, judge(evidence, run.errors), run.warnings))
    return endings


def log_end(spec: Callable[[], RunSpec], ending: Ending) -> None:
    """Log status and verdict of a run, and its work; `spec` is called if its name is logged."""
    message = f"{ending.status}: {ending.reason.removeprefix('interrupted: ')}" if ending.reason else ending.status
    level = logging.WARNING if ending.status == "failed" else logging.INFO
    if _LOG.isEnabledFor(level):
        _LOG.log(level, "run %s ends: %s, verdict %s", spec().run_id(), message, ending.judgement.level)
    _LOG.debug("counters and timings: %s", ending.stats)


def _largest(values: np.ndarray) -> list[tuple[float, int]]:
    """Return the largest of the values (R, J) of the joints of each run, at least 0, and the number of its joint, -1
    without joints; nan counts as largest.
    """
    if not values.shape[1]:
        return [(0.0, -1)] * len(values)
    columns = values.argmax(axis=1)
    largest = values[np.arange(len(values)), columns].tolist()
    return [(0.0 if gap <= 0.0 else gap, column) for gap, column in zip(largest, columns.tolist(), strict=True)]
