"""Words with which the shell completes arguments; where none fits, it completes names of files."""

from collections.abc import Callable
from typing import Any

import typer

from mbdkit.base.errors import MbdkitError
from mbdkit.registry.target import Target

Complete = Callable[[typer.Context, str], list[str]]


def completing(*words: Any) -> Complete:
    """Return a completion with the words that the functions at these targets return."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        """Return the words that begin like the incomplete one."""
        return sorted(word for target in words for word in target()() if word.startswith(incomplete))

    return complete


def names_in_archive(*groups: str) -> Complete:
    """Return a completion with names in the first archive that a command is given, such as those of its ``joints``."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        from mbdkit.archive.reader import load

        given = [*(ctx.params.get("archives") or ()), *ctx.args]  # several archives are not parsed yet
        try:
            with load(given[0]) as run:
                return sorted(name for group in groups for name in getattr(run, group) if name.startswith(incomplete))
        except (MbdkitError, OSError, IndexError):
            return []

    return complete


EXAMPLES = completing(Target("mbdkit.spec:example_names"))  #: Completion with the names of packaged examples.
