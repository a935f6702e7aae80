"""The base class of compiled methods."""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from mbdkit.engine.kernels.bundle_types import kept
from mbdkit.integrators.stages.convergence import MOST_EXTENDED, MOST_ITERATIONS, IterationLimit
from mbdkit.registry.target import Target

if TYPE_CHECKING:
    from mbdkit.engine.native.bundle import PinnedBundle
    from mbdkit.engine.native.kernel import Entry
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.run.run_state import RunState


class DualForm(Protocol):
    """The counterpart of a compiled method for dual numbers, created from the method.

    Attributes
    ----------
    pinned
        The bundle of dual numbers.
    stages
        Number of stages of a step.
    """

    pinned: PinnedBundle
    stages: int

    def step(self, dual: int, run: int, step: tuple[float, float], row: int) -> int:
        """Differentiate a step that a run has taken, given by its start and size [s]; return a status.

        The other parameters are those of `mbdkit.integrators.duals.dual_steps.explicit_step`.
        """


class CompiledMethod(ABC):
    """A compiled method on one mechanism: its compiled functions, its bundle, and the parts that run in Python.

    Attributes
    ----------
    attempt, dense, keep
        The compiled functions for a step, for dense output, and for storing the stages of a step as quadrature nodes;
        see `mbdkit.integrators.loop.step_loop`.
    stages
        Number of stages of a step.
    duals
        The form of the method that differentiates its steps (`mbdkit.integrators.duals.dual_steps`); None if there is
        none.
    hint
        Advice to the user, added to the message when a step fails.
    pinned
        The bundle of the method (a named tuple of arrays) at a fixed address, as kernels read it. Its class declares
        those arrays as `State` that a step or dense output reads of the previous step.
    has_dense_output
        Whether states within a step can be computed.
    carries_multipliers
        Whether the method computes multipliers itself.
    carries_stages
        Whether a step solves equations by iteration, so that a failure may be divergence instead of overflow.
    remembers
        Whether the values that `forget` discards stay valid with other pivots.
    limit
        Default limit of the number of iterations in a step, which fixed steps may extend; None if the user has set the
        limit.
    """

    attempt: Entry
    dense: Entry | None = None
    keep: Entry
    stages: int
    duals: ClassVar[Target[Callable[[Any], DualForm]] | None] = None
    hint: ClassVar[str] = "a smaller time.step may help"
    pinned: PinnedBundle
    has_dense_output: bool = False
    carries_multipliers: bool = False
    carries_stages: ClassVar[bool] = False
    remembers: ClassVar[bool] = False
    limit: IterationLimit | None = None

    def __init__(self, workspace: Workspace):
        self.workspace = workspace

    def start(self, run_state: RunState, h: float) -> None:  # noqa: B027
        """Prepare for steps of about `h` from the state in `run_state`; raises SingularSystemError."""

    @property
    def prepares(self) -> bool:
        """Whether `start` does something."""
        return type(self).start is not CompiledMethod.start

    def renew(self, run_state: RunState, t: float, h: float) -> bool:
        """Choose new pivots for the matrices of the method itself; return whether another attempt at the step can
        succeed.

        Raises
        ------
        SingularSystemError
            If a matrix is singular.
        """
        return False

    def forget(self) -> None:  # noqa: B027
        """Discard the values stored by the last step for the next one."""

    def serve(self) -> None:  # noqa: B027
        """Take what earlier steps have left to Python; called before steps whose start may be restored."""

    def resume(self) -> None:  # noqa: B027
        """Prepare for another attempt after one that has returned `mbdkit.integrators.loop.step_loop.PAUSED`."""

    def pause_at_events(self) -> None:  # noqa: B027
        """From now on, return PAUSED after an event of the method has changed the state at the start of a step."""

    def kept(self, *roles: str) -> dict[str, np.ndarray]:
        """Return the arrays of the method that are declared with a role; see `bundle_types.kept`."""
        return kept(self.pinned.bundle, *roles)

    def stored_systems(self) -> Any:
        """Return the linear systems of the method with their pivots as plain values for a checkpoint; None if it has
        none.
        """
        return None

    def restore_systems(self, state: Any) -> None:  # noqa: B027
        """Use the systems that `stored_systems` has returned; raise ValueError if they are not valid."""

    @property
    def reacting(self) -> Any:
        """Memory of reactions of elements (`mbdkit.integrators.run.impulse.ReactingMemory`); None if there is none."""
        return None

    @property
    def failure(self) -> tuple[str, str] | None:
        """Code and clause of the failure of the last attempt that only the method knows; None if there is none."""
        return None

    def solve_apart(self, run_state: RunState, t: float, h: float) -> bool:
        """Solve the equations of the next attempt by a more robust, slower method; return whether that succeeded.

        The step is from the state in `run_state` at `t`, of size `h`. Called before a run stops with a failure.
        """
        return False

    def switch_iteration(self) -> bool:
        """Solve the equations of the next and all later steps by another iteration; return False if there is none.

        Called before a run with fixed steps stops with a failure, at most once per step.
        """
        return False

    @property
    def is_extended(self) -> bool:
        """Whether the limit of iterations is extended."""
        return self.limit is not None and bool(self.limit.most[0] > MOST_ITERATIONS)

    def extend_iterations(self) -> bool:
        """Extend the limit of iterations for the next attempt; return False if it cannot be extended further."""
        if self.limit is None or self.is_extended:
            return False
        self.limit.most[0] = MOST_EXTENDED
        return True

    def restore_iterations(self) -> None:
        """Restore the default limit of iterations."""
        if self.limit is not None:
            self.limit.most[0] = MOST_ITERATIONS

    def describe_divergence(self, report: np.ndarray) -> str:
        """Return a clause that describes where the equations of a step failed to converge, from a report (3,)."""
        return ""
