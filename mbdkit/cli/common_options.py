"""Options that several commands share, groups of options, names of output files, and commands that write a result."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from mbdkit.base import terminal
from mbdkit.base.frozen import dataclass, fields
from mbdkit.cli.completion import EXAMPLES

Spec = TypeVar("Spec")
Command = Callable[..., None]

CONTEXT = {"help_option_names": ["-h", "--help"]}
PLAIN: dict[str, Any] = {"context_settings": CONTEXT, "rich_markup_mode": None, "no_args_is_help": True}


def _set_debug(context: typer.Context, value: bool) -> bool:
    if value:
        context.meta[terminal.DEBUG] = True
    return value


def set_key(example: str) -> Any:
    """Return the option that sets keys of a spec."""
    return typer.Option(
        "--set", metavar="KEY=VALUE", help=f"Set a key of the spec, such as {example}; may be repeated."
    )


def _spec(packaged: str) -> Any:
    return typer.Argument(
        metavar="SPEC", autocompletion=EXAMPLES, help=f"A YAML, TOML or JSON file, - for stdin, or {packaged}."
    )


_RUN_SPEC: Any = _spec("a packaged example such as knee")
SpecName = Annotated[str, _RUN_SPEC]
SpecNameOrNone = Annotated[str | None, _RUN_SPEC]
AnySpecName = Annotated[str, _spec("a packaged example or study, such as knee")]
Archive = Annotated[Path, typer.Argument(metavar="FILE.h5", help="A run archive.")]
Archives = Annotated[list[Path], typer.Argument(metavar="FILE.h5", help="Run archives.")]
Set = Annotated[list[str] | None, set_key("time.step=0.005")]
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


def grouped(command: Command) -> Command:
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


@dataclass(frozen=True)
class SpecCommand:
    """A call of a command that computes a result from a spec and writes it to a file.

    Attributes
    ----------
    spec
        Name of a file or of a packaged spec, or "-" for stdin.
    assignments
        Assignments to keys of the spec, by ``--set``.
    path
        The file to write; by default, it has the name of the spec, with the suffix ``.h5``.
    overwrite
        Whether an existing file may be replaced.
    printing
        What is printed: one JSON object with ``--json``, nothing but errors with ``--quiet``.
    """

    spec: str
    assignments: Sequence[str]
    path: Path
    overwrite: bool
    printing: Printing

    @classmethod
    def of(
        cls, packaged: str, result: str = "The archive", key: str = "time.step=0.005"
    ) -> Callable[[Command], Command]:
        """Return the decorator that makes a command of a function, whose first argument is a `SpecCommand`.

        The command has the argument SPEC and the options ``--output``, ``--set``, ``--overwrite``, ``--json``,
        ``--quiet`` and ``--debug``. Further arguments of the function, annotated as typer requires, are options too.

        Parameters
        ----------
        packaged
            What SPEC may name apart from a file, such as ``a packaged example``.
        result
            What the command writes.
        key
            Example of an assignment.
        """

        def called(
            spec: Annotated[str, _spec(packaged)],
            output: Annotated[Path | None, output_to("FILE.h5", f"{result}; by default ./SPEC.h5.")] = None,
            assignments: Annotated[list[str] | None, set_key(key)] = None,
            overwrite: Overwrite = False,
            *,
            printing: Printing,
        ) -> "SpecCommand":
            return cls(spec, assignments or (), output or Path(f"{stem(spec)}.h5"), overwrite, printing)

        def decorator(function: Command) -> Command:
            shared = inspect.signature(called).parameters
            _, *further = inspect.signature(function, eval_str=True).parameters.values()

            @wraps(function)
            def command(**given: Any) -> None:
                function(called(**{name: given.pop(name) for name in shared}), **given)

            first, last = list(shared.values())[:3], list(shared.values())[3:]
            every = [one.replace(kind=one.KEYWORD_ONLY) for one in (*first, *further, *last)]
            command.__signature__ = inspect.Signature(every)  # type: ignore[attr-defined]
            return grouped(command)

        return decorator

    def load(self, load: Callable[[str, Sequence[str]], Spec]) -> Spec:
        """Return the spec that a function loads, after a check that the result can be written.

        Raises SpecError if the spec is not valid, or no file of this name may be written.
        """
        loaded = load(self.spec, self.assignments)
        check_new(self.path, self.spec, self.overwrite)
        return loaded

    def notify(self, text: str) -> None:
        """Print a message on the progress to stderr, except with ``--json`` or ``--quiet``."""
        if not (self.printing.quiet or self.printing.as_json):
            terminal.say(text)

    def conclude(self, text: str, values: Mapping[str, object], *, is_good: bool = True) -> None:
        """Print the result, as text or with ``--json`` as values, and exit with status 3 if it is not good."""
        terminal.show_result(values, text, as_json=self.printing.as_json, quiet=self.printing.quiet)
        if not is_good:
            raise typer.Exit(terminal.STOPPED_EARLY)
