"""The examples in docstrings do what they show."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import mbdkit

MODULES = [f"mbdkit.archive.{name}" for name in ("reader", "recorded_data", "run", "run_views")]
MODULES += [f"mbdkit.mechanism.{name}" for name in ("element_methods", "mechanism", "named_elements")]
MODULES += ["mbdkit.methods.tableau", "mbdkit.runs.simulation", "mbdkit_report.plot.comparison"]
MODULES += [f"mbdkit_statics.{name}" for name in ("equilibrium", "kinematics", "modes")]
MODULES += [f"mbdkit_studies.{name}" for name in ("compute.carry_out", "lanes.prepared_run", "study")]


def examples(module: str) -> list[doctest.DocTest]:
    found = doctest.DocTestFinder().find(importlib.import_module(module), extraglobs={"Mechanism": mbdkit.Mechanism})
    return [one for one in found if one.examples]


@pytest.mark.parametrize("module", MODULES)
def test_examples_give_what_they_show(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    output: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL)
    for one in examples(module):
        runner.run(one, out=output.append)
    assert not runner.failures, "".join(output)


def test_the_functions_that_are_used_most_have_examples() -> None:
    assert sum(len(examples(module)) for module in MODULES) >= 20
