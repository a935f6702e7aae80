"""The command ``mbdkit``.

Commands are items of the registry. To add one, write its function in a file of this folder and add it to the commands
of `mbdkit.builtin_plugin`; its docstring is its help. Commands import what they need when they run.
"""

from __future__ import annotations

import atexit
import gc
import io
import os
import sys
import threading
import warnings
from contextlib import suppress
from typing import Annotated

import typer

from mbdkit.base.distributions import own_version
from mbdkit.base.interrupts import INTERRUPTED, stop_as_by_ctrl_c
from mbdkit.base.one_thread import begin_with_one_thread
from mbdkit.base.parts import OWN_PACKAGES
from mbdkit.base.terminal import PlainStream, keep_results_apart, open_streams, show
from mbdkit.cli.common_options import PLAIN, Debug
from mbdkit.cli.registered_commands import MainCommands

#: Modules of mbdkit, its parts and what they compute with, whose warnings refer to lines of code.
QUIET = rf"({'|'.join(OWN_PACKAGES)}|numpy|scipy)\b"

_BUFFERED = frozenset({io.TextIOWrapper, io.BufferedWriter, io.BufferedRandom})
_OWN: set[str] = set()  #: Descriptors of streams that the command itself opens; none if the system does not list them.

app = typer.Typer(cls=MainCommands, pretty_exceptions_enable=False, **PLAIN)


def _print_version(value: bool) -> None:
    if value:
        show(f"mbdkit {own_version()}")
        raise typer.Exit


@app.callback()
def mbdkit(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Simulate planar multibody mechanisms and record joint drift.

    Exit status: 0 success, 1 a rerun differs or a plugin is not verified, 2 the input
    is wrong, 3 the integration stopped early or a resource is not available (full disk,
    no permission, file in use), 4 a plugin failed, 130 interrupted (Ctrl-C, SIGTERM,
    SIGHUP).

    Environment: MBDKIT_PLUGINS=a,b loads only plugins of these distributions (no
    plugins if empty); MBDKIT_DISABLE_PLUGINS=a,b excludes them; MBDKIT_STRICT_PLUGINS=1
    makes a plugin that cannot be loaded an error; MBDKIT_PROCESSOR=x86-64-v2 uses the
    machine code for a lower level of processors.
    """


def main() -> None:
    """Run the command line."""
    begin_with_one_thread()
    before = _open_files()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # which it looks for in all installed distributions
    try:
        open_streams()  # first, because the next file opened would get the file descriptor of a closed stream
        stop_as_by_ctrl_c()
        # mbdkit reports overflows itself
        warnings.filterwarnings("ignore", category=RuntimeWarning, module=QUIET)
        keep_results_apart()
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                # a name may contain characters that the terminal cannot encode
                stream.reconfigure(errors="backslashreplace")
        sys.stdout, sys.stderr = PlainStream(sys.stdout), PlainStream(sys.stderr)
        if opened := _open_files() - before:  # the pipe of signals, and a copy of standard output
            _OWN.update({"0", "1", "2"} | opened)
        app(prog_name="mbdkit")
    except KeyboardInterrupt:  # `--json` before or after the command itself
        sys.exit(INTERRUPTED)


def run_and_exit() -> None:
    """Run the command line, and end the process.

    After handlers of exits have run and files are flushed, the interpreter is not torn down: freeing each of a million
    objects would take a fifth of a short run. Where threads are still at work, or a file cannot be written, it is.
    """
    try:
        main()
        status: object = 0
    except SystemExit as end:
        status = end.code
    if threading.active_count() == 1 and (status is None or isinstance(status, int)):
        atexit._run_exitfuncs()
        with suppress(OSError, ValueError):
            for stream in filter(None, (sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__)):
                stream.flush()
            for thing in gc.get_objects() if not _OWN or _open_files() - _OWN else ():
                if type(thing) in _BUFFERED and not thing.closed:  # a file that a plugin has left open
                    thing.flush()
            os._exit(status or 0)
    sys.exit(status)  # type: ignore[arg-type]


def _open_files() -> set[str]:
    """Return the descriptors of open files; none if the system does not list them."""
    with suppress(OSError):
        return {name for name in os.listdir("/dev/fd") if os.path.exists(f"/dev/fd/{name}")}
    return set()
