"""What this part adds to mbdkit: a self-test, and commands that describe, find, verify and create plugins."""

from __future__ import annotations

from collections.abc import Iterable

from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target


def _of_plugins(name: str, summary: str, order: int, module: str = "commands") -> Command:
    """Return a command of the group `plugins`."""
    target = Target(f"mbdkit_testing.{module}:plugins_{name}")
    return Command(name=name, summary=summary, target=target, group="plugins", order=order)


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the commands that check an installation, and list, show, find, verify and create plugins."""
    doctor = Target("mbdkit_testing.commands:doctor")
    summary = "Check this installation: plugins, machine code, small runs."
    return [
        _of_plugins("list", "List installed plugins, and those that could not be loaded.", 10),
        Command(name="plugins", summary="List, verify and diagnose plugins; `new` creates one.", order=180),
        _of_plugins("show", "Show the options, claims and references of a plugin.", 20),
        _of_plugins("where", "Print the file and line of the code that a name adds.", 25, module="item_places"),
        _of_plugins("verify", "Verify the claims of a plugin by the checks of mbdkit.testing.", 30),
        _of_plugins("matrix", "Draw what was observed of all plugins, side by side.", 35),
        _of_plugins("doctor", "Show the plugins, the machine code in use, and any problems.", 40),
        _of_plugins("new", "Create the project of a new plugin in ./NAME.", 50),
        Command(name="doctor", summary=summary, target=doctor, order=175),
    ]
