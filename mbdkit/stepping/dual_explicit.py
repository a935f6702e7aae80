"""Differentiated steps of explicit Runge-Kutta methods; see `mbdkit.stepping.dual_run`."""

from __future__ import annotations

from mbdkit.engine.example_workspace import example_workspace
from mbdkit.engine.jit.bundle import bundle_loader
from mbdkit.engine.jit.decorators import kernel
from mbdkit.engine.jit.dual_arrays import new_duals
from mbdkit.engine.kernels.system import OK
from mbdkit.stepping.dual_run import advance, load_dual_run, take_base
from mbdkit.stepping.explicit import (
    Explicit,
    add_up_stages,
    evaluate_stages,
    keep_stages,
    new_explicit,
    reuse_first_stage,
)
from mbdkit.stepping.run_state import load_run_state


def dual_explicit(method: Explicit) -> Explicit:
    """Return the bundle of an explicit method with stages of dual numbers; its coefficients are numbers."""
    stages = ("rates", "accelerations", "q_stage", "lam", "power")
    return method._replace(
        **{name: new_duals(*getattr(method, name).shape) for name in stages}, status=method.status.copy()
    )


def _example() -> Explicit:
    from mbdkit.methods import rk4
    from mbdkit.methods.kinds import ExplicitRungeKutta

    return dual_explicit(new_explicit(ExplicitRungeKutta(rk4.tableau()), 6, len(example_workspace().scratch.phi)))


load_dual_explicit = bundle_loader(_example)


@kernel
def explicit_step(dual, run, method, t, h, row):
    """Differentiate the step of size `h` from `t` that a run has taken; return a status.

    Parameters
    ----------
    dual, run, method
        Addresses of the `DualRun`, of the `RunState` and of the method's bundle of dual numbers.
    row
        Index at which the end of the step is recorded; -1 if it is not recorded.
    """
    c, n, m = load_dual_run(dual), load_run_state(run), load_dual_explicit(method)
    take_base(c, n)
    stages = len(m.b)
    first = reuse_first_stage(c, m)
    status = evaluate_stages(c, m, t, h, first, stages)
    if status != OK:
        return status
    m.status[1] = stages
    add_up_stages(c, m, h)
    if c.nodes[0] != 0:
        keep_stages(c, m, t, h)
    return advance(c, n, row)
