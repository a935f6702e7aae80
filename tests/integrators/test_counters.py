"""Counters are honest: they say what was done, counted from outside."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.slow_cases import slow

from .running import DOUBLE, EXPLICIT, IMPLICIT, driven_chain, run

both_models = pytest.mark.parametrize("model", [DOUBLE, driven_chain()], ids=["double pendulum", "driven chain"])


@pytest.mark.parametrize("integrator", EXPLICIT, ids=str)
@both_models
def test_an_explicit_method_evaluates_once_a_stage(model: Any, integrator: dict[str, Any]) -> None:
    stats = run(model, integrator, steps=37, step=0.01).stats
    assert stats["steps"] == stats["accepted"] == 37
    assert stats["rhs_evaluations"] == stats["factorizations"] == 4 * 37
    assert stats["jacobian_evaluations"] == stats["newton_iterations"] == stats["rejected"] == 0
    assert stats["projections"] == 0


@pytest.mark.parametrize("integrator", IMPLICIT, ids=str)
@both_models
def test_iterations_of_the_run_are_those_of_its_steps(model: Any, integrator: dict[str, Any]) -> None:
    result = run(model, integrator, steps=37, step=0.01)
    assert result.stats["newton_iterations"] == result.array("steps/iterations").sum()
    assert (result.array("steps/iterations_max") == result.array("steps/iterations")).all()
    assert result.stats["jacobian_evaluations"] >= 37
    assert result.stats["rejected"] == 0


@pytest.mark.parametrize(("stages", "solver"), [(3, "newton"), (2, "fixed-point"), *slow((0, "-"), (1, "newton"))])
def test_counters_are_what_an_outside_count_finds(stages: int, solver: str) -> None:
    # expected: every function wrapped and counted, in a process where kernels run in Python
    environment = os.environ | {"MBDKIT_KERNELS": "python"}
    script = Path(__file__).with_name("counting.py")
    done = subprocess.run(
        [sys.executable, script, str(stages), solver], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    counts, stats = found["counts"], found["stats"]
    assert stats["rhs_evaluations"] == counts["solve"]
    assert stats["jacobian_evaluations"] == counts.get("tangents", 0)
    factorizations = ("solve", "stage matrices", "choices of pivots")
    assert stats["factorizations"] == sum(counts.get(name, 0) for name in factorizations)
    assert stats["newton_iterations"] == counts.get("iterations", 0) == sum(found["rows"])
