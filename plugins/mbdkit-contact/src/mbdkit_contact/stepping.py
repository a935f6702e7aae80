"""Time-stepping methods in machine code."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.iteration_matrix import StepMatrix
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.run.run_state import RunState
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.integrators.run.step_control import Control
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.kernels.active_set import new_active_set
from mbdkit_contact.kernels.impacts import new_impacts
from mbdkit_contact.kernels.many_contacts import MOST_FACTORIZED
from mbdkit_contact.kernels.pivoting import new_cones
from mbdkit_contact.kernels.smooth_steps import NO_IMPULSES, OVERLAP, STAGES
from mbdkit_contact.kernels.step_impulses import FEW, MOST_PIVOTED
from mbdkit_contact.kernels.stepping_bundle import HeldContacts, Stepping
from mbdkit_contact.kernels.time_stepping import attempt, dense, keep
from mbdkit_contact.rigid_contacts import RigidContacts, zeros
from mbdkit_contact.time_stepping_methods import MoreauJean, NonsmoothGeneralizedAlpha

#: Codes and clauses of the reasons for which an attempt fails.
FAILURES = {
    NO_IMPULSES: ("contact-solver", "no impulses of the contacts satisfy the laws of impact and friction"),
    STAGES: ("newton-failed", "the stage equations were not solved"),
    OVERLAP: ("newton-failed", "no positions without overlap were found"),
}


def new_held(count: int, size: int) -> HeldContacts:
    """Return what is known before the first step, for C contacts and state vectors of this size."""
    return HeldContacts(
        np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(size), np.zeros((2, size)),
        np.zeros(1, dtype=np.int64), np.zeros(1), np.zeros(1), *(np.zeros(count, dtype=np.int64) for _ in range(2)),
    )  # fmt: skip


def alpha_of(rho_inf: float) -> np.ndarray:
    """Return alpha_m, alpha_f, gamma, beta, and the share of a step by which a is ahead of w in time (5,).

    Starting with a at this time gives order 2.
    """
    alpha_m = (2.0 * rho_inf - 1.0) / (rho_inf + 1.0)
    alpha_f = rho_inf / (rho_inf + 1.0)
    gamma = 0.5 + alpha_f - alpha_m
    return np.array([alpha_m, alpha_f, gamma, 0.25 * (gamma + 0.5) ** 2, alpha_m - alpha_f])


class CompiledTimeStepping(CompiledMethod):
    """A time-stepping method on one mechanism.

    Parameters
    ----------
    method
        The method.
    workspace
        The mechanism and its start.
    control
        None: the steps are fixed.
    """

    attempt, dense, keep = attempt, dense, keep
    has_dense_output = True
    remembers = True
    stages = 1

    def __init__(
        self, method: MoreauJean | NonsmoothGeneralizedAlpha, workspace: Workspace, control: Control | None = None
    ):
        super().__init__(workspace)
        top, size = workspace.mechanism.topology, workspace.mechanism.size
        contacts = RigidContacts(EquationsOfMotion(workspace, states_at_start(workspace)))
        self._contacts, count = contacts, len(contacts.names)
        few, pairs = min(count, MOST_PIVOTED), len(top.pairs)
        self.matrix = StepMatrix(workspace)
        bodies, sources = self.matrix.coupling_terms()
        states, coordinates = contacts.held.states, np.array(contacts.held.coordinates, dtype=np.int64)
        # the loads of contacts have no derivatives: a force if a body has two coordinates, and a torque if three
        others = len(top.loads) - int(np.sum(np.unique(coordinates // 3, return_counts=True)[1] - 1))
        is_jointed = len(top.pairs) + len(top.springs) + len(top.sections) + others > 0

        given: dict[str, Any] = zeros({
            "saved_q saved_v q v free after middle base end unchanged ended smooth point x y force": (size,),
            "right solution correction": (workspace.unknowns,),
            "lam lam_x miss": (pairs, 2),
            "gaps more closing friction restitution normal tangent": (count,),
            "factor error lost": (1,),
            "z": (len(top.states),),
            "rows": (count, 16),
            "block": (count, 4),
            "moved": (2 * (count if is_jointed else few), size),
            "krylov": (9, 2 * count if count > few else 0),
        })  # fmt: skip
        counts = {
            "by_matrix is_sparse number other_law reason": (1,),
            "some is_some closed slipping slides stops states": (count,),
            "free_body": (size // 3,),
        }
        given |= zeros(counts, np.int64)
        given |= {name: new_held(count, size) for name in ("now", "before", "saved", "new")}
        self.bundle = Stepping(
            **given,
            theta=np.array([method.theta] if isinstance(method, MoreauJean) else []),
            alpha=alpha_of(method.rho_inf) if isinstance(method, NonsmoothGeneralizedAlpha) else np.zeros(0),
            shapes=contacts.shapes,
            coefficients=contacts.coefficients,
            places=np.array([states.start, len(states)]),
            coordinates=coordinates,
            reach=np.array([contacts.reach]),
            terms=bodies,
            sources=sources,
            **self.matrix.arrays,
            cones=new_cones(min(count, MOST_FACTORIZED), few),
            active=new_active_set(min(count, MOST_FACTORIZED)),
            impacts=new_impacts(min(count, FEW)),
        )
        self.pinned = PinnedBundle(self.bundle)

    def start(self, run_state: RunState, h: float) -> None:
        """See `CompiledMethod.start`: pivots for the terms at the start, if they are regular there."""
        workspace = self.workspace
        workspace.take_states(0.0 * run_state.z)
        with contextlib.suppress(SingularSystemError):
            if self.matrix.evaluate(workspace.t0, run_state.q, run_state.v):
                self.renew(run_state, workspace.t0, h)

    def renew(self, run_state: RunState, t: float, h: float) -> bool:
        """See `CompiledMethod.renew`: pivots for the terms that the failed attempt has evaluated."""
        theta, alpha = self.bundle.theta, self.bundle.alpha
        if len(theta):
            damping, stiffness, of_rows = theta[0] * h, (theta[0] * h) ** 2, (0.0, 0.0)
        else:
            share = (1.0 - alpha[1]) / (1.0 - alpha[0])
            damping, stiffness = h * alpha[2] * share, h * h * alpha[3] * share
            of_rows = -damping, stiffness
        self.matrix.choose_pivots(np.array([1.0, 1.0, damping, stiffness, *of_rows]))
        self._use_matrix()
        return True

    def _use_matrix(self) -> None:
        self.bundle = self.bundle._replace(**self.matrix.arrays)
        self.pinned.replace(self.bundle)

    def stored_systems(self) -> object:
        """See `CompiledMethod.stored_systems`."""
        return self.matrix.stored()

    def restore_systems(self, state: Any) -> None:
        """See `CompiledMethod.restore_systems`."""
        self.matrix.restore(state)
        self._use_matrix()

    def forget(self) -> None:
        """See `CompiledMethod.forget`: after a discontinuity, modes and past accelerations are unknown."""
        self.bundle.now.modes[:] = 0.0
        self.bundle.now.known[0] = 0

    @property
    def reacting(self) -> ContactState:
        """See `CompiledMethod.reacting`."""
        held = self.bundle.now
        return ContactState(
            held.modes.astype(int),
            held.normal.copy(),
            held.tangent.copy(),
            held.force[:-3].copy(),
            changed=self._contacts.named(held.changed),
            ordered=self._contacts.named(held.ordered),
            is_over_step=True,
            residual=float(held.residual[0]),
        )

    @property
    def failure(self) -> tuple[str, str] | None:
        """See `CompiledMethod.failure`."""
        return FAILURES.get(int(self.bundle.reason[0]))
