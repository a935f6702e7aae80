"""A mechanism of a spec and its equations at its consistent start, for analyses without a run."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.mechanism import Mechanism


class MechanismSource(Protocol):
    """A spec that contains a model, or another source of a mechanism."""

    def mechanism(self) -> Mechanism:
        """Return the mechanism."""

    def placed(self, error: SpecError) -> SpecError:
        """Return an error about the mechanism, with its file and line if they are known."""


@dataclass(frozen=True)
class AssembledMechanism:
    """A mechanism at its consistent start, with the spec that contains its model."""

    spec: MechanismSource
    workspace: Workspace
    equations: EquationsOfMotion

    @classmethod
    def at(cls, spec: MechanismSource, start: float, end: float) -> AssembledMechanism:
        """Assemble the mechanism of inverse dynamics for a motion between two times [s].

        Raises SpecError if a motion of the model does not cover these times, the joints cannot be closed, or the
        mechanism has first-order states.
        """
        mechanism = spec.mechanism()
        try:
            mechanism.check_span(start, end)
            workspace, _ = workspace_at_start(mechanism, start, end)
            workspace.mechanism.refuse_states("an analysis of positions")
        except SpecError as error:
            raise spec.placed(error if error.key.startswith("model") else error.located(prefix="model")) from error
        return cls(spec, workspace, EquationsOfMotion(workspace))

    @property
    def held(self) -> np.ndarray:
        """Mask (n,) of the angles of point masses, which have no meaning."""
        bodies = self.spec.mechanism().bodies.values()
        return np.array([(False, False, body.inertia is None) for body in bodies], dtype=bool).ravel()

    @property
    def extent(self) -> float:
        """Largest extent of the centres of mass along x or y in the initial state, or the characteristic length of the
        mechanism if it is larger [m].
        """
        centres = self.equations.q0.reshape(-1, 3)[:, :2]
        return max(float(np.max(np.ptp(centres, axis=0))), self.workspace.mechanism.length)

    @property
    def freedoms(self) -> int:
        """Number of degrees of freedom; driven coordinates are not free."""
        return self.workspace.mechanism.coordinates - self.equations.m

    def error(self, message: str, key: str = "model") -> SpecError:
        """Return an error about this mechanism, with the file and line of its spec."""
        return self.spec.placed(SpecError(message, key=key))
