"""The commands of the command line, which plugins register like models or integrators."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import MbdkitError, SpecError, blaming
from mbdkit.base.terminal import Commands, guard, show_json
from mbdkit.cli.common_options import CONTEXT, PLAIN, Debug
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.feature_items import SpecKind
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.manager import built_in, installed, use

#: Commands by the names that other programs use for them.
OTHER_NAMES = {
    "compare": "archive diff", "diff": "archive diff", "info": "archive info", "summary": "archive info",
    "export": "archive export", "check": "archive check", "resume": "run --resume", "continue": "run --resume",
}  # fmt: skip


class RegisteredCommands(TyperGroup):
    """A group of commands from the registry; the module of a command is imported when the command is called."""

    group = ""  #: Name of the group; empty for ``mbdkit`` itself.

    def __init__(self, **attributes: Any):
        super().__init__(**attributes)
        self.imported: dict[str, Any] = {}

    def list_commands(self, ctx: object) -> list[str]:
        """Return the names of the commands; where distributions clash, ``distribution:name``."""
        return list(self._listed())

    def get_command(self, ctx: object, cmd_name: str) -> Any:
        """Import and return a command; raise SpecError if several distributions use the name."""
        if cmd_name in self.imported:
            return self.imported[cmd_name]
        # commands of mbdkit cannot be replaced, so other plugins are imported for other names only
        item = self._listed(built_in()).get(cmd_name)
        items = {} if item else self._listed()
        item = item or items.get(cmd_name)
        if item is None:
            # typer suggests the keys of `commands`; commands of this name under `distribution:name` clash
            self.commands = _stubs(items)
            for clashing in (item for item in items.values() if item.plugin.name == cmd_name):
                installed().get(clashing.kind, clashing.name)
            if cmd_name in OTHER_NAMES and not self.group:
                raise SpecError(f"there is no command '{cmd_name}'; see `mbdkit {OTHER_NAMES[cmd_name]}`")
            return None
        command = _imported(item)
        guard(command, ("mbdkit", *self.group.split(), cmd_name))
        self.imported[cmd_name] = command
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write names and summaries of the commands, of which none is imported."""
        TyperGroup(commands=_stubs(self._listed())).format_commands(ctx, formatter)

    def _listed(self, registry: Registry | None = None) -> dict[str, Registered]:
        registry, listed = registry or installed(), {}
        for item in (*registry.of_kind(Command.kind), *registry.of_kind(SpecKind.kind)):
            if _group(item.plugin) == self.group:
                is_short = item.name in registry.accepted(item)
                listed[item.plugin.name if is_short else f"{item.origin.distribution}:{item.plugin.name}"] = item
        return listed


class MainCommands(RegisteredCommands, Commands):
    """The commands of ``mbdkit`` itself."""


def _group(item: Item) -> str | None:
    """Return the group of a command; kinds of specs are commands of the group ``schema``."""
    if isinstance(item, SpecKind):
        return "schema" if item.schema or item.model else None
    return item.group if isinstance(item, Command) else None


def _summary(item: Item) -> str:
    return f"Print the JSON schema of {item.phrase}." if isinstance(item, SpecKind) else item.summary


def _stubs(items: Mapping[str, Registered]) -> dict[str, Any]:
    return {name: TyperCommand(name, help=_summary(item.plugin)) for name, item in items.items()}


def _imported(item: Registered) -> Any:
    """Return the command of an item, or the group of its commands."""
    if isinstance(item.plugin, SpecKind):
        return _schema_command(item, item.plugin)
    command: Command = cast(Any, item.plugin)
    if command.target is None:
        group = RegisteredCommands(
            name=command.name,
            help=command.summary,
            no_args_is_help=True,
            context_settings=CONTEXT,
            rich_markup_mode=None,
        )
        group.group = command.name
        return group
    target = command.target()
    if not isinstance(target, typer.Typer):
        target = _app(command.name, _blamed(item, cast("Callable[..., None]", target)))
    return typer.main.get_command(target)


def _blamed(item: Registered, function: Callable[..., None]) -> Callable[..., None]:
    """Return the function of a command; if it raises an error, the plugin is blamed and not mbdkit."""
    if item.origin.distribution == MBDKIT:
        return function

    @functools.wraps(function)
    def call(*arguments: object, **options: object) -> None:
        with blaming(f"the command '{item.id}' failed", MbdkitError, typer.Exit, typer.Abort, typer.BadParameter):
            function(*arguments, **options)

    return call


def _schema_command(item: Registered, kind: SpecKind) -> Any:
    def schema(debug: Debug = False) -> None:
        from mbdkit.spec.schema import schema_of

        show_json(use(item, lambda: schema_of(kind)), indent=2)

    schema.__doc__ = f"{_summary(kind)}\n\nIt contains the options of everything that is installed."
    return typer.main.get_command(_app(kind.name, schema))


def _app(name: str, function: Callable[..., None]) -> typer.Typer:
    app = typer.Typer(add_completion=False, **PLAIN)
    app.command(name)(function)
    return app
