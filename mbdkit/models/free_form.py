"""The free-form model: a mechanism written out in the spec."""

from __future__ import annotations

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_data import MechanismData

SUMMARY = "Any mechanism of bodies, joints, drivers and forces, written out by name."


class MechanismOptions(MechanismData):
    """Parameters of `mechanism`: its bodies, joints and forces."""


def build(options: MechanismOptions) -> Mechanism:
    """Return the mechanism as written, cross-checked."""
    return Mechanism.from_data(options)
