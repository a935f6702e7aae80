"""Runs many specs one after another, without an archive of each, and yields their results in order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.errors import MbdkitError, PluginError, ResourceError, SpecError
from mbdkit.simulation import simulate_arrays
from mbdkit.spec import RunSpec
from mbdkit.stepping.warm_up import to_stderr
from mbdkit.text import one_line


@dataclass(frozen=True)
class Refused:
    """A run that has no results, because an exception was raised.

    Parameters
    ----------
    status
        ``failed`` if the run is to blame; ``missing`` if a resource was lacking, so that a second attempt may succeed.
    reason
        Code and sentence.
    """

    status: str
    reason: str


def simulate_batch(
    specs: Iterable[RunSpec], *, notify: Callable[[str], None] = to_stderr
) -> Iterator[FinishedRun | Refused]:
    """Run validated specs, and yield the result of each, in the order of `specs`.

    The numbers, and therefore `FinishedRun.data_sha256`, are those of `simulate` for the same spec.

    Parameters
    ----------
    notify
        Called with a message before long operations.
    """
    for spec in specs:
        try:
            result: FinishedRun | Refused = simulate_arrays(spec, notify=notify)
        except (Exception, SystemExit) as error:
            result = refusal(error)
        yield result


def refusal(error: BaseException) -> Refused:
    """Return what an exception means for the run that raised it."""
    match error:
        case SpecError():
            return Refused("failed", f"wrong-input: {error}")
        case ResourceError() | OSError():
            return Refused("missing", f"no-resources: {error}")
        case MemoryError():
            return Refused("missing", "no-resources: there is not enough memory.")
        case PluginError():
            return Refused("failed", f"plugin-error: {error}")
        case MbdkitError():
            return Refused("failed", f"error: {error}")
    return Refused("failed", f"error: {one_line(error)}")
