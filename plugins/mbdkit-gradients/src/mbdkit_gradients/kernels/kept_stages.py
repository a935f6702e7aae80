"""Stages of steps that are kept for the way back.

A row holds the accelerations of a stage; those of explicit steps also hold its multipliers, the factors of the Schur
complement of its system, and the cosines and sines of its angles, so that the way back evaluates none of these; ground
is left out.
"""

from __future__ import annotations

from typing import NamedTuple

from mbdkit.engine.kernels.bundle_types import RealMatrix, example_of
from mbdkit.engine.kernels.system import NOT_FINITE, OK
from mbdkit.engine.kernels.vectors import copy, stays_finite
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import entry, subkernel
from mbdkit.integrators.run.run_state import load_run_state
from mbdkit.integrators.stages import collocation_stages, explicit


class KeptStages(NamedTuple):
    """Stages that are kept; their address is that of the stages in `Reacting`, which such runs do not use otherwise."""

    rows: RealMatrix  #: (N S, W) one row for each stage of N steps; see `keep_stage`.


load_kept_stages = bundle_loader(lambda: example_of(KeptStages))


@subkernel
def _pass(x, count, row, at, is_kept):
    """Copy `count` rows of `x` from `row` if they are kept there, else to it, from `at` on; return the index behind."""
    for k in range(count):
        for d in range(len(x[k])):
            if is_kept:
                x[k, d] = row[at + d]
            else:
                row[at + d] = x[k, d]
        at += len(x[k])
    return at


@subkernel
def take_stage(acc, lam, row):
    """Read accelerations and multipliers of a stage from a row."""
    for d in range(len(acc) - 3):
        acc[d] = row[d]
    _pass(lam, len(lam), row, len(acc) - 3, True)


@subkernel
def pass_factors(w, solver, acc, lam, row, is_kept):
    """Copy cosines, sines and factors of the system of a stage from a row if they are kept there, else to it."""
    schur = solver.schur
    at = _pass(schur.diagonal, len(schur.diagonal), row, len(acc) - 3 + 2 * len(lam), is_kept)
    at = _pass(schur.below, len(schur.below), row, at, is_kept)
    at = _pass(w.response, len(w.response), row, at, is_kept)
    _pass(w.cs, len(w.cs) - 1, row, at, is_kept)


@subkernel
def keep_stage(w, solver, acc, lam, row):
    """Write accelerations and multipliers of a stage, its cosines and sines and the factors of its system, to a row."""
    for d in range(len(acc) - 3):
        row[d] = acc[d]
    _pass(lam, len(lam), row, len(acc) - 3, False)
    pass_factors(w, solver, acc, lam, row, False)


@entry
def attempt(run, method, t, h, want_error):
    """Compute a fixed step and keep its stages; see `mbdkit.integrators.stages.explicit.attempt`."""
    c, m = load_run_state(run), explicit.load_explicit(method)
    rows, stages = load_kept_stages(c.w.reacting.stages[0]).rows, len(m.b)
    first = stages * c.progress.accepted[0]
    for i in range(stages):
        status = explicit.evaluate_stages(c, m, t, h, i, i + 1)
        if status != OK:
            return status
        if first + i < len(rows):
            keep_stage(c.w, c.solver, m.accelerations[i], m.lam, rows[first + i])
    m.status[1] = stages
    explicit.add_up_stages(c, m, t, h)
    is_finite = stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)
    return OK if is_finite and stays_finite(c.from_z, c.dz) else NOT_FINITE


@entry
def keep_accelerations(run, method, t, h, unused):
    """Keep the accelerations of the stages of an implicit step, with which the way back begins its iteration."""
    c, acc = load_run_state(run), collocation_stages.load_stages(method).acc
    rows, first = load_kept_stages(c.w.reacting.stages[0]).rows, len(acc) * c.progress.accepted[0]
    for i in range(len(acc)):
        if first + i < len(rows):
            copy(acc[i], rows[first + i])
    return OK
