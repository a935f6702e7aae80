"""Tests of the kind of specs."""

import pytest
from limited_run import load

import mbdkit
from mbdkit.plugin import simulate

SPEC = {
    "mbdkit": 1, "model": {"name": "double-pendulum"}, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}
}  # fmt: skip


def test_its_runs_are_computed_and_its_section_is_validated():
    run = simulate(load(SPEC | {"closed_within": 1e-3})).check()
    assert run.kind == "limited-run"
    with pytest.raises(mbdkit.SpecError, match="closed_within"):
        load(SPEC | {"closed_within": -1.0})
