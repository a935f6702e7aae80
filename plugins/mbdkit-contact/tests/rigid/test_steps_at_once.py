"""Time-stepping runs with events and measures take many steps at once, with the bits of runs that take them singly."""

from __future__ import annotations

import pytest

import mbdkit
from mbdkit.integrators.loop.steps_ahead import StepsAhead


@pytest.mark.parametrize("method", ["moreau-jean", "nonsmooth-generalized-alpha"])
def test_many_steps_at_once_yield_the_same_bits_as_one_by_one(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> mbdkit.Run:
        events = {"seated": {"when": "contacts.seat.gap - 1e-4", "direction": "falling"}}
        return mbdkit.run(
            "sit-down", contact={"treatment": "time-stepping"}, integrator={"name": method}, events=events,
            time={"end": 2.0, "step": 2e-3}, output={"every": 5},
        )  # fmt: skip

    several = run()
    monkeypatch.setattr(StepsAhead, "of", lambda *_: None)
    single = run()
    assert len(several.events) > 0
    assert several.data_sha256 == single.data_sha256
    assert several.measures == single.measures
    assert several.impacts.time.tolist() == single.impacts.time.tolist()
