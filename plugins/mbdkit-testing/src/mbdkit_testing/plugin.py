"""What this part adds to mbdkit: a self-test, and commands that describe, find, verify and create plugins."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from mbdkit.plugin import Command, Item, Target, hookimpl


def _plugins(order: int, name: str, summary: str, place: str = "commands") -> Command:
    """Return the command ``mbdkit plugins NAME``."""
    target: Target[Any] = Target(f"mbdkit_testing.{place}:plugins_{name}")
    return Command(name=name, group="plugins", summary=summary, order=order, target=target)


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the commands that check an installation, and list, show, find, verify and create plugins."""
    return [
        Command(
            name="doctor",
            summary="Check this installation: plugins, machine code, small runs.",
            order=175,
            target=Target("mbdkit_testing.commands:doctor"),
        ),
        Command(name="plugins", summary="List, verify and diagnose plugins; `new` creates one.", order=180),
        _plugins(10, "list", "List installed plugins, and those that could not be loaded."),
        _plugins(20, "show", "Show the options, claims and references of a plugin."),
        _plugins(25, "where", "Print the file and line of the code that a name adds.", "item_places"),
        _plugins(30, "verify", "Verify the claims of a plugin by the checks of mbdkit.testing."),
        _plugins(40, "doctor", "Show the plugins, the machine code in use, and any problems."),
        _plugins(50, "new", "Create the project of a new plugin in ./NAME."),
    ]
