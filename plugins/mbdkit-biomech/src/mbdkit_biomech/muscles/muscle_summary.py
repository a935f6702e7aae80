"""What the summary of a run says of muscles, and its headlines."""

from __future__ import annotations

import numpy as np

from mbdkit.archive.headlines import JOINTS_NAMED, Headline, answers, largest_of, run_headlines
from mbdkit.archive.result_seams import summary_lines
from mbdkit.archive.run import Run
from mbdkit.archive.run_summary import few
from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.muscles.patella import PatellaPath

#: Range of the lengths of fibres, in optimal lengths, outside of which their active force is almost zero.
PULLING = (0.4, 1.6)


@summary_lines
def muscle_lines(run: Run) -> list[tuple[str, str]]:
    """Return the lines of the summary about muscles, each with its label; texts may be empty."""
    own = [("muscles", _largest_activations(run)), ("", _far_fibers(run)), ("", _bent_knees(run))]
    return [*own, ("contact", _contact_forces(run))]


@run_headlines
def activations(run: Run) -> list[Headline]:
    """Return the largest activations of muscles; the two largest are headlines."""
    if not run.records("muscles/activation"):
        return []
    values = run.array("muscles/activation")
    found = largest_of("activation of", run, "muscles.activation", list(run.muscles), values, "1", None)
    return [one._replace(is_main=number < 2) for number, one in enumerate(found)]


def _largest_activations(run: Run) -> str:
    peaks = [f"{one.element} {one.value:.3g} at {one.time:.4g} s" for one in activations(run)]
    rows = "" if run.kind == "inverse" else " in the recorded rows"
    return f"largest activations{rows} {few(peaks)}" if peaks else ""


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


def _bent_knees(run: Run) -> str:
    """Return the knees that bend farther in a run than the data of their patellas; inverse dynamics warns of them."""
    try:
        names = QuantityNames(run.mechanism) if run.muscles and run.kind != "inverse" else None
    except MbdkitError:  # this version does not know all of its bodies
        return ""
    muscles, bent = {} if names is None else names.mechanism.muscles, dict[str, str]()
    for name, muscle in muscles.items():
        if names is not None and muscle.patella is not None:
            patella = PatellaPath(muscle.patella, muscle.path[-1].on, names, f"muscles.{name}.patella")
            bent[patella.joint] = patella.beyond_data(run.array("trajectory/position").reshape(len(run.time), -1))
    return few(list(filter(None, bent.values())))


def _contact_forces(run: Run) -> str:
    """Return the largest reaction forces of joints with muscles, and those of the same joints without muscles.

    Joints whose force the muscles change by less than 0.1 % are left out. Empty without recruitment.
    """
    if not run.records("muscles/certificate"):
        return ""
    without = np.linalg.norm(run.array("muscles/reaction_force_without"), axis=2)
    parts = []
    for one in (one for one in answers(run) if one.quantity == "joints.force"):
        most = float(np.max(without[:, run.joint_names.index(one.element)]))
        if one.value > 1.001 * most or one.value < 0.999 * most:
            parts.append(f"{one.element} {one.text()}, {most:.4g} N without muscles")
    return "; ".join(parts[:JOINTS_NAMED])
