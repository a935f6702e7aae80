"""Pulses, breaks and jumps between the collocation points of predictions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

import mbdkit
from mbdkit_predict.grid import IntervalGrid
from predict.drawn_jumps import effort_of_phases, least
from predict.exact_optima import EFFORT, PUSH, block, swing_up
from tests.margins import assert_within

TRIANGLE = {"table": [[0, 0.5166, 0.5206, 0.5246, 1], [0, 0, 1000, 0, 0]], "interpolation": "linear"}
SWITCHED = "max(0, 1000*(1 - abs(t - 0.5206)/0.004))"
WIDE: dict[str, Any] = {"controls": {PUSH: {"bounds": [-200, 200]}}}


def loaded(value: Any, **sections: Any) -> dict[str, Any]:
    return block(forces={"load": {"type": "force", "body": "block", "value": [value, 0]}}, **WIDE | sections)


def pushed(impulse: float, at: float) -> float:
    """Return the least effort with a pulse that is symmetric about a time `at`, of 1 kg by 1 m in 1 s.

    Double integration is linear: the control reaches what the pulse misses, a distance x and a velocity v from rest,
    with 12 x^2 - 12 x v + 4 v^2.
    """
    x, v = 1.0 - impulse * (1.0 - at), -impulse
    return 12.0 * x**2 - 12.0 * x * v + 4.0 * v**2


@pytest.mark.parametrize(
    ("value", "impulse", "at", "intervals"),
    [
        (TRIANGLE, 4.0, 0.5206, 20),
        (f"{SWITCHED} + 0*block.vx", 4.0, 0.5206, 20),  # an expression of the state
        ("1000*exp(-((t - 0.52)/0.0005)**2)", 0.5 * np.pi**0.5, 0.52, 20),
        # no effect to first order: the multiplier of the force vanishes at half time
        ("1000*exp(-((t - 0.5)/0.0005)**2)", 0.5 * np.pi**0.5, 0.5, 21),
    ],
)
def test_a_short_pulse_belongs_to_the_optimum(value: Any, impulse: float, at: float, intervals: int) -> None:
    run = mbdkit.predict(loaded(value, collocation={"intervals": intervals}))
    assert (run.status, run.verdict) == ("complete", "good")
    assert_within(run.objective - pushed(impulse, at), run.objective_error)
    assert run.objective_error < 2e-7 * run.objective


@pytest.mark.slow
def test_no_drawn_pulse_is_skipped_with_a_good_verdict() -> None:
    # widths from 1/10000 of the motion on, some 2 of the nodes at which equations are evaluated
    random, good = np.random.default_rng(68), 0
    for _ in range(60):
        width, at, force = 10.0 ** random.uniform(-4, -2), random.uniform(0.1, 0.9), random.uniform(-1000, 1000)
        method, points = [("radau", 2), ("radau", 3), ("radau", 5), ("gauss", 2), ("gauss", 3)][random.integers(5)]
        collocation = {"method": method, "points": points, "intervals": int(random.integers(5, 30))}
        run = mbdkit.predict(loaded(f"{force}*exp(-((t - {at})/{width})**2)", collocation=collocation))
        is_right = abs(run.objective - pushed(force * width * np.pi**0.5, at)) <= run.objective_error
        assert is_right or run.verdict == "doubtful", (force, at, width, collocation, run.objective)
        good += run.verdict == "good"
    assert good > 24


def test_a_pulse_of_a_measured_function_belongs_to_the_objective() -> None:
    # the optimum is 12 as before, and the integral of the pulse is added: 1000 exp(-(t/w)^2) by its spline, whose
    # points are 1e-4 s apart
    times = np.concatenate([[0.0, 0.2, 0.4], np.linspace(0.5, 0.51, 101), [0.6, 0.8, 1.0]])
    values = np.exp(-(((times - 0.505) / 5e-4) ** 2))
    table = {"table": [times.tolist(), (1e4 * values).tolist()], "interpolation": "cubic"}
    run = mbdkit.predict(block(measured={"pulse": table}, minimize=f"{EFFORT} + integral(measured.pulse)"))
    assert run.objective == pytest.approx(12.0 + 5.0 * np.pi**0.5, rel=1e-5)


@pytest.mark.parametrize(
    ("value", "collocation"),
    [
        ("-5*(1 + tanh(1e6*(block.x - .5)))", {}),
        ("-5*(1 + tanh(1e8*(block.x - .5)))", {}),
        ("-5*(1 + tanh(1e7*(block.x - .5)))", {"method": "gauss", "intervals": 20}),
        ("-5*(1 + (block.x - .5)/sqrt((block.x - .5)**2))", {"points": 2}),
        ("-.5*(1 + (block.vx - .6)/abs(block.vx - .6))", {"points": 5, "intervals": 8}),
    ],
)
def test_a_jump_that_the_motion_passes_is_doubtful(value: str, collocation: dict[str, Any]) -> None:
    # the optimum with a jump at 0.5 is 17.39; on these meshes, the derivative of the load is zero at all points
    run = mbdkit.predict(loaded(value, collocation=collocation))
    assert run.verdict == "doubtful"
    assert "`model.forces.load.value[0]` jumps, or almost jumps, at t = 0." in run.verdict_reasons[0]


def test_a_jump_of_the_integrand_is_doubtful() -> None:
    by_place = mbdkit.predict(block(minimize=f"{EFFORT} + integral(max(0, min(5, 1e8*(block.x - .4))))"))
    assert by_place.verdict_reasons[0].startswith("An integrand of `minimize` jumps")


def test_a_doubt_about_a_jump_does_not_advise_what_was_given() -> None:
    cost = f"integral(controls['{PUSH}']**2*(2.5 + 1.5*(block.x - .5)/abs(block.x - .5))) + 10*final(t)"
    free: dict[str, Any] = {"duration": {"bounds": [0.3, 5.0]}, "minimize": cost}
    advice = "give `switching: auto`"
    assert advice in mbdkit.predict(block(**free)).verdict_reasons[0]
    assert not any(advice in reason for reason in mbdkit.predict(block(**free, switching="auto")).verdict_reasons)


@pytest.mark.slow
def test_a_jump_at_a_time_of_a_free_duration_is_doubtful() -> None:
    free: dict[str, Any] = {"duration": {"bounds": [0.5, 2.0]}, "minimize": f"{EFFORT} + 10*final(t)"}
    by_time = mbdkit.predict(loaded("-2*tanh(1e8*(t - .4))", **free))
    assert "`model.forces.load.value[0]` jumps, or almost jumps, at t = 0.4 s" in by_time.verdict_reasons[0]


def test_jumps_that_no_change_of_the_motion_moves_are_no_doubts() -> None:
    # at a time of a fixed duration; at the position and the velocity of the start; and corners
    for value, optimum in (
        ("-2*(1 + tanh(1e8*(t - .5)))", pushed(-2.0, 0.75)),
        ("-2*tanh(1e8*(block.x + .5*block.vx))", None),
        ("-abs(block.x - .4)", None),
    ):
        run = mbdkit.predict(loaded(value))
        assert run.verdict == "good", run.verdict_reasons
        assert optimum is None or abs(run.objective - optimum) <= run.objective_error


@pytest.mark.parametrize(
    ("size", "steepness", "collocation"),
    [
        (0.5, 1e4, {}),
        (0.5, 1e5, {"points": 5, "intervals": 10}),
        pytest.param(5.0, 1e4, {}, marks=pytest.mark.slow),
        pytest.param(5.0, 1e5, {"method": "gauss"}, marks=pytest.mark.slow),
    ],
)
def test_friction_that_almost_jumps_at_rest_counts(size: float, steepness: float, collocation: dict[str, Any]) -> None:
    # from rest to rest, the effort is the integral of the squares of acceleration and friction, because that of their
    # product is a change of a potential; a^2 minus the square of the friction is the constant Hamiltonian, so that the
    # layers at both ends, of velocities of about 1/steepness, change 12 + size^2 by twice the integral of 2 (a - 6) dv
    layer, _ = quad(lambda x: 6.0 - np.sqrt(36.0 - (size / np.cosh(x)) ** 2), 0.0, 40.0)
    run = mbdkit.predict(loaded(f"-{size}*tanh({steepness}*block.vx)", collocation=collocation))
    assert run.verdict == "good", run.verdict_reasons
    assert_within(run.objective - (12.0 + size**2 - 4.0 * layer / steepness), run.objective_error)


def test_friction_without_a_value_at_rest_has_the_optimum_of_gauss_points() -> None:
    # 12 by the acceleration and 0.25 by the friction; the guess from which others begin is at rest
    friction = "-.5*block.vx/abs(block.vx)"
    run = mbdkit.predict(loaded(friction, collocation={"method": "gauss"}))
    assert run.verdict == "good", run.verdict_reasons
    assert_within(run.objective - 12.25, run.objective_error)
    run = mbdkit.predict(loaded(friction))  # the last Radau point is at rest
    assert run.verdict == "doubtful" or abs(run.objective - 12.25) <= run.objective_error


def by_way_of(x: float, at: float) -> float:
    """Return the least effort of 1 kg from rest at 0 to rest at 1 m in 1 s that is at x or beyond at a time `at`.

    It is that of two cubics, whose common speed is free.
    """

    def effort(speed: float) -> float:
        first, second = (x, speed, at), (1.0 - x - speed * (1.0 - at), -speed, 1.0 - at)
        return sum(12.0 * d**2 / t**3 - 12.0 * d * w / t**2 + 4.0 * w**2 / t for d, w, t in (first, second))

    return 12.0 if at**2 * (3.0 - 2.0 * at) >= x else float(minimize_scalar(effort, (0.0, 3.0)).fun)


@pytest.mark.parametrize(
    ("width", "at", "collocation", "is_table"),
    [
        (1e-3, 0.4137, {}, False),
        (1e-5, 0.3331, {"points": 2}, True),
        pytest.param(5e-4, 0.377, {"method": "gauss"}, False, marks=pytest.mark.slow),
        pytest.param(2e-2, 0.3054, {"points": 5}, True, marks=pytest.mark.slow),
    ],
)
def test_a_narrow_condition_holds_between_the_points(
    width: float, at: float, collocation: dict[str, Any], is_table: bool
) -> None:
    gate, sections = f"block.x - 0.9*exp(-((t - {at})/{width})**2)", WIDE
    if is_table:
        table = {
            "table": [[0.0, at - width, at, at + width, 1.0], [0.0, 0.0, 0.9, 0.0, 0.0]],
            "interpolation": "linear",
        }
        gate, sections = "block.x - measured.gate", WIDE | {"measured": {"gate": table}}
    run = mbdkit.predict(block(subject_to={"gate": {"value": gate, "min": 0}}, collocation=collocation, **sections))
    assert run.verdict == "good", run.verdict_reasons
    near = np.linspace(-1.0, 1.0, 4001) * width
    heights = 0.9 * (np.maximum(0.0, 1.0 - abs(near) / width) if is_table else np.exp(-((near / width) ** 2)))
    exact = max(by_way_of(x, at + s) for x, s in zip(heights, near, strict=True))
    assert_within(run.objective - exact, run.objective_error)


def test_what_is_exceeded_within_the_tolerance_is_part_of_the_error() -> None:
    # the touching point is 3e-8 s beside the nearest collocation point, and finer meshes move neither
    width, at, inner = 0.00012611585657113306, 0.3585103665305121, np.linspace(-4.0, 4.0, 33)
    times = [0.0, 0.5 * (at - 4.0 * width), *(at + width * inner).tolist(), 0.5 * (1.0 + at + 4.0 * width), 1.0]
    values = [0.0, 0.0, *(0.5589730948495801 * np.exp(-(inner**2))).tolist(), 0.0, 0.0]
    sections: dict[str, Any] = {"measured": {"bar": {"table": [times, values]}}, "collocation": {"intervals": 16}}
    sections |= {"controls": {PUSH: {"bounds": [-500, 500]}}}
    run = mbdkit.predict(block(subject_to={"gate": {"value": "block.x - measured.bar", "min": 0}}, **sections))
    bar = CubicSpline(times, values)
    exact = max(by_way_of(float(bar(at + s)), at + s) for s in 1e-3 * width * np.linspace(-1.0, 1.0, 2001))
    assert run.verdict == "good", run.verdict_reasons
    assert_within(run.objective - exact, run.objective_error)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1e-5, 1e-3, 1e-1])
def test_a_hurdle_in_space_is_right_or_doubtful(width: float) -> None:
    hurdle = {"value": f"dot.y - 0.36*exp(-((dot.x - 0.49)/{width})**2)", "min": 0}
    rest = {f"dot.{name}": 0 for name in ("x", "y", "vx", "vy")}
    push = {"push": {"type": "force", "body": "dot", "value": [0.0, 0.0]}}
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": {"dot": {"mass": 1.0}}, "forces": push}
    run = mbdkit.predict(
        {
            "mbdkit_predict": 1, "base": {"model": model}, "duration": 1.0, "initial": rest, "minimize": EFFORT,
            "controls": {f"forces.push.value[{k}]": {"bounds": [-200, 200]} for k in (0, 1)},
            "final": rest | {"dot.x": 1}, "subject_to": {"hurdle": hurdle}, "limits": {"wall_time": 20},
        }
    )  # fmt: skip
    # by way of 0.36 m at half time, 192 y^2, a lower bound but for the shift of the time and of the summit
    assert run.verdict == "doubtful" or run.objective > 0.99 * (12.0 + 192.0 * 0.36**2)


FREE = {"bounds": [0.1, 0.9]}
PUSHED_BACK = "-5*(1 + tanh(1e6*(block.x - .5)))"
BY_HAND: dict[str, Any] = {
    "duration": None, "final": {"block.x": 1, "block.vx": 0, "t": 1.0},
    "phases": [{"duration": FREE, "final": {"block.x": 0.5}}, {"duration": FREE}],
}  # fmt: skip
AUTO = {"switching": "auto"}


@pytest.mark.parametrize(
    ("value", "sections", "exact"),
    [
        (PUSHED_BACK, AUTO, "place"),
        pytest.param(PUSHED_BACK, BY_HAND, "place", marks=pytest.mark.slow),
        pytest.param("-10*max(0, min(1, 1e8*(block.x - .5)))", AUTO, "place", marks=pytest.mark.slow),
        ("-.5*(1 + (block.vx - .911)/abs(block.vx - .911))", AUTO, "speed"),
    ],
)
def test_a_jump_at_the_end_of_a_phase_is_right(value: str, sections: dict[str, Any], exact: str) -> None:
    right = {
        # x = 0.5 ends the first phase, after a time T with a velocity v; a force of -10 N acts in the second one
        "place": lambda: least(
            lambda y: effort_of_phases([y[0], 1.0], [(0.5, y[1]), (1.0, 0.0)], [0.0, -10.0]), [[0.6, 1.0]]
        ),
        # a force of -1 N acts while the velocity is above 0.911 m/s, from T on, symmetric about half time
        "speed": lambda: least(
            lambda y: effort_of_phases([y[0], y[1], 1.0], [(y[2], 0.911), (y[3], 0.911), (1.0, 0.0)], [0.0, -1.0, 0.0]),
            [[0.2, 0.8, 0.1, 0.9]],
        ),
    }[exact]()
    run = mbdkit.predict(loaded(value, **sections))
    assert run.verdict == "good", run.verdict_reasons
    assert_within(run.objective - right, run.objective_error)


@pytest.mark.slow
def test_a_condition_whose_jump_is_no_factor_of_its_own_is_kept() -> None:
    # a limit of the velocity beyond 0.4713 m only, by an expression that is no constant on either side
    slow = "block.vx*(block.x - .4713)/sqrt((block.x - .4713)**2 + 1e-14)"
    collocation = {"intervals": 10, "points": 3}
    run = mbdkit.predict(
        block(**AUTO, tolerance=1e-3, collocation=collocation, subject_to={"slow": {"value": slow, "max": 1.2}})
    )
    block_speed, beyond = run["block"].velocity[:, 0], run["block"].position[:, 0] > 0.48
    assert np.max(block_speed[beyond]) < 1.21


@pytest.mark.slow
def test_two_jumps_that_pass_at_once_in_the_wrong_order_are_doubtful() -> None:
    # two blocks that know nothing of each other; the best times of their jumps are 0.1996 s and 0.2974 s,
    # and those of the first motion are equal
    rail = {name: {"type": "prismatic", "bodies": ["ground", name], "at": [0, 0], "axis": [1, 0]} for name in "ab"}
    push = {f"push_{name}": {"type": "force", "body": name, "value": [0, 0]} for name in "ab"}
    load = {
        f"load_{name}": {"type": "force", "body": name, "value": [f"-{size}*tanh(1e6*({name}.x - .5))", 0]}
        for name, size in {"a": 40, "b": 20}.items()
    }
    bodies = {name: {"mass": 1.0, "inertia": 1.0} for name in "ab"}
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": bodies, "joints": rail, "forces": push | load}
    state = {f"{name}.{key}": 0 for name in "ab" for key in ("x", "vx")}
    run = mbdkit.predict(
        {
            "mbdkit_predict": 1, "base": {"model": model}, "duration": 1.0, "initial": state,
            "final": state | {"a.x": 1, "b.x": 1}, "collocation": {"method": "gauss", "points": 3, "intervals": 10},
            "controls": {f"forces.push_{name}.value[0]": {"bounds": [-200, 200]} for name in "ab"},
            "minimize": "integral(forces.push_a.value**2 + forces.push_b.value**2)", "tolerance": 1e-5, **AUTO,
            "limits": {"wall_time": 20},
        }
    )  # fmt: skip
    exact = 960.8547 + 188.4093  # minima of closed segments over times and speeds of the crossings
    assert run.verdict != "good" or abs(run.objective - exact) < 3.0 * run.objective_error


@pytest.mark.parametrize("mass", [1e-6, 1e6])
def test_objectives_of_any_magnitude_have_bars_of_their_size(mass: float) -> None:
    # the moment is proportional to the mass, and the objective to its square
    def swing(mass: float) -> mbdkit.Run:
        model = {
            "name": "mechanism", "gravity": [0, -9.81],
            "bodies": {"bob": {"mass": mass, "inertia": 0.1 * mass, "position": [0, -1]}},
            "joints": {"pin": {"type": "revolute", "bodies": ["ground", "bob"], "points": [[0, 0], [0, 1]]}},
            "forces": {"motor": {"type": "torque", "body": "bob", "value": 0.0}},
        }  # fmt: skip
        return mbdkit.predict(
            {
                "mbdkit_predict": 1, "base": {"model": model}, "duration": 2.0,
                "controls": {"forces.motor.value": {"bounds": [-20 * mass, 20 * mass]}},
                "initial": {"bob.angle": 0, "bob.angular_velocity": 0},
                "final": {"bob.angle": 3.14159, "bob.angular_velocity": 0},
                "minimize": "integral(forces.motor.value**2)",
            }
        )  # fmt: skip

    whole, other = swing(1.0), swing(mass)
    assert (whole.verdict, other.verdict) == ("good", "good")
    size = mass**2
    assert_within(other.objective - size * whole.objective, other.objective_error + size * whole.objective_error)
    assert other.objective_error < 1e-6 * other.objective


@pytest.mark.parametrize("coordinates", ["joint", "absolute"])
def test_a_point_mass_swings_up_about_its_cart_or_is_refused(coordinates: str) -> None:
    # the swing-up of a cart-pole whose bob is a point at a distance from the cart
    model = {
        "name": "mechanism", "bodies": {"cart": {"mass": 1, "inertia": 1}, "bob": {"mass": 0.3, "position": [0, -0.5]}},
        "joints": {
            "rail": {"type": "prismatic", "bodies": ["ground", "cart"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
            "rod": {"type": "distance", "bodies": ["cart", "bob"], "points": [[0, 0], [0, 0]], "length": 0.5},
        },
        "forces": {"push": {"type": "force", "body": "cart", "value": [0, 0]}},
    }  # fmt: skip
    rest = {"cart.vx": 0, "bob.vx": 0}
    run = mbdkit.predict(
        {
            "mbdkit_predict": 1, "base": {"model": model}, "duration": 2.0, "minimize": EFFORT,
            "controls": {PUSH: {"bounds": [-20, 20]}}, "initial": {"cart.x": 0, "bob.x": 0, "bob.y": -0.5, **rest},
            "final": {"cart.x": 1, "bob.x": 1, "bob.y": 0.5, **rest}, "limits": {"wall_time": 30},
            "collocation": {"intervals": 10}, "coordinates": coordinates,
        }
    )  # fmt: skip
    if coordinates == "joint":  # the local optimum of the rod of `cart-pole`
        assert run.verdict == "good", run.verdict_reasons
        assert_within(run.objective - swing_up(5, 80), run.objective_error)
        return
    assert (run.status, run.verdict) == ("failed", "bad")
    assert run.status_reason.startswith("jump: between t = ")
    assert "the joint 'rod' is closed at the collocation points only" in run.status_reason


@pytest.mark.parametrize("bounds", ["none", [-1e8, 1e8]])
def test_controls_need_no_tight_bounds(bounds: Any) -> None:
    run = mbdkit.predict(block(controls={PUSH: {"bounds": bounds}}))
    assert (run.status, run.verdict) == ("complete", "good")
    assert_within(run.objective - 12.0, run.objective_error)


def test_tables_must_cover_the_longest_duration() -> None:
    table = {"table": [[0, 0.5], [0, 100]]}
    for duration in (1.0, {"bounds": [0.1, 1.0]}):
        with pytest.raises(mbdkit.SpecError, match="the table covers"):
            mbdkit.predict(loaded(table, duration=duration))
    assert mbdkit.predict(loaded(table, duration=0.5)).status == "complete"


def test_intervals_end_at_given_times() -> None:
    grid = IntervalGrid.uniform([4, 2], np.ones(1)).with_ends(0, [0.3, 0.31, 0.6, 0.9])
    ends = np.array([0.3, 0.31, 0.5, 0.6, 0.75, 0.9, 1.0, 1.5, 2.0])
    np.testing.assert_allclose(np.ones(2) @ grid.ends, ends, atol=1e-15)
    assert grid.counts == (7, 2)
