"""The list of checks of each kind of plugin, and the function that runs them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import SpecError
from mbdkit.base.logs import to_stderr
from mbdkit.registry.catalogue import Kind, Registered, Registry
from mbdkit.registry.item import Plugin
from mbdkit.registry.manager import registry
from mbdkit_testing import (
    contract_checks,
    counter_checks,
    drift_checks,
    element_checks,
    failure_checks,
    final_state_checks,
    force_law_checks,
    inside_step_checks,
    invariant_checks,
    item_checks,
    joint_checks,
    measure_checks,
    model_checks,
    newton_checks,
    option_effect_checks,
    order_checks,
    page_checks,
    restart_checks,
    stability_checks,
    study_checks,
    tableau_checks,
)
from mbdkit_testing.check import Check
from mbdkit_testing.check_result import Report, Result
from mbdkit_testing.integrator_under_test import IntegratorUnderTest
from mbdkit_testing.joint_under_test import JointUnderTest
from mbdkit_testing.options_under_test import plain_options

INTEGRATOR_CHECKS: tuple[Check[IntegratorUnderTest], ...] = (
    *contract_checks.CHECKS,
    *option_effect_checks.METHOD_CHECKS,
    *tableau_checks.CHECKS,
    *order_checks.CHECKS,
    *inside_step_checks.CHECKS,
    *final_state_checks.CHECKS,
    *newton_checks.CHECKS,
    *invariant_checks.CHECKS,
    *stability_checks.CHECKS,
    *drift_checks.CHECKS,
    *counter_checks.CHECKS,
    *failure_checks.CHECKS,
    *restart_checks.CHECKS,
)
#: Checks of the kinds that have some of their own.
CHECKS: dict[Kind, tuple[Check[Any], ...]] = {
    "integrator": INTEGRATOR_CHECKS,
    "model": model_checks.CHECKS,
    "force-law": (*force_law_checks.CHECKS, *option_effect_checks.CHECKS),
    "study": study_checks.CHECKS,
    "measure": measure_checks.CHECKS,
    "element-kind": (*item_checks.CHECKS, *element_checks.CHECKS),
    "joint-kind": (*item_checks.CHECKS, *joint_checks.CHECKS),
    "plot-kind": (*item_checks.CHECKS, *page_checks.CHECKS),
    "report-section": (*item_checks.CHECKS, *page_checks.CHECKS),
}
Watch = Callable[[int, int, str], None]


def checks_of(kind: Kind, *, quick: bool = False) -> Iterator[Check[Any]]:
    """Yield the checks of a kind of plugin in order, without the slow ones if `quick`."""
    return (check for check in CHECKS.get(kind, item_checks.CHECKS) if not (quick and check.slow))


def plugin_under_test(kind: Kind, name: str, options: Mapping[str, object], installed: Registry | None = None) -> Any:
    """Return a plugin with options, in the form that the checks use.

    Raises
    ------
    SpecError
        If there is no such plugin, or its options are invalid.
    """
    installed = installed or registry()
    item = installed.get(kind, name)
    has_options = isinstance(item.plugin, Plugin)
    if options and not has_options:
        raise SpecError(f"'{item.id}' has no options", key=next(iter(options)))
    chosen = plain_options(item, options) if has_options else {}
    types: dict[Kind, Callable[[Registered, dict[str, Any], Registry], Any]] = {
        "integrator": IntegratorUnderTest,
        "model": model_checks.ModelUnderTest,
        "force-law": force_law_checks.ForceLawUnderTest,
        "study": study_checks.StudyUnderTest,
        "measure": measure_checks.MeasureUnderTest,
        "element-kind": element_checks.ElementUnderTest,
        "joint-kind": JointUnderTest,
    }
    return types.get(kind, item_checks.ItemUnderTest)(item, chosen, installed)


def check_element(name: str, *, quick: bool = False) -> Report:
    """Run all checks of a kind of elements; see `verify`."""
    return verify("element-kind", name, quick=quick)


def check_integrator(name: str, options: Mapping[str, object] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of an integrator; see `verify`."""
    return verify("integrator", name, options, quick=quick)


def check_joint(name: str, *, quick: bool = False) -> Report:
    """Run all checks of a kind of joints; see `verify`."""
    return verify("joint-kind", name, quick=quick)


def check_model(name: str, options: Mapping[str, object] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of a model; see `verify`."""
    return verify("model", name, options, quick=quick)


def check_force_law(name: str, options: Mapping[str, object] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of a force law; see `verify`."""
    return verify("force-law", name, options, quick=quick)


def verify(
    kind: Kind,
    name: str,
    options: Mapping[str, object] | None = None,
    *,
    quick: bool = False,
    installed: Registry | None = None,
    watch: Watch | None = None,
    notify: Callable[[str], None] = to_stderr,
) -> Report:
    """Run all checks of a plugin.

    Parameters
    ----------
    name
        Short or long name.
    options
        Options of the plugin. An option with neither a default nor a given value gets an example value; see
        `plain_options`.
    quick
        Whether to leave out the slow checks.
    installed
        The registry; by default all installed plugins.
    watch
        Called before each check with its index, the number of checks, and its name.
    notify
        Called with messages about long operations.

    Raises
    ------
    SpecError
        If there is no such plugin, or its options are invalid.
    """
    under_test = plugin_under_test(kind, name, options or {}, installed)
    is_ours = under_test.item.origin.distribution == MBDKIT
    checks = [*checks_of(kind, quick=quick), *([] if is_ours else [item_checks.imports])]
    results: list[Result] = []
    for number, check in enumerate(checks):
        if watch is not None:
            watch(number, len(checks), check.name)
        results.append(check.run(under_test))
    return report_of(kind, under_test, results)


def report_of(kind: Kind, under_test: Any, results: Iterable[Result]) -> Report:
    """Return the report of the results of checks of a plugin."""
    item: Registered = under_test.item
    claims = _claims(kind, under_test)
    return Report(item.id, kind, item.origin.version, under_test.options, claims, tuple(results))


def _claims(kind: Kind, under_test: Any) -> dict[str, Any]:
    try:
        return asdict(under_test.claims) if kind == "integrator" else dict(under_test.claims)
    except (Exception, SystemExit):  # a check reports it
        return {}
