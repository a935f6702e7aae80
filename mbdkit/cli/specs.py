"""Commands for writing specs: `schema` and `examples`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbdkit.cli.common_options import PLAIN, Debug
from mbdkit.terminal import show, show_json
from mbdkit.text import table

schema_app = typer.Typer(help="Print the JSON schema of a spec, for editors.", **PLAIN)
examples_app = typer.Typer(help="List the packaged examples, or copy one.", **{**PLAIN, "no_args_is_help": False})


@schema_app.command("run")
def schema_run(debug: Debug = False) -> None:
    """Print the JSON schema of a run spec.

    It contains the options of all installed models, integrators and force laws.
    """
    from mbdkit.spec.schema import run_schema

    show_json(run_schema(), indent=2)


@schema_app.command("study")
def schema_study(debug: Debug = False) -> None:
    """Print the JSON schema of a study spec.

    It contains the options of all installed models and integrators.
    """
    from mbdkit.spec.schema import study_schema

    show_json(study_schema(), indent=2)


@examples_app.callback(invoke_without_command=True)
def examples(context: typer.Context, debug: Debug = False) -> None:
    """List the packaged examples.

    Run one by its name, or copy its spec to edit it.
    """
    if context.invoked_subcommand is not None:
        return
    from mbdkit.spec.loading import example_names, read_source  # without validation, which would import plugins

    show(table([("NAME", "TITLE"), *((name, read_source(name).data["title"]) for name in example_names())]))


@examples_app.command("copy")
def examples_copy(
    name: Annotated[str, typer.Argument(metavar="NAME", help="An example, as listed.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE.yaml", help="The file; by default ./NAME.yaml.")
    ] = None,
    debug: Debug = False,
) -> None:
    """Copy the spec of an example to a file, with its comments.

    An existing file is not replaced.
    """
    from mbdkit.errors import SpecError
    from mbdkit.files import replacing
    from mbdkit.spec import example_text

    text = example_text(name)
    path = output if output is not None else Path(f"{name}.yaml")
    if path.is_file():  # there is no --overwrite here, which the message of `replacing` names
        raise SpecError("this file exists already; choose another name with -o", file=path)
    with replacing(path, overwrite=False) as temporary:
        temporary.write_text(text, encoding="utf-8")
    show(path)
