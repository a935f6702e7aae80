"""Collects the numbers on which the verdict on a finished run is based."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.peak_errors import errors_of_largest, expression_of_largest, missed_by_rows, missed_of_verdict
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.integrators.interface import StepEvidence
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.registered_kinds import peaks_of
from mbdkit.runs.law_ranges import steps_are_rows
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.recorder import Recorder
from mbdkit.spec import RunSpec
from mbdkit.trust.criteria import EstimatedErrors, Evidence
from mbdkit.trust.energy_record import EnergyRecord, gravity_level
from mbdkit.trust.finding import Finding, accepted_doubts, open_doubts


class Recorded(Protocol):
    """Quantities recorded during a run; implemented by `Recorder`."""

    @property
    def mechanism(self) -> CompiledMechanism:
        """The compiled mechanism."""
        ...

    @property
    def largest_angle(self) -> np.ndarray:
        """(J,) largest angle misalignment of the recorded states [rad]."""
        ...

    @property
    def energies(self) -> EnergyRecord:
        """Largest energies and energy errors of the recorded states."""
        ...

    @property
    def last_time(self) -> float:
        """Time of the last recorded state [s]."""
        ...


def evidence_of_run(
    spec: RunSpec,
    recorder: Recorded,
    steps: StepEvidence | None,
    ending: tuple[str, str],
    misalignment_max: np.ndarray,
    size: float,
    found: Sequence[Finding],
    doubts: Iterable[str] = (),
) -> Evidence:
    """Return the evidence of a run that has ended.

    - `spec`: spec of the run, which may accept findings.
    - `recorder`: the recorder, after all rows have been written.
    - `steps`: quantities observed over all steps, including steps that are not recorded; None if the method could not
      start.
    - `ending`: status and reason.
    - `misalignment_max`: (J,) largest misalignment of each joint over all steps [m].
    - `size`: size of the mechanism [m].
    - `found`: findings about the spec and the run.
    - `doubts`: further sentences that cast doubt on the result.
    """
    steps = steps or StepEvidence(0.0, 0.0, 0.0)
    energies, topology = recorder.energies, recorder.mechanism.topology
    level = gravity_level(topology.mass[:-1, 0], topology.mass[:-1, 2], topology.gravity)
    misalignment, joint = _largest(recorder, misalignment_max)
    angle_misalignment, angle_joint = _largest(recorder, recorder.largest_angle)
    return Evidence(
        status=ending[0],
        status_reason=ending[1],
        end=recorder.last_time,
        size=size,
        misalignment=misalignment,
        joint=joint,
        angle_misalignment=angle_misalignment,
        angle_joint=angle_joint,
        kinetic=max(energies.kinetic, steps.kinetic),
        energy=float(np.maximum(energies.energy, level)),  # nan if the energies are not known
        balance=0.0 if recorder.mechanism.is_locked else energies.balance,
        energy_jump=0.0 if recorder.mechanism.is_locked else steps.energy_jump,
        energy_jump_time=steps.energy_jump_time,
        branch=steps.branch,
        warnings=(*open_doubts(found, spec.accept), *doubts),
        accepted=accepted_doubts(found, spec.accept),
        faults=open_doubts(found, spec.accept, "bad"),
        finer=spec.finer,
    )


def estimated_errors(
    spec: RunSpec, recorder: Recorder, accuracy: Accuracy, position_error: float, missed: str, integrals: Integrals
) -> EstimatedErrors:
    """Return the estimated errors of a checked run in the form used by the verdict.

    - `recorder`: the recorder, which has stored the rows.
    - `accuracy`: the estimates.
    - `position_error`: largest estimated error of positions as a share of the mechanism's size; nan if nothing is
      known.
    - `missed`: reason why the requested accuracy is not reached, as a clause.
    - `integrals`: integrals and extrema of the run.
    """
    skips_steps = not steps_are_rows(spec) and "joints" in spec.recorded
    measures = {measure.name: measure.expression for measure in spec.defined_measures() if measure.item is None}
    rows, joints = ObservedRows.joined(recorder.kept or []), recorder.workspace.mechanism.joints
    size = np.linalg.norm(rows.force, axis=2)
    beyond = missed_by_rows(integrals, "joints.force", joints, size, skips_steps=skips_steps)
    beyond = missed_of_verdict(beyond, joints, measures)
    figures = accuracy.figures(joints, rows.force, beyond)
    worst = figures.worst_joint
    between = ""
    if worst is not None and worst.missed > worst.error:
        advice = "record more rows" if skips_steps else f"use {spec.finer}"
        between = (
            f"joint '{worst.name}' reaches {worst.peak + worst.missed:.4g} N, in the recorded rows {worst.peak:.4g} N; "
            f"{advice}"
        )
    peak, peak_of = _peak_error(recorder, accuracy, integrals)
    return EstimatedErrors(
        position=position_error,
        peak=peak,
        peak_of=peak_of,
        reaction=0.0 if worst is None else worst.share,
        known_until=figures.known_until,
        between=between,
        **({} if math.isnan(accuracy.asked) else {"asked": accuracy.asked, "reached": accuracy.reached}),
        missed=missed,
        unknown=accuracy.unknown,
    )


def _peak_error(recorder: Recorder, accuracy: Accuracy, integrals: Integrals) -> tuple[float, str]:
    """Return the largest error of the largest force of an element of a plugin's kind, relative to this force, and a
    phrase that names the force.

    Only forces that were compared with those of other runs count; without them, the result is 0 and an empty text. An
    unknown error is nan, and counts as the largest.
    """
    ratios = [(0.0, "")]
    for peaks in peaks_of(archive_names(recorder.workspace.mechanism)):
        force, kind = peaks.quantities[0], element_kinds()[peaks.of].name
        errors = errors_of_largest(integrals, accuracy.compared_measures, force, peaks.names)
        for name, error in zip(peaks.names, errors.tolist(), strict=True):
            text = expression_of_largest(force, name)
            if text in accuracy.compared_measures:
                phrase = f"the largest {force.partition('.')[2].replace('_', ' ')} of {kind} '{name}'"
                ratios.append((error / float(integrals[text]), phrase))  # type: ignore[arg-type] # not a vector
    return max(ratios, key=lambda ratio: math.inf if math.isnan(ratio[0]) else ratio[0])


def _largest(recorder: Recorded, values: np.ndarray) -> tuple[float, str]:
    """Return the largest of the values (J,) of joints, at least 0, and the name of its joint; nan counts as largest."""
    if not len(values):
        return 0.0, ""
    index = int(values.argmax())
    largest = float(values[index])
    return 0.0 if largest <= 0.0 else largest, recorder.mechanism.joints[index]
