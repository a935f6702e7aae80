"""From whatever a user names as a spec to its equations at the consistent start."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.stabilization import NONE
from mbdkit.engine.workspace import Workspace
from mbdkit.errors import SpecError, StepError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.run_preparation import build
from mbdkit.spec import RunSpec, load_spec

UNUSED = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 1.0}}
"""Sections that a spec must have and that nothing here depends on, for a mechanism that comes without them."""


@dataclass(frozen=True)
class Placed:
    """A mechanism at its consistent start, with the spec that it came from."""

    spec: RunSpec
    workspace: Workspace
    equations: EquationsOfMotion

    @classmethod
    def of(cls, source: Any, overrides: Iterable[str] = (), **sections: Any) -> Placed:
        """Build what `source` names, as `mbdkit.run` takes it; a `Mechanism` needs no other sections.

        Raises
        ------
        SpecError
            Where the input is wrong, joints that cannot meet included.
        """
        if isinstance(source, Mechanism):
            sections = UNUSED | sections
        spec = load_spec(source, overrides, **sections)
        workspace, _ = build(spec)
        workspace = replace(workspace, stabilization=NONE)  # which is no property of the mechanism
        return cls(spec, workspace, EquationsOfMotion(workspace))

    @property
    def held(self) -> np.ndarray:
        """(n,) whether a coordinate means nothing: the angle of a point mass."""
        bodies = self.spec.mechanism().bodies.values()
        return np.array([(False, False, body.inertia is None) for body in bodies], dtype=bool).ravel()

    @property
    def extent(self) -> float:
        """The size of the mechanism at its start [m]."""
        centres = self.equations.q0.reshape(-1, 3)[:, :2]
        return max(float(np.max(np.ptp(centres, axis=0))), self.workspace.mechanism.length)

    @property
    def freedoms(self) -> int:
        """Number of degrees of freedom, drivers held to their motion."""
        return self.workspace.mechanism.coordinates - self.equations.m

    def error(self, message: str, key: str = "model") -> SpecError:
        """Return an error about this mechanism, with the file and line of its spec."""
        return self.spec.placed(SpecError(message, key=key))

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Turn equations that cannot be solved into an error about the mechanism."""
        try:
            yield
        except StepError as error:
            raise self.error(f"the equations cannot be solved here: {error}") from error
