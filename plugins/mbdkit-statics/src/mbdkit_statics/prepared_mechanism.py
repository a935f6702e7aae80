"""Loads a spec or mechanism from any accepted source, and prepares its equations in the consistent initial state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.base.errors import RunError, StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.stabilization import NONE
from mbdkit.integrators.interface import Nodes
from mbdkit.runs.assembled_mechanism import AssembledMechanism
from mbdkit.runs.law_ranges import LawRanges
from mbdkit.runs.preparation import build
from mbdkit.spec.loading import loaded
from mbdkit.spec.run_spec import RunSpec

#: Sections that a run spec requires, where they are not given; most of these analyses do not use them.
UNUSED = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}}


@dataclass(frozen=True)
class PreparedMechanism(AssembledMechanism):
    """A mechanism at the consistent start of a run, with the spec of the run."""

    spec: RunSpec

    @classmethod
    def of(cls, source: object, overrides: Iterable[str] = (), **sections: object) -> PreparedMechanism:
        """Prepare a mechanism from any source that `mbdkit.run` accepts; no `integrator` and `time` are needed.

        Raises
        ------
        SpecError
            If the input is wrong, or the joints cannot be closed.
        """
        spec = loaded("run", RunSpec, source, overrides, sections, defaults=UNUSED)
        workspace, _ = build(spec)
        workspace = replace(workspace, stabilization=NONE)  # Baumgarte terms would change the equations
        return cls(spec, workspace, EquationsOfMotion(workspace))

    @contextmanager
    def as_spec_errors(self) -> Iterator[None]:
        """Convert a StepError into a SpecError about the mechanism."""
        try:
            yield
        except StepError as error:
            raise self.error(f"the equations of motion cannot be solved in this position: {error}") from error

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
        ranges.add(np.zeros(0), np.zeros((0, compiled.first_friction, 5)))
        texts = ranges.in_one_state()
        if texts and self.spec.limits.law_range == "stop":
            raise RunError(f"out-of-range: {'; '.join(texts)}. Write `limits: {{law_range: warn}}` to get a result")
        return texts
