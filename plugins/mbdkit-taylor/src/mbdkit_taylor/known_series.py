"""Determines whether a mechanism has Taylor series: each of its elements must have a recurrence in the kernels."""

from __future__ import annotations

import numpy as np

from mbdkit.base.errors import UnsupportedMechanismError
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.applied_forces import PATHWAYS
from mbdkit.engine.kernels.motions import OPCODES
from mbdkit.engine.kernels.table_rows import SPRING
from mbdkit.engine.spanning_tree import is_tree_of_pins, spanning_tree
from mbdkit_taylor.kernels.power_series import EXPANDED

_PATHWAYS = [PATHWAYS[name] for name in ("two_points", "relative_angle")]
_CODES = {OPCODES[name] for name in EXPANDED}


def require_series(mechanism: CompiledMechanism) -> None:
    """Raise UnsupportedMechanismError if a mechanism has elements without Taylor series; the message lists them all."""
    top = mechanism.topology
    others = len(top.springs) and (
        np.any(top.springs[:, SPRING.law] >= 0) or not np.all(np.isin(top.springs[:, SPRING.pathway], _PATHWAYS))
    )
    refused = {
        "closed loops, joints other than pins, or joint friction": not is_tree_of_pins(top, spanning_tree(top)),
        "forces other than linear springs and dampers between two points or two angles, torques and point forces": (
            others or len(top.sections) or len(top.states)
        ),
        "loads that depend on the state": len(top.inputs) + len(top.load_values),
        "contacts": len(top.interactions),
        "motions or loads given by tables or by functions other than sin, cos, exp, log, sqrt and whole powers": (
            not _CODES.issuperset(top.motion_ops.tolist())
        ),
    }
    if any(refused.values()):
        raise UnsupportedMechanismError(
            "taylor computes series of trees of pins with linear springs, torques and point forces; this mechanism has "
            f"{'; '.join(text for text, is_present in refused.items() if is_present)}: use dop853 instead",
            key="integrator",
        )
