"""Measures with abs, min and max, and extrema, are those of the motion between the ends of steps; so are gradients.

Exact values are those of the oscillator x = a cos(w t) with w = 2 and a = 1, until t = 4.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within
from tests.runs.oscillator import END, EXACT, TEXTS, A, W, oscillator, path, turns
from tests.slow_cases import slow


def measures(made: mbdkit.Run) -> np.ndarray:
    return np.array([made.measures[name] - exact for name, (_, exact, _) in EXACT.items() if exact is not None])


@pytest.mark.parametrize(
    ("integrator", "order", "step"),
    [
        ({"name": "rk4"}, 4, 0.1),
        ({"name": "gauss", "stages": 3}, 6, 0.2),
        ({"name": "radau-iia", "stages": 3}, 5, 0.2),
        ({"name": "dop853", "adaptive": False}, 8, 0.4),
    ],
)
def test_kinks_and_extrema_have_the_order_of_the_method(integrator: dict[str, Any], order: int, step: float) -> None:
    errors = [np.max(np.abs(measures(mbdkit.run(oscillator(integrator, h, measures=TEXTS))))) for h in (step, step / 2)]
    assert np.log2(errors[0] / errors[1]) > order - 0.7
    assert_within(errors[1], 1e-4)


@pytest.mark.parametrize(
    "integrator",
    [
        {"name": "dop853", "adaptive": True, "rtol": 1e-9},
        {"name": "dopri5", "adaptive": True, "rtol": 1e-9},
        {"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-9, "atol": 1e-9},
        {"name": "scipy-dop853", "rtol": 1e-10, "atol": 1e-10},
    ],
)
@pytest.mark.parametrize("output", [*slow({"every": 1}), {"every": 1000}])
def test_adaptive_methods_reach_their_tolerance(integrator: dict[str, Any], output: dict[str, Any]) -> None:
    assert_within(measures(mbdkit.run(oscillator(integrator, None, measures=TEXTS, output=output))), 2e-7)


def test_recorded_rows_do_not_matter() -> None:
    spec = oscillator({"name": "rk4"}, 0.05, measures=TEXTS)
    every = mbdkit.run(spec)
    assert mbdkit.run(spec | {"output": {"every": 1000}}).integrals == every.integrals
    assert mbdkit.run(spec | {"output": {"every": 7}}).integrals == every.integrals


def test_a_motion_that_stops_at_an_event_ends_there() -> None:
    # x = 0.2 at the first turn: neither the lowest point nor the largest speed is reached
    stop = {"events": {"at": {"when": "slider.x - 0.2", "action": "stop"}}}
    made = mbdkit.run(oscillator({"name": "gauss", "stages": 3}, 0.1, measures=TEXTS, **stop))
    end = turns(0.2)[0]
    assert made.measures["path"] == pytest.approx(A - 0.2, abs=1e-8)
    assert made.measures["lowest"] == pytest.approx(0.2, abs=1e-8)
    assert made.measures["peak"] == pytest.approx(W * np.sin(W * end), abs=1e-8)


@pytest.mark.parametrize("share", [1e-3, 1e-7])
@pytest.mark.parametrize("integrator", [{"name": "gauss", "stages": 4}, {"name": "dop853", "adaptive": False}])
def test_a_last_step_that_is_tiny_does_not_matter(integrator: dict[str, Any], share: float) -> None:
    # polynomials through ends of steps that are close to each other have no correct digits
    spec = oscillator(integrator, 0.1, measures=TEXTS | {"late": "at(slider.ax, 3.963)"})
    last = 0.1 * share
    made = mbdkit.run(spec | {"time": {"end": END + last, "step": 0.1}})
    assert made.measures["late"] == pytest.approx(-(W**2) * np.cos(W * 3.963), abs=1e-9)
    assert made.measures["path"] == pytest.approx(path() + last * W * abs(np.sin(W * END)), abs=4 * last**2 + 1e-9)
    assert made.measures["peak"] == pytest.approx(W * A, abs=1e-9)


def test_loads_with_corners_are_not_smoothed() -> None:
    # a constant force of 1 N that reverses at t = 0.55: v = t, then 1.1 - t, with its peak at the corner
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("block", mass=1.0)
    m.force("push", "block", value=("1 - 2*min(max(1e9*(t - 0.55), 0), 1)", 0.0))
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 2.0, "step": 0.25}}
    made = mbdkit.run(m, **sections, measures={"top": "max(block.vx)", "path": "integral(abs(block.vx))"})
    assert made.measures["top"] == pytest.approx(0.55, abs=1e-8)
    assert made.measures["path"] == pytest.approx(0.55**2 + 0.9**2 / 2, abs=1e-8)


@pytest.mark.parametrize(
    ("integrator", "step", "precision"),
    [
        ({"name": "gauss", "stages": 3}, 0.02, 1e-7),
        *slow(({"name": "dop853", "adaptive": True, "rtol": 1e-11}, None, 1e-7)),
    ],
)
def test_gradients_are_exact_and_those_of_the_numbers(
    integrator: dict[str, Any], step: float | None, precision: float
) -> None:
    spec = oscillator(integrator, step)
    found = mbdkit.gradient(spec, TEXTS, "model.bodies.slider.position.0")
    made = mbdkit.run(spec | {"measures": TEXTS})
    assert found.value == pytest.approx([made.measures[name] for name in TEXTS], rel=1e-12)
    for name, (_, _, slope) in EXACT.items():
        if slope is not None:
            assert found[name, "model.bodies.slider.position.0"] == pytest.approx(slope, abs=precision), name
    # the motion is proportional to its amplitude
    assert found["swing", "model.bodies.slider.position.0"] == pytest.approx(made.measures["swing"], rel=1e-7)
    assert found.check is not None
    assert found.check.is_passed
    assert found.doubts == ()


@pytest.mark.parametrize(
    ("measure", "word"),
    [
        ("max(abs(slider.x))", None),  # both ends of the swing move alike
        ("max(max(slider.x, -slider.x - 0.0))", None),
        ("max(max(slider.x, 1))", "both sides"),
        ("abs(min(slider.x) + 1)", "both sides"),
        ("integral(abs(slider.y))", None),
        ("abs(final(slider.x) - final(slider.x))", None),
    ],
)
def test_points_without_derivative_are_named(measure: str, word: str | None) -> None:
    spec = oscillator({"name": "gauss", "stages": 4}, 0.05)
    found = mbdkit.gradient(spec, measure, "model.bodies.slider.position.0", check=False)
    assert bool(found.doubts) == (word is not None)
    assert word is None or word in found.doubts[0]


@pytest.mark.parametrize("output", [*slow({"every": 1}), {"every": 1000}])
def test_values_at_times_of_events_and_other_results_are_those_of_the_motion(output: dict[str, Any]) -> None:
    # v = 1 at the first turn where sin(w t) = -1/(a w), x = -sqrt(a^2 - 1/w^2) there; the mean of t is its middle
    x = -np.sqrt(A**2 - 1 / W**2)
    found = {
        "at(slider.x, events.fast.time)": (x, A / x),
        "at(slider.vx, events.fast.last_time)": (1.0, 0.0),
        "at(slider.ax, final(t) - 0.11)": (-(W**2) * np.cos(W * (END - 0.11)), -(W**2) * np.cos(W * (END - 0.11))),
        "at(slider.x, mean(t))": (np.cos(W * END / 2), np.cos(W * END / 2)),
        "at(slider.x - mean(slider.x), 0.5)": (np.cos(W / 2) - np.sin(W * END) / (W * END),) * 2,
        "abs(at(slider.position, 0.777))": (abs(np.cos(W * 0.777)),) * 2,
    }
    events = {"fast": {"when": "slider.vx - 1"}, "never": {"when": "slider.x - 5"}}
    spec = oscillator({"name": "gauss", "stages": 3}, 0.05, events=events, output=output)
    missing = "at(slider.x, events.never.time)"
    made = mbdkit.run(spec | {"measures": {f"m{k}": text for k, text in enumerate([*found, missing])}})
    assert [*made.measures.values()][:-1] == pytest.approx([value for value, _ in found.values()], abs=1e-9)
    assert np.isnan(made.measures[f"m{len(found)}"])
    gradient = mbdkit.gradient(spec, list(found), "model.bodies.slider.position.0")
    assert gradient.jacobian[:, 0] == pytest.approx([slope for _, slope in found.values()], abs=1e-8)
    assert gradient.value == pytest.approx([*made.measures.values()][:-1], rel=1e-12)
    assert gradient.check is not None
    assert gradient.check.is_passed
    assert gradient.doubts == ()


def test_peaks_of_many_blocks_of_steps_are_compared() -> None:
    # 5000 steps: blocks without the largest value do not matter; exact values are those of the oscillator
    made = mbdkit.run(oscillator({"name": "dop853", "adaptive": False}, END / 5000, measures=TEXTS))
    assert_within(measures(made), 1e-11)


def test_a_run_that_stops_before_its_first_row_has_no_remark_on_its_measures() -> None:
    spec = {
        "mbdkit": 1,
        "model": {"name": "double-pendulum", "angles": [1.1, 0.3]},
        "integrator": {"name": "rk4"},
        "time": {"end": 0.4, "step": 0.01},
        "limits": {"misalignment": 1e-18},
        "measures": {"pull": "max(abs(joints.J1.force))"},
    }
    with mbdkit.run(spec) as run:
        assert run.status_reason.startswith("fell-apart")
        assert len(run.time) == 0
        assert not run.measures.remarks


def test_the_time_of_a_peak_just_after_the_start_has_no_errors_of_summed_positions() -> None:
    """A ball thrown up from y = 1 m with a speed v of some um/s peaks at v/g, which is also the derivative by v."""
    speeds = np.geomspace(1e-6, 1e-4, 8)
    names = [f"v{i}" for i in range(len(speeds))]
    bodies = {f"b{i}": {"mass": 1, "position": [i, 1], "velocity": [0, name]} for i, name in enumerate(names)}
    spec = {
        "mbdkit": 1, "parameters": dict(zip(names, speeds.tolist(), strict=True)),
        "model": {"name": "mechanism", "gravity": [0, -10], "bodies": bodies},
        "integrator": {"name": "gauss", "stages": 2}, "time": {"end": 0.004, "step": 0.002},
    }  # fmt: skip
    gradient = mbdkit.gradient(spec, [f"max({name}.y)" for name in bodies], names, check=False)
    # positions are rounded to 1e-16 m and differ by up to 5e-12 m where the peak is located, which moves it by 1e-11 s
    np.testing.assert_allclose(np.diag(gradient.jacobian), speeds / 10, rtol=0.0, atol=1e-10)
