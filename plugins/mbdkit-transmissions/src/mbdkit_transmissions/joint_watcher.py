"""What watches joints of this part over a run: arrays of numbers, noted from recorded states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import numpy as np

    from mbdkit.plugin import States


class JointWatcher(ABC):
    """A watcher of states whose own state is the arrays `ARRAYS`; each is an attribute with an underscore before it."""

    ARRAYS: ClassVar[tuple[str, ...]]

    def add(self, states: States) -> None:
        """Take note of states."""
        if len(states.time):
            self._note(states)

    @abstractmethod
    def _note(self, states: States) -> None:
        """Take note of one state or more."""

    def stored(self) -> dict[str, np.ndarray]:
        """Return the state as plain values, for a checkpoint."""
        return {name: getattr(self, f"_{name}") for name in self.ARRAYS}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        for name in self.ARRAYS:
            getattr(self, f"_{name}")[:] = state[name]
