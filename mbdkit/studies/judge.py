"""Evaluation of a study by the verdict function that its spec names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbdkit.base.errors import PluginError, SpecError, with_place
from mbdkit.studies.verdict_lookup import find_verdict

if TYPE_CHECKING:
    from mbdkit.analysis.verdict import Verdict
    from mbdkit.registry.catalogue import Registered
    from mbdkit.studies.study import Study


def judge(study: Study) -> Verdict:
    """Return the verdict on a study: that of the packaged study that its spec names, or else the general verdict.

    Parameters
    ----------
    study
        The study. It may be incomplete; claims that depend on missing runs remain open.

    Raises
    ------
    SpecError
        If there is no verdict with that name, or if it requires other families and axes than those of the study.
    PluginError
        If the verdict function of another distribution fails or returns no Verdict.
    """
    name = study.spec.verdict
    if not name:
        from mbdkit.studies.general_verdict import general_verdict

        return general_verdict(study)
    item, function = find_verdict(study.spec)
    try:
        found: Any = function(study)
    except (LookupError, ValueError) as error:
        wrong = (
            f"the verdict '{name}' requires the families and axes of the packaged study '{name}'; this one has others"
        )
        raise study.spec.placed(SpecError(wrong, key="verdict")) from error
    except (Exception, SystemExit) as error:
        if item.origin.distribution == "mbdkit":
            raise
        raise PluginError(f"the verdict of '{item.id}' raised {with_place(error)}") from error
    return _checked(found, item)


def _checked(found: Any, item: Registered) -> Verdict:
    from mbdkit.analysis.verdict import Verdict

    if not isinstance(found, Verdict):
        what = type(found).__name__
        raise PluginError(
            f"the verdict of '{item.id}' is an object of type {what}, not an mbdkit.analysis.verdict.Verdict"
        )
    return found
