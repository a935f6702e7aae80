"""Reports begin with the verdict on the run."""

from __future__ import annotations

from pathlib import Path

import h5py

import mbdkit
from mbdkit.archive.fingerprint import attributes_sha256
from mbdkit_report import Answer, run_report
from mbdkit_report.pages.run_verdict import run_verdict
from tests.trust.mechanisms import spec

DOUBLE, RK4 = {"name": "double-pendulum"}, {"name": "rk4"}


def test_a_run_that_stopped_is_bad_at_first_sight() -> None:
    with mbdkit.run(spec(DOUBLE, RK4, 10.0, 0.1)) as run:
        verdict = run_report(run).verdict
    assert verdict.claims[0].computed == "bad"
    assert verdict.sentence.startswith("The verdict is bad. The run stopped at")


def test_a_complete_run_that_is_bad_has_an_alarm() -> None:
    with mbdkit.run(spec(DOUBLE, {"name": "rk-gill"}, 2.0, 0.05)) as run:
        assert (run.status, run.verdict) == ("complete", "bad")
        assert run_report(run).alarm == "VERDICT: BAD"


def test_energy_is_conserved_to_rounding_errors_of_the_sizes_of_bodies() -> None:
    # the potential energy is zero, so that only the lengths of the rod give the level of rounding errors
    rod = {"mass": 10, "inertia": 0.1, "position": [0, 0], "angle": -1.2}
    pin = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0, 0.5]}
    model = {"name": "mechanism", "bodies": {"rod": rod}, "joints": {"pin": pin}}
    run = mbdkit.run(spec(model, {"name": "gauss", "stages": 2}, 0.5, 0.001), check=True)
    assert [claim.answer for claim in run_verdict(run).claims if claim.name == "energy"] == [Answer.YES]


def test_an_archive_without_verdict_is_reported_as_that(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    mbdkit.run(spec(DOUBLE, RK4, 0.1, 0.01), archive=path).close()
    with h5py.File(path, "r+") as file:
        del file.attrs["warnings"], file.attrs["verdict"], file.attrs["verdict_reasons"]
        file.attrs["attributes_sha256"] = attributes_sha256(file)
    with mbdkit.load(path) as run:
        assert "The archive contains no verdict" in run_report(run).verdict.sentence
