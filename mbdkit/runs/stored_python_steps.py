"""Conversion of the state of a run with rigid contacts, whose steps are taken in Python, to plain values of a
checkpoint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from mbdkit.engine.stored_arrays import restore, stored
from mbdkit.integrators.contact_state import ContactImpact, ContactState
from mbdkit.integrators.impulse import DriverImpulse
from mbdkit.integrators.python_stepper import Interval, PythonStepper, Reached
from mbdkit.methods.kinds import StepState

_INTEGERS = ("modes", "features")
"""Arrays of contacts whose values are integers, which may be negative."""
_NAMES = ("cut", "changed", "undetermined", "ordered")
_REACHED = ("done", "whole", "passed", "restart", "time", "is_event", "energy", "energy_low")
_INTERVAL = ("steps", "size", "iterations", "most_iterations", "correction")


def stored_stepper(stepper: PythonStepper) -> dict[str, Any]:
    """Return the state of a stepper between two stretches of steps as plain values."""
    now = stepper.now
    state = now.state
    return {
        "reached": {name: getattr(now, name) for name in _REACHED},
        "interval": {name: getattr(now.interval, name) for name in _INTERVAL},
        "q": state.q,
        "v": state.v,
        "energies": [state.work, state.dissipated],
        "low": list(state.low),
        "contacts": None if state.memory is None else _stored_contacts(state.memory),
        "guards": stored(stepper.guards),
        "worst": stepper.worst_pairs,
        "counters": dict(vars(stepper.counters)),
        "pivots": stepper.equations.stored_pivots(),
        **stored_impulses(stepper.impacts),
    }


def restore_stepper(stepper: PythonStepper, state: Mapping[str, Any]) -> None:
    """Restore a stored state to the stepper of the same run at its start; raise ValueError if it is not valid."""
    n, reached, interval = stepper.equations.n, dict(state["reached"]), dict(state["interval"])
    if reached.keys() != set(_REACHED) or interval.keys() != set(_INTERVAL):
        raise ValueError("it has other parts")
    if not 0 <= reached["passed"] <= len(stepper.timetable.stops):
        raise ValueError("it has passed more stops than exist")
    restore({"worst": stepper.worst_pairs}, {"worst": state["worst"]})
    restore(stepper.guards._asdict(), state["guards"])
    if state["counters"].keys() != vars(stepper.counters).keys():
        raise ValueError("it has other counters")
    vars(stepper.counters).update({name: int(count) for name, count in state["counters"].items()})
    stepper.equations.restore_pivots(state["pivots"])
    contacts = state["contacts"]
    memory = None if contacts is None else _contacts_of(contacts, n, len(stepper.equations.contacts), stepper)
    energies = [None if x is None else float(x) for x in state["energies"]]
    low = tuple(x if isinstance(x, float) else _array(x, (n,)) for x in state["low"])
    if len(low) != 2:
        raise ValueError("it has other parts")
    work, dissipated = energies
    q, v = (_array(state[name], (n,)) for name in ("q", "v"))
    begin = StepState(q, v, None, memory, work, dissipated, (low[0], low[1]))
    for name in ("energy", "energy_low"):
        reached[name] = _array(reached[name], (2,))
    interval["correction"] = _array(interval["correction"], (4,))
    stepper.impacts[:] = impulses_of(state, len(stepper.workspace.mechanism.joints))
    stepper.continue_from(Reached(**reached, state=begin, interval=Interval(**interval)))


def stored_impulses(impulses: Sequence[DriverImpulse]) -> dict[str, Any]:
    """Return the impulses of drivers as two entries of the state of a stepper."""
    numbers = [[one.time, one.energy, one.velocity] for one in impulses]
    return {"impacts": numbers, "impulses": [one.reactions for one in impulses]}


def impulses_of(state: Mapping[str, Any], joints: int) -> list[DriverImpulse]:
    """Return the impulses of drivers in the stored state of a stepper; raise ValueError if they are not valid."""
    reactions = [_array(one, (joints, 3)) for one in state["impulses"]]
    return [
        DriverImpulse(float(time), float(energy), float(velocity), own)
        for (time, energy, velocity), own in zip(state["impacts"], reactions, strict=True)
    ]


def _stored_contacts(memory: ContactState) -> dict[str, Any]:
    """Return the state of contacts as plain values; the impacts are stored as joined arrays."""
    values = {item.name: getattr(memory, item.name) for item in fields(memory)}
    numbers = [[*one[:-1]] for one in memory.impacts]
    values |= {
        "impacts": np.array(numbers, dtype=float).reshape(len(numbers), len(ContactImpact._fields) - 1),
        "reactions": np.array([one.reactions for one in memory.impacts], dtype=float),
        "accelerations": list(memory.accelerations),
        "event": None if memory.event is None else [int(x) for x in memory.event],
    }
    values |= {name: sorted(values[name]) for name in _NAMES}
    for name in _INTEGERS:
        values[name] = None if values[name] is None else values[name].astype(float)
    return values


def _contacts_of(state: Mapping[str, Any], n: int, count: int, stepper: PythonStepper) -> ContactState:
    """Return the stored state of `count` contacts on n coordinates."""
    values = dict(state)
    joints = len(stepper.workspace.mechanism.joints)
    reactions = values.pop("reactions")
    numbers = values["impacts"]
    numbers = _array(numbers, (len(numbers), len(ContactImpact._fields) - 1))
    each = _array(reactions, (len(numbers), joints, 3)) if len(numbers) else ()
    if np.any(numbers[:, 1] < 0) or np.any(numbers[:, 1] >= count):
        raise ValueError("an impact is that of another contact")
    values["impacts"] = tuple(
        ContactImpact(t, int(i), normal, tangential, lost, own)
        for (t, i, normal, tangential, lost), own in zip(numbers.tolist(), each, strict=True)
    )
    for name in _INTEGERS:
        if values[name] is not None:
            own = _array(values[name], (count,) if len(values[name]) else (0,))
            values[name] = own.astype(int)
    for name, size in (("normal", count), ("tangent", count), ("force", n)):
        values[name] = _array(values[name], (size,))
    values["accelerations"] = tuple(_array(x, (n,)) for x in values["accelerations"])
    values["event"] = None if values["event"] is None else (int(values["event"][0]), int(values["event"][1]))
    if values["event"] is not None and not 0 <= values["event"][1] < count:
        raise ValueError("an event is that of another contact")
    for name in _NAMES:
        values[name] = frozenset(map(str, values.get(name, ())))
    return ContactState(**values)


def _array(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return a stored array; raise ValueError if the value is not an array of this shape."""
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.shape != shape:
        raise ValueError("an array has another shape or type")
    return value
