"""The plugin of mbdkit itself, which registers models, integrators, laws and commands as any plugin does."""

from __future__ import annotations

from mbdkit.builtin_features import builtin_features
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command, ForceLawPlugin, IntegratorPlugin, ModelPlugin
from mbdkit.registry.target import Target


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Return the models that mbdkit ships."""
    from mbdkit.models import MODELS

    return list(MODELS)


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Return the integrators that mbdkit ships."""
    from mbdkit.methods import INTEGRATORS

    return list(INTEGRATORS)


@hookimpl
def mbdkit_force_laws() -> list[ForceLawPlugin]:
    """Return the force laws that mbdkit ships."""
    from mbdkit.laws import LAWS

    return list(LAWS)


def _command(order: int, words: str, summary: str, function: str) -> Command:
    """Return the command that is called with the words; `function` is ``module:name`` in `mbdkit.cli`."""
    group, _, name = words.rpartition(" ")
    return Command(name=name, summary=summary, target=Target(f"mbdkit.cli.{function}"), group=group, order=order)


COMMANDS = (
    _command(10, "run", "Run a spec and write its archive.", "runs:run"),
    _command(20, "validate", "Check a spec of any kind without running it.", "runs:validate"),
    _command(130, "rerun", "Run the spec of an archive again and compare the results.", "runs:rerun"),
    _command(140, "guide", "List the pages of the guide, print one, or search them.", "specs:guide"),
    Command(name="schema", summary="Print the JSON schema of a spec, for editors.", order=170),
    _command(190, "examples", "List the packaged examples, or copy one.", "specs:examples_app"),
    Command(name="archive", summary="Describe, check, compare and export run archives.", order=200),
    _command(10, "archive info", "Describe run archives.", "archives:archive_info"),
    _command(20, "archive check", "Check the structure and contents of run archives.", "archives:archive_check"),
    _command(30, "archive diff", "Compare the data of two run archives.", "archives:archive_diff"),
)


@hookimpl
def mbdkit_items() -> list[Item]:
    """Return the commands and features that mbdkit ships."""
    return [*COMMANDS, *builtin_features()]
