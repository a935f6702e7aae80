"""Workspaces of a mechanism at its consistent initial state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Never

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, replace
from mbdkit.engine.assembly import AssembledState, assemble, search_for
from mbdkit.engine.compile_mechanism import compile_mechanism, compiled_content
from mbdkit.engine.compiled_mechanism import CompiledMechanism, with_ground
from mbdkit.engine.kernels.table_rows import STATE_ROW
from mbdkit.engine.least_change import LeastChange
from mbdkit.engine.redundancy import without_redundancy
from mbdkit.engine.self_stress import looped_rows
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.checks import check_centers, check_springs
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.seam import OwnSeam


@contextmanager
def within_double_precision() -> Iterator[None]:
    """Raise SpecError if a computation at the start fails because numbers of the mechanism are too large or small."""
    try:
        with np.errstate(all="ignore"):
            yield
    except SpecError:
        raise
    except (ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError
        said = any(text in str(error) for text in ("infs or NaNs", " is NaN"))
        is_numeric = said or isinstance(error, ArithmeticError | np.linalg.LinAlgError)
        if not is_numeric:
            raise
        raise SpecError(
            "masses, lengths or positions are so large, so small or so different in size that the start cannot be "
            "computed in double precision",
            key="model",
        ) from error


def workspace_at_start(
    mechanism: Mechanism,
    t0: float = 0.0,
    end: float | None = None,
    *,
    formulation: str = "index-1",
    stabilization: Stabilization = NONE,
    starts: Starts | None = None,
) -> tuple[Workspace, AssembledState]:
    """Compile a mechanism, assemble its initial state and determine its independent constraint rows.

    `mechanism`: the validated mechanism. `t0`, `end`: start and end of the run [s]; `end` defaults to `t0`. If there
    are drivers, redundancy is analysed at the start and at times of the run. `formulation`, `stabilization`:
    formulation of the equations of motion, and their stabilization. `starts`: cache of compiled mechanisms, if given.
    Returns the compiled mechanism at its initial state, with its own working arrays, and the initial state with the
    changes made by assembly. Raises SpecError if, at the start, the constraints cannot be satisfied, a driver, load or
    moving center is not finite, the table of a moving center does not cover the angle, the two ends of a spring
    coincide, an element does not allow the positions, redundant joints are inconsistent or make the friction of a joint
    undetermined, the position is singular, or numbers are too large or too small for double precision.
    """
    start = (starts or Starts()).at_start(mechanism, t0, end)
    workspace = Workspace(start.mechanism, t0, start.q0, start.v0, formulation=formulation, stabilization=stabilization)
    return workspace, start.assembled


@dataclass(frozen=True)
class MechanismAtStart:
    """A compiled mechanism with independent constraint rows, and its consistent initial state.

    `q0`, `v0`: (3 (B + 1),) positions and velocities, ground last. `assembled`: the same state, with the changes made
    by assembly.
    """

    mechanism: CompiledMechanism
    q0: np.ndarray
    v0: np.ndarray
    assembled: AssembledState


@OwnSeam
def start_values(handle: Never, mechanism: Mechanism, t0: float, q: np.ndarray, /) -> Mapping[int, float]:
    """Return initial values of states by their index, from the time t0 [s] and the assembled positions q (B, 3)."""
    raise NotImplementedError


def _with_states_at(mechanism: Mechanism, compiled: CompiledMechanism, q: np.ndarray, t0: float) -> CompiledMechanism:
    """Return a compiled mechanism with the states of further kinds that follow from the positions `q` at the start."""
    if not compiled.extensions:
        return compiled
    parameters = compiled.topology.law_parameters.copy()
    for handle, kind in compiled.kinds():
        values = {} if kind.at_start is None else start_values.of(kind.at_start)(handle, mechanism, t0, q)
        for state, value in values.items():
            parameters[compiled.topology.states[state, STATE_ROW.parameter]] = value
    return replace(compiled, topology=compiled.topology._replace(law_parameters=parameters))


MOST_MECHANISMS = 8  #: Largest number of compiled mechanisms in the cache.


@dataclass(frozen=True, eq=False)
class CompiledForStarts:
    """A compiled mechanism with the solver of assembly, shared by mechanisms that differ only in their initial state.

    `has_loops`: whether constraint rows may be redundant.
    """

    mechanism: CompiledMechanism
    search: LeastChange
    has_loops: bool

    @classmethod
    def of(cls, mechanism: Mechanism, t0: float, compiled: CompiledMechanism | None = None) -> CompiledForStarts:
        """Compile a mechanism for starts at time `t0` [s], unless it is `compiled`."""
        compiled = compiled or compile_mechanism(mechanism)
        return cls(compiled, search_for(mechanism, compiled, t0), len(looped_rows(compiled)) > 0)

    def at_start(self, mechanism: Mechanism, end: float) -> MechanismAtStart:
        """Return a mechanism at its start; see `Starts.at_start`."""
        with within_double_precision():
            return self.checked(mechanism, assemble(mechanism, self.search.t0, self.mechanism, self.search), end)

    def checked(self, mechanism: Mechanism, start: AssembledState, end: float) -> MechanismAtStart:
        """Return a mechanism at its start after assembly; raise SpecError for a spring, center or other element that
        does not allow it.
        """
        poses = dict(zip(mechanism.bodies, start.q, strict=True))

        def placed(name: str) -> Body:
            x, y, angle = map(float, poses[name])
            return mechanism.bodies[name].model_copy(update={"position": (x, y), "angle": angle})

        compiled, q0, v0 = self.mechanism, with_ground(start.q), with_ground(start.v)
        check_springs(mechanism.forces, placed)
        check_centers(mechanism.joints, placed)
        compiled = _with_states_at(mechanism, compiled, start.q, self.search.t0)
        if self.has_loops:
            compiled = without_redundancy(compiled, self.search.t0, q0[:-3], v0[:-3], end)
            compiled.refuse_friction_of_shared_reactions()
        return MechanismAtStart(compiled, q0, v0, start)


class Starts:
    """Computes consistent initial states, with a cache of compiled mechanisms.

    Mechanisms that differ only in their initial states are compiled once.
    """

    def __init__(self) -> None:
        self._compiled: dict[tuple[bytes | None, float], CompiledForStarts] = {}

    def at_start(self, mechanism: Mechanism, t0: float = 0.0, end: float | None = None) -> MechanismAtStart:
        """Compile a mechanism and make its initial state consistent; arguments and errors are those of
        `workspace_at_start`.
        """
        return self.compiled(mechanism, t0).at_start(mechanism, t0 if end is None else end)

    def compiled(self, mechanism: Mechanism, t0: float) -> CompiledForStarts:
        """Return a mechanism compiled for a start at time `t0` [s]; raise the errors of `at_start`."""
        content = compiled_content(mechanism)
        key = content, t0
        compiled = None if content is None else self._compiled.pop(key, None)
        if compiled is None:
            known = [one.mechanism for (other, _), one in self._compiled.items() if None is not other == content]
            with within_double_precision():
                compiled = CompiledForStarts.of(mechanism, t0, *known[:1])
        if content is None:
            return compiled
        self._compiled[key] = compiled
        if len(self._compiled) > MOST_MECHANISMS:
            self._compiled.pop(next(iter(self._compiled)))
        return compiled
