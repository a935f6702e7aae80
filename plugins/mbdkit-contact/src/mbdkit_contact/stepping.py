"""Time-stepping methods in machine code."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError, empty_pattern, new_factors
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.iteration_matrix import chosen_pivots, classes_of
from mbdkit.engine.kernels.equations import MASS
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.stored_arrays import pattern_of, stored
from mbdkit.integrators.run.sampled_control import states_at_start
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

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.run.run_state import RunState
    from mbdkit.integrators.run.step_control import Control

#: Codes and clauses of the reasons for which an attempt fails.
FAILURES = {
    NO_IMPULSES: ("contact-solver", "no impulses of the contacts satisfy the laws of impact and friction"),
    STAGES: ("newton-failed", "the stage equations were not solved"),
    OVERLAP: ("newton-failed", "no positions without overlap were found"),
}


def new_held(count: int, size: int) -> HeldContacts:
    """Return what is known before the first step, for C contacts and state vectors of this size."""
    none = (np.zeros(count, dtype=np.int64) for _ in range(2))
    return HeldContacts(
        np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(size), np.zeros((2, size)),
        np.zeros(1, dtype=np.int64), np.zeros(1), np.zeros(1), *none,
    )  # fmt: skip


def alpha_of(spectral_radius: float) -> np.ndarray:
    """Return alpha_m, alpha_f, gamma, beta, and the share of a step by which a is ahead of w in time (5,).

    Starting with a at this time gives order 2.
    """
    alpha_m = (2.0 * spectral_radius - 1.0) / (spectral_radius + 1.0)
    alpha_f = spectral_radius / (spectral_radius + 1.0)
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
        self._names, count = contacts.names, len(contacts.names)
        few, pairs = min(count, MOST_PIVOTED), len(top.pairs)
        classes, terms, n = classes_of(workspace), workspace.terms, size - 3
        is_coupling = classes != MASS
        # rows of constraints couple the bodies of their columns
        sides = [np.where(x < n, x, y) // 3 for x, y in ((terms.row, terms.column), (terms.column, terms.row))]
        states, coordinates = contacts.held.states, np.array(contacts.held.coordinates, dtype=np.int64)
        # the loads of contacts have no derivatives: a force if a body has two coordinates, and a torque if three
        of_contacts = int(np.sum(np.unique(coordinates // 3, return_counts=True)[1] - 1))
        others = len(top.loads) - of_contacts
        is_jointed = len(top.pairs) + len(top.springs) + len(top.sections) + others > 0

        none = empty_pattern()
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
        given |= zeros(
            {
                "by_matrix is_sparse number other_law reason": (1,),
                "some is_some closed slipping slides stops states": (count,),
                "free_body": (size // 3,),
                "scatter": (0, 3),
            },
            np.int64,
        )
        given |= {name: new_held(count, size) for name in ("now", "before", "saved", "new")}
        self.bundle = Stepping(
            **given,
            theta=np.array([method.theta] if isinstance(method, MoreauJean) else []),
            alpha=alpha_of(method.spectral_radius) if isinstance(method, NonsmoothGeneralizedAlpha) else np.zeros(0),
            shapes=contacts.shapes,
            coefficients=contacts.coefficients,
            places=np.array([states.start, len(states)]),
            coordinates=coordinates,
            reach=np.array([contacts.reach]),
            terms=np.ascontiguousarray(np.column_stack(sides)[is_coupling].astype(np.int64)),
            sources=np.ascontiguousarray(terms.source[is_coupling].astype(np.int64)),
            pattern=none,
            factors=new_factors(none, float),
            cones=new_cones(min(count, MOST_FACTORIZED), few),
            active=new_active_set(min(count, MOST_FACTORIZED)),
            impacts=new_impacts(min(count, FEW)),
        )
        self.pinned = PinnedBundle(self.bundle)

    def start(self, run_state: RunState, h: float) -> None:
        """See `CompiledMethod.start`: pivots for the terms at the start, if they are regular there."""
        workspace, size = self.workspace, self.workspace.mechanism.size
        none = np.zeros(size), np.zeros((len(workspace.mechanism.topology.pairs), 2))
        workspace.take_states(0.0 * run_state.z)
        with contextlib.suppress(SingularSystemError):
            workspace.retry_with_new_pivots(
                lambda: tangents_at(workspace.stepping_engine, workspace.t0, run_state.q, run_state.v, *none)
            )
            if workspace.is_finite():
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
        coefficients = np.array([1.0, 1.0, damping, stiffness, *of_rows])
        pivots = chosen_pivots(self.workspace, classes_of(self.workspace), coefficients)
        self._use(pivots.pattern, pivots.scatter)
        return True

    def _use(self, pattern: Any, scatter: np.ndarray, reference: np.ndarray | None = None) -> None:
        factors = new_factors(pattern, float)
        if reference is not None:
            factors = factors._replace(reference=reference)
        self.bundle = self.bundle._replace(pattern=pattern, scatter=scatter, factors=factors)
        self.pinned.replace(self.bundle)

    def stored_systems(self) -> object:
        """See `CompiledMethod.stored_systems`."""
        bundle = self.bundle
        return {"pattern": stored(bundle.pattern), "scatter": bundle.scatter, "reference": bundle.factors.reference}

    def restore_systems(self, state: Any) -> None:
        """See `CompiledMethod.restore_systems`."""
        pattern = pattern_of(state["pattern"], self.workspace.unknowns)
        scatter, reference = np.ascontiguousarray(state["scatter"]), np.array(state["reference"], dtype=float)
        sources = len(self.workspace.scratch.source)
        if (
            scatter.dtype != np.int64
            or scatter.shape[1:] != (3,)
            or np.any(scatter < 0)
            or np.any(scatter >= [sources, max(len(pattern.a_column), 1), 6])
            or reference.shape != pattern.row_of.shape
        ):
            raise ValueError("a term of a matrix does not exist")
        self._use(pattern, scatter, reference)

    def forget(self) -> None:
        """See `CompiledMethod.forget`: after a discontinuity, modes and past accelerations are unknown."""
        self.bundle.now.modes[:] = 0.0
        self.bundle.now.known[0] = 0

    @property
    def reacting(self) -> ContactState:
        """See `CompiledMethod.reacting`."""
        held = self.bundle.now

        def names(some: np.ndarray) -> frozenset[str]:
            return frozenset(self._names[i] for i in np.flatnonzero(some).tolist())

        return ContactState(
            held.modes.astype(int),
            held.normal.copy(),
            held.tangent.copy(),
            held.force[:-3].copy(),
            changed=names(held.changed),
            ordered=names(held.ordered),
            is_over_step=True,
            residual=float(held.residual[0]),
        )

    @property
    def failure(self) -> tuple[str, str] | None:
        """See `CompiledMethod.failure`."""
        return FAILURES.get(int(self.bundle.reason[0]))
