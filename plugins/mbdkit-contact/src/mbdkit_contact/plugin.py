"""What this part adds to mbdkit: treatments of contacts between rigid bodies, and time-stepping methods."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from mbdkit.plugin import Item, Target, Treatment, hookimpl


def _of_treatments(name: str) -> Target[Any]:
    return Target(f"mbdkit_contact.treatments:{name}")


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the treatments."""
    comparison = {"guards": _of_treatments("guards"), "guarded_by": "event-driven"}
    return [
        Treatment(
            name="event-driven",
            summary="Rigid bodies; impacts and changes between sticking, slipping and separation are located.",
            order=10,
            require=_of_treatments("require_event_driven"),
            begin=_of_treatments("with_contact_forces"),
            method=_of_treatments("event_driven"),
            **comparison,
        ),
        Treatment(
            name="time-stepping",
            summary="Rigid bodies, whose velocities may jump in every step.",
            order=20,
            require=_of_treatments("require_time_stepping"),
            begin=_of_treatments("with_contact_forces"),
            # errors are bounded by a constant times the step, but do not decrease steadily with the step, because
            # impacts fall between the ends of steps
            factors=(4, 16),
            includes_impacts=True,
            **comparison,
        ),
    ]
