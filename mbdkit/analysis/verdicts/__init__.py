"""How the packaged studies are judged: functions from a study to its verdict, by the name that a study's spec gives."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from mbdkit.errors import SpecError
from mbdkit.text import did_you_mean, listed

if TYPE_CHECKING:
    from mbdkit.analysis.verdict import Verdict
    from mbdkit.spec.study_spec import StudySpec
    from mbdkit.studies.study import Study

#: The name of the verdict and where its function is; one is only imported when it is asked for.
VERDICTS: Mapping[str, tuple[str, str]] = {
    "paper": ("mbdkit.analysis.verdicts.paper", "paper"),
    "drift": ("mbdkit.analysis.verdicts.drift", "drift"),
    "no-drift": ("mbdkit.analysis.verdicts.no_drift", "no_drift"),
    "textbook-four-bar": ("mbdkit.analysis.verdicts.textbook", "textbook"),
}
GENERAL = ("mbdkit.analysis.verdicts.general", "general")


def check_verdict(spec: StudySpec) -> None:
    """Check that there is a verdict of the name that a study gives.

    Parameters
    ----------
    spec
        The study's spec.

    Raises
    ------
    SpecError
        If there is none.
    """
    name = spec.verdict
    if name and name not in VERDICTS:
        message = (
            f"there is no verdict '{name}'{did_you_mean(name, list(VERDICTS))}; verdicts: {listed(list(VERDICTS))}"
        )
        raise spec.placed(SpecError(message, key="verdict"))


def judge(study: Study) -> Verdict:
    """Return the verdict on a study: by the function that its spec names under `verdict`, or the general one.

    Parameters
    ----------
    study
        The study, complete or not: what its runs do not decide stays open.

    Raises
    ------
    SpecError
        If there is no verdict of that name, or it is for a study of other axes.
    """
    check_verdict(study.spec)
    name = study.spec.verdict
    module, function = VERDICTS.get(name, GENERAL)
    verdict: Callable[[Study], Verdict] = getattr(importlib.import_module(module), function)
    try:
        return verdict(study)
    except (LookupError, ValueError) as error:
        if not name:
            raise
        wrong = f"the verdict '{name}' is made for the families and axes of the packaged study '{name}', not for these"
        raise study.spec.placed(SpecError(wrong, key="verdict")) from error
