"""The callback of a run's progress, and the messages of the logger `mbdkit`."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import mbdkit

LONG: dict[str, Any] = {
    "mbdkit": 1,
    "model": {"name": "n-pendulum", "n": 20},
    "integrator": {"name": "gauss", "stages": 2},
    "time": {"end": 50.0, "step": 0.001},
}


def test_progress_is_called_with_the_time_reached_and_the_end() -> None:
    seen: list[tuple[float, float]] = []
    mbdkit.run("pendulum", time={"end": 3.0, "step": 0.01}, progress=lambda time, end: seen.append((time, end)))
    assert seen[-1] == (3.0, 3.0)
    assert {end for _, end in seen} == {3.0}
    assert [time for time, _ in seen] == sorted(time for time, _ in seen)


def interrupt(time: float, end: float) -> None:
    raise KeyboardInterrupt


def test_keyboard_interrupt_in_the_callback_ends_the_run_as_ctrl_c_does(tmp_path: Path) -> None:
    with mbdkit.run(LONG, archive=tmp_path / "a.h5", progress=interrupt) as run:
        assert run.status == "interrupted"
        assert 0.0 < run.time[-1] < 50.0
    assert {path.name for path in tmp_path.iterdir()} == {"a.h5", "a.h5.checkpoint"}  # by which it can be resumed


def test_keyboard_interrupt_while_the_method_is_chosen_leaves_no_file(tmp_path: Path) -> None:
    spec = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "time": {"end": 1.0}, "accuracy": 1e-4}
    with pytest.raises(KeyboardInterrupt):
        mbdkit.run(spec, archive=tmp_path / "a.h5", progress=interrupt)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("check", [False, True])
@pytest.mark.parametrize("first", [True, False])
def test_another_exception_in_the_callback_is_raised_and_leaves_no_file(
    tmp_path: Path, check: bool, first: bool
) -> None:
    calls: list[float] = []

    def fail(time: float, end: float) -> None:
        calls.append(time)
        # in the run, or once it has ended: in a companion run if errors are estimated
        if first or time == end:
            raise ZeroDivisionError("of the user")

    spec = LONG | {"model": {"name": "n-pendulum", "n": 2}, "time": {"end": 2.0, "step": 0.01}, "check": check}
    with pytest.raises(ZeroDivisionError, match="of the user"):
        mbdkit.run(spec, archive=tmp_path / "a.h5", progress=fail)
    assert len([time for time in calls if first or time == 2.0]) == 1
    assert list(tmp_path.iterdir()) == []


def test_an_exception_in_a_companion_run_is_not_blamed_on_its_method(tmp_path: Path) -> None:
    ends: list[float] = []

    def fail(time: float, end: float) -> None:
        ends.extend([time] if time == end else [])
        if len(ends) == 2:
            raise ZeroDivisionError("of the user")

    with pytest.raises(ZeroDivisionError, match="of the user"):
        mbdkit.run("pendulum", check=True, archive=tmp_path / "a.h5", progress=fail)
    assert list(tmp_path.iterdir()) == []


def test_a_run_is_logged_from_start_to_end(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, logger="mbdkit"):
        run = mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01})
    told = [(record.name, record.levelname, record.getMessage()) for record in caplog.records]
    info = [message for name, level, message in told if level == "INFO" and name == "mbdkit.runs.simulation"]
    assert info[0].startswith(f"run {run.run_id} begins: mbdkit:")
    assert info[-1] == f"run {run.run_id} ends: complete, verdict unknown"
    assert any(level == "DEBUG" and "degree of freedom" in message for _, level, message in told)


def test_warnings_and_failed_runs_are_logged_as_warnings(caplog: pytest.LogCaptureFixture) -> None:
    spec = LONG | {"time": {"end": 1.0, "step": 0.01}, "limits": {"max_steps": 3}}
    spec["model"] = {"name": "n-pendulum", "n": 2, "angle": 45.0}
    run = mbdkit.run(spec)
    assert run.warnings
    warned = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warned[: len(run.warnings)] == run.warnings
    assert "failed: max-steps" in warned[-1]


def test_nothing_is_logged_to_the_terminal_unless_a_program_asks_for_it() -> None:
    code = "import mbdkit; mbdkit.run('pendulum', limits={'max_steps': 3})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "run " not in done.stdout + done.stderr
    assert "failed" not in done.stdout + done.stderr
