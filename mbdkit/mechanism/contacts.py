"""Modes and treatments of contacts, which are elements of a plugin."""

from __future__ import annotations

from typing import NamedTuple

OPEN, STICK, SLIP = range(3)
"""Modes of a contact: open, sticking (closed without slip) and slipping."""


class ChosenTreatment(NamedTuple):
    """How contacts act in a run.

    Attributes
    ----------
    kind
        ``compliant``, ``event-driven`` or ``time-stepping``; in the latter two, bodies are rigid.
    impact_law
        Law of impacts of rigid bodies, ``newton`` or ``poisson``.
    rest_energy
        A contact stays closed if the kinetic energy of its rebound is below this share of the largest kinetic energy of
        the mechanism so far.
    """

    kind: str = "compliant"
    impact_law: str = "newton"
    rest_energy: float = 1e-12

    @property
    def is_rigid(self) -> bool:
        """Whether bodies in contact are rigid, so that no compliance lets them overlap."""
        return self.kind != "compliant"


COMPLIANT = ChosenTreatment()
