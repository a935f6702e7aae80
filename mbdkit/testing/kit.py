"""The one list of checks of each kind of plugin, and how a plugin is taken through it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

from mbdkit.registry.catalogue import Kind, Registered, Registry
from mbdkit.registry.manager import registry
from mbdkit.stepping.warm_up import ensure_compiled, to_stderr
from mbdkit.testing import (
    contract_checks,
    cost_checks,
    counter_checks,
    drift_checks,
    failure_checks,
    force_law_checks,
    invariant_checks,
    model_checks,
    newton_checks,
    order_checks,
    restart_checks,
    study_checks,
    tableau_checks,
    tolerance_checks,
)
from mbdkit.testing.check import Check
from mbdkit.testing.integrator_under_test import IntegratorSubject
from mbdkit.testing.options_under_test import plain_options
from mbdkit.testing.outcome import Report, Result

INTEGRATOR_CHECKS: tuple[Check[IntegratorSubject], ...] = (
    *contract_checks.CHECKS,
    *tableau_checks.CHECKS,
    *order_checks.CHECKS,
    *tolerance_checks.CHECKS,
    *newton_checks.CHECKS,
    *invariant_checks.CHECKS,
    *drift_checks.CHECKS,
    *counter_checks.CHECKS,
    *failure_checks.CHECKS,
    *restart_checks.CHECKS,
    *cost_checks.CHECKS,
)
CHECKS: dict[Kind, tuple[Check[Any], ...]] = {
    "integrator": INTEGRATOR_CHECKS,
    "model": model_checks.CHECKS,
    "force-law": force_law_checks.CHECKS,
    "study": study_checks.CHECKS,
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
        "model": model_checks.ModelSubject,
        "force-law": force_law_checks.LawSubject,
        "study": study_checks.StudySubject,
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
