"""Steps of a run that are differentiated one after another in compiled code."""

from __future__ import annotations

from mbdkit.engine.kernels.system import OK
from mbdkit.engine.native.functions import kernel
from mbdkit.integrators.duals.dual_run import load_dual_run
from mbdkit.integrators.duals.dual_steps import differentiated_explicit
from mbdkit.integrators.loop.step_loop import drive_steps
from mbdkit.integrators.run.run_state import PROJECTIONS, load_run_state


@kernel
def drive_explicit_duals(
    run: int, method: int, attempt: int, plan: int, budget: int, dual: int, dual_method: int, recorded: int
) -> tuple[int, int, int]:
    """Attempt up to `budget` steps of an explicit method, and differentiate each accepted one.

    Parameters
    ----------
    run, method, attempt, plan
        See `step_loop.drive_steps`.
    dual, dual_method
        Addresses of the `DualRun` and of the method's bundle of dual numbers.
    recorded
        Number of states that have been recorded with derivatives.

    Returns
    -------
    status, rows
        See `step_loop.drive_steps`.
    failed
        Status of the last differentiated step.
    """
    c, d = load_run_state(run), load_dual_run(dual)
    progress, first = c.progress, c.first_row[0]
    status, failed, rows = OK, OK, first
    for _ in range(budget):
        accepted, projections = progress.accepted[0], c.counts[PROJECTIONS]
        c.first_row[0] = rows
        status, after = drive_steps(run, method, attempt, 0, plan, 1, 0)
        row = recorded if after > rows else -1
        if progress.accepted[0] > accepted:
            d.projected[0] = 1.0 if c.counts[PROJECTIONS] > projections else 0.0
            failed = differentiated_explicit(
                dual, run, dual_method, progress.tried_begin[0], progress.last_size[0], row
            )
        has_moved = after > rows or progress.accepted[0] > accepted
        recorded += after - rows
        rows = after
        if failed != OK or status != OK or not has_moved or rows >= len(c.row_time):
            break
    c.first_row[0] = first
    return status, rows, failed
