"""Lookup of the verdict function that a study spec names."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.items import StudyPlugin
from mbdkit.registry.manager import registry

if TYPE_CHECKING:
    from mbdkit.registry.catalogue import Registered
    from mbdkit.spec.study_spec import StudySpec


def check_verdict(spec: StudySpec) -> None:
    """Check that the verdict named in a study spec exists.

    Parameters
    ----------
    spec
        The study spec; its ``verdict`` is the name of a packaged study with a verdict function, or empty.

    Raises
    ------
    SpecError
        If there is no such verdict.
    """
    if spec.verdict:
        find_verdict(spec)


def find_verdict(spec: StudySpec) -> tuple[Registered, Callable[[Any], Any]]:
    """Return the packaged study that a spec names as its verdict, and its verdict function."""
    installed = registry()
    named = {item: item.plugin.verdict for item in installed.of_kind("study") if isinstance(item.plugin, StudyPlugin)}
    judges = {item: function for item, function in named.items() if function is not None}
    if any(spec.verdict in (item.name, item.id) for item in judges):
        try:
            found = installed.get("study", spec.verdict)
        except SpecError as error:  # the name is ambiguous: several distributions use it
            raise spec.placed(SpecError(error.message, key="verdict")) from None
        return found, judges[found]
    names = [installed.accepted(item)[0] for item in judges]
    hint, advice = did_you_mean(spec.verdict, names), installed.advice(spec.verdict)
    message = f"there is no verdict '{spec.verdict}'{hint}; verdicts: {listed(names)}{advice}"
    raise spec.placed(SpecError(message, key="verdict"))
