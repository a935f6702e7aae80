"""Errors of the largest recorded values cover the peaks between rows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

import mbdkit
from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.headlines import headlines, largest_loads
from mbdkit.archive.peak_errors import BETWEEN, excess_between_rows, jumps
from mbdkit.archive.run_summary import summary, summary_lines
from mbdkit.base.text import plus_minus
from tests.margins import assert_within


@pytest.mark.parametrize(("rows", "share"), [(4, 0.08), (6, 0.02), (10, 0.003)])
def test_the_peaks_of_random_sums_of_sines_are_covered(rows: int, share: float) -> None:
    """Three frequencies up to 1 Hz, in irregular rows, of which there are `rows` in a second."""
    random, missed, ratios = np.random.default_rng(7), 0, []
    frequencies = np.array([0.3, 0.6, 1.0])
    for _ in range(200):
        time = (np.arange(3 * rows) + random.uniform(-0.1, 0.1, 3 * rows)) / rows
        fine = np.linspace(time[0], time[-1], 2_001)
        size, phase = random.normal(size=3), random.uniform(0.0, 2.0 * math.pi, 3)
        curve, true = (np.sin(2.0 * math.pi * frequencies * t[:, None] + phase) @ size for t in (time, fine))
        excess, bar = np.max(true) - np.max(curve), excess_between_rows(time, curve[:, None])[0]
        missed += excess > bar + 1e-6
        ratios.append(bar / max(excess, 1e-9))
    assert missed <= share * 200
    assert np.median(ratios) < 2.2


def test_rows_at_equal_times_and_few_rows_are_no_peaks() -> None:
    time = np.array([0.0, 1.0, 1.0, 2.0])
    assert excess_between_rows(time, np.array([[0.0], [1.0], [1.0], [2.0]]))[0] == 0.0
    assert excess_between_rows(time[:2], np.array([[0.0], [1.0]]))[0] == 0.0


@pytest.mark.parametrize(("size", "share"), [(1.0, 0.02), (0.05, 0.01)], ids=["1 %", "0.05 %"])
def test_errors_are_shares_of_the_force_of_a_joint_or_of_a_thousandth_of_the_largest(size: float, share: float) -> None:
    # joint B carries `size` beside 100 N, with an error of 2 % of its force
    errors, zeros = np.array([[0.0, 0.02 * size]] * 2), np.zeros((2, 0, 3))
    found = Accuracy(np.array([0.0, 1.0]), zeros, zeros, errors, errors, 1.0, 4.0, "", 0.0)
    force = np.array([[[100.0, 0.0], [size, 0.0]]] * 2)
    worst = found.figures(["A", "B"], force).worst_joint
    assert worst is not None
    assert worst.share == pytest.approx(share)


@pytest.mark.parametrize("step", [0.05, 0.11, 0.17])
def test_the_largest_force_of_a_pendulum_between_rows_is_covered(step: float) -> None:
    """A uniform rod that falls from the horizontal has the force 5/2 m g in its lowest position."""
    run = mbdkit.run("pendulum", time={"end": 2.0, "step": step}, check=True)
    largest = largest_loads(run)[0]
    true = 2.5 * 9.81
    assert_within(true - largest.value, largest.bar.upper)  # margin: an error bar of mbdkit
    assert largest.bar.upper < 0.1 * true


@pytest.mark.parametrize("jump", [0.71, 0.749, 0.7001])
def test_a_jump_between_rows_is_no_peak_but_the_curves_reach_it(jump: float) -> None:
    """exp(t) is continued to the jump from the rows before it; a spline through the jump would be far above."""
    time = np.arange(21) * 0.05
    size = np.where(time < jump, np.exp(time), 0.1)[:, None]
    bar = excess_between_rows(time, size, [jump])[0]
    true = math.exp(jump) - math.exp(0.7)
    assert true <= bar <= 2.2 * true + 1e-4
    assert excess_between_rows(time, size)[0] > 0.1


def test_forces_that_jump_at_impacts_have_small_errors() -> None:
    """The legs of the walker carry their weight by turns, so that the force of each jumps at every step of the walk."""
    run = mbdkit.run("walker")
    assert len(run.impacts.time) == 2
    size = np.linalg.norm(run.joints["left_leg"].reaction_force, axis=1)[:, None]
    assert_within(excess_between_rows(run.time, size, jumps(run))[0], 1e-4 * size.max())


MASS, ARM, SPEED = 2.0, 0.5, 2.0 * math.pi


def _turning(measures: dict[str, str] | None = None, step: float = 0.005, **output: float) -> mbdkit.Run:
    """A crank that a motor turns once in a second; it starts at the top, where its force is smallest.

    The pin exerts the centripetal force m r w^2 and carries the weight m g, so that its force is between the difference
    and the sum of the two; the largest torque of the motor is m g r.
    """
    model = {
        "name": "mechanism",
        "bodies": {"crank": {"mass": MASS, "inertia": 0.1, "position": [0, ARM]}},
        "joints": {
            "pin": {"type": "revolute", "bodies": ["ground", "crank"], "at": [0, 0]},
            "motor": {"type": "driver", "bodies": ["ground", "crank"], "coordinate": "angle", "motion": "2*pi*t"},
        },
    }
    return mbdkit.run(
        {"mbdkit": 1, "model": model, "integrator": {"name": "gauss", "stages": 3}},
        time={"end": 3.0, "step": step}, output=output, check=True, measures=measures or {},
    )  # fmt: skip


@pytest.mark.parametrize("output", [{"every": 200}, {"interval": 1.0}])
def test_peaks_that_all_rows_miss_make_a_run_bad(output: dict[str, float]) -> None:
    """The rows show the same position of every turn, in which the force is smallest and the torque is zero."""
    run = _turning(**output)
    torque, force = largest_loads(run)
    turning, weight = MASS * ARM * SPEED**2, MASS * 9.81
    assert force.recorded == pytest.approx(turning - weight, rel=1e-9)
    assert force.value == pytest.approx(turning + weight, rel=1e-6)
    assert force.bar.upper == pytest.approx(2.0 * weight * BETWEEN / 200**2, rel=1e-3)
    assert torque.value == pytest.approx(weight * ARM, rel=1e-6)
    assert force.text() == "19.86 N in the recorded rows, 59.0984 +- 0.00098 N between them"
    assert run.verdict == "bad"
    assert "the force in joint 'pin' reaches 59.1 N, in the recorded rows 19.86 N" in run.verdict_reasons[0]


def test_a_largest_load_that_is_a_measure_has_the_error_of_the_measure_everywhere() -> None:
    """The rows show a torque of zero; the largest one, m g r, is known as well as the measure knows it."""
    run = _turning({"peak": {"value": "max(abs(joints.motor.torque))", "unit": "mN m"}}, every=200)
    error = run.measure_errors["peak"]
    torque = next(one for one in largest_loads(run) if one.element == "motor")
    assert torque.value == pytest.approx(MASS * 9.81 * ARM, abs=1e-3 * error)
    assert (*torque.bar, torque.recorded) == (1e-3 * error, 1e-3 * error, torque.value)
    told = next(text for label, text in summary_lines(run) if label == "drivers")
    assert told.startswith(f"largest torque of motor {plus_minus(MASS * 9.81 * ARM, 1e-3 * error)} N m at ")


def test_peaks_between_coarse_steps_are_covered_and_count_in_the_verdict() -> None:
    """Seven steps in a turn: the motor's torque m g r sin(2 pi t) is recorded up to 3 % below its largest value."""
    run = _turning(step=1.0 / 7.0)
    torque, force = largest_loads(run)
    for one, true in ((torque, MASS * 9.81 * ARM), (force, MASS * (ARM * SPEED**2 + 9.81))):
        assert one.recorded < 0.99 * true
        assert one.value == pytest.approx(true, rel=1e-6)
        assert one.bar.upper <= 1.01 * (true - one.recorded)
        assert_within(one.value - true, one.bar.upper)
    assert run.verdict == "doubtful"
    assert run.verdict_reasons[0].startswith("The step of 0.142857 s is 0.14 of the period of 1 s")
    assert "use smaller steps" in run.verdict_reasons[1]
    told = next(text for label, text in summary_lines(run) if label == "drivers")
    assert told.startswith(f"largest torque of motor {torque.recorded:.4g} N m in the recorded rows, 9.8 +- 0.25 N m")
    peak = mbdkit.workload(run)["motor"].load
    assert (peak.peak, peak.peak_error, peak.id) == (torque.value, torque.bar, torque.id)
    assert run.plot.torques().get_figure() is not None


def test_errors_are_unknown_if_rows_skip_steps_of_an_archive_without_largest_values() -> None:
    run = _turning(every=8)
    run.__dict__["integrals"] = {}
    size = np.linalg.norm(run.array("joints/reaction_force"), axis=2)
    largest = run.errors.of_largest("joints.force", run.joint_names, size, 0.0 * size)
    assert np.all(np.isnan(largest.bars))
    assert run.errors.sentence().startswith("positions known to")
    assert " N (error unknown) in the recorded rows\n" in summary(run)


def test_an_impact_between_rows_has_its_force_and_overlap() -> None:
    """A ball falls on a compliant floor; at the turn, its weight has done the work of the force k d^1.5."""
    mass, height, stiffness = 1.0, 0.2, 1e6
    ball = {"mass": mass, "inertia": 0.004, "position": [0.0, 0.1 + height]}
    floor = {
        "bodies": ["ground", "ball"],
        "shapes": [{"line": {"normal": [0.0, 1.0]}}, {"circle": {"radius": 0.1}}],
        "compliance": {"stiffness": stiffness},
    }
    run = mbdkit.run(
        {"mbdkit": 1, "model": {"name": "mechanism", "bodies": {"ball": ball}, "contacts": {"floor": floor}}},
        contact={"treatment": "compliant"}, integrator={"name": "dop853", "adaptive": True, "rtol": 1e-8},
        time={"end": 0.3}, output={"interval": 0.15}, check=True,
    )  # fmt: skip
    depth = brentq(lambda d: mass * 9.81 * (height + d) - 0.4 * stiffness * d**2.5, 1e-4, 0.1)
    (force,) = headlines(run)
    assert force.recorded == 0.0
    assert force.value == pytest.approx(stiffness * depth**1.5, rel=1e-6)
    assert f"floor overlaps by up to {depth:.3g} m between the recorded rows" in summary(run)
