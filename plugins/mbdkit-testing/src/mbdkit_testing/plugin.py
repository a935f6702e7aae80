"""What this part adds to mbdkit: a self-test, and commands that describe, find, verify and create plugins."""

from __future__ import annotations

from collections.abc import Iterable

from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the commands that check an installation, and list, show, find, verify and create plugins."""
    # fmt: off
    return [
        Command(
            name="list", summary="List installed plugins, and those that could not be loaded.",
            target=Target("mbdkit_testing.commands:plugins_list"), group="plugins", order=10,
        ),
        Command(name="plugins", summary="List, verify and diagnose plugins; `new` creates one.", order=180),
        Command(
            name="show", summary="Show the options, claims and references of a plugin.",
            target=Target("mbdkit_testing.commands:plugins_show"), group="plugins", order=20,
        ),
        Command(
            name="where", summary="Print the file and line of the code that a name adds.",
            target=Target("mbdkit_testing.item_places:plugins_where"), group="plugins", order=25,
        ),
        Command(
            name="verify", summary="Verify the claims of a plugin by the checks of mbdkit.testing.",
            target=Target("mbdkit_testing.commands:plugins_verify"), group="plugins", order=30,
        ),
        Command(
            name="matrix", summary="Draw what was observed of all plugins, side by side.",
            target=Target("mbdkit_testing.commands:plugins_matrix"), group="plugins", order=35,
        ),
        Command(
            name="doctor", summary="Show the plugins, the machine code in use, and any problems.",
            target=Target("mbdkit_testing.commands:plugins_doctor"), group="plugins", order=40,
        ),
        Command(
            name="new", summary="Create the project of a new plugin in ./NAME.",
            target=Target("mbdkit_testing.commands:plugins_new"), group="plugins", order=50,
        ),
        Command(
            name="doctor", summary="Check this installation: plugins, machine code, small runs.",
            target=Target("mbdkit_testing.commands:doctor"), order=175,
        ),
    ]
    # fmt: on
