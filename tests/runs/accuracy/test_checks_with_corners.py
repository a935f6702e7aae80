"""Companions of a check end their steps at knots and corners, and take the same impulses as the run.

The crank of a linkage is driven, and its rate jumps; a pinned rod follows. Expected: the same motion by Gauss with six
stages and a tenth of the step, whose rows at the corner are on the same side as those of the run.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.runs.accuracy.companion import finer
from mbdkit.runs.accuracy.companion_choice import choose_companions
from mbdkit.runs.preparation import RunSetup, timetable
from mbdkit.spec import load_spec
from tests.linkages import driven_crank
from tests.margins import assert_within
from tests.slow_cases import slow

SIX = {"name": "gauss", "stages": 6}
DOP853 = {"name": "dop853", "adaptive": True, "rtol": 1e-7}


def spec_of(integrator: dict[str, Any], corner: float = 0.5, step: float | None = 0.01, **rest: Any) -> dict[str, Any]:
    """Return the spec of a checked run of the linkage."""
    time = {"end": 1.0} | ({} if step is None else {"step": step})
    model = driven_crank(corner)
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, "impacts": "allow", **rest}


CASES: list[tuple[dict[str, Any], float | None, dict[str, Any]]] = [
    ({"name": "rk4"}, 0.01, {}),
    ({"name": "gauss", "stages": 2}, 0.01, {}),
    ({"name": "gauss", "stages": 2}, 0.01, {"output": {"interval": 0.05}}),
    ({"name": "radau-iia", "stages": 2}, 0.01, {"formulation": "index-3"}),
    ({"name": "rk4"}, 0.0004, {"output": {"every": 50}}),
    (DOP853, None, {"output": {"interval": 0.05}}),
    ({"name": "radau-iia", "adaptive": True, "rtol": 1e-6}, None, {"output": {"interval": 0.05}}),
    ({"name": "scipy-radau", "rtol": 1e-6}, None, {"output": {"interval": 0.05}}),
]


@pytest.mark.parametrize("corner", [0.5037, *slow(0.5)])
@pytest.mark.parametrize(("integrator", "step", "rest"), CASES)
def test_errors_are_known_through_an_impact(
    integrator: dict[str, Any], step: float | None, rest: dict[str, Any], corner: float
) -> None:
    with mbdkit.run(spec_of(integrator, corner, step, check=True, **rest)) as there:
        found = there.check().accuracy
        assert found is not None
        assert found.is_complete, found.method
        fine = 0.001 if step is None else step / 10
        if step is None or "interval" in rest.get("output", {}):
            output: dict[str, Any] = {"interval": 0.05}
        else:
            output = {"every": 10 * rest.get("output", {}).get("every", 1)}
        with mbdkit.run(spec_of(SIX, corner, fine, output=output)) as exact:
            np.testing.assert_allclose(there.time, exact.check().time, rtol=0, atol=1e-12)
            for name in ("position", "velocity"):
                path = f"trajectory/{name}"
                error = np.maximum.accumulate(np.abs(there.array(path) - exact.array(path)).max(axis=(1, 2)))
                estimate = np.maximum.accumulate(there.array(f"accuracy/{name}_error").max(axis=(1, 2)))
                assert_within(error, 3 * estimate + 1e-11)
                assert error[-1] >= estimate[-1] / 30 - 1e-11


def test_errors_of_an_adaptive_run_are_known_through_an_impact_at_its_own_rows() -> None:
    # expected: rows next to the corner show the side before it, at the time before it
    for integrator in (DOP853, {"name": "radau-iia", "adaptive": True, "rtol": 1e-6}):
        with mbdkit.run(spec_of(integrator, 0.5037, None, check=True)) as there:
            found = there.check().accuracy
            assert found is not None
            assert found.is_complete, found.method
            assert float(np.max(there.array("accuracy/velocity_error"))) < 1e-3


KNOTS = ([0.0, 0.21, 0.4, 0.777, 1.0], [0.0, 1.0, -2.0, 0.5, 0.0])
TABLE = {"table": list(KNOTS), "interpolation": "linear"}


def pushed() -> dict[str, Any]:
    """Return a mass on a spring under a force with knots."""
    return {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"a": {"mass": 1.0, "inertia": 1.0, "position": [0.3, 0.0]}},
        "forces": {
            "f": {"type": "force", "body": "a", "value": [TABLE, 0.0]},
            "s": {"type": "spring-damper", "bodies": ["ground", "a"], "points": [[-10, 0], [0, 0]], "stiffness": 4.0,
                  "damping": 0.0, "free_length": 10.0},
        },
    }  # fmt: skip


def displacement(t: np.ndarray) -> np.ndarray:
    """Return the exact motion x'' + 4 x = F of `pushed`: F is a sum of ramps that begin at the knots."""
    x = 0.3 * np.cos(2 * t)
    slopes = np.diff(KNOTS[1]) / np.diff(KNOTS[0])
    for knot, slope in zip(KNOTS[0], np.diff(slopes, prepend=0.0), strict=False):
        s = np.maximum(0.0, t - knot)
        x += slope * (s - np.sin(2 * s) / 2) / 4
    return x


@pytest.mark.parametrize(
    ("integrator", "time"),
    [
        ({"name": "rk4"}, {"end": 0.95, "step": 0.05}),
        ({"name": "gauss", "stages": 2}, {"end": 0.95, "step": 0.05}),
        (DOP853, {"end": 0.95}),
        ({"name": "dopri5", "adaptive": True}, {"end": 0.95}),
        ({"name": "scipy-dop853", "rtol": 1e-6, "atol": 1e-6}, {"end": 0.95}),
    ],
)
def test_companions_stop_at_knots_and_estimate_the_true_error(integrator: dict[str, Any], time: Any) -> None:
    data = {"mbdkit": 1, "model": pushed(), "integrator": integrator, "time": time, "check": True}
    spec = load_spec(data)
    with mbdkit.run(data) as there:
        accuracy = there.check().accuracy
        assert accuracy is not None
        assert accuracy.is_complete, accuracy.method
        error = np.maximum.accumulate(np.abs(there["a"].position[:, 0] - displacement(there.time)))
        estimate = np.maximum.accumulate(there.array("accuracy/position_error")[:, 0, 0])
        assert_within(error, 3 * estimate + 1e-13)
        times = there.time
    chosen = choose_companions(RunSetup.of(spec), times, 100)
    inner = [t for t in KNOTS[0][1:-1] if time.get("step") is None or round(t / 0.05, 9) % 1]
    assert chosen.guards
    for companion in (*chosen.finer, *chosen.guards):
        assert set(inner) <= set(companion.timetable.stops) <= set(KNOTS[0])


def test_guards_stop_at_smooth_knots_on_the_grid_of_the_run_too() -> None:
    # a knot of a cubic table that a fixed step meets needs no stop there, but does in steps of other sizes
    model = pushed()
    model["forces"]["f"]["value"][0] = {"table": [[0.0, 0.25, 0.5, 1.0], [0.0, 1.0, -1.0, 0.0]]}
    time = {"end": 1.0, "step": 0.05}
    spec = load_spec({"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": time})
    assert timetable(spec, None).stops == ()
    chosen = choose_companions(RunSetup.of(spec), np.linspace(0, 1, 21), 20)
    assert all(companion.timetable.stops == (0.25, 0.5) for companion in chosen.guards)


def test_companions_of_a_run_that_ended_early_have_no_stops_beyond_its_end() -> None:
    spec = load_spec(spec_of({"name": "rk4"}, 0.5037))
    plan = timetable(spec, None)
    assert plan.stops == plan.impacts == (0.5037,)
    for end in (0.3, 0.5037 - plan.stop_margins[0]):
        early = finer(plan, np.array([0.0, end]), 2)
        assert early.stops == early.impacts == ()
        chosen = choose_companions(RunSetup.of(spec), np.array([0.0, end]), 50)
        assert all(companion.timetable.stops == () for companion in (*chosen.finer, *chosen.guards))
