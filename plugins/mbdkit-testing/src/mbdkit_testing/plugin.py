"""What this part adds to mbdkit: a self-test, places of code, the conformance kit, and templates of new plugins."""

from __future__ import annotations

from collections.abc import Iterable

from mbdkit.plugin import Command, Item, Target, hookimpl


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the commands that check an installation, and find, verify and create plugins."""
    return [
        Command(
            name="doctor",
            summary="Check this installation: plugins, machine code, small runs.",
            order=175,
            target=Target("mbdkit_testing.commands:doctor"),
        ),
        Command(
            name="where",
            group="plugins",
            summary="Print the file and line of the code that a name adds.",
            order=25,
            target=Target("mbdkit_testing.item_places:plugins_where"),
        ),
        Command(
            name="verify",
            group="plugins",
            summary="Verify the claims of a plugin by the checks of mbdkit.testing.",
            order=30,
            target=Target("mbdkit_testing.commands:plugins_verify"),
        ),
        Command(
            name="new",
            group="plugins",
            summary="Create the project of a new plugin in ./NAME.",
            order=50,
            target=Target("mbdkit_testing.commands:plugins_new"),
        ),
    ]
