"""Arguments and options that several commands share, groups of options, and default names of output files."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from mbdkit.base import terminal

CONTEXT = {"help_option_names": ["-h", "--help"]}
PLAIN: dict[str, Any] = {"context_settings": CONTEXT, "rich_markup_mode": None, "no_args_is_help": True}


def _set_debug(context: typer.Context, value: bool) -> bool:
    if value:
        context.meta[terminal.DEBUG] = True
    return value


_RUN_SPEC: Any = typer.Argument(
    metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged example such as knee."
)
SpecName = Annotated[str, _RUN_SPEC]
SpecNameOrNone = Annotated[str | None, _RUN_SPEC]
AnySpecName = Annotated[
    str,
    typer.Argument(
        metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged example or study, such as knee."
    ),
]
Archive = Annotated[Path, typer.Argument(metavar="FILE.h5", help="A run archive.")]
Archives = Annotated[list[Path], typer.Argument(metavar="FILE.h5", help="Run archives.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a key of the spec, such as time.step=0.005; may be repeated."),
]
MotionSet = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set a key of the spec, such as motion.smooth.cutoff=6; may be repeated."
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing file when the new one is complete.")]
Files = Annotated[
    bool,
    typer.Option("--files", help="Read the files that the spec in the archive names, if they have the same SHA-256."),
]
Call = Annotated[bool, typer.Option("--call", help="Call the Python functions that controllers of the spec name.")]
Debug = Annotated[bool, typer.Option("--debug", callback=_set_debug, help="Show the traceback of an error.")]


@dataclass
class Printing:
    """Options on what a command prints."""

    as_json: AsJson = False
    quiet: Quiet = False
    debug: Debug = False


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command for which each field of a dataclass parameter is a separate option."""
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, Any] = {
        name: parameter.annotation
        for name, parameter in signature.parameters.items()
        if is_dataclass(parameter.annotation)
    }
    parameters: list[inspect.Parameter] = []
    for name, one in signature.parameters.items():
        if name in groups:
            hints = get_type_hints(groups[name], include_extras=True)
            parameters += [
                inspect.Parameter(field.name, one.kind, default=field.default, annotation=hints[field.name])
                for field in fields(groups[name])
            ]
        else:
            parameters.append(one)

    @wraps(command)
    def called(**given: object) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        command(**given)

    called.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return called


def output_to(metavar: str, text: str) -> Any:
    """Return the option for the file or folder that a command writes."""
    return typer.Option("-o", "--output", metavar=metavar, help=text)


def stem(spec: str) -> str:
    """Return the default name, without suffix, of files with results of a spec."""
    return "stdin" if spec == "-" else Path(spec).stem


def check_new(path: Path, source: str, overwrite: bool) -> None:
    """Raise SpecError if an archive cannot be written."""
    from mbdkit.archive.part_file import check_target

    check_target(path, overwrite=overwrite, source=source)
