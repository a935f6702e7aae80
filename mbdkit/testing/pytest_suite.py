"""The kit inside a plugin's own tests: one line makes every check a test."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from mbdkit.registry.catalogue import Kind
from mbdkit.testing.check import Check
from mbdkit.testing.kit import checks_of, subject_of
from mbdkit.testing.outcome import Result, figures_text


class ConformanceWarning(UserWarning):
    """A check that passed with a remark."""


@dataclass(frozen=True)
class Case:
    """One check of one plugin, as a test: call it.

    A failure raises AssertionError, a warning is warned of, what does not apply is skipped.
    """

    kind: Kind
    plugin: str
    options: tuple[tuple[str, Any], ...]
    check: Check[Any]

    def __call__(self) -> Result:
        """Carry the check out."""
        import pytest

        from mbdkit.stepping.warm_up import ensure_compiled

        ensure_compiled()
        result = self.check.run(_subject(self.kind, self.plugin, self.options))
        if result.outcome == "skip":
            pytest.skip(result.cause)
        if result.outcome == "fail":
            raise AssertionError(
                f"{self.plugin}: {result.name}: {result.cause} ({figures_text(result) or 'no figures'})"
            )
        if result.outcome == "warn":
            warnings.warn(f"{self.plugin}: {result.name}: {result.cause}", ConformanceWarning, stacklevel=2)
        return result

    def __str__(self) -> str:
        return self.check.name


@cache
def _subject(kind: Kind, name: str, options: tuple[tuple[str, Any], ...]) -> Any:
    return subject_of(kind, name, dict(options))


def cases(kind: Kind, name: str, options: dict[str, Any] | None = None, *, quick: bool = False) -> Iterator[Case]:
    """Give the checks of a plugin as tests to be called."""
    frozen = tuple((options or {}).items())
    return (Case(kind, name, frozen, check) for check in checks_of(kind, quick=quick))


def conformance(
    *,
    integrator: str | None = None,
    model: str | None = None,
    force_law: str | None = None,
    options: dict[str, Any] | None = None,
    quick: bool = False,
) -> Callable[[Callable[[Case], Any]], Callable[[Case], Any]]:
    """Decorate a test with the argument ``case``: it runs once for each check of a plugin, under the check's name.

    Parameters
    ----------
    integrator, model, force_law
        The plugin, by short or long name: exactly one of the three.
    options
        Its options.
    quick
        Whether to leave out the slow checks.

    Examples
    --------
    >>> @conformance(integrator="gauss", options={"stages": 3})
    ... def test_gauss_conforms(case):
    ...     case()
    """
    import pytest

    named: list[tuple[Kind, str]] = []
    if integrator is not None:
        named.append(("integrator", integrator))
    if model is not None:
        named.append(("model", model))
    if force_law is not None:
        named.append(("force-law", force_law))
    if len(named) != 1:
        raise TypeError("conformance takes exactly one of integrator=, model= and force_law=")
    kind, name = named[0]
    return pytest.mark.parametrize("case", list(cases(kind, name, options, quick=quick)), ids=str)
