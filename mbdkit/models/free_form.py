"""The free-form model: a mechanism whose elements are listed in the spec."""

from __future__ import annotations

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_data import MechanismData
from mbdkit.mechanism.mechanism_seams import model_builder


class MechanismOptions(MechanismData):
    """Parameters of `mechanism`: bodies, joints, forces and markers by name."""


@model_builder
def build(options: MechanismOptions) -> Mechanism:
    """Return the mechanism described by the options, after checks across its elements."""
    return Mechanism.from_data(options)
