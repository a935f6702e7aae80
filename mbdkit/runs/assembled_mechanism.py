"""Loads a spec or mechanism from any accepted source, and prepares its equations in the consistent initial state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from mbdkit.base.errors import RunError, SpecError, StepError
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.stabilization import NONE
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Nodes
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.law_ranges import LawRanges
from mbdkit.runs.preparation import build
from mbdkit.spec import RunSpec, load_spec

UNUSED = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 1.0}}
"""Sections that a run spec requires, for a `Mechanism` without a spec; most of these analyses do not use them."""


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

        Raises
        ------
        SpecError
            If a motion of the model does not cover these times, the joints cannot be closed, or the mechanism has
            first-order states.
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

    @contextmanager
    def as_spec_errors(self) -> Iterator[None]:
        """Convert a StepError into a SpecError about the mechanism."""
        try:
            yield
        except StepError as error:
            raise self.error(f"the equations of motion cannot be solved in this position: {error}") from error


@dataclass(frozen=True)
class PreparedMechanism(AssembledMechanism):
    """A mechanism at the consistent start of a run, with the spec of the run."""

    spec: RunSpec

    @classmethod
    def of(cls, source: Any, overrides: Iterable[str] = (), **sections: Any) -> PreparedMechanism:
        """Prepare a mechanism from any source that `mbdkit.run` accepts; for a `Mechanism`, no other sections are
        needed.

        Raises
        ------
        SpecError
            If the input is wrong, or the joints cannot be closed.
        """
        if isinstance(source, Mechanism):
            sections = UNUSED | sections
        spec = load_spec(source, overrides, **sections)
        workspace, _ = build(spec)
        workspace = replace(workspace, stabilization=NONE)  # Baumgarte terms would change the equations
        return cls(spec, workspace, EquationsOfMotion(workspace))

    def laws_out_of_range(self, time: float, q: np.ndarray, v: np.ndarray) -> tuple[str, ...]:
        """Return a sentence for each argument of a force law that is outside its range in a state.

        Parameters
        ----------
        time
            Time of the state [s].
        q, v
            (n,) position and velocity of all bodies.

        Raises
        ------
        RunError
            If there is such an argument and ``limits.law_range`` is ``stop``.
        """
        compiled = self.workspace.mechanism
        ranges = LawRanges.of(self.spec.mechanism(), compiled, self.workspace)
        if ranges is None:
            return ()
        q, v = (np.append(x, np.zeros(3))[None] for x in (q, v))
        ranges.add_between(Nodes(np.array([time]), np.zeros(1), q, v))
        ranges.add(np.zeros(0), np.zeros((0, len(compiled.forces) + len(compiled.muscles), 5)))
        found = ranges.in_one_state()
        if found and self.spec.limits.law_range == "stop":
            raise RunError(f"out-of-range: {'; '.join(found)}. Write `limits: {{law_range: warn}}` to get a result")
        return found
