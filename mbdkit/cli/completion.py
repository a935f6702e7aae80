"""Words with which the shell completes arguments; where none fits, it completes names of files."""

from collections.abc import Callable
from typing import Any

import typer

from mbdkit.base.errors import MbdkitError
from mbdkit.registry.target import Target

Complete = Callable[[typer.Context, str], list[str]]


def completing(*words: Any) -> Complete:
    """Return a completion with the words that the functions at these targets return."""
    return lambda ctx, incomplete: sorted(w for own in words for w in own()() if w.startswith(incomplete))


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


EXAMPLES = completing(Target("mbdkit.spec:example_names"))
