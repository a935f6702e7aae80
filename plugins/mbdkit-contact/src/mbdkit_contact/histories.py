"""Histories of contacts and of ground reactions, with the columns of `mbdkit_contact.quantities`."""

from __future__ import annotations

from typing import NamedTuple

from mbdkit.archive import recorded_columns as columns

MODES = ("open", "stick", "slip")  #: Names of the modes of contacts.


class Transition(NamedTuple):
    """A change of the mode of a contact between two recorded rows.

    Attributes
    ----------
    time
        Time of the first row with the new mode, s.
    before, after
        Modes: ``open``, ``stick`` or ``slip``.
    """

    time: float
    before: str
    after: str


class ContactHistory(columns.Contacts, of="contacts"):
    """Gap, forces, slip and mode of one contact.

    Friction is the force on the second body, and slip its velocity relative to the first. Both are positive along the
    normal turned by -90 degrees.
    """

    @property
    def transitions(self) -> list[Transition]:
        """Changes of the mode in the recorded rows, in order of time. Events on the mode give exact times."""
        time, mode = self.source.array("contacts/time").tolist(), self.mode.astype(int).tolist()
        changes = (row for row in range(1, len(mode)) if mode[row] != mode[row - 1])
        return [Transition(time[row], MODES[mode[row - 1]], MODES[mode[row]]) for row in changes]


class GroundReactionHistory(columns.GroundReactions, of="ground_reactions"):
    """Force of the ground on one body [N], and its centre of pressure [m], nan where the body is in the air."""
