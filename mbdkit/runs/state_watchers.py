"""The watchers of a run, which look at all recorded states and say at its end what they have found."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from mbdkit.quantities.states import States
from mbdkit.registry.manager import use
from mbdkit.runs.findings import as_findings, criteria, findings
from mbdkit.runs.run_seams import StateWatcher, rows_criterion

if TYPE_CHECKING:
    from mbdkit.archive.checkpoint import StoredState
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord
    from mbdkit.trust.finding import Finding


class WatcherOfMany(Protocol):
    """A watcher that can look at many runs at once; its decisions do not depend on the numbers of a mechanism."""

    def found_in(self, time: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return whether there would be a finding in each of R runs, (R,).

        `time`: (R, T) times [s]. `forces`: (R, T, F, 5) values of all force elements.
        """


class StateWatchers:
    """The watchers that a mechanism needs.

    `spec`, `compiled`: the spec, and its compiled mechanism. `size`: size of the mechanism [m].
    """

    def __init__(self, spec: RunSpec, compiled: CompiledMechanism, size: float):
        self._spec = spec
        self._criteria = {item.name: (item, criterion) for item, criterion in criteria("rows", spec)}
        self._watchers: dict[str, StateWatcher] = {}
        for name, (item, criterion) in self._criteria.items():
            watcher = use(item, lambda find=criterion.find: rows_criterion.of(find)(spec, compiled, size))  # type: ignore[misc]
            if watcher is not None:
                self._watchers[name] = watcher

    def __bool__(self) -> bool:
        return bool(self._watchers)

    @property
    def of_many(self) -> list[WatcherOfMany] | None:
        """The watchers, if all can look at many runs at once; else None."""
        watchers = [*self._watchers.values()]
        return watchers if all(hasattr(watcher, "found_in") for watcher in watchers) else None  # type: ignore[return-value]

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""
        for watcher in self._watchers.values():
            watcher.add(states)

    def findings(self, energies: EnergyRecord, integrals: Integrals) -> list[Finding]:
        """Return what is wrong with the states of a run and at its end; see `StateWatcher.findings`."""
        watched: list[Finding] = []
        for name, watcher in self._watchers.items():
            item, criterion = self._criteria[name]
            result = use(item, lambda own=watcher: [*own.findings(energies, integrals)])  # type: ignore[misc]
            watched += as_findings(criterion, result)
        return [*watched, *findings("end", self._spec, energies)]

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        return {name: watcher.stored() for name, watcher in self._watchers.items()}

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        for name, watcher in self._watchers.items():
            watcher.restore(state[name])
