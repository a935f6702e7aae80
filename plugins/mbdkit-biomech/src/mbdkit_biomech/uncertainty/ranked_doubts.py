"""What doubts change in the largest joint force: the most important one comes first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, reactions_of
from mbdkit_biomech.inverse_dynamics.criteria.load_criteria import residual_wrench
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import free_roots
from mbdkit_biomech.uncertainty.changed_problem import Changer

#: First words of the names of the sources of error that a criterion doubts.
SOURCES: Mapping[str, tuple[str, ...]] = {
    "centers": ("centre",), "lengths": ("centre", "lengths"), "load-point": ("pressure",), "load-time": ("offset",),
    "load-offset": ("gain",), "misfit": ("centre", "pressure", "gain", "mass", "inertia", "zero"),
    "fibers": ("fibre", "tendon"), "max-force": ("strength",), "inertia": ("inertia",),
    **dict.fromkeys(("noise", "fit", "cutoff", "gaps", "ends", "large-errors", "outliers"), ("noise",)),
}  # fmt: skip


def ranked_doubts(result: Inverse, bars: ResultBars | None, findings: Sequence[Finding]) -> list[Finding]:
    """Return findings with the change of the largest joint force, the largest first; those whose effect is not known,
    and remarks, keep their order.

    The effect of residuals is the residual force at the time of the largest force, and that of an offset of the plates
    the change without its correction. Other effects are the parts of the error bar by the sources that are doubted.
    """
    force = np.linalg.norm(reactions_of(result)[..., :2], axis=2)
    if not force.size or not any(one.level for one in findings):
        return list(findings)
    row, joint = map(int, np.unravel_index(np.argmax(force), force.shape))
    name = result.problem.prepared.workspace.mechanism.joints[joint]
    known = {one.criterion: _effect(one.criterion, result, bars, row, joint) for one in findings if one.level}

    def with_effect(one: Finding) -> Finding:
        if not one.level or not known[one.criterion]:
            return one
        effect = f"(about {float(f'{known[one.criterion]:.2g}'):g} N of the largest force, of {name})"
        return replace(one, sentence=f"{one.sentence.rstrip('.')} {effect}")

    return sorted(map(with_effect, findings), key=lambda one: -known[one.criterion] if one.level else 0.0)


def _effect(criterion: str, result: Inverse, bars: ResultBars | None, row: int, joint: int) -> float:
    """Return the effect of the doubts of a criterion on the force of a joint in a row [N]; 0 if it is not known."""
    if criterion in ("residuals", "residual-size"):
        residual = residual_wrench(result, free_roots(result.problem.names.mechanism)[0], None, only_residuals=False)[0]
        return float(np.linalg.norm(residual[row, :2]))
    person = result.problem.source.person
    if criterion == "plates" and person is not None and person.plates.offset is not None and person.plates.loads:
        try:
            other = Changer(result).at({("offset",): -person.plates.offset.late}).forces()
        except MbdkitError:
            return 0.0
        return float(np.nan_to_num(np.linalg.norm((reactions_of(other) - reactions_of(result))[row, joint, :2])))
    if bars is None or not (parts := bars.accuracy.further):
        return 0.0
    of = [str(name).split(" ")[0] in SOURCES.get(criterion, ()) for name in parts["source"].values]
    share = float(np.sum(np.maximum(parts["contribution"].values[of, row, joint], 0.0)))
    return float(np.nan_to_num(bars.accuracy.reaction_error[row, joint] * share**0.5))
