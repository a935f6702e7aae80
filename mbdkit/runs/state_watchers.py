"""The watchers of a run, which look at all recorded states and give warnings at its end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from mbdkit.quantities.states import States
from mbdkit.runs.coarse_beams import CoarseBeams
from mbdkit.runs.coincident_ends import CoincidentEnds
from mbdkit.runs.deep_overlaps import DeepOverlaps
from mbdkit.runs.moving_centers import MovingCenters
from mbdkit.runs.slow_friction import SlowFriction
from mbdkit.runs.warnings import passivity_warnings

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord


class StateWatcher(Protocol):
    """What a watcher of recorded states does."""

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""

    def warnings(self, energies: EnergyRecord) -> tuple[str, ...]:
        """Return a sentence for each thing that is wrong; `energies` are the largest of the run."""

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
        found: dict[str, StateWatcher | None] = {
            "centers": MovingCenters.of(self._mechanism, compiled),
            "friction": SlowFriction.of(self._mechanism, compiled, size),
            "ends": CoincidentEnds.of(spec, compiled),
            "beams": CoarseBeams.of(self._mechanism, compiled),
            "overlaps": DeepOverlaps.of(compiled),
        }
        self._watchers = {name: watcher for name, watcher in found.items() if watcher is not None}

    def __bool__(self) -> bool:
        return bool(self._watchers)

    def add(self, states: States) -> None:
        """Take note of states, which are later than those of earlier calls."""
        for watcher in self._watchers.values():
            watcher.add(states)

    def warnings(self, energies: EnergyRecord) -> tuple[str, ...]:
        """Return a sentence for each thing that is wrong with the states or energies of a run."""
        found = [sentence for watcher in self._watchers.values() for sentence in watcher.warnings(energies)]
        return (*found, *passivity_warnings(self._mechanism, energies))

    def stored(self) -> dict[str, Any]:
        """Return the state as plain values, for a checkpoint."""
        return {name: watcher.stored() for name, watcher in self._watchers.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        for name, watcher in self._watchers.items():
            watcher.restore(state[name])
