"""The command that this process executes, in the form that archives record: subcommands and file names only.

Command lines may contain private data, such as tokens, or paths in a user's home. The options of a command, the folders
of its files, and the whole command line of a Python program are therefore left out.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

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
