"""Finds and calls the verdict function of a study."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from mbdkit.errors import PluginError, SpecError
from mbdkit.registry.items import StudyPlugin
from mbdkit.registry.manager import registry
from mbdkit.text import did_you_mean, listed, one_line

if TYPE_CHECKING:
    from mbdkit.analysis.verdict import Verdict
    from mbdkit.registry.catalogue import Registered
    from mbdkit.spec.study_spec import StudySpec
    from mbdkit.studies.study import Study


def check_verdict(spec: StudySpec) -> None:
    """Check that the verdict exists that a study names.

    Parameters
    ----------
    spec
        The study's spec; its ``verdict`` is the name of a packaged study with a verdict function, or empty.

    Raises
    ------
    SpecError
        If there is no such verdict.
    """
    if spec.verdict:
        _find(spec)


def judge(study: Study) -> Verdict:
    """Return the verdict on a study: by the packaged study that its spec names under `verdict`, else the general one.

    Parameters
    ----------
    study
        The study, complete or not; claims that depend on missing runs stay open.

    Raises
    ------
    SpecError
        If there is no verdict of that name, or if it is written for a study with other families and axes.
    PluginError
        If the verdict function of another distribution fails or returns no Verdict.
    """
    name = study.spec.verdict
    if not name:
        from mbdkit.studies.general_verdict import general_verdict

        return general_verdict(study)
    item, function = _find(study.spec)
    try:
        found: Any = function(study)
    except (LookupError, ValueError) as error:
        wrong = f"the verdict '{name}' is made for the families and axes of the packaged study '{name}', not for these"
        raise study.spec.placed(SpecError(wrong, key="verdict")) from error
    except Exception as error:
        if item.origin.distribution == "mbdkit":
            raise
        raise PluginError(f"the verdict of '{item.id}' raised {one_line(error)}") from error
    return _checked(found, item)


def _find(spec: StudySpec) -> tuple[Registered, Callable[[Study], Any]]:
    """Return the item of the verdict that a spec names, and its function."""
    installed = registry()
    named = {item: item.plugin.verdict for item in installed.of_kind("study") if isinstance(item.plugin, StudyPlugin)}
    judges = {item: function for item, function in named.items() if function is not None}
    if any(spec.verdict in (item.name, item.id) for item in judges):
        try:
            found = installed.get("study", spec.verdict)
        except SpecError as error:  # several distributions use the name
            raise spec.placed(SpecError(error.message, key="verdict")) from None
        return found, judges[found]
    names = [installed.accepted(item)[0] for item in judges]
    hint, advice = did_you_mean(spec.verdict, names), installed.advice(spec.verdict)
    message = f"there is no verdict '{spec.verdict}'{hint}; verdicts: {listed(names)}{advice}"
    raise spec.placed(SpecError(message, key="verdict"))


def _checked(found: Any, item: Registered) -> Verdict:
    from mbdkit.analysis.verdict import Verdict

    if not isinstance(found, Verdict):
        what = type(found).__name__
        raise PluginError(
            f"the verdict of '{item.id}' is an object of type {what}, not an mbdkit.analysis.verdict.Verdict"
        )
    return found
