"""What this part adds to mbdkit: cuffs, what runs record of them, examples, and a page of the guide."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit import StudyPlugin
from mbdkit.plugin import (
    Accessor,
    CriterionItem,
    ElementForces,
    ElementKind,
    Example,
    GuidePage,
    HeadlineItem,
    Item,
    ModelKey,
    ModelPlugin,
    QuantityKind,
    SummaryLine,
    Target,
    hookimpl,
)

_HERE = Path(__file__).parent

#: Devices for legs: name, class of the options, function that builds it, references, and summary.
_MODELS = (
    (
        "hinge-orthosis",
        "OrthosisOptions",
        "hinge",
        "REFERENCES",
        "An orthosis of the knee with one hinge, a spring and a motor.",
    ),
    (
        "four-bar-orthosis",
        "FourBarOrthosisOptions",
        "four_bar",
        "FOUR_BAR",
        "An orthosis of the knee with a crossed four-bar linkage.",
    ),
    (
        "geared-orthosis",
        "GearedOrthosisOptions",
        "geared",
        "REFERENCES",
        "An orthosis of the knee with two pivots and toothed sectors.",
    ),
    (
        "self-aligning-orthosis",
        "SelfAligningOrthosisOptions",
        "self_aligning",
        "SELF_ALIGNING",
        "An orthosis of the knee whose hinge moves on two passive slides.",
    ),
    (
        "hip-knee-exoskeleton",
        "ExoskeletonOptions",
        "hip_knee",
        "REFERENCES",
        "An exoskeleton with springs and motors at hip and knee.",
    ),
    ("passive-strut", "StrutOptions", "strut", "REFERENCES", "A spring behind the knee between two shells."),
)


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Return devices for legs."""
    models = []
    for order, (name, *names, summary) in enumerate(_MODELS, 80):
        options, build, references = (Target(f"mbdkit_wearable.orthoses:{own}") for own in names)
        models.append(ModelPlugin(name, summary, options, build, references, order=order))
    return models


@hookimpl
def mbdkit_studies() -> list[StudyPlugin]:
    """Return the study of misfit."""
    summary = "Force that a misplaced orthosis adds to the knee, shear of its cuffs and help lost, for three devices."
    spec = Target("mbdkit_wearable.misfit.study:study")
    return [StudyPlugin("misfit", summary, spec, Target("mbdkit_wearable.misfit.verdict:verdict"))]


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the kind of elements, its group of the archive, the examples, and the page of the guide."""
    return [
        ElementKind(
            name="cuff",
            summary="Cuffs by name: soft attachments of links of devices to limbs.",
            order=150,
            key_in_model="cuffs",
            builder="cuff",
            model=Target("mbdkit_wearable.cuff:Cuff"),
            in_expressions={
                "normal_force": "normal.tension",
                "shear_force": "tangential.tension",
                "moment": "rotation.tension",
                "tangential_rate": "tangential.rate",
            },
            acts=ElementForces(
                forces=Target("mbdkit_wearable.acting_cuffs:forces_of"),
                lower=Target("mbdkit_wearable.acting_cuffs:lower"),
                lower_expressions=Target("mbdkit_wearable.acting_cuffs:lower_slip"),
            ),
            at_start=Target("mbdkit_wearable.acting_cuffs:skin_at_start"),
            draw=Target("mbdkit_wearable.acting_cuffs:cuff_lines"),
            example="knee-orthosis",
        ),
        ModelKey(
            name="devices",
            summary="Devices that the person wears, by name.",
            model=Target("mbdkit_wearable.device:Device"),
            extend=Target("mbdkit_wearable.device:add_devices"),
            read_files=Target("mbdkit_wearable.device:read_devices"),
            follow=Target("mbdkit_wearable.worn.worn_device:worn_device"),
        ),
        Accessor(
            name="wear",
            summary="Method that adds a device to the mechanism of a person.",
            of="Mechanism",
            target=Target("mbdkit_wearable.device:wear_method"),
        ),
        Accessor(
            name="added_force",
            summary="Force in a joint with and without devices that follow a measured motion.",
            of="Run",
            target=Target("mbdkit_wearable.worn.added_force:added_force_of"),
        ),
        HeadlineItem(
            name="devices",
            summary="What devices change in the joint that they load most.",
            order=5,
            take=Target("mbdkit_wearable.worn.added_force:device_headlines"),
            group="followers",
        ),
        SummaryLine(
            name="devices",
            summary="What devices add to the forces of joints.",
            order=1050,
            text=Target("mbdkit_wearable.worn.added_force:device_lines"),
            group="followers",
        ),
        QuantityKind(
            name="cuffs",
            summary="Displacements, forces and power of cuffs.",
            order=240,
            target=Target("mbdkit_wearable.quantities:CUFFS"),
            word="cuffs",
            peaks=("normal_force", "shear_force"),
            history=Target("mbdkit_wearable.histories:CuffHistory"),
        ),
        SummaryLine(
            name="cuffs",
            summary="Largest forces of cuffs.",
            order=1040,
            text=Target("mbdkit_wearable.cuff_criteria:cuff_lines"),
            group="cuffs",
        ),
        CriterionItem(
            name="cuffs",
            summary="Forces of cuffs beyond what persons accept, and cuffs that slide on the skin.",
            order=190,
            stage="rows",
            find=Target("mbdkit_wearable.cuff_criteria:watch_cuffs"),
            criteria=("cuff-loads", "cuff-slip"),
            elements="cuffs",
        ),
        *Example.folder(_HERE / "examples", "People and their devices"),
        *GuidePage.folder(_HERE / "guide", "Persons"),
    ]
