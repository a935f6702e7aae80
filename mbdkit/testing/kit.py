"""The one list of checks of each kind of plugin, and how a plugin is taken through it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

from mbdkit.engine.warm import ensure_compiled, to_stderr
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.manager import registry
from mbdkit.testing import (
    contract,
    cost,
    drift,
    failure,
    force_law,
    geometry,
    honesty,
    model,
    newton,
    order,
    restart,
    tableau,
    tolerance,
)
from mbdkit.testing.check import Check
from mbdkit.testing.options import plain_options
from mbdkit.testing.outcome import Kind, Report, Result
from mbdkit.testing.subject import IntegratorSubject

INTEGRATOR_CHECKS: tuple[Check[IntegratorSubject], ...] = (
    *contract.CHECKS,
    *tableau.CHECKS,
    *order.CHECKS,
    *tolerance.CHECKS,
    *newton.CHECKS,
    *geometry.CHECKS,
    *drift.CHECKS,
    *honesty.CHECKS,
    *failure.CHECKS,
    *restart.CHECKS,
    *cost.CHECKS,
)
CHECKS: dict[Kind, tuple[Check[Any], ...]] = {
    "integrator": INTEGRATOR_CHECKS,
    "model": model.CHECKS,
    "force-law": force_law.CHECKS,
}
Watch = Callable[[int, int, str], None]


def checks_of(kind: Kind, *, quick: bool = False) -> Iterator[Check[Any]]:
    """Give the checks of a kind of plugin, in their order; without the slow ones if `quick`."""
    return (check for check in CHECKS[kind] if not (quick and check.slow))


def subject_of(kind: Kind, name: str, options: Mapping[str, Any], installed: Registry | None = None) -> Any:
    """Return a plugin with options, ready to be checked.

    Raises
    ------
    SpecError
        Where there is no such plugin, or its options are wrong.
    """
    installed = installed or registry()
    item = installed.get(kind, name)
    chosen = plain_options(item, options)
    subjects: dict[Kind, Callable[[Registered, dict[str, Any], Registry], Any]] = {
        "integrator": IntegratorSubject,
        "model": model.ModelSubject,
        "force-law": force_law.LawSubject,
    }
    return subjects[kind](item, chosen, installed)


def verify(
    kind: Kind,
    name: str,
    options: Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    installed: Registry | None = None,
    watch: Watch | None = None,
    notify: Callable[[str], None] = to_stderr,
) -> Report:
    """Take a plugin through all checks of its kind.

    Parameters
    ----------
    kind
        What it is.
    name
        Its short or long name.
    options
        Its options; for what has neither a default nor a value here, the plainest value that the schema allows.
    quick
        Whether to leave out the slow checks.
    installed
        Where to look it up; by default, in all that is installed.
    watch
        Called before each check with its number, the number of all, and its name.
    notify
        Told what takes long.

    Raises
    ------
    SpecError
        Where there is no such plugin, or its options are wrong.
    """
    subject = subject_of(kind, name, options or {}, installed)
    ensure_compiled(notify)
    checks = list(checks_of(kind, quick=quick))
    results: list[Result] = []
    for number, check in enumerate(checks):
        if watch is not None:
            watch(number, len(checks), check.name)
        results.append(check.run(subject))
    item: Registered = subject.item
    return Report(
        id=item.id,
        kind=kind,
        version=item.origin.version,
        options=subject.options,
        claims=_claims(kind, subject),
        results=tuple(results),
    )


def _claims(kind: Kind, subject: Any) -> dict[str, Any]:
    if kind == "model":
        return {}
    try:
        return asdict(subject.claims) if kind == "integrator" else dict(subject.claims)
    except Exception:  # a check has said so
        return {}
