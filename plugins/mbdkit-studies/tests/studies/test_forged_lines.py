"""Text from outside adds no lines to the summary of a study."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from mbdkit_studies.report.study_summary import summary


def test_reasons_do_not_add_lines() -> None:
    spec = SimpleNamespace(title="", defined_measures=tuple, has_table=False)
    study: Any = SimpleNamespace(points=(), references=(), failures=(), spec=spec, computed=0, folder="out")
    study.unfinished, study.statuses, study.verdicts = ("x\nall is well",), list, list
    study.columns = lambda: dict.fromkeys(("status", "status_reason", "verdict", "verdict_reasons"), ())
    assert summary(study).splitlines()[-1] == "unfinished 1 time: x\\nall is well"
