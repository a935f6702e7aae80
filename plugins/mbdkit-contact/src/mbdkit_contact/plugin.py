"""What this part adds to mbdkit: treatments of contacts between rigid bodies, and time-stepping methods."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mbdkit.plugin import Example, GuidePage, IntegratorPlugin, Item, Target, Treatment, hookimpl

_HERE = Path(__file__).parent


def _of_treatments(name: str) -> Target[Any]:
    return Target(f"mbdkit_contact.treatments:{name}")


def _integrator(order: int, name: str, summary: str, options: str, suffix: str) -> IntegratorPlugin:
    home = "mbdkit_contact.time_stepping_methods"
    return IntegratorPlugin(
        name=name,
        summary=summary,
        options=Target(f"{home}:{options}", type),
        create=Target(f"{home}:create_{suffix}"),
        claims=Target(f"{home}:claims_of_{suffix}"),
        references=Target(f"{home}:REFERENCES_OF_{suffix.upper()}", tuple),
        dense_output=False,
        order=order,
    )


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Return the time-stepping methods."""
    return [
        _integrator(
            130,
            "moreau-jean",
            "Moreau and Jean: time-stepping for rigid contacts, order 1, no drift of joints and gaps, fixed steps.",
            "MoreauJeanOptions",
            "moreau_jean",
        ),
        _integrator(
            140,
            "nonsmooth-generalized-alpha",
            "Nonsmooth generalized-alpha: time-stepping for rigid contacts, order 2 without them, fixed steps.",
            "GeneralizedAlphaOptions",
            "generalized_alpha",
        ),
    ]


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the treatments, the examples, and the page of the guide."""
    comparison: dict[str, Any] = {"guards": _of_treatments("guards"), "guarded_by": "event-driven"}
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
        *Example.folder(_HERE / "examples"),
        *GuidePage.folder(_HERE / "guide"),
    ]
