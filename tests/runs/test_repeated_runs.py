"""Repeated runs of mappings equal those computed in the ordinary way, whatever differs between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.runs import repeated_runs, simulation
from mbdkit.runs.repeated_runs import FIRST
from mbdkit.spec import RunSpec
from mbdkit.spec.loading import load_spec

BASE: dict[str, Any] = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum", "masses": [1.0, 1.5], "lengths": [1.0, 0.7], "angles": [0.3, 0.4]},
    "integrator": {"name": "rk4"},
    "time": {"end": 0.1, "step": 0.01},
}

#: Another value of each key of a run spec.
CHANGES: dict[str, Any] = {
    "title": "another",
    "parameters": {"unused": 1.0},
    "model": {**BASE["model"], "name": "n-pendulum"},
    "formulation": "joint-coordinates",
    "stabilization": "projection",
    "integrator": {"name": "gauss", "stages": 2},
    "time": {"start": 0.05, "end": 0.1, "step": 0.01},
    "output": {"every": 3, "quantities": ["energy"]},
    "events": {"stop": {"when": "bodies.rod1.angle - 0.25", "action": "stop"}},
    "measures": {"peak": "max(abs(joints.J1.force))"},
    "gradients": ["model.masses.1"],
    "limits": {"max_steps": 7},
    "check": True,
    "accuracy": 1e-4,
    "impacts": "allow",
    "accept": ["moved-start"],
    "mbdkit": 2,
    "meta": {"description": "another"},
    "choose": "step",
    "inputs": {"push": {"table": [[0.0, 1.0], [0.0, 1.0]]}},
    "estimates": {"names": ["mass"]},
}


@pytest.fixture(autouse=True)
def _without_earlier_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repeated_runs, "_KNOWN", {})


def told(run: mbdkit.Run) -> dict[str, Any]:
    counters = {name: value for name, value in run.stats.items() if not name.endswith("_s")}
    return {
        "data": run.data_sha256, "spec": run.spec_json, "id": run.run_id, "status": run.status_reason or run.status,
        "verdict": (run.verdict, run.verdict_reasons), "warnings": run.warnings, "counters": counters,
        "measures": dict(run.measures), "provenance": dict(run.provenance), "mechanism": run.mechanism.to_spec(),
    }  # fmt: skip


def outcome(compute: Callable[[dict[str, Any]], mbdkit.Run], data: dict[str, Any]) -> dict[str, Any]:
    """Return what a run tells, or the error that it raises."""
    try:
        return told(compute(data))
    except SpecError as error:
        return {"error": str(error)}


def ordinary(data: dict[str, Any]) -> dict[str, Any]:
    return outcome(lambda data: simulation.simulate(load_spec(data)), data)


def with_masses(mass: float) -> dict[str, Any]:
    return {**BASE, "model": {**BASE["model"], "masses": [1.0, mass]}}


def warm() -> None:
    for mass in range(1, FIRST + 2):
        mbdkit.run(with_masses(float(mass)))


def refuse(*_: object, **__: object) -> None:
    raise AssertionError("the run was computed in the ordinary way")


@pytest.mark.parametrize("key", sorted(CHANGES))
def test_a_run_with_another_value_of_a_key_is_that_of_a_process_without_earlier_runs(key: str) -> None:
    assert {*CHANGES} == {*RunSpec.model_fields}
    changed = {**BASE, key: CHANGES[key]}
    warm()
    expected = ordinary(changed)
    assert [outcome(mbdkit.run, changed) for _ in range(FIRST + 1)] == [expected] * (FIRST + 1)
    assert outcome(mbdkit.run, BASE) == ordinary(BASE)


def test_repeated_runs_with_other_numbers_equal_ordinary_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    masses = [0.2, 1.0, 1.5, 40.0]
    expected = [ordinary(with_masses(mass)) for mass in masses]
    warm()
    with monkeypatch.context() as patch:
        patch.setattr(simulation, "simulate", refuse)
        runs = [mbdkit.run(with_masses(mass)) for mass in masses]
    assert [told(run) for run in runs] == expected  # what is computed later comes from copies


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), float("inf"), 1e-320])
def test_a_wrong_number_is_refused_after_right_ones(mass: float) -> None:
    warm()
    with pytest.raises(SpecError) as repeated:
        mbdkit.run(with_masses(mass))
    with pytest.raises(SpecError) as alone:
        load_spec(with_masses(mass))
    assert str(repeated.value) == str(alone.value)


def test_warnings_are_printed_with_every_run(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(FIRST + 3):
        mbdkit.run({**BASE, "parameters": {"unused": 1.0}})
        assert "unused" in capsys.readouterr().err


def test_other_plugins_and_settings_of_the_environment_share_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    warm()
    monkeypatch.setattr(simulation, "simulate", refuse)
    mbdkit.run(BASE)
    for change in (
        lambda patch: patch.setattr(repeated_runs, "registry", object),
        lambda patch: patch.setenv("MBDKIT_STRICT_PLUGINS", "1"),
    ):
        with monkeypatch.context() as patch:
            change(patch)
            with pytest.raises(AssertionError, match="ordinary"):
                mbdkit.run(BASE)


def test_a_mapping_that_changes_after_its_runs_has_no_effect_on_them() -> None:
    data = with_masses(2.0)
    warm()
    run = mbdkit.run(data)
    expected = ordinary(with_masses(2.0))
    data["model"]["masses"][1] = 3.0
    assert told(run) == expected
