"""Treatments of contacts by name."""

from __future__ import annotations

from typing import cast

from mbdkit.registry.feature_items import Treatment
from mbdkit.registry.manager import registry


def treatment_of(name: str) -> Treatment:
    """Return the treatment of contacts with a name; raises SpecError if it is not installed."""
    return cast(Treatment, registry().get(Treatment.kind, name).plugin)
