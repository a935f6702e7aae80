"""What the compiled driver and every compiled family of methods share: one run's state, room and results.

The arrays are bundled once and kept with the kernels (`mbdkit.engine.jit.bundle`); functions hand their address on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.example_workspace import example_workspace
from mbdkit.engine.jit.bundle import bundle_loader
from mbdkit.engine.kernels.system import Scratch, Solver, Topology

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

ADVANCED, SAME, ALTERED = range(3)
"""How the state stands to that of the last attempt: where it led; where it began; neither."""

RHS, JACOBIANS, FACTORIZATIONS, ITERATIONS, PROJECTIONS = range(5)
"""What is counted where."""


class Common(NamedTuple):
    """One run as the compiled driver sees it; vectors are (3 (B + 1),), ground last, multipliers (P, 2) by pair."""

    top: Topology
    """The mechanism, with its Baumgarte terms if there are any."""
    still: Topology
    """The same without gravity and without these terms, for systems with a given right side."""
    w: Scratch
    solver: Solver
    has_power: np.ndarray
    """(1,) whether work or dissipated energy can change."""
    q: np.ndarray
    """State between two steps; `q_low` and so on hold the low parts of its compensated sums."""
    q_low: np.ndarray
    v: np.ndarray
    v_low: np.ndarray
    energy: np.ndarray
    """(2,) work of loads and drivers, and dissipated energy [J]."""
    energy_low: np.ndarray
    from_q: np.ndarray
    """What an attempt starts from: the state, or the state perturbed by the symmetric projection."""
    from_v: np.ndarray
    moved: np.ndarray
    """(1,) ADVANCED, SAME or ALTERED: how that stands to the last attempt; methods may keep what still holds."""
    dq: np.ndarray
    """What an attempt gives: increments of positions and velocities."""
    dv: np.ndarray
    gain: np.ndarray
    """(2,) increments of the energies, by the method's own weights."""
    own_lam: np.ndarray
    """The multipliers that the method itself carries, at the end of the step, of the pairs' own rows."""
    est_q: np.ndarray
    """Estimates of the local error, where asked for."""
    est_v: np.ndarray
    second_q: np.ndarray
    """A second estimate of lower order, for methods that bring two."""
    second_v: np.ndarray
    point_q: np.ndarray
    """What dense output gives: positions, velocities, energies gained so far, own multipliers."""
    point_v: np.ndarray
    point_gain: np.ndarray
    point_lam: np.ndarray
    new_q: np.ndarray
    """The state at the end of the step under way, corrected if need be."""
    new_v: np.ndarray
    shift_q: np.ndarray
    """The correction of that state by projection."""
    shift_v: np.ndarray
    mu: np.ndarray
    """(P, 2) multipliers of the symmetric projection, of positions and of velocities; kept from step to step."""
    nu: np.ndarray
    rest: np.ndarray
    """Zeros."""
    x: np.ndarray
    """Scratch of projections."""
    lam: np.ndarray
    miss: np.ndarray
    before_q: np.ndarray
    """State at the beginning of the last step, kept where somebody looks inside steps."""
    before_v: np.ndarray
    worst: np.ndarray
    """(P,) largest square of the norm of each pair's Phi so far."""
    counts: np.ndarray
    """(5,) RHS, JACOBIANS, FACTORIZATIONS, ITERATIONS, PROJECTIONS."""
    report: np.ndarray
    """(3,) on divergence: largest change, its coordinate, iterations."""
    clock: np.ndarray
    """(6,) see `mbdkit.stepping.driver`."""
    tally: np.ndarray
    """(8,) what happened since the last recorded row; see `mbdkit.stepping.driver`."""
    row_time: np.ndarray
    row_q: np.ndarray
    row_v: np.ndarray
    row_energy: np.ndarray
    row_tally: np.ndarray
    row_lam: np.ndarray
    """(R, P, 2), or no rows where the method carries no multipliers."""


def new_common(workspace: Workspace, rows: int, *, own_multipliers: bool = False) -> Common:
    """Return the bundle of a run at its start.

    Parameters
    ----------
    workspace
        The mechanism and its start.
    rows
        Room for recorded states.
    own_multipliers
        Whether the method carries multipliers that are recorded.
    """
    top = workspace.stepping_topology
    size, pairs = workspace.mechanism.size, len(top.pairs)
    still = workspace.mechanism.topology._replace(gravity=np.zeros(2))

    def vector() -> np.ndarray:
        return np.zeros(size)

    def by_pair() -> np.ndarray:
        return np.zeros((pairs, 2))

    q, v = workspace.q0.copy(), workspace.v0.copy()
    return Common(
        top=top, still=still, w=workspace.scratch, solver=workspace.solver,
        has_power=np.array([int(workspace.has_power)]),
        q=q, q_low=vector(), v=v, v_low=vector(), energy=np.zeros(2), energy_low=np.zeros(2),
        from_q=q.copy(), from_v=v.copy(), moved=np.array([ALTERED]),
        dq=vector(), dv=vector(), gain=np.zeros(2), own_lam=by_pair(),
        est_q=vector(), est_v=vector(), second_q=vector(), second_v=vector(),
        point_q=vector(), point_v=vector(), point_gain=np.zeros(2), point_lam=by_pair(),
        new_q=vector(), new_v=vector(), shift_q=vector(), shift_v=vector(),
        mu=by_pair(), nu=by_pair(), rest=vector(), x=vector(), lam=by_pair(), miss=by_pair(),
        before_q=q.copy(), before_v=v.copy(),
        worst=np.zeros(pairs), counts=np.zeros(5, dtype=np.int64), report=np.zeros(3),
        clock=np.zeros(6), tally=np.zeros(9),
        row_time=np.zeros(rows), row_q=np.zeros((rows, size)), row_v=np.zeros((rows, size)),
        row_energy=np.zeros((rows, 2)), row_tally=np.zeros((rows, 9)),
        row_lam=np.zeros((rows if own_multipliers else 0, pairs, 2)),
    )  # fmt: skip


load_common = bundle_loader(lambda: new_common(example_workspace(), 1))
