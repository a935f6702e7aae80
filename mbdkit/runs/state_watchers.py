"""The watchers of a run, which look at all recorded states and say at its end what they have found."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Protocol

from mbdkit.quantities.states import States
from mbdkit.registry.use import use
from mbdkit.runs.findings import as_findings, criteria, findings

if TYPE_CHECKING:
    from mbdkit.archive.checkpoint import StoredState
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord
    from mbdkit.trust.finding import Finding


class StateWatcher(Protocol):
    """What a watcher of recorded states does."""

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""

    def findings(self, energies: EnergyRecord, integrals: Integrals) -> Iterable[str | Finding]:
        """Return what is wrong, as sentences or findings.

        Parameters
        ----------
        energies
            The largest energies of the run.
        integrals
            Integrals and extrema of the run, also between the recorded states, by their expressions. Those of checked
            runs contain the peaks of elements (`mbdkit.registry.feature_items.QuantityKind.peaks`).
        """

    def stored(self) -> Any:
        """Return the state as plain values, for a checkpoint."""

    def restore(self, state: Any) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""


class StateWatchers:
    """The watchers that a mechanism needs.

    Parameters
    ----------
    spec, compiled
        The spec, and its compiled mechanism.
    size
        Size of the mechanism [m].
    """

    def __init__(self, spec: RunSpec, compiled: CompiledMechanism, size: float):
        self._spec = spec
        self._criteria = {item.name: (item, criterion) for item, criterion in criteria("rows", spec)}
        self._watchers: dict[str, StateWatcher] = {}
        for name, (item, criterion) in self._criteria.items():
            watcher = use(item, lambda find=criterion.find: find()(spec, compiled, size))  # type: ignore[misc]
            if watcher is not None:
                self._watchers[name] = watcher

    def __bool__(self) -> bool:
        return bool(self._watchers)

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""
        for watcher in self._watchers.values():
            watcher.add(states)

    def findings(self, energies: EnergyRecord, integrals: Integrals) -> list[Finding]:
        """Return what is wrong with the states of a run and at its end; see `StateWatcher.findings`."""
        watched: list[Finding] = []
        for name, watcher in self._watchers.items():
            item, criterion = self._criteria[name]
            found = use(item, lambda own=watcher: [*own.findings(energies, integrals)])  # type: ignore[misc]
            watched += as_findings(criterion, found)
        return [*watched, *findings("end", self._spec, energies)]

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        return {name: watcher.stored() for name, watcher in self._watchers.items()}

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        for name, watcher in self._watchers.items():
            watcher.restore(state[name])
