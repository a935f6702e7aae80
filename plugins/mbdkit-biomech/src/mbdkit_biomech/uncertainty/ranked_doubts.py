"""What doubts change in the largest joint force: the most important one comes first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbdkit.plugin import Finding, MbdkitError
from mbdkit_biomech.inverse_dynamics.compute import Inverse, reaction_forces
from mbdkit_biomech.inverse_dynamics.criteria.load_criteria import residual_wrench
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import free_roots
from mbdkit_biomech.uncertainty.changed_problem import Changer
from mbdkit_biomech.uncertainty.uncertain_result import OF_DATA

SOURCES: Mapping[str, tuple[str, ...]] = {
    "centers": ("centre",), "lengths": ("centre", "lengths"), "load-point": ("pressure",), "load-time": ("offset",),
    "load-offset": ("gain",), "misfit": ("centre", "pressure", "gain", "mass", "inertia", "zero"),
    "fibers": ("fibre", "tendon"), "max-force": ("strength",), "inertia": ("inertia",),
    **dict.fromkeys(("noise", "fit", "cutoff", "gaps", "ends", "large-errors", "outliers"), ("noise",)),
}  # fmt: skip
"""First words of the names of the sources of error that a criterion doubts."""


def ranked_doubts(result: Inverse, bars: ResultBars | None, findings: Sequence[Finding]) -> list[Finding]:
    """Return findings with the change of the largest joint force, the largest first; those whose effect is not known,
    and remarks, keep their order.

    The effect of residuals is the residual force at the time of the largest force, and that of an offset of the plates
    the change without its correction. Other effects are the parts of the error bar by the sources that are doubted.
    """
    force = np.linalg.norm(reaction_forces(result), axis=2)
    if not force.size or not any(one.level for one in findings):
        return list(findings)
    row, joint = map(int, np.unravel_index(np.argmax(force), force.shape))
    name = result.problem.prepared.workspace.mechanism.joints[joint]
    known = {one.criterion: 0.0 for one in findings if one.level}
    known = {criterion: _effect(criterion, result, bars, (row, joint)) for criterion in known}
    told = [
        replace(
            one,
            sentence=f"{one.sentence.rstrip('.')} (about {known[one.criterion]:.2g} N of the largest force, of {name})",
        )
        if one.level and known[one.criterion] > 0
        else one
        for one in findings
    ]
    return sorted(told, key=lambda one: -known.get(one.criterion, 0.0) if one.level else 0.0)


def _effect(criterion: str, result: Inverse, bars: ResultBars | None, at: tuple[int, int]) -> float:
    """Return the effect of the doubts of a criterion on the force of a joint in a row [N]; 0 if it is not known."""
    row, joint = at
    if criterion in ("residuals", "residual-size"):
        residual = residual_wrench(result, free_roots(result.problem.names.mechanism)[0], None, only_residuals=False)[0]
        return float(np.linalg.norm(residual[row, :2]))
    person = result.problem.source.person
    if criterion == "plates" and person is not None and person.plates.offset is not None and person.plates.loads:
        try:
            other = Changer(result).at({("offset",): -person.plates.offset.late}).forces()
        except MbdkitError:
            return 0.0
        change = float(np.linalg.norm((reaction_forces(other) - reaction_forces(result))[row, joint]))
        return change if np.isfinite(change) else 0.0
    if bars is None or not (parts := bars.accuracy.further):
        return 0.0
    words = SOURCES.get(criterion, ())
    of = [
        str(name).split(" ")[0] in words and (words != ("noise",) or name == OF_DATA) for name in parts["source"].values
    ]
    share = float(np.sum(np.maximum(parts["contribution"].values[of, row, joint], 0.0)))
    effect = float(bars.accuracy.reaction_error[row, joint]) * share**0.5
    return effect if np.isfinite(effect) else 0.0
