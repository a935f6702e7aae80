"""The state of an open simulation, to which it can return."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit.archive.checkpoint import StoredState, decoded_state, encoded_state
from mbdkit.base.errors import ArchiveError
from mbdkit.base.frozen import dataclass

KIND = "mbdkit simulation state"


@dataclass(frozen=True, eq=False)
class SimulationState:
    """The state of a simulation at a time: what later steps depend on, and what was set until then.

    `Simulation.state` returns it, and `Simulation.restore` returns to it, also in another process or in a simulation of
    the same spec that is opened later. It is plain data; nothing is unpickled.

    - `time`: the time [s].
    - `run_id`: name of the spec to which the state belongs.
    - `history`: times at which inputs were set or steps ended for the program, and the values.
    - `motion`: nested mappings and lists of arrays, numbers, texts and None.
    - `random`: state of `Simulation.random`.
    - `before`: the state at the start of the fixed step within which the simulation has paused; otherwise None. If no
      input is set, the whole step is taken from there.
    """

    time: float
    run_id: str
    history: Mapping[str, list[Any]]
    motion: StoredState
    random: Mapping[str, Any]
    before: SimulationState | None = None

    def to_bytes(self) -> bytes:
        """Return the state as bytes, which begin with their SHA-256."""
        return encoded_state({"kind": KIND, **self._plain()})

    def _plain(self) -> dict[str, Any]:
        return {**vars(self), "before": None if self.before is None else self.before._plain()}

    @classmethod
    def from_bytes(cls, content: bytes) -> SimulationState:
        """Return the state that `to_bytes` has returned as these bytes.

        Raises ArchiveError if they are damaged or are something else.
        """
        try:
            values = decoded_state(content) or {}
            if values.pop("kind", None) == KIND:
                return cls._of(values)
        except (LookupError, TypeError, AttributeError, ValueError, RecursionError):
            pass
        raise ArchiveError("these bytes are not the state of a simulation, or they are damaged")

    @classmethod
    def _of(cls, values: dict[str, Any]) -> SimulationState:
        before = values.pop("before")
        return cls(**values, before=None if before is None else cls._of(before))


def copied(value: object) -> object:
    """Return a copy of nested mappings and sequences with copies of their arrays."""
    match value:
        case np.ndarray():
            return value.copy()
        case Mapping():
            return {name: copied(item) for name, item in value.items()}
        case list() | tuple():
            return [copied(item) for item in value]
    return value
