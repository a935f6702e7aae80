"""What this part adds to mbdkit: contacts, their treatments between rigid bodies, and time-stepping methods."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mbdkit.plugin import (
    CriterionItem,
    ElementKind,
    Example,
    GuidePage,
    HeadlineItem,
    IntegratorPlugin,
    Item,
    QuantityKind,
    SummaryLine,
    Target,
    Treatment,
    hookimpl,
)

_HERE = Path(__file__).parent


def _of_treatments(name: str) -> Target[Any]:
    return Target(f"mbdkit_contact.treatments:{name}")


def _criterion(order: int, name: str, stage: Any, summary: str, where: str, **more: Any) -> CriterionItem:
    return CriterionItem(
        name=name,
        summary=summary,
        order=order,
        stage=stage,
        find=Target(f"mbdkit_contact.{where}"),
        **{"of": frozenset({"run"}), "criteria": (name,), "elements": "contacts", **more},
    )


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
    """Return contacts, what runs record and say of them, treatments, examples, and the page of the guide."""
    comparison: dict[str, Any] = {"guards": _of_treatments("guards"), "guarded_by": "event-driven"}
    return [
        ElementKind(
            name="contact",
            summary="Contacts between bodies by name.",
            order=300,
            key_in_model="contacts",
            model=Target("mbdkit_contact.contact:Contact"),
            builder="contact",
            method=Target("mbdkit_contact.contact:add_contact"),
            read_files=Target("mbdkit_contact.polyline_files:read_polylines"),
            check_elements=Target("mbdkit_contact.contact:check_contacts"),
            lower=Target("mbdkit_contact.acting_contacts:lower_contacts"),
            at_start=Target("mbdkit_contact.acting_contacts:check_start"),
            members=Target("mbdkit_contact.acting_contacts:members_of"),
            sides=Target("mbdkit_contact.contact_corners:sides"),
            gradient_doubts=Target("mbdkit_contact.contact_corners:jumps"),
        ),
        QuantityKind(
            name="contacts",
            summary="Gaps, forces, slip and modes of contacts; polygons and polylines have several, `NAME.i`.",
            order=52,
            target=Target("mbdkit_contact.quantities:CONTACTS"),
            word="contacts",
            names=Target("mbdkit_contact.quantities:contact_names"),
            history=Target("mbdkit_contact.histories:ContactHistory"),
        ),
        QuantityKind(
            name="ground_reactions",
            summary="Force and centre of pressure of each body that may touch the ground.",
            order=54,
            target=Target("mbdkit_contact.quantities:GROUND_REACTIONS"),
            word="ground_reactions",
            of="contacts",
            names=Target("mbdkit_contact.quantities:feet_of"),
            history=Target("mbdkit_contact.histories:GroundReactionHistory"),
        ),
        SummaryLine(
            name="contacts",
            summary="Overlaps and slip of contacts.",
            order=1010,
            text=Target("mbdkit_contact.contact_summary:contact_lines"),
            group="contacts",
        ),
        HeadlineItem(
            name="contact-forces",
            summary="Largest normal forces of contacts.",
            order=30,
            take=Target("mbdkit_contact.contact_summary:largest_forces"),
            group="contacts",
        ),
        _criterion(
            85,
            "rolling-point-masses",
            "spec",
            "Point masses with circles that friction does not turn.",
            "contact_criteria:rolling_point_masses",
            of=frozenset({"run", "mechanism"}),
        ),
        _criterion(
            107,
            "slip-events",
            "spec",
            "Events at zeros of a slip that are rounding errors.",
            "contact_criteria:slip_events",
        ),
        _criterion(
            155,
            "slow-contacts",
            "rows",
            "Contacts that slip so slowly that friction is viscous.",
            "contact_criteria:SlowContactFriction.of",
            criteria=("slow-friction",),
        ),
        _criterion(
            175,
            "deep-overlaps",
            "rows",
            "Circles in contact that overlap deeply.",
            "deep_overlaps:DeepOverlaps.of",
        ),
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
