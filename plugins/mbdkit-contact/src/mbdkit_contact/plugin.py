"""What this part adds to mbdkit: contacts, their treatments between rigid bodies, and time-stepping methods."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.element_items import ElementDerivatives, ElementForces, ElementKind, QuantityKind
from mbdkit.registry.feature_items import CriterionItem, Example, GuidePage, HeadlineItem, SummaryLine, Treatment
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import IntegratorPlugin
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Return the time-stepping methods."""
    # fmt: off
    return [
        IntegratorPlugin(
            name="moreau-jean",
            summary="Moreau and Jean: time-stepping for rigid contacts, order 1, no drift of joints and gaps, "
            "fixed steps.",
            options=Target("mbdkit_contact.time_stepping_methods:MoreauJeanOptions"),
            create=Target("mbdkit_contact.time_stepping_methods:create_moreau_jean"),
            claims=Target("mbdkit_contact.time_stepping_methods:claims_of_moreau_jean"),
            references=Target("mbdkit_contact.time_stepping_methods:REFERENCES_OF_MOREAU_JEAN"), order=130,
        ),
        IntegratorPlugin(
            name="nonsmooth-generalized-alpha",
            summary="Nonsmooth generalized-alpha: time-stepping for rigid contacts, order 2 without them, fixed steps.",
            options=Target("mbdkit_contact.time_stepping_methods:NonsmoothGeneralizedAlphaOptions"),
            create=Target("mbdkit_contact.time_stepping_methods:create_generalized_alpha"),
            claims=Target("mbdkit_contact.time_stepping_methods:claims_of_generalized_alpha"),
            references=Target("mbdkit_contact.time_stepping_methods:REFERENCES_OF_GENERALIZED_ALPHA"), order=140,
        ),
    ]
    # fmt: on


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return contacts, what runs record and say of them, treatments, examples, and the page of the guide."""
    supports = {
        "gradients": "gradients of runs do not include event-driven and time-stepping contacts; use compliant ones",
        "statics": "an analysis of a mechanism at rest needs compliant contacts: use `treatment: compliant`",
    }
    undecided = "impacts of rigid contacts make the errors of the motion unknown before its end"
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
            acts=ElementForces(
                check_run=Target("mbdkit_contact.treatments:check_run"),
                lower=Target("mbdkit_contact.acting_contacts:lower_contacts"),
                members=Target("mbdkit_contact.acting_contacts:members_of"),
            ),
            at_start=Target("mbdkit_contact.acting_contacts:check_start"),
            derivatives=ElementDerivatives(
                sides=Target("mbdkit_contact.contact_corners:sides"),
                doubts=Target("mbdkit_contact.contact_corners:jumps"),
            ),
        ),
        QuantityKind(
            name="contacts",
            summary="Gaps, forces, slip and modes of contacts.",
            order=52,
            target=Target("mbdkit_contact.quantities:CONTACTS"),
            word="contacts",
            names=Target("mbdkit_contact.quantities:contact_names"),
            peaks=("normal_force", "-gap"),
            modes="mode",
            history=Target("mbdkit_contact.histories:ContactHistory"),
        ),
        QuantityKind(
            name="ground_reactions",
            summary="Forces of the ground on bodies.",
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
        CriterionItem(
            name="rolling-point-masses",
            summary="Circles of point masses, which friction cannot turn.",
            order=85,
            stage="spec",
            find=Target("mbdkit_contact.contact_criteria:rolling_point_masses"),
            of=frozenset({"run", "mechanism"}),
            elements="contacts",
        ),
        CriterionItem(
            name="slip-events",
            summary="Events at zeros of a slip that are rounding errors.",
            order=107,
            stage="spec",
            find=Target("mbdkit_contact.contact_criteria:slip_events"),
            elements="contacts",
        ),
        CriterionItem(
            name="slow-contacts",
            summary="Dry friction that slips so slowly that it is viscous.",
            order=155,
            stage="rows",
            find=Target("mbdkit_contact.contact_criteria:slow_friction"),
            criteria=("slow-friction",),
            elements="contacts",
        ),
        CriterionItem(
            name="deep-overlaps",
            summary="Circles in contact that overlap deeply.",
            order=175,
            stage="rows",
            find=Target("mbdkit_contact.deep_overlaps:watch_deep_overlaps"),
            elements="contacts",
        ),
        CriterionItem(
            name="long-steps-at-contacts",
            summary="Fixed steps so long that bodies may pass through each other.",
            order=176,
            stage="rows",
            find=Target("mbdkit_contact.deep_overlaps:watch_long_steps"),
            elements="contacts",
        ),
        CriterionItem(
            name="rigid-overlaps",
            summary="Rigid bodies that overlap.",
            order=177,
            stage="rows",
            find=Target("mbdkit_contact.deep_overlaps:watch_rigid_overlaps"),
            level="bad",
            elements="contacts",
        ),
        Treatment(
            name="compliant",
            summary="Forces by the overlap of the shapes.",
            order=0,
            of="contacts",
            method=Target("mbdkit_contact.compliant_methods:compliant"),
        ),
        Treatment(
            name="event-driven",
            summary="Rigid bodies; impacts and changes between sticking, slipping and separation are located.",
            order=10,
            of="contacts",
            reacting=True,
            require=Target("mbdkit_contact.treatments:require_event_driven"),
            begin=Target("mbdkit_contact.event_driven:with_contact_forces"),
            method=Target("mbdkit_contact.treatments:event_driven"),
            guards=Target("mbdkit_contact.treatments:guards"),
            guarded_by="event-driven",
            undecided=undecided,
            supports=supports,
        ),
        Treatment(
            name="time-stepping",
            summary="Rigid bodies, whose velocities may jump in every step.",
            order=20,
            of="contacts",
            reacting=True,
            require=Target("mbdkit_contact.treatments:require_time_stepping"),
            begin=Target("mbdkit_contact.event_driven:with_contact_forces"),
            guards=Target("mbdkit_contact.treatments:guards"),
            guarded_by="event-driven",
            # errors are bounded by a constant times the step, but do not decrease steadily with the step, because
            # impacts fall between the ends of steps
            factors=(4, 16),
            includes_impacts=True,
            undecided=undecided,
            supports=supports,
        ),
        *Example.folder(_HERE / "examples", "Contacts"),
        *GuidePage.folder(_HERE / "guide", "Model"),
    ]
