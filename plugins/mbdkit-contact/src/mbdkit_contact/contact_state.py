"""Data of rigid contacts that one step passes to the next: modes, forces and impacts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import zip_longest
from typing import Any

import numpy as np

from mbdkit.base.text import listed
from mbdkit.integrators.run.impulse import ElementImpact, ReactingMemory
from mbdkit_contact.acting_contacts import HELD, ActingContact, held_coordinates, held_states
from mbdkit_contact.contact_section import ContactTreatment

#: `ContactState.remarks` mentions relative errors of the velocities of contacts that are larger than this.
SOLVED = 1e-6
#: Largest `contact.rest_energy` for which the bounces that are left out count as negligible.
NEGLIGIBLE_BOUNCES = 1e-9
#: What is said of the contacts whose names a field has.
REMARKS = {
    "cut": "an infinite sequence of impacts was cut off at {names}: the contact stays closed after the last one "
    "that was computed; `/impacts` has the time at which the impacts would have accumulated",
    "changed": "the law of impact would have created energy at {names}; Stronge's law was used there or, for several "
    "contacts at once, the law of the run or Poisson's law with a smaller restitution",
    "undetermined": "the normal forces of contacts {names} are not unique, because other forces cause the same motion; "
    "the run records one possible set",
    "ordered": "impacts of contacts {names} coincide, and the run computes them together; if they happened one after "
    "another, for example because of a tiny gap, the velocities after them would be different",
}
_NAMES = tuple(REMARKS)  #: Fields that are sets of names.


@dataclass(frozen=True)
class ContactState:
    """Data of contacts that one step passes to the next.

    Attributes
    ----------
    modes, normal, tangent
        (C,) modes and forces [N] at the end of the step.
    force
        (n,) generalized forces of all contacts [N, N m].
    impacts
        All impacts so far.
    cut
        Names of contacts whose infinite sequence of impacts was cut short.
    changed
        Names of contacts at which a law of impact other than the chosen one was used.
    undetermined
        Names of contacts whose normal forces were not unique.
    ordered
        Names of contacts with simultaneous impacts, in another order of which their velocities would be different.
    cut_time
        Time at which a sequence of impacts was first cut short [s].
    time
        Time at which the step ended [s]; before its planned end if there was an event.
    is_over_step
        Whether the forces are means over the step, not values at its end.
    undecided
        First time at which several contacts that affect each other have closed at once, in an unknown order [s].
    residual
        Largest error of the velocities of contacts, relative to the largest velocity in the same step.
    known
        Arrays that kernels pass to the next step, by name (`mbdkit_contact.kernels.event_bundle.Known`); none before
        the first step.
    between
        Memory of the method that takes the steps between events; None after an event.
    """

    modes: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    force: np.ndarray
    impacts: tuple[ElementImpact, ...] = ()
    cut: frozenset[str] = frozenset()
    changed: frozenset[str] = frozenset()
    undetermined: frozenset[str] = frozenset()
    ordered: frozenset[str] = frozenset()
    cut_time: float = math.inf
    time: float = math.inf
    is_over_step: bool = False
    undecided: float = math.inf
    residual: float = 0.0
    known: Mapping[str, np.ndarray] = field(default_factory=dict)
    between: Any = None

    def after_stop(self) -> ContactState:
        """Return the state after a discontinuity of a motion or load; the next step determines the modes anew."""
        if known := dict(self.known):
            known |= {"determined": np.zeros(2, dtype=np.int64), "event": np.zeros(2, dtype=np.int64)}
        return replace(self, modes=np.zeros(0, dtype=int), known=known, between=None)

    def stored(self) -> dict[str, object]:
        """Return the state as plain data; the impacts are stored as joined arrays."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return values | {
            "known": dict(self.known),
            "impacts": np.array([impact[:-1] for impact in self.impacts], dtype=float),
            "reactions": np.array([impact.reactions for impact in self.impacts], dtype=float),
            **{name: sorted(values[name]) for name in _NAMES},
        }

    def restored(self, data: Mapping[str, Any]) -> ContactState:
        """Return the state from what `stored` has returned; raise ValueError if it is not one of these contacts."""
        values = dict(data)
        count, reactions = len(self.normal), values.pop("reactions")
        sizes = {"normal": (count,), "tangent": (count,), "force": self.force.shape}
        if values.keys() != {item.name for item in fields(self)} or any(
            values[name].shape != shape for name, shape in sizes.items()
        ):
            raise ValueError("it has other parts")
        if any(not 0 <= int(impact[1]) < count for impact in values["impacts"]):
            raise ValueError("an impact is that of another contact")
        values["impacts"] = tuple(
            ElementImpact(t, int(contact), normal, tangential, lost, own)
            for (t, contact, normal, tangential, lost), own in zip(values["impacts"].tolist(), reactions, strict=True)
        )
        return ContactState(**values | {name: frozenset(map(str, values[name])) for name in _NAMES})

    def remarks(self) -> tuple[str, ...]:
        """Return sentences about sequences of impacts that were cut short, about impacts computed with another law than
        the chosen one, about normal forces that are not unique, about simultaneous impacts whose order would matter,
        and about inaccurate velocities of contacts.
        """
        names = {name: listed([f"'{one}'" for one in sorted(getattr(self, name))], "and") for name in _NAMES}
        sentences = [REMARKS[name].format(names=text) for name, text in names.items() if text]
        if self.residual > SOLVED:
            sentences.append(
                f"the laws of contact and friction are satisfied to {self.residual:.1g} of the largest velocity only, "
                "in the worst step; a smaller `time.step` may help"
            )
        return tuple(sentences)

    def agrees(self, others: Sequence[ReactingMemory], section: ContactTreatment) -> tuple[float, str]:
        """See `ReactingMemory.agrees`: impacts should be the same, in the same order, and none should be left out.

        Runs by time-stepping methods, which do not locate impacts, are not compared.
        """
        runs = [self, *(other for other in others if isinstance(other, ContactState))]
        undecided = min(run.undecided for run in runs)
        differs = math.inf
        for impacts in zip_longest(*(run.impacts for run in runs if not run.is_over_step)):
            if len({None if impact is None else impact.element for impact in impacts}) > 1:
                differs = min(impact.time for impact in impacts if impact is not None)
                break
        until, why = differs, f" After {differs:.6g} s, the impacts of the runs differ."
        if undecided < differs:
            until = undecided
            why = f" At {undecided:.6g} s, contacts that affect each other close at once, in an unknown order."
        if self.cut and section.rest_energy > NEGLIGIBLE_BOUNCES and self.cut_time < until:
            until = self.cut_time
            why = (
                f" After {until:.6g} s, bounces below contact.rest_energy are left out, in the comparison runs as well."
            )
        return until, why if math.isfinite(until) else ""


class HeldForces:
    """Forces and modes of rigid contacts as first-order states, which are constant within each step."""

    def __init__(self, contacts: Iterable[ActingContact]):
        rigid = [contact for contact in contacts if contact.first_state >= 0]
        self._contacts, self.coordinates = len(HELD) * len(rigid), held_coordinates(rigid)
        self.states = held_states(rigid)

    def of(self, memory: ContactState) -> np.ndarray:
        """Return the states (Z,) from the memory of the method."""
        z = np.zeros(len(self.states))
        if len(self.states):
            modes = memory.modes if len(memory.modes) else np.zeros(len(memory.normal))  # unknown after a stop
            z[: self._contacts] = np.stack([memory.normal, memory.tangent, np.abs(modes)], axis=1).ravel()
            z[self._contacts :] = memory.force[self.coordinates]
        return z
