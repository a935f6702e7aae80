"""What this part adds to mbdkit: inverse dynamics of measured motion, workload, and models of knees and legs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.element_items import ElementFailures, ElementForces, ElementKind, QuantityKind
from mbdkit.registry.feature_items import (
    Accessor,
    CriterionItem,
    Example,
    GuidePage,
    HeadlineItem,
    ReportSection,
    SpecKind,
    SummaryLine,
    ViewItem,
)
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command, ModelPlugin
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent

#: Commands: name, order and summary.
_COMMANDS = (
    ("inverse", 30, "Compute joint and actuator forces from a measured motion."),
    ("workload", 40, "Print the workload of joints: peaks, impulses and work."),
)

#: Groups of the archive with a history of each element: name, order, class of the histories, and summary.
_GROUPS = (
    ("motion", 200, "ObservedHistory", "Observed quantities of a measured motion."),
    ("actuators", 210, "ActuatorHistory", "Values and powers of actuators in inverse dynamics."),
    ("muscles", 220, "MuscleHistory", "Lengths, activations, tensions and powers of muscles."),
    ("knees", 225, "KneeHistory", "Forces of patella and compartments in knees."),
    ("loads", 230, "LoadHistory", "Measured loads."),
)


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Return models of knees and legs."""
    return [
        ModelPlugin(
            "four-bar-knee",
            "A lower leg on a crossed four-bar linkage at a fixed thigh, with springs and dampers.",
            Target("mbdkit_biomech.models.four_bar_knee:FourBarKneeOptions"),
            Target("mbdkit_biomech.models.four_bar_knee:build"),
            Target("mbdkit_biomech.models.four_bar_knee:REFERENCES"),
            order=50,
        ),
        ModelPlugin(
            "leg",
            "One or two legs of thigh, shank and foot, scaled by body mass and height, on a fixed hip or on a free "
            "trunk.",
            Target("mbdkit_biomech.models.leg:LegOptions"),
            Target("mbdkit_biomech.models.leg:build"),
            Target("mbdkit_biomech.models.leg:REFERENCES"),
            order=60,
        ),
        ModelPlugin(
            "leg-four-bar",
            "The same leg with a knee that is a crossed four-bar linkage.",
            Target("mbdkit_biomech.models.leg:LegFourBarOptions"),
            Target("mbdkit_biomech.models.leg:build_four_bar"),
            Target("mbdkit_biomech.models.leg:FOUR_BAR_REFERENCES"),
            order=70,
        ),
    ]


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the kind of specs of inverse dynamics, commands, examples, and what summaries and reports say of it."""
    return [
        SpecKind(
            name="inverse",
            summary="Inverse dynamics: forces from a measured motion.",
            order=200,
            phrase="a spec of inverse dynamics",
            marker="motion",
            command="mbdkit inverse",
            given_instead="this is a spec of inverse dynamics, with a measured motion: compute it with "
            "`mbdkit inverse`",
            run_instead="this is a run spec: run it with `mbdkit run`; a spec of inverse dynamics has a section "
            "`motion`, and neither `integrator` nor a step",
            heading="Inverse dynamics",
            load=Target("mbdkit_biomech.inverse_dynamics.spec.inverse_spec:load_inverse_spec"),
            validate=Target("mbdkit_biomech.commands:validate_inverse"),
            schema=Target("mbdkit_biomech.inverse_dynamics.spec.inverse_spec:inverse_schema"),
            run_kind="inverse",
            model=Target("mbdkit_biomech.inverse_dynamics.spec.inverse_spec:InverseSpec"),
            compute=Target("mbdkit_biomech.inverse_dynamics.results.inverse_run:compute_run"),
            differentiate=Target("mbdkit_biomech.inverse_dynamics.gradient.inverse_gradient:gradient_of_inverse"),
            errors=Target("mbdkit_biomech.inverse_dynamics.results.frame_errors:FrameErrors"),
            is_integrated=False,
            repeat=Target("mbdkit_biomech.commands:repeated_inverse"),
        ),
        ElementKind(
            name="muscle",
            summary="Muscles by name. In runs they exert forces; in inverse dynamics with `recruitment`, they share "
            "the moments of the actuators.",
            order=100,
            key_in_model="muscles",
            model=Target("mbdkit_biomech.muscles.muscle:Muscle"),
            builder="muscle",
            method=Target("mbdkit_biomech.muscles.muscle:add_muscle"),
            in_expressions={"length": "length", "rate": "rate", "force": "tension"},
            check_elements=Target("mbdkit_biomech.muscles.muscle:check_moving_points"),
            acts=ElementForces(
                only_in_runs=True,
                check_run=Target("mbdkit_biomech.muscles.acting_muscles:check_acting"),
                forces=Target("mbdkit_biomech.muscles.acting_muscles:forces_of"),
                lower=Target("mbdkit_biomech.muscles.acting_muscles:lower"),
                lower_expressions=Target("mbdkit_biomech.muscles.acting_muscles:lower_excitations"),
            ),
            at_start=Target("mbdkit_biomech.muscles.acting_muscles:fibers_at_start"),
            failures=ElementFailures(
                obstacle=Target("mbdkit_biomech.muscles.acting_muscles:torn_path"),
                stiffest=Target("mbdkit_biomech.muscles.acting_muscles:stiffest"),
            ),
            draw=Target("mbdkit_biomech.muscles.muscle_path:muscle_lines"),
            example="elbow-curl",
            supports={
                "gradients": "gradients of runs do not include muscles; leave them out",
                "statics": "an analysis of a mechanism at rest does not include muscles; leave them out",
            },
        ),
        *(
            Command(name=name, summary=summary, order=order, target=Target(f"mbdkit_biomech.commands:{name}"))
            for name, order, summary in _COMMANDS
        ),
        Accessor(
            name="raw_misalignment",
            summary="Misalignment of each joint if bodies are placed by the measured data alone.",
            of="Run",
            target=Target("mbdkit_biomech.inverse_dynamics.results.frame_errors:raw_misalignment"),
        ),
        Accessor(
            name="moment_arms",
            summary="Moment arms of a muscle.",
            of="Run",
            target=Target("mbdkit_biomech.inverse_dynamics.motion.moment_arms:arms_of"),
        ),
        Accessor(
            name="contributions",
            summary="What contributes to the error bar of the force of a joint.",
            of="Run",
            target=Target("mbdkit_biomech.uncertainty.contributions:contributions_of"),
        ),
        SummaryLine(
            name="inverse",
            summary="Fit, gaps, actuators, residuals, reserves, and sources of the error bars of joint forces.",
            text=Target("mbdkit_biomech.inverse_dynamics.results.inverse_summary:inverse_lines"),
            of=frozenset({"inverse"}),
        ),
        SummaryLine(
            name="muscles",
            summary="Activations and fibres of muscles, and forces of joints without muscles.",
            order=1000,
            text=Target("mbdkit_biomech.muscles.muscle_summary:muscle_lines"),
            group="muscles",
        ),
        HeadlineItem(
            name="activations",
            summary="Largest activations of muscles.",
            order=10,
            take=Target("mbdkit_biomech.muscles.muscle_summary:activations"),
            group="muscles",
        ),
        HeadlineItem(
            name="actuators",
            summary="Largest values of actuators.",
            order=20,
            take=Target("mbdkit_biomech.inverse_dynamics.results.inverse_summary:largest_actuators"),
            group="actuators",
            excluded=Target("mbdkit_biomech.uncertainty.contributions:excluded_error"),
        ),
        *(
            QuantityKind(
                name=name,
                summary=summary,
                order=order,
                target=Target(f"mbdkit_biomech.quantities:{name.upper()}"),
                word=name,
                history=Target(f"mbdkit_biomech.histories:{history}"),
            )
            for name, order, history, summary in _GROUPS
        ),
        QuantityKind(
            name="followers",
            summary="Joint forces without bodies that follow a measured motion.",
            order=235,
            target=Target("mbdkit_biomech.quantities:FOLLOWERS"),
        ),
        ReportSection(
            name="loads",
            summary="Loads over the motion, workload, disagreement of model and data, and sources of the error bars.",
            order=100,
            make=Target("mbdkit_biomech.inverse_dynamics.results.load_sections:inverse_sections"),
            charts=Target("mbdkit_biomech.inverse_dynamics.results.load_sections:inverse_charts"),
            film=Target("mbdkit_biomech.inverse_dynamics.loads.load_frames:film_with_arrows"),
        ),
        ViewItem(
            name="workload",
            summary="Peaks and impulses of the loads.",
            of="mbdkit_biomech.inverse_dynamics.results.workload:Workload",
            make=Target("mbdkit_biomech.inverse_dynamics.results.load_sections:workload_view"),
        ),
        CriterionItem(
            name="excitations",
            summary="Excitations of muscles below 0 or above 1.",
            order=105,
            stage="spec",
            find=Target("mbdkit_biomech.muscles.acting_muscles:excitations"),
            elements="muscles",
        ),
        CriterionItem(
            name="data",
            summary="Columns, loads, model and record of inverse dynamics, and the person.",
            order=0,
            stage="data",
            find=Target("mbdkit_biomech.inverse_dynamics.criteria.data_verdict:doubts_of_data"),
            of=frozenset({"inverse"}),
            criteria=(
                *("times", "time-unit", "outliers", "constant", "units", "shared-column", "turns", "fit", "noise"),
                *("cutoff", "load-point", "load-sign", "load-direction", "load-offset", "load-time", "residuals"),
                *("residual-size", "knee", "inertia", "elements", "fibers", "reserves", "max-force", "left-out"),
                *("compression", "gaps", "ends", "large-errors", "plane", "centers", "lengths", "plates", "misfit"),
            ),
            level=None,
        ),
        *Example.folder(_HERE / "examples", "People and their devices"),
        *GuidePage.folder(_HERE / "guide", "Persons"),
    ]
