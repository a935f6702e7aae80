"""Evaluation of a study by the verdict function that its spec names, and the lookup of this function."""

from __future__ import annotations

from collections.abc import Callable

from mbdkit.base.errors import PluginError, SpecError, with_place
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.items import StudyPlugin
from mbdkit.registry.manager import registry
from mbdkit.registry.seam import Seam
from mbdkit_report import Verdict
from mbdkit_studies.results.general_verdict import general_verdict, with_added_methods
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.study import Study


@Seam
def study_verdict(study: Study, /) -> Verdict:
    """Return the verdict on the results of a packaged study, which may be incomplete."""
    raise NotImplementedError


def judge(study: Study) -> Verdict:
    """Return the verdict on a study.

    If the spec of the study names a packaged study as its ``verdict``, the verdict function of that study is called.
    Otherwise, the general verdict is returned. Either is followed by the results of added methods.

    Parameters
    ----------
    study
        The study. It may be incomplete; claims that depend on missing runs remain open.

    Raises
    ------
    SpecError
        If there is no verdict with the name in the spec, or several distributions have one, or if the verdict function
        requires other families and axes than those of the study.
    PluginError
        If the verdict function of another distribution fails or returns no Verdict.
    """
    if not (name := study.spec.verdict):
        return with_added_methods(general_verdict(study), study)
    item, function = find_verdict(study.spec)
    try:
        verdict: object = function(study)
    except (LookupError, ValueError) as error:
        wrong = f"the verdict '{name}' requires the families and axes of the packaged study '{name}'"
        raise study.spec.placed(SpecError(f"{wrong}; this one has others", key="verdict")) from error
    except (Exception, SystemExit) as error:
        if item.origin.distribution == "mbdkit":
            raise
        raise PluginError(f"the verdict of '{item.id}' raised {with_place(error)}") from error
    if not isinstance(verdict, Verdict):
        what = f"an object of type {type(verdict).__name__}, not an mbdkit_report.analysis.verdict.Verdict"
        raise PluginError(f"the verdict of '{item.id}' is {what}")
    return with_added_methods(verdict, study)


def find_verdict(spec: StudySpec) -> tuple[Registered, Callable[[object], object]]:
    """Return the packaged study that a spec names as its verdict, and the verdict function of that study.

    Raises
    ------
    SpecError
        If there is no such verdict, or several distributions have one.
    """
    installed = registry()
    studies = {item: item.plugin for item in installed.of_kind("study") if isinstance(item.plugin, StudyPlugin)}
    judges = {item: study for item, study in studies.items() if study.has_verdict}
    if any(spec.verdict in (item.name, item.id) for item in judges):
        try:
            result = installed.get("study", spec.verdict)
        except SpecError as error:  # the name is ambiguous: several distributions use it
            raise spec.placed(SpecError(error.message, key="verdict")) from None
        judge = judges[result].verdict
        assert judge is not None
        return result, judge
    names = [installed.accepted(item)[0] for item in judges]
    hint, advice = did_you_mean(spec.verdict, names), installed.advice(spec.verdict)
    message = f"there is no verdict '{spec.verdict}'{hint}; verdicts: {listed(names)}{advice}"
    raise spec.placed(SpecError(message, key="verdict"))
