"""Conversion of the state of a run whose steps are taken in Python to plain values of a checkpoint, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mbdkit.archive.checkpoint import StoredState, decoded_state, encoded_state
from mbdkit.base.errors import StepError
from mbdkit.engine.stored_arrays import restore, stored
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.run.impulse import DriverImpulse
from mbdkit.integrators.run.reached import IntervalSoFar, Reached
from mbdkit.integrators.run.step_results import kept
from mbdkit.methods.step_methods import ExternalMethod, StepState

#: Fields of a point of a run that are stored as they are.
_REACHED = tuple(name for name in Reached._fields if name not in ("state", "interval", "event"))


class MemoryNotStoredError(Exception):
    """The memory of a method cannot be stored, for the reason in the message."""


def stored_stepper(stepper: StepHost) -> StoredState:
    """Return the state of a stepper between two stretches of steps as plain values.

    Raises MemoryNotStoredError if the memory of the method cannot be stored.
    """
    try:
        stepper.apply_event()  # an event that has not happened yet cannot be stored
    except StepError as error:
        raise MemoryNotStoredError(str(error)) from error
    now = stepper.now
    state = now.state
    library = None
    if isinstance(stepper.method, ExternalMethod) and (library := stepper.method.save()) is None and not now.why:
        raise MemoryNotStoredError("the library of the method does not give its state")
    return {
        "reached": {name: getattr(now, name) for name in _REACHED},
        "interval": now.interval._asdict(),
        "q": state.q,
        "v": state.v,
        "energies": [state.work, state.dissipated],
        "low": list(state.low),
        "z": state.z,
        "multipliers": state.multipliers,
        "next_row": stepper.rows.next_row,
        "sampler": stepper.sampler.stored(),
        "library": None if library is None else library.hex(),
        **_stored_memory(stepper, state.memory),
        "guards": stored(stepper.guards),
        "worst": stepper.worst_pairs,
        "switches": stepper.spell,
        "counters": dict(vars(stepper.counters)),
        "pivots": stepper.equations.stored_pivots(),
        **stored_impulses(stepper.impacts),
    }


def copy_state(stepper: StepHost, other: StepHost) -> None:
    """Let another stepper continue from the state of a stepper, as a resumed run does: from the bytes of a checkpoint.

    Raises MemoryNotStoredError if the memory of the method cannot be stored.
    """
    restore_stepper(other, decoded_state(encoded_state(stored_stepper(stepper))))


def restore_stepper(stepper: StepHost, state: StoredState) -> None:
    """Restore a stored state to the stepper of the same run at its start; raise ValueError if it is not valid."""
    n, m, reached, interval = stepper.equations.n, stepper.equations.m, dict(state["reached"]), dict(state["interval"])
    if reached.keys() != set(_REACHED) or interval.keys() != set(IntervalSoFar._fields):
        raise ValueError("it has other parts")
    if not 0 <= reached["passed"] <= len(stepper.timetable.stops):
        raise ValueError("it has passed more stops than exist")
    restore({"worst": stepper.worst_pairs}, {"worst": state["worst"]})
    restore(stepper.guards._asdict(), state["guards"])
    restore(stepper.spell, state["switches"])
    if state["counters"].keys() != vars(stepper.counters).keys():
        raise ValueError("it has other counters")
    vars(stepper.counters).update({name: int(count) for name, count in state["counters"].items()})
    stepper.equations.restore_pivots(state["pivots"])
    memory = _memory_of(stepper, state)
    z = _array(state["z"], stepper.now.state.z.shape)
    energies = [None if x is None else float(x) for x in state["energies"]]
    low = tuple(x if isinstance(x, float) else _array(x, x.shape) for x in state["low"])
    if len(low) not in (2, 3) or any(np.shape(x) not in ((), (n,), z.shape) for x in low):
        raise ValueError("it has other parts")
    work, dissipated = energies
    q, v = (_array(state[name], (n,)) for name in ("q", "v"))
    multipliers = state["multipliers"]
    multipliers = None if multipliers is None else _array(multipliers, (m,))
    begin = StepState(q, v, multipliers, memory, work, dissipated, low, z)
    for name in ("energy", "energy_low"):
        reached[name] = _array(reached[name], (2,))
    error, earlier_error, last_size, earlier_size = reached["history"]
    reached["history"] = float(error), float(earlier_error), float(last_size), float(earlier_size)
    interval["correction"] = _array(interval["correction"], (4,))
    stepper.impacts[:] = impulses_of(state, len(stepper.workspace.mechanism.joints))
    stepper.sampler.restore(state["sampler"])
    library = state["library"]
    stepper.continue_from(
        Reached(**reached, state=begin, interval=IntervalSoFar(**interval)),
        int(state["next_row"]),
        None if library is None else bytes.fromhex(library),
    )


def _stored_memory(stepper: StepHost, memory: object) -> StoredState:
    try:
        if not hasattr(memory, "stored"):
            return {"memory": _plain(memory)}
        if hasattr(stepper.first_memory, "restored"):
            return {"restored": _plain(memory.stored())}
        kind, reason = type(memory).__name__, "`begin` does not return one from which `restored` can be called"
    except TypeError as error:
        kind, reason = type(memory).__name__, str(error)
    raise MemoryNotStoredError(f"the memory of the method, a {kind}, cannot be stored: {reason}")


def _memory_of(stepper: StepHost, state: StoredState) -> object:
    if "restored" in state:
        first = stepper.first_memory
        restored = first.restored(_unplain(state["restored"]))
        return first if restored is None else restored
    return kept(_unplain(state["memory"]))


def _plain(value: object) -> object:
    """Return data with marks from which `_unplain` finds their types; raise TypeError for other objects."""
    match value:
        case np.ndarray():
            return value if value.dtype == np.float64 else {"array": value.tolist(), "dtype": value.dtype.str}
        case np.generic():
            return {"array": value.item(), "dtype": value.dtype.str}
        case bool() | int() | float() | str() | None:
            return value
        case list():
            return [_plain(item) for item in value]
        case tuple() if type(value) is tuple:
            return {"tuple": [_plain(item) for item in value]}
        case Mapping():
            return {"items": [[_plain(key), _plain(item)] for key, item in value.items()]}
    raise TypeError(f"it contains a {type(value).__name__}")


def _unplain(value: object) -> object:
    match value:
        case {"dtype": str(kind), "array": array}:
            values = np.array(array, dtype=np.dtype(kind))
            return values if values.ndim else values[()]
        case {"tuple": items}:
            return tuple(_unplain(item) for item in items)
        case {"items": items}:
            return {_unplain(key): _unplain(item) for key, item in items}
        case list():
            return [_unplain(item) for item in value]
    return value


def stored_impulses(impulses: Sequence[DriverImpulse]) -> StoredState:
    """Return the impulses of drivers as two entries of the state of a stepper."""
    numbers = [[impulse.time, impulse.energy, impulse.velocity] for impulse in impulses]
    return {"impacts": numbers, "impulses": [impulse.reactions for impulse in impulses]}


def impulses_of(state: StoredState, joints: int) -> list[DriverImpulse]:
    """Return the impulses of drivers in the stored state of a stepper; raise ValueError if they are not valid."""
    reactions = [_array(reaction, (joints, 3)) for reaction in state["impulses"]]
    return [
        DriverImpulse(float(time), float(energy), float(velocity), own)
        for (time, energy, velocity), own in zip(state["impacts"], reactions, strict=True)
    ]


def _array(value: object, shape: tuple[int, ...]) -> np.ndarray:
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.shape != shape:
        raise ValueError("an array has another shape or type")
    return value
