"""What this part adds to mbdkit: contacts, their treatments between rigid bodies, and time-stepping methods."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

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


_CRITERIA: tuple[tuple[int, Literal["spec", "rows"], str, str, str], ...] = (
    (
        85,
        "spec",
        "rolling-point-masses",
        "Circles of point masses, which friction cannot turn.",
        "contact_criteria:rolling_point_masses",
    ),
    (107, "spec", "slip-events", "Events at zeros of a slip that are rounding errors.", "contact_criteria:slip_events"),
    (
        155,
        "rows",
        "slow-contacts",
        "Dry friction that slips so slowly that it is viscous.",
        "contact_criteria:slow_friction",
    ),
    (175, "rows", "deep-overlaps", "Circles in contact that overlap deeply.", "deep_overlaps:DeepOverlaps.of"),
    (177, "rows", "rigid-overlaps", "Rigid bodies that overlap.", "deep_overlaps:RigidOverlaps.of"),
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
    rigid: dict[str, Any] = {
        "of": "contacts",
        "reacting": True,
        "begin": _of_treatments("with_contact_forces"),
        "guards": _of_treatments("guards"),
        "guarded_by": "event-driven",
        "undecided": "impacts of rigid contacts make the errors of the motion unknown before its end",
        "supports": {
            "gradients": "gradients of runs do not include event-driven and time-stepping contacts; use compliant ones",
            "statics": "an analysis of a mechanism at rest needs compliant contacts: use `treatment: compliant`",
        },
    }
    return [
        ElementKind(
            name="contact",
            summary="Contacts between bodies by name.",
            order=300,
            key_in_model="contacts",
            example="bouncing-ball",
            model=Target("mbdkit_contact.contact:Contact"),
            builder="contact",
            method=Target("mbdkit_contact.contact:add_contact"),
            section="contact",
            section_model=Target("mbdkit_contact.contact_section:ContactTreatment"),
            read_files=Target("mbdkit_contact.polyline_files:read_polylines"),
            check_elements=Target("mbdkit_contact.contact:check_contacts"),
            check_run=Target("mbdkit_contact.treatments:check_run"),
            lower=Target("mbdkit_contact.acting_contacts:lower_contacts"),
            at_start=Target("mbdkit_contact.acting_contacts:check_start"),
            members=Target("mbdkit_contact.acting_contacts:members_of"),
            sides=Target("mbdkit_contact.contact_corners:sides"),
            gradient_doubts=Target("mbdkit_contact.contact_corners:jumps"),
        ),
        *(
            QuantityKind(
                name=name,
                summary=summary,
                order=order,
                target=Target(f"mbdkit_contact.quantities:{name.upper()}"),
                word=name,
                of="contacts",
                names=Target(f"mbdkit_contact.quantities:{names}"),
                peaks=("normal_force", "-gap") if name == "contacts" else (),
                modes="mode" if name == "contacts" else "",
                history=Target(f"mbdkit_contact.histories:{history}"),
            )
            for order, name, names, history, summary in (
                (52, "contacts", "contact_names", "ContactHistory", "Gaps, forces, slip and modes of contacts."),
                (54, "ground_reactions", "feet_of", "GroundReactionHistory", "Forces of the ground on bodies."),
            )
        ),
        SummaryLine(
            name="contacts",
            summary="Overlaps and slip of contacts.",
            order=1010,
            text=Target("mbdkit_contact.contact_summary:contact_lines"),
            group="contacts",
        ),
        SummaryLine(
            name="impacts",
            summary="Impacts of contacts.",
            order=1020,
            text=Target("mbdkit_contact.contact_summary:impact_lines"),
            group="impacts",
        ),
        HeadlineItem(
            name="contact-forces",
            summary="Largest normal forces of contacts.",
            order=30,
            take=Target("mbdkit_contact.contact_summary:largest_forces"),
            group="contacts",
        ),
        *(
            CriterionItem(
                name=name,
                summary=summary,
                order=order,
                stage=stage,
                find=Target(f"mbdkit_contact.{find}"),
                of=frozenset({"run", "mechanism"} if name == "rolling-point-masses" else {"run"}),
                criteria=("slow-friction" if name == "slow-contacts" else name,),
                level="bad" if name == "rigid-overlaps" else "doubtful",
                elements="contacts",
            )
            for order, stage, name, summary, find in _CRITERIA
        ),
        Treatment(name="compliant", summary="Forces by the overlap of the shapes.", order=0, of="contacts"),
        Treatment(
            name="event-driven",
            summary="Rigid bodies; impacts and changes between sticking, slipping and separation are located.",
            order=10,
            require=_of_treatments("require_event_driven"),
            method=_of_treatments("event_driven"),
            **rigid,
        ),
        Treatment(
            name="time-stepping",
            summary="Rigid bodies, whose velocities may jump in every step.",
            order=20,
            require=_of_treatments("require_time_stepping"),
            # errors are bounded by a constant times the step, but do not decrease steadily with the step, because
            # impacts fall between the ends of steps
            factors=(4, 16),
            includes_impacts=True,
            **rigid,
        ),
        *Example.folder(_HERE / "examples"),
        *GuidePage.folder(_HERE / "guide"),
    ]
