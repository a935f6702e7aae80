"""The checks of a plugin as pytest tests."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from mbdkit.registry.catalogue import Kind
from mbdkit_testing.check import Check
from mbdkit_testing.check_result import Result, figures_text
from mbdkit_testing.kit import checks_of, plugin_under_test, report_of


class ConformanceWarning(UserWarning):
    """Warning for a check that passed with a remark."""


@dataclass(frozen=True)
class Case:
    """A check of a plugin as a test; calling the object runs the check.

    A failure raises AssertionError, and a remark issues a ConformanceWarning. A check that does not apply, or whose
    property is not claimed, is skipped.
    """

    kind: Kind
    plugin: str
    options: tuple[tuple[str, Any], ...]
    check: Check[Any]

    def __call__(self) -> Result:
        """Run the check."""
        import pytest

        under_test: Any = _under_test(self.kind, self.plugin, self.options)
        result = self.check.run(under_test)
        if (unrecorded := _UNRECORDED.get((self.kind, self.plugin, self.options))) is not None:
            unrecorded.results[result.name] = result
            if len(unrecorded.results) == unrecorded.count:
                from mbdkit_testing.recorded_evidence import renew

                report = report_of(self.kind, under_test, unrecorded.results.values())
                renew(under_test.item, report, quick=unrecorded.quick)
        if result.outcome == "skip":
            pytest.skip(result.cause)
        if result.outcome == "not claimed":
            pytest.skip(f"not claimed; measured: {figures_text(result)}")
        if result.outcome == "fail":
            raise AssertionError(
                f"{self.plugin}: {result.name}: {result.cause} ({figures_text(result) or 'no figures'})"
            )
        if result.outcome == "warn":
            warnings.warn(f"{self.plugin}: {result.name}: {result.cause}", ConformanceWarning, stacklevel=2)
        return result

    def __str__(self) -> str:
        return self.check.name


@dataclass
class _Unrecorded:
    """Results of checks that are recorded as evidence once all `count` of them are there."""

    count: int
    quick: bool
    results: dict[str, Result] = field(default_factory=dict)


_UNRECORDED: dict[tuple[Kind, str, tuple[tuple[str, Any], ...]], _Unrecorded] = {}


@cache
def _under_test(kind: Kind, name: str, options: tuple[tuple[str, Any], ...]) -> object:
    return plugin_under_test(kind, name, dict(options))


def cases(kind: Kind, name: str, options: dict[str, Any] | None = None, *, quick: bool = False) -> Iterator[Case]:
    """Yield the checks of a plugin as tests."""
    frozen = tuple((options or {}).items())
    return (Case(kind, name, frozen, check) for check in checks_of(kind, quick=quick))


def conformance(
    *,
    integrator: str | None = None,
    model: str | None = None,
    force_law: str | None = None,
    measure: str | None = None,
    element: str | None = None,
    joint: str | None = None,
    options: dict[str, Any] | None = None,
    quick: bool = False,
    record: bool = False,
) -> Callable[[Callable[[Case], object]], Callable[[Case], object]]:
    """Return a decorator that runs a test once for each check of a plugin, with the check as its argument ``case``.

    Parameters
    ----------
    integrator, model, force_law, measure, element, joint
        Short or long name of the plugin; exactly one of the six is given.
    quick
        Whether to leave out the slow checks.
    record
        Whether to write the results into the package as its evidence, as ``mbdkit plugins verify --record`` does. This
        is done in a source tree, once all checks have been run in one process, and if the code has changed.

    Examples
    --------
    >>> @conformance(integrator="gauss", options={"stages": 3})
    ... def test_gauss_conforms(case):
    ...     case()
    """
    import pytest

    texts: dict[Kind, str | None] = {
        "integrator": integrator,
        "model": model,
        "force-law": force_law,
        "measure": measure,
        "element-kind": element,
        "joint-kind": joint,
    }
    named = [(kind, name) for kind, name in texts.items() if name is not None]
    if len(named) != 1:
        raise TypeError(
            "conformance needs exactly one of integrator=, model=, force_law=, measure=, element= and joint="
        )
    kind, name = named[0]
    every = list(cases(kind, name, options, quick=quick))
    if record:
        _UNRECORDED[kind, name, tuple((options or {}).items())] = _Unrecorded(len(every), quick)
    return pytest.mark.parametrize("case", every, ids=str)
