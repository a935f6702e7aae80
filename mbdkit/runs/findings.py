"""The findings of criteria, those of mbdkit and those of plugins, and the watchers that criteria let look at rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Any, Literal, Protocol, cast

import numpy as np

from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.measured_values import Integrals
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.quantities.states import States
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.feature_items import CriterionItem
from mbdkit.registry.manager import registry, use
from mbdkit.runs.run_seams import StateWatcher, rows_criterion
from mbdkit.spec import RunSpec
from mbdkit.trust.energy_record import EnergyRecord
from mbdkit.trust.finding import Finding

Stage = Literal["spec", "start", "rows", "end", "data"]


@lru_cache(maxsize=64)
def _criteria_of(known: Registry, stage: Stage, kind: str) -> tuple[tuple[Registered, CriterionItem], ...]:
    """Return the criteria of a stage for specs of a kind, in their order."""
    pairs = [(item, cast(CriterionItem, item.plugin)) for item in known.of_kind(CriterionItem.kind)]
    return tuple((item, one) for item, one in pairs if one.stage == stage and kind in one.of)


def criteria(stage: Stage, spec: Any = None, kind: str = "run") -> list[tuple[Registered, CriterionItem]]:
    """Return the criteria of a stage for the result of a spec, or for any spec, in their order."""
    known = _criteria_of(registry(), stage, kind)
    if spec is None or not any(criterion.elements for _, criterion in known):
        return list(known)
    elements = spec.mechanism().elements
    return [(item, criterion) for item, criterion in known if criterion.examines(elements)]


def findings(stage: Stage, *examined: object, kind: str = "run") -> list[Finding]:
    """Return what all criteria of a stage find in the objects that are examined; see `CriterionItem`."""
    found: list[Finding] = []
    for item, criterion in criteria(stage, examined[0], kind):
        results = use(item, lambda: [*criterion.find()(*examined)])  # type: ignore[operator]  # noqa: B023
        if results:
            found += use(item, lambda: [*as_findings(criterion, results)])  # noqa: B023
    return found


def as_findings(criterion: CriterionItem, results: Iterable[str | Finding]) -> Iterator[Finding]:
    """Yield what a criterion has found; sentences become findings of its name and level."""
    for finding in results:
        if not isinstance(finding, str | Finding):
            raise TypeError(f"it found {finding!r}, which is neither a sentence nor a Finding")
        yield Finding(criterion.name, criterion.level, finding, is_named=False) if isinstance(finding, str) else finding


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
