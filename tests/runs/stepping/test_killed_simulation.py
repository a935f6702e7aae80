"""What an archive holds when the process of an open simulation is killed, and when a policy misbehaves."""

import signal
import subprocess
import sys

import numpy as np
import pytest

import mbdkit
from tests.runs.stepping.driven_pendulum import driven_pendulum, sections

PROGRAM = """
import os, signal, sys
import mbdkit
from mbdkit.archive import writer
from tests.runs.stepping.driven_pendulum import driven_pendulum, sections
simulation = mbdkit.open(driven_pendulum(), sys.argv[1], **sections("rk4", end=1000.0))
writer.FLUSH_INTERVAL = 0.2
while os.path.getsize(sys.argv[1] + ".part") == 0 or simulation.time < 1.0:
    simulation.inputs["held"] = simulation.time % 1.0
    simulation.advance(0.01)
print(simulation.time, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_rows_that_were_written_survive_a_killed_process(tmp_path):
    told = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path / "killed.h5")], check=False, capture_output=True, text=True
    )
    assert told.returncode == -signal.SIGKILL, told.stderr
    with mbdkit.load(tmp_path / "killed.h5.part") as run:
        assert run.status == "running"
        assert 0.1 < run.time[-1] <= float(told.stdout)
        np.testing.assert_allclose(np.diff(run.time), 0.01, rtol=1e-9)
        changes = run.inputs["held"].set
        assert len(changes.time) > 10
        np.testing.assert_allclose(changes.value[1:], changes.time[1:] % 1.0, atol=1e-9)


def test_ctrl_c_in_a_program_keeps_the_record(tmp_path):
    def program() -> None:
        with mbdkit.open(driven_pendulum(), tmp_path / "stopped.h5", **sections("gauss")) as simulation:
            simulation.advance(0.1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        program()
    with mbdkit.load(tmp_path / "stopped.h5") as run:
        assert run.status == "interrupted"
        assert run.status_reason == "interrupted: stopped by Ctrl-C at t = 0.1 s."
        assert run.time[-1] == 0.1


def test_nan_of_a_policy_is_refused_and_the_simulation_goes_on():
    simulation = mbdkit.open(driven_pendulum(), **sections("rk4"))
    simulation.advance(0.1)
    for wrong in (float("nan"), np.array([1.0, 2.0]), None, "fast"):
        with pytest.raises(mbdkit.SpecError, match=r"^inputs.held: should be a"):
            simulation.inputs["held"] = wrong
    simulation.inputs["held"] = np.float32(1.0)
    simulation.advance(0.1)
    assert simulation.inputs["held"] == 1.0


def test_a_failed_step_is_an_error_and_a_failed_run():
    m = driven_pendulum()
    simulation = mbdkit.open(m, integrator={"name": "rk4"}, time={"end": 10.0, "step": 0.01}, limits={"max_steps": 25})
    simulation.advance(0.2)
    with pytest.raises(mbdkit.RunError, match=r"^max-steps: stopped after"):
        simulation.advance(0.2)
    with pytest.raises(mbdkit.SpecError, match="the simulation has ended: max-steps"):
        simulation.advance(0.2)
    run = simulation.finish()
    assert run.status == "failed"
    assert run.time[-1] == 0.25
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256


def test_a_guard_that_stops_the_last_step_of_an_advance_is_not_missed():
    limits = {"misalignment": 1e-9}
    simulation = mbdkit.open(driven_pendulum(), **sections("rk4", end=10.0), limits=limits)

    def program() -> None:
        for _ in range(900):
            simulation.advance(0.01)

    with pytest.raises(mbdkit.RunError, match=r"^fell-apart: "):
        program()
    run = simulation.finish()
    assert run.status == "failed"
    again = mbdkit.run(run.spec)
    assert again.status_reason == run.status_reason
    assert again.data_sha256 == run.data_sha256
