"""What a compiled family of methods is to the stepper that drives it."""

from __future__ import annotations

from abc import ABC
from typing import TYPE_CHECKING, ClassVar

import numpy as np

if TYPE_CHECKING:
    from mbdkit.engine.jit.bundle import PinnedBundle
    from mbdkit.engine.jit.entry import Entry
    from mbdkit.engine.workspace import Workspace
    from mbdkit.stepping.run_state import Common


class Family(ABC):
    """One method of a family, ready to be stepped: its compiled bundle, and what Python has to do for it.

    Attributes
    ----------
    attempt, dense
        The compiled step, and the state inside it; see `mbdkit.stepping.driver`.
    hint
        What a user may try when a step fails.
    hold
        The family's own bundle.
    memory
        The arrays that one step hands to the next, and those of dense output.
    has_dense_output
        Whether states between steps can be had.
    carries_multipliers
        Whether the method carries multipliers of its own.
    carries_stages
        Whether a step solves equations by iteration, whose failure to converge is told apart from overflow.
    """

    attempt: ClassVar[Entry]
    dense: ClassVar[Entry | None] = None
    hint: ClassVar[str] = "a smaller time.step may help"
    hold: PinnedBundle
    memory: tuple[np.ndarray, ...]
    has_dense_output: bool = False
    carries_multipliers: bool = False
    carries_stages: ClassVar[bool] = False

    def __init__(self, workspace: Workspace):
        self.workspace = workspace

    def start(self, common: Common, h: float) -> None:  # noqa: B027
        """Get ready for steps of about `h` from the state in `common`; raises SingularSystemError."""

    def renew(self, common: Common, t: float, h: float) -> bool:
        """Choose new pivots for the matrices of the method itself; return whether that can help.

        Raises
        ------
        SingularSystemError
            Where a matrix is singular.
        """
        return False

    def forget(self) -> None:  # noqa: B027
        """Drop what the last step left for the next."""

    def solve_apart(self, common: Common, t: float, h: float) -> bool:
        """Solve the equations of the next attempt some other way, dear as it may be; return whether that succeeded.

        The step is from the state in `common` at `t`, of size `h`; asked before a run stops.
        """
        return False

    def describe_divergence(self, report: np.ndarray) -> str:
        """Return where the equations of a step failed to converge, from a report (3,)."""
        return ""
