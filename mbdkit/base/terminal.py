"""Output of results and error messages of the commands, and their exit statuses.

stdout is reserved for the results that `show` and `show_json` print. While a command runs, everything else that is
written to stdout, such as output of a plugin, goes to stderr.

Archives record the command of this process: subcommands and file names only, because command lines may contain private
data, such as tokens, or paths in a user's home.
"""

from __future__ import annotations

import errno
import functools
import os
import shlex
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import PurePath
from typing import Any, TextIO

import typer
from typer.core import TyperGroup

from mbdkit.base.errors import ArchiveError, MbdkitError, PluginError, ResourceError, RunError, SpecError, file_error
from mbdkit.base.interrupts import INTERRUPTED as INTERRUPTED
from mbdkit.base.text import bounded, one_line, shown

_words: Sequence[str] = ()


def command_line() -> str:
    """Return the command that is executed, such as ``mbdkit run knee.yaml``; empty outside of commands.

    Bytes of file names that are not UTF-8 are escaped. If the locale is C, Python does not decode bytes beyond ASCII.
    """
    return os.fsencode(shlex.join(_words)).decode("utf-8", "backslashreplace")


def for_shell(words: Sequence[str]) -> str:
    """Return a command with the quotes that the shell of this system needs, so that users can copy it."""
    if os.name != "nt":
        return shlex.join(words)
    import subprocess

    return subprocess.list2cmdline(words)


def command_words() -> list[str]:
    """Return the words of `command_line`, which are passed to processes that execute a part of the command."""
    return list(_words)


@contextmanager
def executing(words: Sequence[str]) -> Iterator[None]:
    """Make `command_line` return these words within a block.

    A worker process receives the words of the command that started it.
    """
    global _words
    before, _words = _words, words
    try:
        yield
    finally:
        _words = before


DONE, BUG, WRONG_INPUT, STOPPED_EARLY, PLUGIN_FAILED = 0, 1, 2, 3, 4
DIFFERS = NOT_VERIFIED = 1

DEBUG, JSON = "mbdkit.debug", "mbdkit.json"


class PlainStream:
    """A text stream that escapes control characters, so that titles, names and messages from files cannot control the
    terminal.

    `stream`: the stream to write to. Progress bars need its control characters and use it directly.
    """

    def __init__(self, stream: TextIO):
        self.stream = stream

    def write(self, text: str) -> int:
        """Write text with its control characters escaped.

        Raises TypeError for bytes, so that click recognizes a text stream.
        """
        if not isinstance(text, str):
            raise TypeError(f"text is written here, not {type(text).__name__}")
        self.stream.write(shown(text, lines=True))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several pieces of text."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> object:
        return getattr(self.stream, name)


class Commands(TyperGroup):
    """The top-level command group: reports exceptions on stderr and converts them to exit statuses.

    With ``--json``, an exception is also printed on stdout, as one object.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments, and note whether JSON is requested."""
        ctx.meta[JSON] = "--json" in args
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> object:
        """Run the selected command."""
        with _results_apart() as results:
            try:
                return super().invoke(ctx)
            except BrokenPipeError:
                raise
            except (Exception, KeyboardInterrupt, SystemExit) as error:
                if hasattr(error, "exit_code"):  # a usage error, or an exit of typer
                    if isinstance(error, typer.BadParameter):
                        error.message = error.message.removeprefix("Value error, ")  # of pydantic
                    if ctx.meta[JSON] and hasattr(error, "format_message"):
                        results.show(_json_error(error.format_message(), error.exit_code))
                    raise
                if ctx.meta.get(DEBUG):
                    traceback.print_exc()
                sentence, status = _sentence(error), _status(error)
                say(sentence)
                if ctx.meta[JSON] and not results.shown:
                    with suppress(OSError):
                        results.show(_json_error(sentence.removeprefix("error: "), status, error))
                raise typer.Exit(status) from None


class _Results:
    """The stream of results, and whether anything has been printed to it."""

    def __init__(self, stream: TextIO):
        self.stream, self.shown = stream, False

    def show(self, text: object) -> None:
        try:
            print(text, file=self.stream, flush=True)
        except OSError as error:
            with suppress(OSError, ValueError):  # without this, Python would flush again at exit and print a warning
                os.dup2(os.open(os.devnull, os.O_WRONLY), self.stream.fileno())
            if error.errno == errno.EINVAL:  # of a closed pipe on Windows
                raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE)) from None
            raise
        self.shown = True


_results: _Results | None = None


@contextmanager
def _results_apart() -> Iterator[_Results]:
    """Yield the stream of results, which is stdout; `show` prints there in this block."""
    global _results
    before = _results
    _results = results = _Results(sys.stdout)
    try:
        yield results
    finally:
        _results = before


def guard(command: Any, words: tuple[str, ...]) -> None:
    """Wrap the functions of a command and its subcommands: while they run, stdout goes to stderr, and the command is
    recorded for archives.

    `words`: the names with which the command is called.
    """
    for name, subcommand in getattr(command, "commands", {}).items():
        guard(subcommand, (*words, name))
    if (function := command.callback) is None or hasattr(function, "_is_guarded"):
        return

    @functools.wraps(function)
    def guarded(*arguments: object, **options: object) -> object:
        with redirect_stdout(sys.stderr), executing([*words, *_files(command, options)]):
            return function(*arguments, **options)

    guarded._is_guarded = True  # type: ignore[attr-defined]
    command.callback = guarded


_OF_FILES = ("output", "resume")  #: Options whose values are names of files.


def _files(command: Any, options: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names, without folders, of the files that were passed to a command."""
    for parameter in command.params:
        value = options.get(parameter.name)
        if value is None or (parameter.param_type_name != "argument" and parameter.name not in _OF_FILES):
            continue
        if parameter.param_type_name != "argument":
            yield parameter.opts[-1]
        for one in [value] if isinstance(value, str | os.PathLike) else value:
            yield PurePath(one).name or str(one)


def show(result: object) -> None:
    """Print a result to stdout."""
    (_results or _Results(sys.stdout)).show(result)


def show_json(data: object, indent: int | None = None) -> None:
    """Print a result to stdout as JSON; numbers that are not finite become null."""
    from mbdkit.base.plain_data import json_text

    show(json_text(data, indent))


def show_result(values: object, text: object, *, as_json: bool, quiet: bool = False) -> None:
    """Print a result on stdout: its values as JSON, or its text unless `quiet`."""
    if as_json:
        show_json(values)
    elif not quiet:
        show(text)


def _json_error(message: str, status: int, error: BaseException | None = None) -> str:
    from mbdkit.base.plain_data import json_text

    location = {}
    if isinstance(error, SpecError):
        location = {"key": error.key or None, "file": error.file, "line": error.line}
    elif isinstance(error, ArchiveError):
        location = {"key": None, "file": error.file, "line": None}
    return json_text({"error": message, "exit_status": status, **location})


def open_streams() -> None:
    """Open the null device in place of closed standard streams, as after ``2>&-``.

    Otherwise, the next file to be opened would get the file descriptor of such a stream, and output of the program
    would be written into this file.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor, which is that of the closed stream
        if getattr(sys, name) is None:
            stream = os.fdopen(number, "w" if number else "r", encoding="utf-8")
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)  # keeps the descriptor open when the stream is replaced


def keep_results_apart() -> None:
    """Redirect file descriptor 1 to stderr for the rest of the process, while `sys.stdout` writes to the real stdout.

    Compiled code and child processes then cannot write into the results.
    """
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        stream = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding, errors="backslashreplace")
        os.dup2(2, 1)
        sys.stdout = stream


def say(text: str) -> None:
    """Print a line to stderr; only results go to stdout."""
    with suppress(OSError):  # the disk of a redirected stderr may be full
        print(text, file=sys.stderr, flush=True)


def silence(text: str) -> None:
    """Do nothing; replaces `say` in quiet mode."""


def _status(error: BaseException) -> int:
    match error:
        case PluginError() | SystemExit():
            return PLUGIN_FAILED
        case RunError() | ResourceError() | MemoryError():
            return STOPPED_EARLY
        case OSError() if error.errno:
            return _status(file_error(error.errno, ""))
        case MbdkitError() | OSError():
            return WRONG_INPUT
        case KeyboardInterrupt():
            return INTERRUPTED
    return BUG


def _sentence(error: BaseException) -> str:
    match error:
        case MbdkitError():
            return f"error: {error}"
        case OSError():
            why = error.strerror or str(error) or type(error).__name__
            return f"error: {bounded(str(error.filename))}: {why}" if error.filename else f"error: {why}"
        case MemoryError():
            return "error: there is not enough memory for this"
        case KeyboardInterrupt():
            return "interrupted"
        case SystemExit():  # mbdkit never raises SystemExit
            return "error: a plugin tried to end the program"
    return (
        f"error: this is a bug in mbdkit: {one_line(error)}\n"
        "  rerun the command with --debug for a traceback, and please report it"
    )
