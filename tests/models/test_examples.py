"""The packaged examples: each is a spec that soon runs to its end, and does what its comment says."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp

import mbdkit
from mbdkit.spec import example_names, example_text, load_spec
from tests.margins import assert_within
from tests.models.example_runs import length, ran

SCHEMA = "https://raw.githubusercontent.com/mbdkit/mbdkit/main/schemas/run.schema.json"
MODELINE = f"# yaml-language-server: $schema={SCHEMA}"
NAMES = ["car-axis", "chain", "crank-press", "delayed-balance", "double-pendulum"]
NAMES += ["double-wishbone", "flexible-slider-crank", "flying-spaghetti", "four-bar", "leaf-spring"]
NAMES += ["gravity-balanced-arm", "limit-stop", "n-four-bar", "pd-leg", "pendulum", "quick-return", "roll-up"]
NAMES += ["series-elastic-knee", "slider-crank", "spin-up-beam"]
NAMES += ["spring-pendulum", "watt-six-bar"]


every_example = pytest.mark.parametrize("name", sorted({*NAMES, *example_names("run")}))


@every_example
def test_packaged_example_that_is_dumped_and_read_again_is_the_same(name):
    spec = load_spec(name)
    for mode in ("python", "json"):
        assert load_spec(spec.model_dump(mode=mode)).sha256() == spec.sha256()


@every_example
def test_packaged_example_is_a_valid_spec_that_says_what_it_is(name):
    assert name in example_names("run")
    text = example_text(name)
    first, comment = text.splitlines()[:2]
    assert first == MODELINE
    assert comment.startswith("# ")
    assert max(len(line) for line in text.splitlines()[1:]) <= 120
    spec = load_spec(name)
    assert spec.title
    spec.mechanism().validate()


@every_example
def test_packaged_example_runs_to_its_end_in_balance_and_asks_little(name):
    # expected: conservation of energy; joints that meet
    run = ran(name)
    run.check()
    assert "verdict" in run.summary()
    largest = np.max(run.energy.kinetic)
    assert largest > 0
    assert_within(run.energy.balance, 2e-6 * largest)
    assert all(np.max(joint.misalignment) < 1e-5 for joint in run.joints.values())
    assert all(np.isfinite(joint.reaction_force).all() for joint in run.joints.values())
    assert run.stats["rhs_evaluations"] < 100_000  # a fraction of a second
    known = ("the elements of beam", "an infinite sequence of impacts was cut off", "impacts of contacts ")
    warnings = [text for text in run.warnings if not text.startswith(known)]
    assert (run.verdict, run.verdict_reasons, warnings) == ("unknown", [], [])  # the best verdict without a check


def test_pen_of_the_four_bar_draws_a_line_of_four_crank_lengths_while_the_crank_is_on_its_left_half():
    # expected: the closed loop with both arms 2.5 cranks long: for the crank's end B = (-sin u, cos u) the pin C is
    # halfway from B to the fixed pin and on the mean normal, and the pen is at 2 C - B
    run = ran("four-bar")
    pen, crank = np.asarray(run["pen"].position), np.asarray(run["crank"].angle)
    end = 0.1 * np.exp(1j * crank)
    half = (0.2 - end) / 2
    drawn = end + 2 * half * (1 + 1j * np.sqrt(0.25**2 - np.abs(half) ** 2) / np.abs(half))
    np.testing.assert_allclose(pen @ [1, 1j], drawn, rtol=0, atol=1e-10)
    left = np.cos(crank) < 0
    assert_within(pen[left, 1] - 0.4, 0.003)
    assert np.ptp(pen[left, 0]) == pytest.approx(0.4, abs=0.01)
    assert np.ptp(crank) > 4 * np.pi


def test_spring_pendulum_turns_its_bounce_into_a_swing_and_back():
    # expected: E = k A^2 / 2 = m g L (1 - cos swing) at the two-to-one resonance, 30 degrees for A = 1/4 m; the
    # exchange is not complete
    run = ran("spring-pendulum")
    x, y = np.asarray(run["weight"].position).T
    swing = np.degrees(np.arctan2(x, -y))
    early, middle = np.abs(swing[:50]).max(), np.abs(swing).max()
    assert early < 3
    assert 25 < middle < 32
    late = np.abs(swing[run_rows(x, 12.0, 16.0)]).max()
    assert late < 8


def run_rows(rows, start, end):
    """Return the rows between two times of a run of 40 s."""
    return slice(int(start / 40 * len(rows)), int(end / 40 * len(rows)))


def test_balanced_arm_has_the_same_potential_energy_everywhere_and_stays_where_it_stops():
    # expected: k h b = m g c for both springs makes gravity and springs cancel at every pose
    run = ran("gravity-balanced-arm")
    potential = np.asarray(run.energy.potential)
    np.testing.assert_allclose(potential, potential[0], rtol=0, atol=1e-12 * np.abs(potential[0]))
    assert np.ptp(run["forearm"].angle) > 2.0
    assert np.abs(run["forearm"].angular_velocity[-1]) < 0.02
    assert_within(np.asarray(run["plate"].angle), 2e-12)


def test_ram_of_the_press_follows_the_crank_and_the_peak_asks_little_of_the_motor():
    # expected: y = r sin(phi) - sqrt(l^2 - r^2 cos^2(phi)); 20 kN at a lever of a whole crank would be 1000 N m
    run = ran("crank-press")
    phi = np.pi / 2 + 2 * np.pi * np.asarray(run.time)
    height = 0.05 * np.sin(phi) - np.sqrt(0.4**2 - (0.05 * np.cos(phi)) ** 2)
    np.testing.assert_allclose(run["ram"].position[:, 1], height, rtol=0, atol=1e-12)
    assert np.abs(run.joints["motor"].reaction_torque).max() < 350


def test_double_wishbone_stands_at_rest_until_the_bump_and_keeps_its_tyre_on_the_road():
    # expected: the weight of all that the tyre carries, 360 kg, and k (0.3286 m - length) as its force; a tyre as a
    # spring must not pull
    run = ran("double-wishbone")
    time = np.asarray(run.time)
    road, wheel, chassis = (np.asarray(run[name].position) for name in ("road", "upright", "chassis"))
    lean = np.asarray(run["upright"].angle)
    tyre = 190e3 * (0.3286 - np.hypot(*(wheel - road).T))
    before = time < 0.4
    np.testing.assert_allclose(tyre[before], 360 * 9.81, rtol=2e-3)
    assert_within(np.ptp(chassis[before, 1]), 1e-4)
    assert tyre.min() > 500
    assert_within(road[before, 1], 1e-5)
    assert road[:, 1].max() == pytest.approx(0.02, abs=1e-4)
    assert lean[np.argmax(wheel[:, 1] - chassis[:, 1])] > 0.01  # its top leans inwards as it rises
    assert_within(np.ptp(wheel[:, 0]), 0.002)
    assert_within(chassis[-1] - chassis[0], 2e-3)


def test_coil_of_the_double_wishbone_is_to_the_wheel_what_its_source_says():
    # expected: 16 kN/m and 1000 N s/m as the wheel feels them: rates times the square of the lengths' ratio
    mechanism = load_spec("double-wishbone").mechanism()
    with mbdkit.run(mechanism, integrator={"name": "gauss", "stages": 2}, time={"end": 0.6, "step": 0.0025}) as run:
        coil, rise = length(run, mechanism, "coil"), run["upright"].position[:, 1] - run["chassis"].position[:, 1]
    ratio = np.polyfit(rise - rise[0], coil, 2)[1]  # where the car stands
    force = mechanism.forces["coil"]
    assert force.stiffness * ratio**2 == pytest.approx(16000, rel=0.01)
    assert force.damping * ratio**2 == pytest.approx(1000, rel=0.01)


def test_stop_of_the_artificial_knee_takes_up_what_the_blow_brings_and_gives_it_back():
    # expected: at blows and rebounds the stop's spring is at its free angle; between them it pushes with k times the
    # angle, so that hip, knee and stop together balance the shank: J theta'' = sum of moments about its centre
    run = ran("limit-stop")
    angles = run.events.position[:, 1, 2] - run.events.position[:, 0, 2]
    np.testing.assert_allclose(angles, 0.0, rtol=0, atol=1e-11)
    assert [event.name for event in run.events[:4]] == ["blow", "rebound", "blow", "rebound"]
    shank, thigh = run["shank"], run["thigh"]
    angle, rate = shank.angle - thigh.angle, shank.angular_velocity - thigh.angular_velocity
    x, y = 0.2 * np.cos(shank.angle), 0.2 * np.sin(shank.angle)
    force = run.joints["knee"].reaction_force
    moment = -x * force[:, 1] + y * force[:, 0] - 0.1 * rate - 500.0 * np.maximum(angle, 0.0)
    np.testing.assert_allclose(moment, 0.05 * shank.angular_acceleration, rtol=0, atol=1e-9)
    assert 0.05 < angle.max() < 0.1
    assert len(run.events.of_name("overload")) == 0


def test_spun_up_beam_stretches_as_published():
    # expected: Simo and Vu-Quoc (1986): steady extension of 5.14e-4 m; the tip lags by about 0.58 m in their figure
    run = ran("spin-up-beam")
    at = run.beams["blade"].position
    late = run.time > 18.0
    along = np.hypot(at[late, -1, 0], at[late, -1, 1]) - 10.0
    assert along.mean() == pytest.approx(5.14e-4, abs=2e-6)
    lag = at[:, -1, 1] * np.cos(at[:, 0, 2]) - at[:, -1, 0] * np.sin(at[:, 0, 2])
    assert lag.min() == pytest.approx(-0.58, abs=0.02)


def test_rolled_up_strip_is_a_circle():
    run = ran("roll-up")
    x, y, angle = run.beams["strip"].position[-1].T
    assert angle[-1] == pytest.approx(2 * np.pi, abs=1e-4)
    # expected: the corners of a regular polygon of 16 sides of 1/16 m
    radius = np.hypot(x - x[:-1].mean(), y - y[:-1].mean())
    np.testing.assert_allclose(radius, 1 / 32 / np.sin(np.pi / 16), rtol=1e-3)


def test_slider_on_a_flexible_rod_ends_where_the_published_solution_ends():
    # expected: Test Set for IVP Solvers, "Slider crank": 0.169737 m; its rod has fewer modes along its axis, whose
    # oscillations stretch the rod by some 1e-5 m
    run = ran("flexible-slider-crank")
    # margin: how far the source is from this model
    assert run["slider"].position[-1, 0] == pytest.approx(0.169737, abs=2e-5)


def test_leaf_spring_has_the_stiffness_of_linear_theory_at_small_angles():
    # expected: the tip of a cantilever is displaced by angle length/2, and its force acts at length/2 from the knee
    spec = load_spec("leaf-spring").model_dump(mode="json")
    spec["model"]["joints"]["motor"]["motion"] = "-0.001*(1 - cos(2*pi*t/10))"
    with mbdkit.run(spec) as run:
        bending = 2.1e11 * 0.03 * 1.5e-3**3 / 12
        # margin: error of linear theory
        assert run.measures["stiffness"] == pytest.approx(3 * bending / (4 * 0.3), rel=0.0025)


def elastica_across_a_knee(angle: float) -> tuple[float, float]:
    """Return torque at the knee and moment at the clamp [N m] of the leaf spring, as an inextensible elastica at rest.

    A boundary value problem: clamped to the thigh at one end; at the other one, without moment, a force along the x
    axis of the shank, in which direction the end does not move in the shank. The angle grows in steps.
    """
    bending, length, lever = 2.1e11 * 0.03 * 1.5e-3**3 / 12, 0.3, 0.04
    s, force = np.linspace(0, length, 41), np.zeros(1)
    y = np.array([np.full(41, lever), length / 2 - s, np.full(41, -np.pi / 2), np.zeros(41)])
    for phi in np.linspace(0, angle, 13)[1:]:
        axis = np.array([np.cos(phi), np.sin(phi)])

        def rates(s, y, p, axis=axis):
            c, sn = np.cos(y[2]), np.sin(y[2])
            return np.array([c, sn, y[3] / bending, -p[0] * (c * axis[1] - sn * axis[0])])

        def ends(a, b, p, axis=axis):
            return np.array([a[0] - lever, a[1] - length / 2, a[2] + np.pi / 2, b[3], axis @ b[:2] - lever])

        solution = solve_bvp(rates, ends, s, y, p=force, tol=1e-9)
        s, y, force = solution.x, solution.y, solution.p
    return float(force[0] * (y[0, -1] * axis[1] - y[1, -1] * axis[0])), float(y[3, 0])


def test_leaf_spring_has_the_stiffness_of_the_elastica_at_60_degrees():
    # at the end, the motor also accelerates the shank
    torque, moment = elastica_across_a_knee(-np.pi / 3)
    inertia = (0.005 + 0.4 * 0.2**2) * np.pi / 6 * (np.pi / 5) ** 2
    run = ran("leaf-spring")
    assert run.verdict in ("good", "unknown")
    assert run.measures["torque"] == pytest.approx(abs(torque) - inertia, rel=2e-4)
    assert run.measures["stiffness"] == pytest.approx((abs(torque) - inertia) / (np.pi / 3), rel=2e-4)
    assert abs(run.joints["clamp"].reaction_torque[-1]) == pytest.approx(abs(moment), rel=1e-3)  # one inertia
    stress = 6 * abs(moment) / (0.03 * 1.5e-3**2) / 1e6  # at the clamp; that of the example is half an element off
    assert 0.9 * stress < run.measures["stress"] < stress


def test_the_series_elastic_actuator_moves_as_its_equations_say():
    """Against DOP853 in the minimal coordinate, from one change of the voltage to the next."""
    end, inertia, volts, wanted = 0.3, 0.06 + 3.5 * 0.22**2, 0.0, 0.0

    def rates(t, y):
        angle, speed, current, motor_speed, motor_angle = y
        torque = 250 * (motor_angle / 50 - angle)
        return [
            speed,
            (torque - 3.5 * 9.81 * 0.22 * np.sin(angle)) / inertia,
            (volts - 0.6 * current - 0.03 * motor_speed) / 0.002,
            (0.03 * current - torque / 50) / 1e-5,
            motor_speed,
        ]

    y, now, following = np.zeros(5), 0.0, 0.0
    for k in range(round(end / 0.005)):
        for time, applies in ((0.005 * k, False), (0.005 * k + 0.002, True)):
            if time > now:
                y = solve_ivp(rates, (now, time), y, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
                now = time
            if applies:
                volts = following
            else:
                following = np.clip(0.6 * wanted / (50 * 0.03) + 0.03 * 50 * y[1], -24, 24)
                wanted = -60 * (y[0] - 0.5 * np.sin(2 * np.pi * time / 1.2)) - 6 * y[1]
    y = solve_ivp(rates, (now, end), y, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    run = mbdkit.run("series-elastic-knee", time={"end": end, "step": 0.0005})
    found = [
        run["shank"].angle[-1],
        *(run.states[name].value[-1] for name in ("current", "motor_speed", "motor_angle")),
    ]
    np.testing.assert_allclose(found, y[[0, 2, 3, 4]], rtol=1e-6, atol=1e-6)


def test_the_controlled_leg_swings_in_the_closed_form():
    # expected: the damped oscillation of the linear equation I a'' + d a' + k (a - target) = 0 from rest
    run = mbdkit.run("pd-leg", integrator={"name": "gauss", "stages": 3})
    inertia, stiffness, damping, target = 0.9 + 11 * 0.38**2, 60.0, 10.0, 0.6
    decay = damping / (2 * inertia)
    frequency = np.sqrt(stiffness / inertia - decay**2)
    turned = frequency * run.time
    wanted = target * (1 - np.exp(-decay * run.time) * (np.cos(turned) + decay / frequency * np.sin(turned)))
    np.testing.assert_allclose(run["leg"].angle, wanted, atol=1e-12)


def test_the_delayed_loop_moves_as_its_discrete_equation_says():
    """Between changes of the torque, a small lean follows the linear equation, whose solution is exact."""
    inertia, weight = 8 + 70 * 0.95**2, 70 * 9.81 * 0.95
    rate, half = np.sqrt(weight / inertia), 0.001  # the torque changes half a period after a sample
    c, s = np.cosh(rate * half), np.sinh(rate * half)
    moved, pushed = np.array([[c, s / rate], [rate * s, c]]), np.array([(c - 1) / weight, rate * s / weight])
    x, torque, waiting = np.array([1e-4, 0.0]), 0.0, {}
    for k in range(round(1.0 / half)):
        if k % 2 == 0:
            waiting[k + 149] = -np.array([1000.0, 350.0]) @ x
        torque = waiting.pop(k, torque)
        x = moved @ x + pushed * torque
    parameters = load_spec("delayed-balance").parameters | {"lean": 1e-4}
    run = mbdkit.run("delayed-balance", parameters=parameters, time={"end": 1.0, "step": 0.01})
    np.testing.assert_allclose([run["person"].angle[-1], run["person"].angular_velocity[-1]], x, rtol=1e-6)
