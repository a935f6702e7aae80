"""The watchers of a run, which look at all recorded states and give warnings at its end."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Protocol, cast

from mbdkit.quantities.states import States
from mbdkit.registry.feature_items import CriterionItem
from mbdkit.registry.manager import registry
from mbdkit.registry.use import use
from mbdkit.runs.warnings import passivity_warnings

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord
    from mbdkit.trust.finding import Finding


class StateWatcher(Protocol):
    """What a watcher of recorded states does."""

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""

    def warnings(self, energies: EnergyRecord) -> Iterable[str | Finding]:
        """Return what is wrong, as sentences or findings; `energies` are the largest of the run."""

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
        self._mechanism = spec.mechanism()
        self._watchers: dict[str, StateWatcher] = {}
        for item in registry().of_kind(CriterionItem.kind):
            criterion = cast(CriterionItem, item.plugin)
            if criterion.stage == "rows":
                watcher = use(item, lambda find=criterion.find: find()(spec, compiled, size))  # type: ignore[misc]
                if watcher is not None:
                    self._watchers[item.name] = watcher

    def __bool__(self) -> bool:
        return bool(self._watchers)

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""
        for watcher in self._watchers.values():
            watcher.add(states)

    def warnings(self, energies: EnergyRecord) -> tuple[str, ...]:
        """Return a sentence for each thing that is wrong with the states or energies of a run."""
        found = [str(finding) for watcher in self._watchers.values() for finding in watcher.warnings(energies)]
        return (*found, *passivity_warnings(self._mechanism, energies))

    def stored(self) -> dict[str, Any]:
        """Return the state as plain values, for a checkpoint."""
        return {name: watcher.stored() for name, watcher in self._watchers.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        for name, watcher in self._watchers.items():
            watcher.restore(state[name])
