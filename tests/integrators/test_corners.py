"""Steps end at knots and corners of motions and loads; drivers whose rate jumps are refused or get an impulse.

Exact motions: a mass m = 1 on a spring k = 4 under a force F(t) = 3 max(0, t - c) along x, released at x = 0.3, moves
as x = 0.3 cos 2t + 3 (s - sin(2s) / 2) / 4 with s = max(0, t - c).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.runs.corners import stops_of
from mbdkit.spec import load_spec
from tests.integrators.step_methods import Remembering, RungeKutta, run_with
from tests.linkages import driven_crank
from tests.margins import assert_within

CORNER = 0.37123
DOP853 = {"name": "dop853", "adaptive": True, "rtol": 1e-10}
GAUSS = {"name": "gauss", "stages": 3}
ADAPTIVE = [
    DOP853,
    {"name": "dopri5", "adaptive": True, "rtol": 1e-10},
    {**GAUSS, "adaptive": True, "rtol": 1e-10},
    {"name": "radau-iia", "adaptive": True, "rtol": 1e-10},
    {"name": "scipy-dop853", "rtol": 1e-10},
    {"name": "scipy-radau", "rtol": 1e-10},
    {"name": "scipy-lsoda", "rtol": 1e-10},
]
FIXED = [{"name": "rk4"}, GAUSS, {"name": "radau-iia"}, {"name": "dop853"}]


def named(integrator: dict[str, Any]) -> str:
    """Return the name of a test."""
    return str(integrator["name"]) + ("-adaptive" if integrator.get("adaptive") else "")


def pushed(force: Any, **changes: Any) -> dict[str, Any]:
    """Return a free mass of 1 kg under a force along x."""
    body = {"mass": 1.0, "inertia": 1.0, **changes}
    forces = {"f": {"type": "force", "body": "a", "value": [force, 0.0]}}
    return {"name": "mechanism", "gravity": [0, 0], "bodies": {"a": body}, "forces": forces}


def oscillator() -> dict[str, Any]:
    """Return the mass on a spring of the head of this file."""
    model = pushed(f"3*max(0, t - {CORNER})", position=[0.3, 0.0])
    spring = {"type": "spring-damper", "bodies": ["ground", "a"], "points": [[-10, 0], [0, 0]]}
    model["forces"]["s"] = {**spring, "stiffness": 4.0, "damping": 0.0, "free_length": 10.0}
    return model


def displacement(t: np.ndarray) -> np.ndarray:
    """Return the exact displacement of the oscillator [m]."""
    s = np.maximum(0.0, t - CORNER)
    return 0.3 * np.cos(2 * t) + 0.75 * (s - np.sin(2 * s) / 2)


def run(model: Any, integrator: dict[str, Any], end: float, **rest: Any) -> mbdkit.Run:
    """Run a model."""
    time = {"end": end} | ({"step": rest.pop("step")} if "step" in rest else {})
    return mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **rest}).check()


def driven(motion: Any) -> dict[str, Any]:
    """Return a mass that is driven along x."""
    model = pushed(0.0)
    joint = {"type": "prismatic", "bodies": ["ground", "a"], "points": [[0, 0], [0, 0]], "axis": [1, 0]}
    driver = {"type": "driver", "bodies": ["ground", "a"], "coordinate": "x", "motion": motion}
    return {**model, "joints": {"p": joint, "d": driver}, "forces": {}}


# ---- loads ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("integrator", "order"), [(GAUSS, 6), ({"name": "rk4"}, 4), ({"name": "radau-iia"}, 5)])
def test_a_method_keeps_its_order_over_a_corner_of_a_load(integrator: dict[str, Any], order: int) -> None:
    errors = []
    for step in (0.2, 0.1, 0.05):
        with run(oscillator(), integrator, 2.0, step=step) as there:
            errors.append(np.max(np.abs(there["a"].position[:, 0] - displacement(there.time))))
    assert math.log2(errors[0] / errors[2]) / 2 > order - 0.4


@pytest.mark.parametrize("method", [RungeKutta(), Remembering()])
def test_a_method_in_python_keeps_its_order_over_a_corner_of_a_load(method: Any) -> None:
    errors = []
    for step in (0.2, 0.05):
        with run_with(method, oscillator(), {"end": 2.0, "step": step}) as there:
            assert there.check().time == pytest.approx(np.arange(round(2.0 / step) + 1) * step)
            assert there.stats["steps"] == round(2.0 / step) + 1
            errors.append(np.max(np.abs(there["a"].position[:, 0] - displacement(there.time))))
    assert math.log2(errors[0] / errors[1]) / 2 > 3.6


@pytest.mark.parametrize("integrator", FIXED, ids=named)
def test_a_fixed_step_is_split_and_the_rows_stay_on_the_grid(integrator: dict[str, Any]) -> None:
    with run(oscillator(), integrator, 1.0, step=0.1, output={"every": 2}) as there:
        assert there.time == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0], abs=1e-15)
        assert there.steps.steps.tolist() == [2, 3, 2, 2, 2]
        assert there.stats["steps"] == there.stats["accepted"] == 11
        assert there.energy.balance == pytest.approx(0.0, abs=2e-5)


def test_a_corner_on_the_grid_splits_no_step() -> None:
    with run(pushed("max(0, t - 0.3)"), GAUSS, 1.0, step=0.1) as there:
        assert there.stats["steps"] == 10
        exact = np.maximum(0.0, there.time - 0.3) ** 3 / 6
        assert there["a"].position[:, 0] == pytest.approx(exact, abs=1e-16)


@pytest.mark.parametrize("integrator", [*FIXED, *ADAPTIVE], ids=named)
def test_a_force_that_jumps_is_integrated_exactly(integrator: dict[str, Any]) -> None:
    jump = f"abs(t - {CORNER})/(t - {CORNER})"  # constant on both sides
    with run(pushed(jump), integrator, 1.0, step=0.1) as there:
        assert there["a"].velocity[-1, 0] == pytest.approx(1.0 - 2 * CORNER, abs=1e-13)
        s = 1.0 - CORNER
        assert there["a"].position[-1, 0] == pytest.approx(-0.5 * CORNER**2 - CORNER * s + 0.5 * s**2, abs=1e-9)


@pytest.mark.parametrize("integrator", ADAPTIVE, ids=named)
def test_adaptive_steps_do_not_jump_over_a_pulse(integrator: dict[str, Any]) -> None:
    # an area of 100 N * 0.05 s at t = 5 s; the mass then moves at 5 m/s
    with run(pushed("100*max(0,1-abs(t-5)/0.05)"), integrator, 10.0) as there:
        assert there["a"].velocity[-1, 0] == pytest.approx(5.0, rel=1e-9)
        assert there["a"].position[-1, 0] == pytest.approx(25.0, rel=1e-9)
        assert there.stats["accepted"] < 1000


@pytest.mark.parametrize("integrator", [GAUSS, {**GAUSS, "adaptive": True, "rtol": 1e-10}, DOP853], ids=named)
def test_rows_by_interval_are_right_on_both_sides_of_a_corner(integrator: dict[str, Any]) -> None:
    step = {} if integrator.get("adaptive") else {"step": 0.02}
    with run(oscillator(), integrator, 1.0, output={"interval": 0.013}, **step) as there:
        assert there["a"].position[:, 0] == pytest.approx(displacement(there.time), abs=1e-8)


@pytest.mark.parametrize("integrator", [GAUSS, {"name": "rk4"}, DOP853, ADAPTIVE[4]], ids=named)
def test_events_are_found_in_the_parts_of_a_split_step(integrator: dict[str, Any]) -> None:
    events = {name: {"when": f"t - {at}"} for name, at in (("before", 0.3705), ("after", 0.3745))}
    events["enough"] = {"when": "t - 0.3795", "action": "stop"}
    step = {} if integrator.get("adaptive") else {"step": 0.01}
    with run(oscillator(), integrator, 1.0, events=events, **step) as there:
        assert there.events.time == pytest.approx([0.3705, 0.3745, 0.3795], abs=1e-10)
        at = there.array("events/position")[:, 0, 0]
        assert at == pytest.approx(displacement(there.events.time), abs=1e-8)
        assert there.time[-1] == pytest.approx(0.3795, abs=1e-10)
        assert there.energy.balance == pytest.approx(0.0, abs=1e-7)


def test_knots_are_stops_but_for_those_on_the_grid_and_for_thousands() -> None:
    def stops(times: list[float], **time: float) -> tuple[float, ...]:
        table = {"table": [times, np.sin(times).tolist()]}
        integrator = GAUSS if "step" in time else DOP853
        spec = {"mbdkit": 1, "model": pushed(table), "integrator": integrator, "time": {"end": 1.0, **time}}
        return stops_of(load_spec(spec)).times

    knots = [0.0, 0.1, 0.25, 0.4, 1.0]
    assert stops(knots) == (0.1, 0.25, 0.4)
    assert stops(knots, step=0.1) == (0.25,)
    assert stops(np.linspace(0.0, 1.0, 6001).tolist()) == ()


# ---- the time at stops ---------------------------------------------------------------------------------------------


FLAT = "1e-30*max(sin(pi*t), sin(3*pi*t)/3)"
"""A corner at every whole number of seconds where the first three derivatives of both sides agree."""


@pytest.mark.parametrize("integrator", [GAUSS, {"name": "rk4"}, DOP853, ADAPTIVE[4], None], ids=str)
def test_steps_lose_no_time_at_corners(integrator: dict[str, Any] | None) -> None:
    # expected: a free body at 1 m/s, which a force of 1e-30 N does not move
    model = pushed(FLAT, velocity=[1.0, 0.0])
    time = {"end": 200.0} if integrator in ADAPTIVE else {"end": 200.0, "step": 0.4}
    if integrator is None:
        made = run_with(RungeKutta(), model, time)
    else:
        made = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time})
    with made as there:
        assert there.check().stats["steps"] > 200
        assert there["a"].position[-1, 0] == pytest.approx(200.0, abs=1e-10)


@pytest.mark.parametrize("integrator", [GAUSS, DOP853, None], ids=str)
def test_a_knot_just_before_the_end_does_not_take_the_last_row(integrator: dict[str, Any] | None) -> None:
    table = {"table": [[0, 0.5, 1.0 - 7e-15, 2], [0, 1, 0, 5]], "interpolation": "linear"}
    model = pushed(table)
    time = {"end": 1.0} if integrator is DOP853 else {"end": 1.0, "step": 0.3}
    output = {"every": 3}
    if integrator is None:
        made = run_with(RungeKutta(), model, time, output=output)
    else:
        made = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time, "output": output})
    with made as there:
        assert there.check().time[-1] == 1.0
        assert there["a"].velocity[-1, 0] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize(
    ("integrator", "output"),
    [
        *((one, {"every": 1}) for one in (GAUSS, {"name": "rk4"}, DOP853, ADAPTIVE[4], None)),
        *((one, {"interval": 0.25}) for one in (GAUSS, DOP853, ADAPTIVE[4])),  # methods with dense output
    ],
    ids=str,
)
def test_the_row_at_an_impact_has_time_and_velocities_of_one_side(
    integrator: dict[str, Any] | None, output: dict[str, Any]
) -> None:
    # expected: the rate of the driver, 1 m/s before the impact at 1 s and -1 m/s after it
    model = driven({"table": [[0, 1, 2], [0, 1, 0]], "interpolation": "linear"})
    time = {"end": 2.0} if integrator in ADAPTIVE else {"end": 2.0, "step": 0.25}
    if integrator is None:
        made = run_with(RungeKutta(), model, time, output=output, impacts="allow")
    else:
        spec = {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, "output": output}
        made = mbdkit.run({**spec, "impacts": "allow"})
    with made as there:
        there.check()
        assert_within(np.min(np.abs(there.time - 1.0)), 1e-12)
        assert there.joints["d"].velocity_misalignment == pytest.approx(0.0, abs=1e-9)
        before = there.time <= 1.0  # the row at the impact holds the limit from before
        assert there["a"].velocity[:, 0] == pytest.approx(np.where(before, 1.0, -1.0), abs=1e-9)


@pytest.mark.parametrize("integrator", ADAPTIVE[4:], ids=named)
def test_solvers_of_scipy_refuse_a_load_that_is_no_number_after_a_corner(integrator: dict[str, Any]) -> None:
    # without the check of the first rates, DOP853 chooses a step that is no number, and tries it for ever
    model = pushed("0*abs(t - 1) + sqrt(1 - t)")
    with mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 2.0}}) as there:
        expected = "not-finite: the value of a driver, a load or a moving center is not finite in step "
        assert there.status_reason.startswith(expected)
        assert "from t = 1 s" in there.status_reason
        assert there.time[-1] == pytest.approx(1.0)


# ---- max_step ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ADAPTIVE, ids=named)
def test_max_step_bounds_the_steps_so_that_a_smooth_pulse_is_found(integrator: dict[str, Any]) -> None:
    pulse = pushed("exp(-((t - 5)/0.02)**2)")
    with run(pulse, {**integrator, "max_step": 0.02, "rtol": 1e-8}, 6.0) as there:
        assert np.max(np.diff(there.time)) <= 0.02 * 1.01
        assert there["a"].velocity[-1, 0] == pytest.approx(0.02 * math.sqrt(math.pi), rel=1e-5)


def test_max_step_is_for_adaptive_steps_only() -> None:
    with pytest.raises(SpecError, match="takes `max_step` only with `adaptive: true`"):
        load_spec({"mbdkit": 1, "model": pushed(0.0), "integrator": {**GAUSS, "max_step": 0.1}, "time": {"end": 1.0}})


# ---- drivers -------------------------------------------------------------------------------------------------------


def spec_of(model: Any, integrator: dict[str, Any] = GAUSS, end: float = 2.0, **rest: Any) -> dict[str, Any]:
    """Return a spec with a step."""
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": end, "step": 0.01}, **rest}


def test_a_driver_whose_rate_jumps_is_refused_with_the_remedy() -> None:
    with pytest.raises(SpecError, match=r"jumps from 1 to 0 m/s at t = 1 s.*smooth the motion.*`impacts: allow`") as no:
        mbdkit.run(spec_of(driven("min(t,1)")))
    assert no.value.key == "model.joints.d.motion"
    line = {"table": [[0.0, 1.0, 2.0], [0.0, 1.0, 1.0]], "interpolation": "linear"}
    with pytest.raises(SpecError, match="the rate of this motion jumps"):
        mbdkit.run(spec_of(driven(line)))


def test_a_driver_whose_value_jumps_is_refused_in_any_case() -> None:
    for impacts in ("refuse", "allow"):
        with pytest.raises(SpecError, match=r"jumps from 3.14159 to -3.14159 m at t = 0.5 s.*atan2"):
            mbdkit.run(spec_of(driven("atan2(sin(2*pi*t), cos(2*pi*t))"), impacts=impacts))


def test_a_driver_may_start_and_end_at_a_corner_if_it_has_the_inner_side_there() -> None:
    with mbdkit.run(spec_of(driven("abs(t) + min(t, 2)"))) as there:
        assert there.check()["a"].velocity[:, 0] == pytest.approx(2.0)
    with pytest.raises(SpecError, match="at the start of the run, t = 0 s; write the motion that applies after this"):
        mbdkit.run(spec_of(driven("max(0, t)")))
    with pytest.raises(SpecError, match="at the end of the run, t = 2 s; write the motion that applies before this"):
        mbdkit.run(spec_of(driven("max(t, 2)")))


def test_a_driver_whose_acceleration_jumps_keeps_the_order() -> None:
    # x = max(0, t - c)^2: the first and last stage of a step see one side of the corner only
    for integrator in ({"name": "rk4"}, {"name": "radau-iia"}, GAUSS):
        with run(driven(f"max(0, t - {CORNER})**2"), integrator, 1.0, step=0.1) as there:
            exact = np.maximum(0.0, there.time - CORNER) ** 2
            assert there["a"].position[:, 0] == pytest.approx(exact, abs=1e-13)


def check_impulse(there: mbdkit.Run) -> None:
    """Check that one impulse of the driver brings 1 kg from 1 m/s to rest at 1.0037 s."""
    impacts = there.impacts
    assert (impacts.time.tolist(), impacts.contact.tolist()) == ([1.0037], ["d"])
    assert impacts.energy_lost == pytest.approx(0.5, abs=1e-8)
    assert impacts.reaction_impulse[0] == pytest.approx(np.array([[0.0, 0.0], [-1.0, 0.0]]), abs=1e-8)
    assert impacts.reaction_torque_impulse[0] == pytest.approx(0.0, abs=1e-12)


IMPACTS = [
    *((one, {}) for one in (*FIXED, *ADAPTIVE)),
    *(({"name": "radau-iia"}, {"formulation": name}) for name in ("index-2", "index-3", "ggl")),
    ({"name": "rk4"}, {"formulation": "joint-coordinates"}),
    ({"name": "rk4"}, {"stabilization": "projection"}),
    ({"name": "rk4"}, {"stabilization": "baumgarte"}),
    (GAUSS, {"stabilization": {"name": "projection", "symmetric": True}}),
    ({"name": "rattle"}, {"formulation": "index-3"}),
]


@pytest.mark.parametrize(("integrator", "rest"), IMPACTS)
def test_an_allowed_impact_gives_the_velocities_after_the_corner(
    integrator: dict[str, Any], rest: dict[str, Any]
) -> None:
    spec = spec_of(driven("min(t, 1.0037)"), integrator, impacts="allow", **rest)
    with mbdkit.run(spec) as there:
        there.check()
        after = there.time > 1.0037
        assert there["a"].velocity[after, 0] == pytest.approx(0.0, abs=1e-8)
        assert there["a"].velocity[~after & (there.time < 1.0037), 0] == pytest.approx(1.0, abs=1e-8)
        assert there["a"].position[-1, 0] == pytest.approx(1.0037, abs=1e-9)
        assert there.energy.work[-1] == pytest.approx(-0.5, abs=1e-8)  # of the impulse
        assert there.energy.balance == pytest.approx(0.0, abs=1e-8)
        check_impulse(there)


def test_an_allowed_impact_gives_the_velocities_after_the_corner_to_methods_in_python() -> None:
    for method in (RungeKutta(), Remembering()):
        spec = spec_of(driven("min(t, 1.0037)"))
        with run_with(method, spec["model"], spec["time"], impacts="allow") as there:
            there.check()
            assert there["a"].position[-1, 0] == pytest.approx(1.0037, abs=1e-12)
            assert there.energy.work[-1] == pytest.approx(-0.5, abs=1e-12)
            check_impulse(there)


def test_impulses_of_joints_change_the_momenta_of_their_bodies() -> None:
    # A rod pinned to the tip of a driven crank, which stops. The impulse at the pin has no moment about it, so that it
    # follows from the change of the velocities of the rod, and those of the bearing and the motor from the crank's.
    model = driven_crank(0.5) | {"gravity": [0, 0]}
    integrator = {**GAUSS, "adaptive": True, "rtol": 1e-12}
    spec = {"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 1.0}, "impacts": "allow"}

    def ended(end: float) -> tuple[np.ndarray, np.ndarray]:
        with mbdkit.run(spec | {"time": {"end": end}}) as there:
            there.check()
            assert len(there.impacts) == (end > 0.5)
            q, v = (there.array(f"trajectory/{name}")[-1] for name in ("position", "velocity"))
            return q, v

    def moment(angle: float, force: np.ndarray) -> float:
        """Return the moment about the center of a body of a force at its second end."""
        return float(0.5 * (math.cos(angle) * force[1] - math.sin(angle) * force[0]))

    q, v0 = ended(0.5)  # a run that ends at the corner has the velocities before it
    change = ended(0.5 + 1e-9)[1] - v0
    assert change[0, 2] == pytest.approx(-2.0, abs=1e-9)
    pin = 2.0 * change[1, :2]
    assert np.linalg.norm(pin) > 0.5
    assert 0.3 * change[1, 2] == pytest.approx(-moment(q[1, 2], pin), abs=1e-7)
    bearing = change[0, :2] + pin
    motor = 0.1 * change[0, 2] + moment(q[0, 2], pin) + moment(q[0, 2], bearing)
    with mbdkit.run(spec) as there:
        assert there.check().energy.balance == pytest.approx(0.0, abs=1e-9)
        impacts = there.impacts
        assert impacts.joint.tolist() == ["A", "B", "D"]
        assert impacts.reaction_impulse[0] == pytest.approx(np.array([bearing, pin, [0.0, 0.0]]), abs=1e-7)
        assert impacts.reaction_torque_impulse[0] == pytest.approx(np.array([0.0, 0.0, motor]), abs=1e-7)
        assert "1 (D 1), impulses of joints up to" in there.summary()


# ---- tables and specs ----------------------------------------------------------------------------------------------


# ---- quintic and periodic tables -----------------------------------------------------------------------------------

KNOTS = [-0.5, 0.0371, 0.4113, 0.7317, 1.0531, 1.3919, 1.7673, 2.5]
"""Times of a table, none of which is on the grids below [s]."""


def quintic(ends: str = "clamped") -> dict[str, Any]:
    values = [math.sin(3.0 * t) for t in KNOTS]
    return {"table": [KNOTS, values], "interpolation": "quintic", "ends": ends}


@pytest.mark.parametrize(
    ("integrator", "stops_of_a_load", "stops_of_a_driver"), [({"name": "rk4"}, 0, 0), (GAUSS, 6, 6), (DOP853, 6, 6)]
)
def test_steps_end_at_knots_of_a_quintic_table_only_where_the_method_needs_it(
    integrator: dict[str, Any], stops_of_a_load: int, stops_of_a_driver: int
) -> None:
    time = {"end": 2.0} if integrator.get("adaptive") else {"end": 2.0, "step": 0.1}
    for model, stops in ((pushed(quintic()), stops_of_a_load), (driven(quintic()), stops_of_a_driver)):
        spec = load_spec({"mbdkit": 1, "model": model, "integrator": integrator, "time": time})
        assert stops_of(spec).times == pytest.approx([t for t in KNOTS if 0 < t < 2][:stops])


@pytest.mark.parametrize(("integrator", "order"), [({"name": "rk4"}, 4), (GAUSS, 6), ({"name": "radau-iia"}, 5)])
def test_a_method_keeps_its_order_over_the_knots_of_a_quintic_load(integrator: dict[str, Any], order: int) -> None:
    # expected: the spline of SciPy, integrated twice; the mass is at rest at the start
    curve = make_interp_spline(*quintic()["table"], k=5, bc_type=([(1, 0.0), (2, 0.0)],) * 2)
    once, twice = curve.antiderivative(), curve.antiderivative(2)
    errors = []
    for step in (0.2, 0.1):
        with run(pushed(quintic()), integrator, 2.0, step=step) as there:
            exact = twice(there.time) - twice(0.0) - there.time * once(0.0)
            errors.append(np.max(np.abs(there["a"].position[:, 0] - exact)))
    assert math.log2(errors[0] / errors[1]) > order - 0.5 or errors[1] < 1e-12


def test_a_periodic_table_goes_on_beyond_its_end_and_its_knots_repeat() -> None:
    # expected: two integrals of a sine whose table has one period; a cubic spline with steps of 1/48 of the period
    # differs from the sine by at most 5/384 (2 pi / 48)^4 = 4e-6, and the integrals by less
    times = np.linspace(0.0, 0.5, 49)
    table = {"table": [times.tolist(), np.sin(4 * np.pi * times).tolist()], "ends": "periodic"}
    spec = {"mbdkit": 1, "model": pushed(table), "integrator": GAUSS, "time": {"end": 3.0, "step": 0.07}}
    stops = stops_of(load_spec(spec)).times
    assert stops[:3] == pytest.approx([0.5 / 48 * k for k in (1, 2, 3)])
    assert len(stops) > 250
    with mbdkit.run(spec).check() as there:
        w = 4 * np.pi
        exact = there.time / w - np.sin(w * there.time) / w**2
        assert there["a"].position[:, 0] == pytest.approx(exact, abs=4e-6)
        assert there.warnings == []


def test_a_table_that_does_not_repeat_is_told_at_its_key() -> None:
    table = {"table": [[0.0, 1.0, 2.0], [0.0, 1.0, 0.5]], "ends": "periodic"}
    with pytest.raises(SpecError, match=r"forces\.f\.value\[0\]\.ends: the first and the last value of a periodic"):
        load_spec({"mbdkit": 1, "model": pushed(table), "integrator": GAUSS, "time": {"end": 3.0, "step": 0.07}})
