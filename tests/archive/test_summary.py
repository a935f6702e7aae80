"""The summary tells what matters and fits on a screen."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.headlines import headlines
from mbdkit.archive.layout import CORRECTIONS
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import Ending
from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import plus_minus

from .making import SPEC, STATS, largest, make, names, rows, steps, writer


def test_summary_of_a_complete_run(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", spec={**SPEC, "title": "two\nrods"})
    with load(tmp_path / "run.h5") as run:
        lines = run.summary().splitlines()
    off = np.abs(rows(11, names())["energy/balance"]).max()
    most = rows(11, names())["energy/kinetic"].max()
    force = np.linalg.norm(rows(11, names())["joints/reaction_force"], axis=2)
    rises = (force.argmax(axis=0) == 10) & (force[10] - force[0] > 0.01 * np.ptp(force, axis=0))
    when = np.where(rises, " at the end of the run", "")
    told = sorted(
        ((value, f"largest force in J{k + 1} {value:.6g} N{when[k]}") for k, value in enumerate(force.max(axis=0))),
        reverse=True,
    )
    turned = np.abs(rows(11, names())["joints/angle_misalignment"]).max(axis=0)
    assert lines == [
        "verdict       unknown: nothing suspicious seen; error not estimated",
        "run           two rods",
        f"answer        {'; '.join(text for _, text in told)}",
        "status        complete",
        "model         double-pendulum, 2 bodies, 2 joints",
        "integrator    gauss, stages 2, step 0.01 s, index-1",
        "time          0 to 0.1 s, 10 steps, 11 rows",
        "speed         2 ms (200 us a step), setup 250 ms",
        f"misalignment  1 m at most (J2 1, J1 1); {turned.max():.3g} rad (J{np.argmax(turned) + 1})",
        f"energy        balance within {off:.3g} J, {off / most:.2g} of the largest kinetic energy",
        (
            "counters      40 right-hand sides, 50 Jacobians, 60 factorizations, 70 iterations, 80 projections, 30 "
            "rejections"
        ),
        f"archive       {tmp_path / 'run.h5'}",
    ]


def test_speed_of_a_checked_run_is_the_cost_of_its_steps(tmp_path: Path) -> None:
    with mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}) as run:
        assert not {"integrals_s", "check_s"} & run.stats.keys()
    with mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}, check=True) as run:
        assert 0.0 < run.stats["integrals_s"] < run.stats["wall_s"]
        assert run.stats["check_s"] > 0.0
        assert {"reaction_force_error", "reaction_torque_error"} <= {*dir(run.joints["J1"])}
        np.testing.assert_array_equal(run.joints["J1"].reaction_force_error, run.accuracy.reaction_error[:, 0])
        np.testing.assert_array_equal(run.joints["J1"].reaction_torque_error, run.accuracy.torque_error[:, 0])
    into = writer(tmp_path / "run.h5")
    into.append(rows(11, names()))
    into.append_numbered("steps", steps(10))
    into.finish(Ending("complete", "", STATS | {"integrals_s": 0.0015, "check_s": 0.5}, largest(11, names())))
    with load(tmp_path / "run.h5") as run:
        (speed,) = (line for line in run.summary().splitlines() if line.startswith("speed"))
    assert speed == "speed         500 us (50 us a step), setup 250 ms, integrals and extrema 1.5 ms, check 500 ms"
    assert check(tmp_path / "run.h5") == []


def test_a_run_is_answered_by_its_measures_or_by_its_largest_forces() -> None:
    hanging = {"mbdkit": 1, "model": {"name": "single-pendulum", "mass": 2.0, "angle": -np.pi / 2}}
    hanging |= {"integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}
    at_rest = mbdkit.run(hanging)
    assert "kinetic energy" not in at_rest.summary()  # it is zero up to rounding, and so no measure of errors
    (weight,) = headlines(at_rest)
    assert weight.text() == "19.62 N"  # 2 kg at rest
    assert weight.label == "largest force in J1"
    measured = mbdkit.run(hanging, measures={"half": "final(t)/2"}, check=True)
    (half,) = headlines(measured)
    assert half.label == "half"
    assert half.text().startswith("0.05")
    assert "measures      half 0.05" in measured.summary()


def test_summary_of_a_failed_run_says_why() -> None:
    with Run(make(None, status="failed", reason="singular: the joints A and B bind at t = 0.02 s")) as run:
        assert "status        failed: singular: the joints A and B bind at t = 0.02 s" in run.summary()
        assert "archive       in memory" in run.summary()


def test_summary_leaves_out_what_was_not_recorded() -> None:
    with Run(make(None, quantities=frozenset(), named=names(1, 0))) as run:
        labels = [line.split()[0] for line in run.summary().splitlines()]
    assert labels == ["verdict", "status", "model", "integrator", "time", "speed", "counters", "archive"]


def test_summary_tells_of_stabilization_and_of_its_corrections() -> None:
    chosen = {"name": "projection", "every": 2, "bound": None, "symmetric": False}
    corrected = {
        "projections": [1] * 10,
        "position_correction": 1e-9 * np.arange(10.0),
        "velocity_correction": [2e-8] * 10,
    }
    into = writer(None, spec=SPEC | {"stabilization": chosen}, extra_datasets=CORRECTIONS["projection"])
    into.append(rows(11, names()))
    into.append_numbered("steps", {**steps(10), **{name: np.array(values) for name, values in corrected.items()}})
    with Run(into.finish(Ending("complete", "", STATS, largest(11, names())))) as run:
        told = "stabilization projection, every 2; 10 projections, moved by at most 9e-09 m and 2e-08 m/s"
        assert told in run.summary()
        np.testing.assert_array_equal(run.steps.position_correction, corrected["position_correction"])
        with pytest.raises(MbdkitError, match="acceleration_correction; its method, stabilization and events do"):
            _ = run.steps.acceleration_correction


def test_summary_names_the_worst_joints_of_many() -> None:
    with Run(make(None, named=names(9, 9))) as run:
        assert "misalignment  1.01 m at most (J9 1, J8 1, J7 1, J6 1, 5 more)" in run.summary()


def test_summary_says_how_near_a_run_came_to_a_singular_position() -> None:
    path = "constraints/singularity_distance"
    near = np.array([0.3, 0.2, 0.1, 0.05, 0.002, 0.03, 0.1, 0.2, 0.3, 0.4, 0.3])
    for distance, told in ((near, True), (near + 0.2, False), (near * 0 + 0.05, False)):
        into = writer(None, extra_datasets=[path])
        into.append(rows(11, names()) | {path: distance})
        into.append_numbered("steps", steps(10))
        with Run(into.finish(Ending("complete", "", STATS, np.full(2, 1.0)))) as run:
            np.testing.assert_array_equal(run.singularity_distance, distance)
            assert ("singularity   distance 0.002 at 0.04 s, maximum 0.4" in run.summary()) is told
            assert ("singularity" in run.summary()) is told


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (144.4242648, 3.4e-5, "144.42426 +- 3.4e-05"),
        (185.8112901234567, 4.4e-7, "185.8112901 +- 4.4e-07"),
        (185.8112901234567, 4.4e-9, "185.8112901 +- 5e-08"),  # rounding to ten digits changes it by up to 5e-8
        (146.853, 9.1e-13, "146.8530000 +- 5e-08"),
        (0.0, 0.0, "0"),
        (1.5, 0.0, "1.5"),
        (368.2, 0.3, "368.2 +- 0.3"),
        (368.2, 30.0, "368 +- 30"),
        (3597.3, 213.4, "3600 +- 210"),
        (1649.0, 1352.0, "1600 +- 1400"),
        (0.3, 0.5, "0.3 +- 0.5"),
        (431.7, 1813.0, "430 +- 1800"),
        (0.0312, 5.2, "0.03 +- 5.2"),
        (0.0, 1800.0, "0 +- 1800"),
        (-2.0, 1e-30, "-2.000000000 +- 5e-10"),
        (1.234567e-6, 2e-9, "1.235e-06 +- 2e-09"),
        (1.0, math.nan, "1 (error unknown)"),
        (math.inf, 1.0, "inf (error unknown)"),
    ],
)
def test_a_value_is_printed_with_the_digits_that_its_error_leaves(value: float, error: float, text: str) -> None:
    assert plus_minus(value, error) == text


def test_the_summary_tells_the_largest_torque_of_a_motor_and_force_of_a_driven_slide() -> None:
    # expected: I alpha at the start for a wheel whose angle is t^3 - t^2; m a at the end for a block at x = t^3
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    wheel = m.body("wheel", mass=1.0, inertia=0.5)
    block = m.body("block", mass=2.0, inertia=1.0, position=(1.0, 0.0))
    m.revolute("hub", m.ground, wheel, at=(0.0, 0.0))
    m.driver("motor", m.ground, wheel, coordinate="angle", motion="t**3 - t**2")
    m.prismatic("slide", m.ground, block, axis=(1.0, 0.0), at=(0.0, 0.0))
    m.driver("push", m.ground, block, coordinate="x", motion="1 + t**3")
    with mbdkit.run(m, integrator={"name": "gauss"}, time={"end": 0.5, "step": 0.01}) as run:
        assert run.drivers == ("motor", "push")
        told = next(line for line in run.summary().splitlines() if line.startswith("drivers"))
    assert told == "drivers       largest torque of motor 1 N m at 0 s; largest force in push 6 N at 0.5 s"


def test_the_summary_shows_gravity_as_the_spec_gives_it() -> None:
    spec: dict[str, Any] = {
        "mbdkit": 1,
        "parameters": {"slope": 0.1},
        "model": {"name": "single-pendulum", "gravity": ["9.81*sin(slope)", -9.0]},
        "time": {"end": 0.1, "step": 0.01},
        "integrator": {"name": "gauss"},
    }
    with mbdkit.run(spec) as run:
        assert "gravity       (9.81*sin(slope), -9.0), as in the spec" in run.summary()


@pytest.mark.parametrize(
    ("integrator", "step"), [({"name": "dop853", "adaptive": True}, None), ({"name": "gauss", "stages": 5}, 0.1)]
)
def test_a_peak_between_the_ends_of_long_steps_is_not_said_to_be_that_of_the_rows(integrator, step):
    # 5/2 m g at the lowest point, between two ends of steps
    rod = {"mass": 1.0, "inertia": 0.25 / 12, "position": [0.25, 0.0]}
    pin = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0.0, 0.0]}
    spec = {"mbdkit": 1, "model": {"name": "mechanism", "bodies": {"rod": rod}, "joints": {"pin": pin}}}
    spec |= {"integrator": integrator, "time": {"end": 1.0} | ({"step": step} if step else {})}
    (largest,) = headlines(mbdkit.run(spec))
    assert largest.value < 24.5
    assert largest.text().endswith(" N in the recorded rows")
    (largest,) = headlines(mbdkit.run(spec, check=True))
    assert largest.value == pytest.approx(2.5 * 9.81, rel=1e-3)
    assert not largest.is_at_end
    (largest,) = headlines(mbdkit.run("pendulum", time={"end": 1.0, "step": 0.0005}))
    assert largest.text() == "24.525 N"
