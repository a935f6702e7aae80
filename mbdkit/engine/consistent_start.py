"""From a mechanism to a workspace at its consistent start."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.assembly import AssembledState, assemble
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.redundancy import without_redundancy
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.checks import check_springs
from mbdkit.mechanism.mechanism import Mechanism


def workspace_at_start(
    mechanism: Mechanism,
    t0: float = 0.0,
    end: float | None = None,
    *,
    formulation: str = "index-1",
    stabilization: Stabilization = NONE,
) -> tuple[Workspace, AssembledState]:
    """Compile a mechanism, make its start consistent and find its independent constraint rows.

    Parameters
    ----------
    mechanism
        As a model builds it.
    t0, end
        Start and end of the run [s]; redundant joints must agree at both. `end` is `t0` if left out.
    formulation, stabilization
        Of the equations that are stepped.

    Returns
    -------
    Workspace
        The compiled mechanism at its start, with working arrays of its own.
    AssembledState
        The start, and by how much assembly changed it.

    Raises
    ------
    SpecError
        Where joints cannot meet, the two ends of a spring coincide, or redundant joints contradict each other.
    """
    compiled = compile_mechanism(mechanism)
    start = assemble(mechanism, t0, compiled)
    poses = dict(zip(mechanism.bodies, start.q, strict=True))

    def placed(name: str) -> Body:
        x, y, angle = map(float, poses[name])
        return mechanism.bodies[name].model_copy(update={"position": (x, y), "angle": angle})

    check_springs(mechanism.forces, placed)
    compiled = without_redundancy(compiled, t0, start.q.ravel(), start.v.ravel(), t0 if end is None else end)
    q0, v0 = (np.append(x.ravel(), np.zeros(3)) for x in (start.q, start.v))
    return Workspace(compiled, t0, q0, v0, formulation=formulation, stabilization=stabilization), start
