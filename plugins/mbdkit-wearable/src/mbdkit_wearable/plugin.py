"""What this part adds to mbdkit: cuffs, what runs record of them, examples, and a page of the guide."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import (
    Accessor,
    ElementForces,
    ElementKind,
    Example,
    GuidePage,
    Item,
    ModelKey,
    QuantityKind,
    Target,
    hookimpl,
)

_HERE = Path(__file__).parent


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
            acts=ElementForces(
                forces=Target("mbdkit_wearable.acting_cuffs:forces_of"),
                lower=Target("mbdkit_wearable.acting_cuffs:lower"),
            ),
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
        QuantityKind(
            name="cuffs",
            summary="Displacements, forces and power of cuffs.",
            order=240,
            target=Target("mbdkit_wearable.quantities:CUFFS"),
            word="cuffs",
            peaks=("normal_force", "shear_force"),
        ),
        *Example.folder(_HERE / "examples"),
        *GuidePage.folder(_HERE / "guide"),
    ]
