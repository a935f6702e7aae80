"""Loads that are expressions of the state, and first-order states of a mechanism, against independent solutions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.matrix_terms import RATE
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from tests.margins import assert_within
from tests.runs.leg_with_states import DAMPING, INERTIA, LAG, STIFFNESS, leg, rotor, spec_of
from tests.runs.resuming.killed_runs import killed
from tests.slow_cases import slow


def rates(t: float, y: np.ndarray) -> list[float]:
    """The derivatives of angle, angular velocity and state of the leg."""
    angle, speed, filtered = y
    torque = -STIFFNESS * (angle - 0.5 * np.sin(2 * t)) - DAMPING * speed + filtered
    return [speed, (torque - 3 * 9.81 * 0.2 * np.sin(angle)) / INERTIA, (angle - filtered) / LAG]


EXACT = solve_ivp(rates, (0, 0.5), [0.0, 0.0, 0.1], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
"""Angle, angular velocity and state at the end."""


def at_end(run: mbdkit.Run) -> np.ndarray:
    return np.array([run["leg"].angle[-1], run["leg"].angular_velocity[-1], run.states["i"].value[-1]])


@pytest.mark.parametrize(
    ("integrator", "more", "order"),
    [
        ({"name": "rk4"}, {}, 4),
        ({"name": "rk4"}, {"stabilization": "projection"}, 4),
        ({"name": "gauss", "stages": 2}, {}, 4),
        ({"name": "gauss", "stages": 2, "stage_solver": "fixed-point"}, {}, 4),
        ({"name": "radau-iia", "stages": 2}, {}, 3),
        ({"name": "radau-iia", "stages": 2}, {"formulation": "index-2"}, 3),
        ({"name": "radau-iia", "stages": 2}, {"formulation": "ggl"}, 3),
    ],
)
def test_methods_keep_their_order(integrator: dict[str, Any], more: dict[str, Any], order: int) -> None:
    errors = [
        np.abs(at_end(mbdkit.run(spec_of(integrator, step, **more)).check()) - EXACT).max() for step in (0.02, 0.01)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)
    assert_within(errors[1], 1e-4)


EVERY_KIND: list[dict[str, Any]] = [
    {"name": "rk4"}, {"name": "dop853", "adaptive": True, "rtol": 1e-10}, {"name": "gauss", "stages": 2},
    {"name": "gauss", "stages": 3, "stage_solver": "fixed-point"}, {"name": "radau-iia", "stages": 3},
    {"name": "scipy-dop853", "rtol": 1e-10, "atol": 1e-10},
]  # fmt: skip


@pytest.mark.parametrize("integrator", EVERY_KIND, ids=lambda one: f"{one['name']}-{one.get('stages', '')}")
def test_states_need_neither_forces_nor_inputs(integrator: dict[str, Any]) -> None:
    # expected: the recorded angles, and integrals of the rates
    pin = {"J": {"type": "revolute", "bodies": ["ground", "b"], "at": [0, 0]}}
    hung = pin | {"W": {"type": "revolute", "bodies": ["b", "c"], "at": [1.0, 0.0]}}
    driven = pin | {"D": {"type": "driver", "bodies": ["ground", "b"], "coordinate": "angle", "motion": "0.3*sin(3*t)"}}
    welded = pin | {"W": {"type": "weld", "bodies": ["b", "c"], "at": [1.0, 0.0]}}
    bodies = {name: {"mass": 1.0, "inertia": 0.1, "position": [x, 0.0]} for name, x in (("b", 0.5), ("c", 1.5))}
    spring = {"S": {"type": "torsion-spring", "bodies": ["ground", "b"], "stiffness": 2.0}}
    controlled = {"adaptive", "rtol"} & integrator.keys()
    time = {"end": 1.0} if controlled else {"end": 1.0, "step": 0.01}
    for joints in (pin, hung, driven, welded):
        some = {name: body for name, body in bodies.items() if name == "b" or "W" in joints}
        for rate, forces in (("b.angular_velocity", {}), ("cos(3*t)", {}), ("cos(3*t)", spring)):
            own = joints if not (forces and "D" in joints) else pin
            model = {
                "name": "mechanism",
                "bodies": some,
                "joints": own,
                "forces": forces,
                "states": {"z": {"rate": rate}},
            }
            run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time}).check()
            expected = run["b"].angle if rate == "b.angular_velocity" else np.sin(3 * run.time) / 3
            assert_within(np.abs(run.states["z"].value - expected).max(), 1e-6)


@pytest.mark.parametrize("integrator", ["dop853", "radau-iia"])
def test_adaptive_methods_reach_their_tolerance(integrator: str) -> None:
    chosen = {"name": integrator, "adaptive": True, "rtol": 1e-9, "atol": 1e-9}
    assert_within(at_end(mbdkit.run(spec_of(chosen, None))) - EXACT, 1e-7)


def everything() -> Mechanism:
    """A mechanism whose loads contain each kind of quantity."""
    m = Mechanism()
    cart = m.body("cart", mass=1.0, inertia=0.1)
    rod = m.body("rod", mass=3.0, inertia=0.05, position=(0.1, -0.2), angle=0.2, angular_velocity=1.0)
    m.prismatic("rail", m.ground, cart, at=(0, 0), axis=(1, 0.2))
    m.revolute("hip", cart, rod, at=(0, 0))
    m.marker("foot", rod, point=(0.05, -0.3))
    m.spring_damper("s", m.ground, rod, points=((0.5, 0), (0, 0.1)), stiffness=30, damping=1.0, free_length=0.3)
    m.torque(
        "knee", rod, reaction_body=cart,
        value="-4*joints.hip.angle - 0.3*rod.angular_velocity + 0.05*forces.s.value + 0.1*abs(markers.foot.vx)",
    )  # fmt: skip
    m.force(
        "push", cart, point=(0.1, 0.05), frame="body",
        value=("-20*joints.rail.angle - 0.5*forces.s.length", "3*sin(t)*markers.foot.y + 2*cart.vx"),
    )  # fmt: skip
    m.force("pull", rod, point=(0.1, 0.05), value=("-2*markers.foot.vy", "0.4*min(markers.foot.vx, 0.1)"))
    return m


def test_every_quantity_has_the_value_that_the_archive_records() -> None:
    run = mbdkit.run(everything(), time={"end": 0.3, "step": 0.005}, integrator={"name": "rk4"})
    (_, foot_y), (foot_vx, foot_vy) = run.markers["foot"].position.T, run.markers["foot"].velocity.T
    s = run.forces["s"]
    knee = -4 * run.joints["hip"].angle - 0.3 * run["rod"].angular_velocity + 0.05 * s.value + 0.1 * np.abs(foot_vx)
    np.testing.assert_allclose(run.forces["knee"].value, knee, rtol=1e-12)
    x = -20 * run.joints["rail"].angle - 0.5 * s.length
    y = 3 * np.sin(run.time) * foot_y + 2 * run["cart"].velocity[:, 0]
    np.testing.assert_allclose(run.forces["push"].value, np.hypot(x, y), rtol=1e-12)
    pull = np.hypot(-2 * foot_vy, 0.4 * np.minimum(foot_vx, 0.1))
    np.testing.assert_allclose(run.forces["pull"].value, pull, rtol=1e-12)
    assert_within(run.energy.balance, 1e-6)


def test_the_tangents_of_loads_are_those_of_differences() -> None:
    m = everything()
    m.torque("rates", "rod", value="0.7*forces.s.rate + 0.3*forces.s.value + 0.1*forces.s.length**2")
    workspace, _ = build(load_spec(m, time={"end": 1, "step": 0.1}, integrator={"name": "rk4"}))
    random = np.random.default_rng(0)
    n = workspace.mechanism.size - 3
    q, v = workspace.q0.copy(), workspace.v0.copy()
    q[:n] += 0.1 * random.normal(size=n)
    v[:n] += random.normal(size=n)
    top, w = workspace.mechanism.topology, workspace.scratch

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tangents_at(workspace.engine, 0.3, q, v, np.zeros_like(q), np.zeros((len(top.pairs), 2)))
        return w.force[:n].copy()

    step = 1e-6 * np.eye(n + 3)[:n]
    by_position = np.array([force(q - one, v) - force(q + one, v) for one in step]).T / 2e-6
    by_velocity = np.array([force(q, v - one) - force(q, v + one) for one in step]).T / 2e-6
    force(q, v)
    terms, found = workspace.terms, np.zeros((2, n, n))
    first = workspace._offsets
    of_forces = (terms.source >= first["spring_stiff"]) & (terms.row < n) & (terms.column < n)
    for source, row, column, factor in np.column_stack(
        [terms.source, terms.row, terms.column, terms.factor]
    )[of_forces]:  # fmt: skip
        found[int(factor == RATE), row, column] += w.source[source]
    np.testing.assert_allclose(found[0], by_position, atol=1e-8 * np.abs(by_position).max())
    np.testing.assert_allclose(found[1], by_velocity, atol=1e-8 * np.abs(by_velocity).max())


def test_the_linearization_contains_the_feedback() -> None:
    spec = spec_of({"name": "rk4"}, model=leg("-Kp*leg.angle - Kd*leg.angular_velocity") | {"states": {}})
    found = np.linalg.eigvals(mbdkit.linearize(spec).state_matrix())
    stiffness = STIFFNESS + 3 * 9.81 * 0.2
    wanted = np.roots([INERTIA, DAMPING, stiffness])
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(wanted), rtol=1e-9)


def test_a_gradient_by_a_gain_is_exact() -> None:
    """The angle of a rotor under control, without gravity, is linear: its derivative is that of a matrix function."""
    model = leg("-Kp*leg.angle - Kd*leg.angular_velocity") | {"states": {}, "gravity": [0, 0]}
    model["bodies"]["leg"]["angular_velocity"] = 1.0
    model["bodies"]["leg"]["velocity"] = [0.2, 0.0]
    found = mbdkit.gradient(spec_of({"name": "dop853"}, 0.005, model=model), "final(leg.angle)", "Kp")

    def angle(gain: float) -> float:
        return float((expm(0.5 * np.array([[0, 1], [-gain / INERTIA, -DAMPING / INERTIA]])) @ [0.0, 1.0])[0])

    step = 1e-2
    wanted = (8 * (angle(STIFFNESS + step) - angle(STIFFNESS - step))
        - (angle(STIFFNESS + 2 * step) - angle(STIFFNESS - 2 * step))) / (12 * step)  # fmt: skip
    assert found.jacobian[0, 0] == pytest.approx(wanted, rel=1e-7)
    assert found.check is not None
    assert found.check.is_passed


def test_a_mechanism_keeps_its_expressions_in_a_spec() -> None:
    m = everything()
    m.state("z", rate="states.z*markers.foot.x - rod.angle", initial=0.3, unit="m")
    again = Mechanism.from_spec(m.to_spec())
    assert again.to_spec() == m.to_spec()
    assert again.expressions() == m.expressions()


@pytest.mark.parametrize(
    ("value", "sentence"),
    [("contacts.heel.gap", "'contacts.heel.gap' cannot be part"), ("heel.gap", "'heel' is a contact")],
)
def test_kinds_without_quantities_of_the_state_are_refused(value: str, sentence: str) -> None:
    heel = {"bodies": ["ground", "leg"], "shapes": [{"line": {"normal": [0, 1]}}, {"point": [0, -0.2]}]}
    with pytest.raises(SpecError, match=sentence):
        Mechanism.from_spec(leg(value) | {"contacts": {"heel": heel}}, {"lag": LAG})


def test_a_value_that_is_not_finite_names_its_load() -> None:
    run = mbdkit.run(spec_of({"name": "rk4"}, model=leg("5 + 0.01*log(0.1 - leg.angle)")))
    assert run.status == "failed"
    assert "the value of load 'motor' is not finite" in run.status_reason


@pytest.mark.parametrize("method", ["scipy-radau", "scipy-dop853", "scipy-lsoda"])
def test_methods_of_scipy_integrate_states(method: str) -> None:
    run = mbdkit.run(spec_of({"name": method, "rtol": 1e-10, "atol": 1e-10}, None))
    assert_within(at_end(run) - EXACT, 1e-7)


def exact_rotor(delay: float, end: float) -> float:
    """The angle at the end: between changes of the output, the rotor accelerates uniformly."""
    angle, speed, total, output, now = 0.3, 0.0, 0.1, 0.0, 0.0
    pending: dict[int, float] = {}
    number = round(end / 0.02)
    changes = [(round(k * 0.02, 9), 0, k) for k in range(number)]
    changes += [(round(k * 0.02 + delay, 9), 1, k) for k in range(number)]
    for time, kind, k in [*sorted(one for one in changes if one[0] < end), (end, 2, 0)]:
        angle, speed = angle + (time - now) * speed + (time - now) ** 2 * output, speed + 2 * (time - now) * output
        now = time
        if kind == 0:
            pending[k] = -6 * angle - 2 * speed - total
            total += 0.1 * angle
        elif kind == 1:
            output = pending[k]
    return angle


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.02, 0.047])
@pytest.mark.parametrize(
    ("integrator", "time"),
    [
        ({"name": "rk4"}, {"end": 1.0, "step": 0.005}),
        ({"name": "rk4"}, {"end": 1.0, "step": 0.03}),
        ({"name": "gauss", "stages": 2}, {"end": 1.0, "step": 0.02}),
        ({"name": "dopri5", "adaptive": True}, {"end": 1.0}),
        ({"name": "scipy-dop853", "rtol": 1e-9}, {"end": 1.0}),
    ],
)
def test_a_sampled_controller_holds_its_output(integrator: dict[str, Any], time: dict[str, Any], delay: float) -> None:
    run = mbdkit.run(rotor(delay), integrator=integrator, time=time).check()
    assert run["rotor"].angle[-1] == pytest.approx(exact_rotor(delay, 1.0), abs=1e-12)
    assert list(run.states) == ["pid.u", "pid.sum"]


def test_a_delayed_loop_becomes_unstable_where_theory_says() -> None:
    """A rotor with the torque -k w(t - d): the loop with dead time is stable for k d / I < pi / 2."""
    growth = []
    for share in (0.97, 1.03):
        m = Mechanism(gravity=(0, 0))
        m.body("rotor", mass=1, inertia=0.5, angular_velocity=1.0)
        m.revolute("pin", m.ground, "rotor", at=(0, 0))
        gain = share * 0.5 * np.pi / 2 / 0.1005  # holding the output delays it by half a period more
        m.controller("loop", period=0.001, delay=0.1, outputs={"u": f"-{gain}*rotor.angular_velocity"})
        m.torque("motor", "rotor", value="controllers.loop.u")
        run = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 12.0, "step": 0.01}).check()
        late, early = (
            np.abs(run["rotor"].angular_velocity[part]).max() for part in (slice(-200, None), slice(400, 600))
        )
        growth.append(late / early)
    assert growth[0] < 0.8
    assert growth[1] > 1.2


def test_a_killed_run_with_a_controller_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    spec = {"mbdkit": 1, "model": rotor(0.047).to_spec(), "integrator": {"name": "rk4"}}
    spec["time"] = {"end": 100.0, "step": 0.005}
    part = tmp_path / "run.h5.part"
    assert killed(spec, part, delay=0.0)
    assert mbdkit.resume(part).data_sha256 == mbdkit.run(spec).data_sha256


def test_a_controller_is_not_sampled_more_often_than_steps_can_be_taken() -> None:
    model = rotor(0.0).to_spec()
    model["controllers"]["pid"]["period"] = 1e-9
    with pytest.raises(SpecError, match="sampled more often than") as caught:
        mbdkit.run({"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.01}})
    assert str(caught.value.key).startswith("model.controllers.pid")


@pytest.mark.parametrize(
    ("integrator", "step"),
    [
        ({"name": "rk4"}, 0.01),
        ({"name": "gauss", "stages": 2}, 0.01),
        ({"name": "dop853", "adaptive": True, "rtol": 1e-6, "atol": 1e-6}, None),
    ],
)
def test_the_error_bars_of_a_run_with_states_contain_its_errors(integrator: dict[str, Any], step: float | None) -> None:
    run = mbdkit.run(spec_of(integrator, step, check=True)).check()
    assert run.accuracy is not None
    assert run.accuracy.known_until == run.time[-1]
    error = abs(at_end(run)[0] - EXACT[0])
    assert error / 5 < run.accuracy.position_error[-1, 0, 2] * 5
    assert error < run.accuracy.position_error[-1, 0, 2]


@pytest.mark.parametrize("accuracy", [1e-4, *slow(1e-7)])
@pytest.mark.parametrize(
    "sections", [{}, {"integrator": {"name": "rk4"}, "choose": "step"}, {"integrator": {"name": "gauss"}}], ids=str
)
def test_a_chosen_method_and_step_reach_the_accuracy(sections: dict[str, Any], accuracy: float) -> None:
    spec = spec_of({}, None) | {"accuracy": accuracy}
    del spec["integrator"]
    run = mbdkit.run(spec | sections).check()
    assert run.accuracy is not None
    error = abs(at_end(run)[0] - EXACT[0])  # times 0.2 m, from the hip to the centre of mass, which is the leg's size
    assert error <= run.accuracy.reached <= accuracy


def test_the_accuracy_of_a_run_with_a_controller() -> None:
    run = mbdkit.run(rotor(0.013), time={"end": 1.0}, accuracy=1e-8).check()
    assert run.accuracy is not None
    assert run.accuracy.is_reached
    assert run["rotor"].angle[-1] == pytest.approx(exact_rotor(0.013, 1.0), abs=1e-9)


@pytest.mark.parametrize(
    "integrator",
    [{"name": "rk4"}, {"name": "gauss", "stages": 2}, {"name": "scipy-dop853", "rtol": 1e-11, "atol": 1e-11}],
    ids=str,
)
def test_events_see_states_and_what_controllers_hold(integrator: dict[str, Any]) -> None:
    """The torque of the leg, which contains a state, crosses 1 N m where the independent solution says."""
    events = {"strong": {"when": "forces.motor.value - 1", "direction": "falling"}}
    run = mbdkit.run(spec_of(integrator, None if "scipy" in integrator["name"] else 0.002, events=events)).check()

    def torque(t: float, y: np.ndarray) -> float:
        return float(-STIFFNESS * (y[0] - 0.5 * np.sin(2 * t)) - DAMPING * y[1] + y[2] - 1)

    torque.direction = -1  # type: ignore[attr-defined]
    wanted = solve_ivp(rates, (0, 0.5), [0.0, 0.0, 0.1], method="DOP853", rtol=1e-12, atol=1e-13, events=torque)
    assert [one.time for one in run.events] == pytest.approx(wanted.t_events[0], abs=1e-7)
    held = mbdkit.run(
        rotor(0.02), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.005},
        events={"on": {"when": "forces.motor.value + 1"}},
    )  # fmt: skip
    assert held.events[0].time == pytest.approx(0.02, abs=1e-9)  # the torque jumps from 0 to -1.9 N m there


def test_measures_over_samples_and_events_that_set_states_are_split_there() -> None:
    """What a controller holds is constant between samples; its integral is a sum."""
    total = {"v": "integral(abs(controllers.pid.u))"}
    run = mbdkit.run(rotor(0.013), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.005}, measures=total)
    held = run.states["pid.u"].value
    changes = 0.02 * np.arange(50) + 0.013
    after = np.array([held[np.searchsorted(run.time, t + 1e-9)] for t in changes])
    lengths = np.diff(np.append(changes, 1.0))
    assert run.measures["v"] == pytest.approx(np.abs(after) @ lengths, rel=1e-12)
    events = {"drops": {"when": "states.i - 0.2", "direction": "rising", "set": {"i": 0}}}
    model = leg() | {"states": {"i": {"rate": "1"}}}
    spec = spec_of({"name": "rk4"}, 0.03, model=model, events=events)
    measures = {name: f"{name}(states.i)" for name in ("integral", "max")}
    found = mbdkit.run(spec | {"measures": measures}).measures  # a saw-tooth: 0.2, 0.2 and 0.1 s
    assert found["integral"] == pytest.approx(2 * 0.02 + 0.005, abs=1e-12)
    assert found["max"] == pytest.approx(0.2, abs=1e-12)


def test_measures_contain_states_and_what_controllers_hold() -> None:
    measures = {"most": "max(states.i)", "rate": "final(states.i.rate)", "cooled": "1000*min(states.i)"}
    run = mbdkit.run(spec_of({"name": "rk4"}, measures=measures))
    state = run.states["i"]
    assert run.measures["most"] == pytest.approx(state.value.max(), rel=1e-4)  # between recorded times
    assert run.measures["most"] >= state.value.max()
    assert run.measures["rate"] == state.rate[-1] == pytest.approx((run["leg"].angle[-1] - state.value[-1]) / LAG)
    held = {"volts": "min(controllers.pid.u)", "sum": 'final(states["pid.sum"])'}
    run = mbdkit.run(rotor(0.02), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.005}, measures=held)
    assert run.measures["volts"] == pytest.approx(run.states["pid.u"].value.min(), rel=1e-12)
    assert run.measures["sum"] == run.states["pid.sum"].value[-1]
    model = leg()
    model["states"]["i"]["unit"] = "A"  # not a unit of mechanics
    with pytest.raises(SpecError, match="give the unit of the result"):
        mbdkit.run(spec_of({"name": "rk4"}, model=model, measures={"most": "max(states.i)"}))
