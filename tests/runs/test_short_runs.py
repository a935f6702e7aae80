"""Repeated short runs, in which what does not depend on numbers is reused, have the results of single runs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.runs import short_runs, simulation

TIME = {"end": 0.1, "step": 0.01}


def pendulum(**numbers: Any) -> dict[str, Any]:
    return {"mbdkit": 1, "model": {"name": "double-pendulum", **numbers}, "integrator": {"name": "rk4"}, "time": TIME}


def oscillator(stiffness: float, damping: float, joint: Any = None, **sections: Any) -> dict[str, Any]:
    """Return a rod with a spring; a second joint at the same point is redundant, one elsewhere closes a loop."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1, inertia=0.1, position=(0.5, 0))
    m.revolute("A", m.ground, rod, at=(0, 0))
    if joint is not None:
        m.revolute("B", m.ground, rod, at=joint)
    points = ((0.0, 1.0), (0.5, 0.0))
    m.spring_damper("s", m.ground, rod, points=points, stiffness=1.0, free_length=1.0)
    model = m.to_spec()
    model["forces"]["s"] |= {"stiffness": stiffness, "damping": damping}
    return {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": TIME} | sections


def varied() -> Iterator[dict[str, Any]]:
    """Yield specs that differ in numbers, also those that change the structure or make a run fail."""
    for mass in (1.0, 1.1, 1e-9, 1e9, 1):
        yield pendulum(masses=[1.0, mass])
    for angles in ([0.0, -0.0], [-0.0, 0.0], [0, 3.0], [100.0, 0.1], [57.0, 90.0]):
        yield pendulum(angles=angles)
    yield pendulum(gravity=[0, 0])
    yield pendulum(rates=[1e4, -1e4])  # the guards stop it
    yield pendulum(lengths=[1e-3, 1e3])
    for stiffness, damping in ((10, 0), (10, 1), (0, 0), (0, 1), (-10, 0), (10, 0), (1e7, 0), (10, -0.0)):
        yield oscillator(stiffness, damping)
    redundant, loop = oscillator(10, 0, (0, 0)), oscillator(10, 0, (1, 0))
    yield from (redundant, loop, redundant, loop, oscillator(10, 0))
    yield oscillator(10, 0, parameters={"unused": 1})
    yield oscillator(10, 0, measures={"peak": "max(rod.vx)"})
    yield oscillator(10, 0, time={"end": 0.1, "step": 0.2})
    yield pendulum() | {"integrator": {"name": "dop853", "adaptive": True}}
    yield pendulum() | {"integrator": {"name": "gauss", "stages": 2}}
    yield pendulum() | {"stabilization": {"name": "projection"}}


def result_of(spec: dict[str, Any], capfd: pytest.CaptureFixture[str]) -> tuple[object, ...]:
    """Return everything of a run but its times, with what it prints on stderr."""
    try:
        run = mbdkit.run(spec)
    except SpecError as error:
        return (str(error),)
    stats = {name: value for name, value in run.stats.items() if not name.endswith("_s")}
    says = run.status, run.status_reason, run.verdict, run.verdict_reasons, run.warnings, repr(dict(run.measures))
    hashes = run.data_sha256, run.spec_sha256, run.run_id
    return hashes, says, stats, dict(run.provenance), capfd.readouterr().err


def test_runs_again_have_the_results_of_single_runs(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    specs = [*varied()]
    with monkeypatch.context() as patched:
        patched.setattr(simulation, "run_again", lambda *_: None)
        single = [result_of(spec, capfd) for spec in specs]
    again: list[bool] = []

    def run_again(*given: Any) -> Any:
        again.append((run := short_runs.run_again(*given)) is not None)
        return run

    monkeypatch.setattr(simulation, "run_again", run_again)
    for spec, expected in [*zip(specs, single, strict=True)] * 3:
        assert result_of(spec, capfd) == expected
    assert sum(again) > 1.5 * len(specs)  # of those computed three times
