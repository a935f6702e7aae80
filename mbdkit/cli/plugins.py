"""Commands on plugins: `plugins`."""

from __future__ import annotations

from typing import Annotated

import typer

from mbdkit.base import terminal
from mbdkit.base.terminal import show, show_json
from mbdkit.cli.common_options import AsJson, Debug


def plugins_list(as_json: AsJson = False, debug: Debug = False) -> None:
    """List installed plugins, and those that could not be loaded."""
    from mbdkit.registry import describe
    from mbdkit.registry.manager import load_installed

    installed = load_installed()
    if as_json:
        show_json(describe.listing(installed))
    else:
        show(describe.listing_text(installed))


def plugins_show(
    name: Annotated[str, typer.Argument(metavar="ID", help="A name such as gauss, or an id such as mbdkit:gauss.")],
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Show the options, claims and references of a plugin.

    With --json, prints one object with a list "plugins": a model and an
    integrator may share a name.
    """
    from mbdkit.registry import describe

    items = describe.find(name)
    if as_json:
        show_json({"plugins": [describe.details(item) for item in items]})
    else:
        show("\n\n".join(describe.page(item) for item in items))


def plugins_doctor(as_json: AsJson = False, debug: Debug = False) -> None:
    """Show the plugins, the machine code in use, and any problems.

    Exit status 4 if a plugin could not be loaded.
    """
    from mbdkit.engine.native.machine_code import code_report, code_text
    from mbdkit.registry import describe
    from mbdkit.registry.manager import checked, load_installed

    installed = checked(load_installed())
    if as_json:
        show_json({**describe.diagnosis(installed), "machine_code": code_report()})
    else:
        show(f"{describe.diagnosis_text(installed)}\n{code_text()}")
    if not describe.is_sound(installed):
        raise typer.Exit(terminal.PLUGIN_FAILED)
