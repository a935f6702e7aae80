"""What this part adds to mbdkit: joints that are functions of the relative pose, examples, and a page of the guide."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import CriterionItem, Example, GuidePage, Item, JointKind, SummaryLine, Target, hookimpl

_HERE = Path(__file__).parent

#: Types of joints: name, class of the elements, example, and summary.
_JOINTS = (
    ("gear", "gears:Gear", "planetary-gear", "two gears whose pitch circles roll on each other"),
    ("rack", "gears:Rack", "rack-railway", "a gear that rolls on a rack"),
    ("rolling", "gears:Rolling", "rack-railway", "a wheel that rolls without slip on a line or a circle"),
    ("belt", "gears:Belt", "rack-railway", "a belt over two pulleys"),
    ("cam", "cams:Cam", "cam-follower", "a cam and a follower"),
    ("slot", "cams:Slot", "knee-slot", "a point that slides along a curve"),
    ("coupling", "coupling:Coupling", "knee-slot", "an equation between the relative coordinates of two bodies"),
)
#: Types of joints that may form a train.
_OF_TRAINS = ("gear", "belt")


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the types of joints, the examples, and the page of the guide."""
    return [
        *(
            JointKind(
                name=name,
                summary=summary,
                order=order,
                model=Target(f"mbdkit_transmissions.{model}"),
                check_elements=Target("mbdkit_transmissions.trains:check_trains") if name in _OF_TRAINS else None,
                example=example,
            )
            for order, (name, model, example, summary) in zip(itertools.count(100, 10), _JOINTS, strict=False)
        ),
        CriterionItem(
            name="locked-joints",
            summary="Gears, couplings and other joints of transmissions that hold each other still.",
            order=175,
            stage="rows",
            find=Target("mbdkit_transmissions.trains:watch_still_joints"),
            elements="joints",
            types=frozenset(name for name, *_ in _JOINTS),
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
