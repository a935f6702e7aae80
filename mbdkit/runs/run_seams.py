"""What functions of plugins that judge runs, or treat elements in runs, take and return."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Never, Protocol

from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.run import Run
from mbdkit.engine.assembly import AssembledState
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.kinds import Method
from mbdkit.quantities.states import States
from mbdkit.registry.seam import OwnSeam, Seam
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.energy_record import EnergyRecord
from mbdkit.trust.finding import Finding


class StateWatcher(Protocol):
    """What a watcher of recorded states does."""

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""

    def findings(self, energies: EnergyRecord, integrals: Integrals) -> Iterable[str | Finding]:
        """Return what is wrong, as sentences or findings.

        `energies`: the largest energies of the run. `integrals`: integrals and extrema of the run, also between the
        recorded states, by their expressions. Those of checked runs contain the peaks of elements
        (`mbdkit.registry.feature_items.QuantityKind.peaks`).
        """

    def stored(self) -> object:
        """Return the state as plain values, for a checkpoint."""

    def restore(self, state: Any) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""


@Seam
def spec_criterion(spec: RunSpec, measures: Sequence[str], /) -> Iterable[str | Finding]:
    """Return what is doubtful in a spec, and in the expressions of further measures."""
    raise NotImplementedError


@Seam
def start_criterion(spec: RunSpec, start: AssembledState, /) -> Iterable[str | Finding]:
    """Return what is doubtful at the start of a run after assembly."""
    raise NotImplementedError


@Seam
def rows_criterion(spec: RunSpec, compiled: CompiledMechanism, size: float, /) -> StateWatcher | None:
    """Return what watches the recorded rows of a run, None if it needs nothing; `size` of the mechanism is in m."""
    raise NotImplementedError


@Seam
def end_criterion(spec: RunSpec, energies: EnergyRecord, /) -> Iterable[str | Finding]:
    """Return what is doubtful at the end of a run, from its largest energies."""
    raise NotImplementedError


@Seam
def treatment_condition(spec: RunSpec, method: Method, /) -> None:
    """Raise SpecError if a spec and its method do not suit the treatment."""
    raise NotImplementedError


@Seam
def treatment_start(workspace: Workspace, /) -> Workspace:
    """Return the workspace of a run that starts with the forces and modes of the elements at the initial state."""
    raise NotImplementedError


@Seam
def treatment_guards(method: Method, /) -> Mapping[str, int]:
    """Return fixed-step methods for comparison runs by name, with the factors by which their steps are smaller."""
    raise NotImplementedError


#: Function that is called with the time reached and the time at the end of a run [s].
Progress = Callable[[float, float], None]


@OwnSeam
def computed_run(
    spec: Never, /, *, path: Path | None = None, overwrite: bool = False, progress: Progress | None = None
) -> Run:
    """Compute the run of a validated spec, and write it to `path`, or keep it in memory if that is None."""
    raise NotImplementedError


@Seam
def repeated_run(run: Run, archive: Path, output: Path | None, /, *, overwrite: bool, progress: Progress | None) -> Run:
    """Compute the run of an archive again, and write it to `output`, or keep it in memory."""
    raise NotImplementedError
