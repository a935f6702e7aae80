"""What the summary of a run says of muscles, and its headlines."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.archive.headlines import JOINTS_NAMED, Headline, largest_of, plus_minus, run_headlines
from mbdkit.archive.result_seams import summary_lines
from mbdkit.archive.run import Run
from mbdkit.archive.run_summary import few, ranked
from mbdkit.base.errors import MbdkitError

#: Range of the lengths of fibres, in optimal lengths, outside of which their active force is almost zero.
PULLING = (0.4, 1.6)


@summary_lines
def muscle_lines(run: Run) -> list[tuple[str, str]]:
    """Return the lines of the summary about muscles, each with its label; texts may be empty."""
    return [
        ("muscles", _largest_activations(run)),
        ("", _far_fibers(run)),
        ("contact", _contact_forces(run)),
    ]


@run_headlines
def activations(run: Run) -> list[Headline]:
    """Return the two largest activations of muscles."""
    if not run.records("muscles/activation"):
        return []
    return largest_of("activation of", run, list(run.muscles), run.array("muscles/activation"), "1", None)[:2]


def _largest_activations(run: Run) -> str:
    peaks = []
    for name, muscle in run.muscles.items():
        row = int(np.argmax(muscle.activation))
        peaks.append((float(muscle.activation[row]), f"{name} {muscle.activation[row]:.3g} at {run.time[row]:.4g} s"))
    rows = "" if run.kind == "inverse" else " in the recorded rows"
    return f"largest activations{rows} {few(ranked(peaks))}" if peaks else ""


def _far_fibers(run: Run) -> str:
    """Return the muscles whose fibres leave the lengths at which they can pull, unless the verdict names them."""
    if any("fibers: " in reason for reason in run.verdict_reasons):
        return ""
    try:
        muscles = run.mechanism.muscles if run.muscles else {}
    except MbdkitError:  # this version does not know all of its bodies
        return ""
    texts = []
    for name, muscle in run.muscles.items():
        lengths = muscle.fiber_length[np.isfinite(muscle.fiber_length)]
        if name in muscles and lengths.size:
            low, high = lengths.min() / muscles[name].optimal_length, lengths.max() / muscles[name].optimal_length
            if low < PULLING[0] or high > PULLING[1]:
                texts.append(f"those of {name} are {low:.3g} to {high:.3g} optimal lengths long")
    limits = f"below {PULLING[0]:g} and above {PULLING[1]:g} optimal lengths"
    return f"fibres have almost no active force {limits}; {few(texts)}" if texts else ""


def _contact_forces(run: Run) -> str:
    """Return the largest reaction forces of joints with muscles, and those of the same joints without muscles.

    Joints whose force the muscles change by less than 0.1 % are left out. Empty without recruitment.
    """
    if not run.records("muscles/certificate"):
        return ""
    without = np.linalg.norm(run.array("muscles/reaction_force_without"), axis=2)
    size = np.linalg.norm(run.array("joints/reaction_force"), axis=2)
    errors = run.errors.of_reactions("reaction_error", size)
    parts = []
    for index, name in enumerate(run.joint_names):
        largest, most = float(np.max(size[:, index])), float(np.max(without[:, index]))
        error = math.nan if errors is None else float(errors[index])
        with_muscles = f"{largest:.4g}" if math.isnan(error) else plus_minus(largest, error)
        if largest > 1.001 * most or largest < 0.999 * most:
            parts.append((largest, f"{name} {with_muscles} N, {most:.4g} N without muscles"))
    return "; ".join(ranked(parts)[:JOINTS_NAMED])
