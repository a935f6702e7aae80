"""The modes of a contact: open, sticking and slipping."""

from __future__ import annotations

OPEN, STICK, SLIP = range(3)  #: Modes of a contact: open, sticking (closed without slip) and slipping.
