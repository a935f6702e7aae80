"""What this part adds to mbdkit: joints that are functions of the relative pose, examples, and a page of the guide."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import CriterionItem, Example, GuidePage, Item, JointKind, SummaryLine, Target, hookimpl

_HERE = Path(__file__).parent


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the types of joints, the examples, and the page of the guide."""
    return [
        JointKind(
            name="gear",
            summary="two gears whose pitch circles roll on each other",
            order=100,
            model=Target("mbdkit_transmissions.gears:Gear"),
            check_elements=Target("mbdkit_transmissions.trains:check_trains"),
            example="planetary-gear",
        ),
        JointKind(
            name="rack",
            summary="a gear that rolls on a rack",
            order=110,
            model=Target("mbdkit_transmissions.gears:Rack"),
            example="rack-railway",
        ),
        JointKind(
            name="rolling",
            summary="a wheel that rolls without slip on a line or a circle",
            order=120,
            model=Target("mbdkit_transmissions.gears:Rolling"),
            example="rack-railway",
        ),
        JointKind(
            name="belt",
            summary="a belt over two pulleys",
            order=130,
            model=Target("mbdkit_transmissions.gears:Belt"),
            check_elements=Target("mbdkit_transmissions.trains:check_trains"),
            example="rack-railway",
        ),
        JointKind(
            name="cam",
            summary="a cam and a follower",
            order=140,
            model=Target("mbdkit_transmissions.cams:Cam"),
            example="cam-follower",
        ),
        JointKind(
            name="slot",
            summary="a point that slides along a curve",
            order=150,
            model=Target("mbdkit_transmissions.cams:Slot"),
            example="knee-slot",
        ),
        JointKind(
            name="coupling",
            summary="an equation between the relative coordinates of two bodies",
            order=160,
            model=Target("mbdkit_transmissions.coupling:Coupling"),
            example="knee-slot",
        ),
        CriterionItem(
            name="locked-joints",
            summary="Gears, couplings and other joints of transmissions that hold each other still.",
            order=175,
            stage="rows",
            find=Target("mbdkit_transmissions.trains:watch_still_joints"),
            elements="joints",
            types=frozenset({"gear", "rack", "rolling", "belt", "cam", "slot", "coupling"}),
        ),
        CriterionItem(
            name="pulled-joints",
            summary="Cams and rolling wheels whose reaction pulls, so that they would lift off.",
            order=180,
            stage="rows",
            find=Target("mbdkit_transmissions.unilateral:watch_reactions"),
            of=frozenset({"run"}),
            criteria=("lift-off", "rolling-friction"),
            elements="joints",
            types=frozenset({"cam", "rolling"}),
        ),
        CriterionItem(
            name="meshing",
            summary="Gears, racks and belts whose axes do not keep their distance, and pins that leave their slot.",
            order=185,
            stage="rows",
            find=Target("mbdkit_transmissions.meshing:watch_meshing"),
            elements="joints",
            types=frozenset({"gear", "rack", "belt", "slot"}),
        ),
        SummaryLine(
            name="rolling",
            summary="Friction that rolling wheels need.",
            order=1030,
            text=Target("mbdkit_transmissions.rolling_summary:needed_friction"),
        ),
        *Example.folder(_HERE / "examples", "Gears, cams and slots"),
        *GuidePage.folder(_HERE / "guide", "Model"),
    ]
