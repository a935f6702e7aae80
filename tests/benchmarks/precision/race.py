"""Errors, then times in turns, then tables; a picture and everything measured go to a folder if one is given."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from mbdkit.base.files import replacing

from .collocation import collocation
from .compiled import compiled
from .contender import Contender
from .interpreted import interpreted
from .measure import Curve, climb, take_times
from .motions import MOTIONS, Motion
from .ours import ours
from .tables import as_mapping, machine, show
from .taylor import SECONDS, taylor

PICTURE, NUMBERS = "work-precision.png", "work-precision.json"


def contenders(motion: Motion) -> tuple[list[Contender], list[str]]:
    """Return all contenders that are installed, and the names of the others."""
    found: list[Contender] = []
    missing: list[str] = []
    for room in (ours, compiled, taylor, collocation, interpreted):
        some, absent = room(motion)
        found += some
        missing += absent
    return found, missing


def series(console: Console) -> None:
    """Print the times of Taylor series alone, and of DOP853 for comparison: a few minutes instead of an hour."""
    precision(console, only=("Taylor", "taylor", "dop853, joints", "DOP853"))


def precision(
    console: Console,
    output: Path | None = None,
    motions: Sequence[Motion] = MOTIONS,
    only: Sequence[str] = (),
) -> None:
    """Print for each motion the time that every contender takes for an error.

    Parameters
    ----------
    console
        Where to.
    output
        Folder for the picture and the numbers, if any.
    motions
        Which of them.
    only
        Beginnings of the names of methods to compare; all by default.
    """
    before = machine()
    console.print(f"{before['processors']} processors, load {before['load']}; {before['versions']}")
    found: dict[Motion, list[Curve]] = {}
    missing: dict[Motion, list[str]] = {}
    for motion in motions:
        some, missing[motion] = contenders(motion)
        some = [one for one in some if not only or one.method.startswith(tuple(only))]
        found[motion] = []
        for contender in some:
            console.print(f"{motion.name}: errors of {contender.name}", style="dim")
            found[motion].append(climb(contender, motion))
    for motion, curves in found.items():
        take_times(curves, lambda text, name=motion.name: console.print(f"{name}: {text}", style="dim"))
        show(console, motion, curves, missing[motion])
    if SECONDS:
        console.print(
            f"heyoka compiled its integrators in {min(SECONDS):.2g} to {max(SECONDS):.2g} s each, which is not counted"
        )
    after = machine()
    console.print(f"load afterwards {after['load']}")
    if output is not None:
        from .picture import draw

        mapping = {
            "before": before,
            "after": after,
            "motions": {motion.name: as_mapping(motion, curves, missing[motion]) for motion, curves in found.items()},
        }
        with replacing(output / NUMBERS) as temporary:
            temporary.write_text(json.dumps(mapping, indent=1))
        draw(found, output / PICTURE)
        console.print(f"{PICTURE} and {NUMBERS} are in {output}")
