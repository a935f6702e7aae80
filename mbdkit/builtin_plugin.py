"""The plugin of mbdkit itself, which registers models, integrators, laws and commands as any plugin does."""

from __future__ import annotations

from mbdkit.builtin_features import builtin_features
from mbdkit.laws import LAWS
from mbdkit.methods import INTEGRATORS, STEP_CONTROLS
from mbdkit.models import MODELS
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target

#: Commands: name, group, order, function and summary.
_COMMANDS = (
    ("run", "", 10, "runs:run", "Run a spec and write its archive."),
    ("info", "archive", 10, "archives:archive_info", "Describe run archives."),
    ("validate", "", 20, "runs:validate", "Check a spec of any kind without running it."),
    ("check", "archive", 20, "archives:archive_check", "Check the structure and contents of run archives."),
    ("diff", "archive", 30, "archives:archive_diff", "Compare the data of two run archives."),
    ("rerun", "", 130, "runs:rerun", "Run the spec of an archive again and compare the results."),
    ("guide", "", 140, "specs:guide", "List the pages of the guide, print one, or search them."),
    ("examples", "", 190, "specs:examples_app", "List the packaged examples, or copy one."),
)
COMMANDS = (
    *(
        Command(name=name, summary=summary, target=Target(f"mbdkit.cli.{function}"), group=group, order=order)
        for name, group, order, function, summary in _COMMANDS
    ),
    Command(name="schema", summary="Print the JSON schema of a spec, for editors.", order=170),
    Command(name="archive", summary="Describe, check, compare and export run archives.", order=200),
)


@hookimpl
def mbdkit_items() -> list[Item]:
    """Return the models, methods, laws, commands, controllers of steps and features that mbdkit ships."""
    return [*MODELS, *INTEGRATORS, *LAWS, *COMMANDS, *STEP_CONTROLS, *builtin_features()]
