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

# fmt: off
COMMANDS = (
    Command(name="run", summary="Run a spec and write its archive.", target=Target("mbdkit.cli.runs:run"), order=10),
    Command(
        name="info", summary="Describe run archives.", target=Target("mbdkit.cli.archives:archive_info"),
        group="archive", order=10,
    ),
    Command(
        name="validate", summary="Check a spec of any kind without running it.",
        target=Target("mbdkit.cli.runs:validate"), order=20,
    ),
    Command(
        name="check", summary="Check the structure and contents of run archives.",
        target=Target("mbdkit.cli.archives:archive_check"), group="archive", order=20,
    ),
    Command(
        name="diff", summary="Compare the data of two run archives.", target=Target("mbdkit.cli.archives:archive_diff"),
        group="archive", order=30,
    ),
    Command(
        name="rerun", summary="Run the spec of an archive again and compare the results.",
        target=Target("mbdkit.cli.runs:rerun"), order=130,
    ),
    Command(
        name="guide", summary="List the pages of the guide, print one, or search them.",
        target=Target("mbdkit.cli.specs:guide"), order=140,
    ),
    Command(
        name="examples", summary="List the packaged examples, or copy one.",
        target=Target("mbdkit.cli.specs:examples_app"), order=190,
    ),
    Command(name="schema", summary="Print the JSON schema of a spec, for editors.", order=170),
    Command(name="archive", summary="Describe, check, compare and export run archives.", order=200),
)
# fmt: on


@hookimpl
def mbdkit_items() -> list[Item]:
    """Return the models, methods, laws, commands, controllers of steps and features that mbdkit ships."""
    return [*MODELS, *INTEGRATORS, *LAWS, *COMMANDS, *STEP_CONTROLS, *builtin_features()]
