"""Wrong runs stop or are flagged with their cause, right ones are not."""

from __future__ import annotations

import html
import math
from pathlib import Path
from typing import Any

import h5py
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import data_sha256, seal
from mbdkit.archive.info import describe
from mbdkit.methods.step_methods import StepMethod, StepState
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec import load_spec
from tests.margins import assert_within

from .mechanisms import cranks, guided_tip, spec, two_cranks

DOUBLE = {"name": "double-pendulum"}
RK4 = {"name": "rk4"}
LSODA = {"name": "scipy-lsoda", "rtol": 0.1, "atol": 0.1}
DOPRI5 = {"name": "dopri5", "adaptive": True}


@pytest.mark.parametrize(("integrator", "step"), [(RK4, 0.1), (LSODA, None)], ids=["rk4", "scipy-lsoda"])
def test_a_run_whose_joints_fall_apart_stops_before_that_row(integrator: dict[str, Any], step: float | None) -> None:
    # these runs were complete, with misalignments of 2.4 and 13.7 m; joints and centres of the two rods span 1.5 m
    with mbdkit.run(spec(DOUBLE, integrator, 10.0, step)) as run:
        assert run.status == "failed"
        assert run.status_reason.startswith("fell-apart: joint 'J")
        assert "more than limits.misalignment allows (1.5 m); this state is not recorded" in run.status_reason
        recorded = run.array("joints/misalignment").max()
        assert recorded <= run.misalignment_max <= 1.5
        assert run.verdict == "bad"
    with mbdkit.run(spec(DOUBLE, integrator, 10.0, step, limits={"misalignment": 1e6})) as run:
        assert (run.status, run.verdict) == ("complete", "bad")
        assert run.misalignment_max > 2.0


def test_advice_for_controlled_steps_speaks_of_tolerances() -> None:
    for integrator, step, advice in ((LSODA, None, "smaller tolerances"), (RK4, 0.1, "smaller steps")):
        with mbdkit.run(spec(DOUBLE, integrator, 10.0, step)) as run:
            assert f"this state is not recorded; use {advice} or" in run.status_reason
        with mbdkit.run(spec(DOUBLE, integrator, 10.0, step, limits={"misalignment": 1e6})) as run:
            (energy,) = (reason for reason in run.verdict_reasons if "energy balance is violated" in reason)
            assert f"use {advice} or a method of higher order" in energy


@pytest.mark.parametrize(("step", "is_named"), [(0.1, True), (0.04, True), (0.005, False)])
def test_a_step_too_long_for_an_oscillation_is_the_first_reason(step: float, is_named: bool) -> None:
    """A mass on a spring of stiffness (2 pi / T)^2 m oscillates with the period T = 0.2 s."""
    guide = {"type": "prismatic", "bodies": ["ground", "block"], "at": [0, 0], "axis": [1, 0]}
    spring = {"type": "spring-damper", "bodies": ["ground", "block"], "points": [[-1, 0], [0, 0]], "free_length": 1.0}
    model = {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"block": {"mass": 2.0, "inertia": 1.0, "position": [0.1, 0]}},
        "joints": {"guide": guide},
        "forces": {"spring": spring | {"stiffness": 2.0 * (2.0 * math.pi / 0.2) ** 2}},
    }
    with mbdkit.run(spec(model, RK4, 1.0, step)) as run:
        first = "".join(run.verdict_reasons[:1])
    assert (f"The step of {step:g} s is" in first) == is_named
    assert ("of the period of 0.2 s of the fastest motion" in first) == is_named


class Exploding(StepMethod):
    """Doubles all positions in every step, as an unstable method does in the end."""

    def step(self, problem: Any, t: float, state: StepState, h: float) -> StepState:
        return StepState(2 * state.q, state.v)


@pytest.mark.parametrize("every", [1, 1000])
def test_a_stopped_run_reports_no_misalignment_from_beyond_its_last_row(every: int) -> None:
    # a state between rows is recorded when a run stops there: it is refused too if its joints are apart
    from mbdkit.runs.run_record import Request, RunRecord, begin_arrays
    from mbdkit.runs.simulated_run import SimulatedRun
    from mbdkit.runs.simulation import measured_in

    given = load_spec(spec(DOUBLE, RK4, 2.0, 0.01, output={"every": every}), ())
    setup = RunSetup.of(given, method=Exploding())
    simulation = SimulatedRun(RunRecord(setup, Request(begin=begin_arrays, since=0.0, measured_in=measured_in)))
    simulation.integrate(None)
    with simulation.conclude() as run:
        assert run.status_reason.startswith("fell-apart: ")
        assert run.misalignment_max == run.array("joints/misalignment").max() <= 1.5
        assert run.verdict == "bad"


PARTING = {
    # rk4 ended complete with joints 4.5 m apart, the others 0.7 m
    "cranks, rk4": (two_cranks("0.7+0.5*t+3*max(0,t-0.25)**2"), RK4, 2.0, 0.05, 0.25, "B1"),
    "cranks, dopri5": (two_cranks("0.7+0.5*t+0.3*max(0,t-0.15)**2"), DOPRI5, 2.0, None, 0.16, "B1"),
    "tip, dopri5": (guided_tip("sin(t+0.3)+0.3*max(0,t-0.15)**3"), {**DOPRI5, "rtol": 1e-3}, 1.4, None, 0.15, "A"),
}


@pytest.mark.parametrize("case", PARTING)
def test_drivers_that_part_stop_the_run_at_once(case: str) -> None:
    model, integrator, end, step, latest, joint = PARTING[case]
    with mbdkit.run(spec(model, integrator, end, step)) as run:
        assert run.status_reason.startswith(f"singular: joint '{joint}' is misaligned by ")
        assert run.time[-1] <= latest
        assert_within(run.misalignment_max, 1e-9)
        assert run.verdict == "bad"


COARSE = [
    *((name, step, spares) for name in ("rk4", "rk-gill", "dopri5") for step, spares in ((0.02, 3), (0.05, 1))),
    *((name, step, 1) for name in ("gauss 1", "gauss 2", "radau-iia 2") for step in (0.05, 0.2)),
    *((name, 0.1, 3) for name in ("gauss 1", "gauss 2", "radau-iia 2")),
]
"""Methods, steps, and numbers of spare joints."""


@pytest.mark.parametrize(("name", "step", "spares"), COARSE)
def test_joints_that_agree_are_not_stopped_in_coarse_steps(name: str, step: float, spares: int) -> None:
    method, _, stages = name.partition(" ")
    integrator: dict[str, Any] = {"name": method, **({"stages": int(stages)} if stages else {})}
    model = cranks((0.0, 2.0, 0.7, 1.3, 2.5)[: 2 + spares])
    with mbdkit.run(spec(model, integrator, 4.0, step)) as run:
        assert run.redundancy
        assert run.status == "complete"


def hinged(stiffness: float) -> dict[str, Any]:
    """Return a rod on a pin with a torsion spring, released with a deflection."""
    body = {"rod": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}}
    pin = {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]}
    spring = {"type": "torsion-spring", "bodies": ["ground", "rod"], "stiffness": stiffness, "free_angle": 0.3}
    return {"name": "mechanism", "bodies": body, "joints": {"pin": pin}, "forces": {"spring": spring}}


def test_energy_from_nowhere_is_flagged_and_ends_the_run_only_under_its_limit() -> None:
    # at h omega = 2.4, below the limit 2.83 of rk4, each step loses a sixth of the energy
    stiffness = 0.35 * 240.0**2
    given = spec(hinged(stiffness), RK4, 0.2, 0.01, limits={"misalignment": 1e6})
    with mbdkit.run(given) as run:
        assert (run.status, run.verdict) == ("complete", "bad")
        assert any("in one step at t = " in reason for reason in run.verdict_reasons)
    given["limits"]["energy_jump"] = 0.05
    with mbdkit.run(given) as run:
        assert run.status_reason.startswith("energy-jump: the energy balance changes by ")
        assert len(run.time) < 21
        assert run.verdict == "bad"


def test_stabilization_is_not_blamed_for_the_energy_it_takes_in_a_step() -> None:
    given = spec(DOUBLE, {"name": "gauss", "stages": 1}, 2.0, 0.05, limits={"energy_jump": 1e-9})
    with mbdkit.run(given) as run:
        assert run.status_reason.startswith("energy-jump: ")
    with mbdkit.run({**given, "stabilization": {"name": "baumgarte", "alpha": 5, "beta": 5}}) as run:
        assert run.status == "complete"
        assert not any("in one step" in reason for reason in run.verdict_reasons)
    projected = spec(DOUBLE, {"name": "gauss", "stages": 2}, 2.0, 0.05, stabilization="projection")
    with mbdkit.run(projected) as run:
        assert run.status == "complete"
        assert not any("in one step" in reason for reason in run.verdict_reasons)


def test_a_mechanism_at_rest_with_its_centre_of_mass_at_the_origin_is_not_flagged_for_rounding() -> None:
    # the potential energy is zero, so that only the lengths of the rod give the level of rounding errors
    rod = {"mass": 10, "inertia": 0.1, "position": [0, 0], "angle": -1.2}
    pin = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0, 0.5]}
    model = {"name": "mechanism", "bodies": {"rod": rod}, "joints": {"pin": pin}}
    run = mbdkit.run(spec(model, {"name": "gauss", "stages": 2}, 0.5, 0.001), check=True)
    assert (run.verdict, run.verdict_reasons) == ("good", [])


def test_a_warning_is_kept_and_makes_the_run_doubtful_at_least(capfd: pytest.CaptureFixture[str]) -> None:
    given = spec(DOUBLE, RK4, 0.02, 0.01, stabilization={"name": "baumgarte", "alpha": 400, "beta": 400})
    with mbdkit.run(given) as run:
        (warning,) = run.warnings
        assert warning.startswith("Baumgarte's alpha = 400")
        assert warning in run.verdict_reasons
        assert run.verdict in ("doubtful", "bad")
        assert run.summary().count(warning) == 1
    assert f"warning: {warning}" in capfd.readouterr().err


def test_the_verdict_leads_every_account_of_a_run(tmp_path: Path) -> None:
    path = tmp_path / "apart.h5"
    with mbdkit.run(spec(DOUBLE, RK4, 10.0, 0.1, title="two rods"), archive=path) as run:
        first = "".join(run.verdict_reasons[:1])
        assert run.summary().splitlines()[0] == f"verdict       bad: {first}"
        assert "verdict bad" in repr(run)
        assert f"Verdict bad: {first}" in html.unescape(run._repr_html_())
    told = describe(path)
    assert (told["verdict"], told["verdict_reasons"][0]) == ("bad", first)
    assert check(path) == []


def test_archives_without_verdict_are_unknown_and_valid(tmp_path: Path) -> None:
    path = tmp_path / "old.h5"
    mbdkit.run(spec(DOUBLE, RK4, 0.1, 0.01), archive=path).close()
    with h5py.File(path, "r+") as file:
        assert file.attrs["verdict"] == "unknown"
        assert file.attrs["verdict_reasons"].shape == file.attrs["warnings"].shape == (0,)
        del file.attrs["warnings"]
        seal(file)
    assert check(path) == ["the verdict is incomplete: there is no attribute warnings"]
    with h5py.File(path, "r+") as file:
        del file.attrs["verdict"], file.attrs["verdict_reasons"]
        seal(file)
    assert check(path) == []
    with mbdkit.load(path) as run:
        assert (run.verdict, run.verdict_reasons, run.warnings, run.is_judged) == ("unknown", [], [], False)
        assert "verdict       unknown: the archive has none" in run.summary()


def test_the_verdict_is_no_part_of_the_data_hash(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    mbdkit.run(spec(DOUBLE, RK4, 0.1, 0.01), archive=path).close()
    with h5py.File(path, "r+") as file:
        file.attrs["verdict"] = "good"
        assert file.attrs["data_sha256"] == data_sha256(file)
        seal(file)
    assert check(path) == []
    with h5py.File(path, "r+") as file:
        file.attrs["verdict"] = "fine"
        seal(file)
    assert check(path) == ["verdict is 'fine', not one of good, unknown, doubtful, bad"]


def test_limits_reach_the_stepper_in_metres_and_radians() -> None:
    given = load_spec(spec(DOUBLE, RK4, 0.1, 0.01, limits={"misalignment": 0.1, "energy_jump": 0.2}), ())
    setup = RunSetup.of(given)
    found = setup.timetable().guards
    assert setup.size == 1.5
    assert found.misalignment == pytest.approx(0.15)
    assert (found.angle_misalignment, found.energy_jump) == (0.1, 0.2)


@pytest.mark.parametrize("torque", [50.0, "50*sin(t)"])
@pytest.mark.parametrize(("angle", "method"), [(0.0, "rk4"), (0.3, "radau-iia")])
def test_rounding_errors_of_a_held_arm_are_no_errors_of_its_energy_and_forces(
    torque: float | str, angle: float, method: str
) -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    place = 0.15 * math.cos(angle), 0.15 * math.sin(angle)
    arm = m.body("arm", mass=1.5, inertia=0.02, position=place, angle=angle)
    m.revolute("elbow", m.ground, arm, points=((0, 0), (-0.15, 0)))
    m.driver("hold", m.ground, arm, coordinate="angle", motion=angle)
    m.torque("load", arm, value=torque)
    sections: dict[str, Any] = {"integrator": {"name": method}, "time": {"end": 0.5, "step": 0.002}}
    assert mbdkit.run(m, **sections).verdict == "unknown"
    run = mbdkit.run(m, check=True, **sections)
    assert (run.verdict, run.verdict_reasons) == ("good", [])
    largest = 50.0 if isinstance(torque, float) else 50.0 * math.sin(0.5)
    assert abs(run.joints["hold"].reaction_torque).max() == pytest.approx(largest, rel=1e-12)
