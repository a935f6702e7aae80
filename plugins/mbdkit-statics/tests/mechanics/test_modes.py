"""Small motions about a state, compared with textbooks, minimal coordinates and runs of small amplitude."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy
from scipy.linalg import eigh

import mbdkit
from mbdkit.spec import load_spec
from mbdkit_statics.modes import oscillations
from tests.margins import assert_within

from .chains import G, chain_stiffness_and_mass, hung_between, spec, weight_on_a_spring


def test_the_hanging_double_pendulum_has_its_known_frequencies() -> None:
    # expected: roots of det(K - w^2 M) for uniform rods of 1 m and 1 kg, M = [[4/3, 1/2], [1/2, 1/3]],
    # K = 9.81 diag(3/2, 1/2), computed separately with 30 digits
    found = mbdkit.modes(spec({"name": "double-pendulum", "angles": [-1.0, -0.4]}))
    np.testing.assert_allclose(found.natural_frequency, [2.68011401225338, 7.18867087028771], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.damping_ratio, 0.0)
    np.testing.assert_allclose(found.frequency_hz, found.natural_frequency / (2 * math.pi))


def test_a_pendulum_swings_at_its_textbook_frequency() -> None:
    # expected: sqrt(m g l / J) about the pin
    found = mbdkit.modes(spec({"name": "single-pendulum", "length": 0.7, "mass": 2.0, "inertia": 0.3}))
    expected = math.sqrt(2.0 * G * 0.35 / (0.3 + 2.0 * 0.35**2))
    assert found.natural_frequency[0] == pytest.approx(expected, rel=1e-14)
    m = mbdkit.Mechanism()
    bob = m.body("bob", mass=3.0, position=(0.4, -0.3))
    m.distance("string", m.ground, bob, points=((0.0, 0.0), (0.0, 0.0)), length=0.5)
    found = mbdkit.modes(m)
    assert len(found.eigenvalues) == found.freedoms == 1
    assert found.natural_frequency[0] == pytest.approx(math.sqrt(G / 0.5), rel=1e-13)
    assert found.shapes[0, 0, 2] == 0


def test_a_damped_weight_has_the_textbooks_damping_ratio() -> None:
    # expected: c / (2 sqrt(k m)); beyond 1 the two roots of the characteristic equation
    mass, stiffness, damping = 2.0, 800.0, 8.0
    found = mbdkit.modes(weight_on_a_spring(stiffness, damping, mass))
    assert found.natural_frequency[0] == pytest.approx(math.sqrt(stiffness / mass), rel=1e-14)
    assert found.damping_ratio[0] == pytest.approx(damping / (2 * math.sqrt(stiffness * mass)), rel=1e-13)
    assert found.damped_frequency[0] == pytest.approx(math.sqrt(400.0 - 4.0), rel=1e-13)
    found = mbdkit.modes(weight_on_a_spring(stiffness, 200.0, mass))
    np.testing.assert_allclose(found.eigenvalues, np.sort(np.roots([mass, 200.0, stiffness]))[::-1], rtol=1e-13)
    np.testing.assert_allclose(found.damping_ratio, 1.0)


@pytest.mark.parametrize("n", [3, 10, 40])
def test_a_hanging_chain_swings_as_in_minimal_coordinates(n: int) -> None:
    # expected: Lagrange's equations in the rods' tilts, by hand
    rng = np.random.default_rng(n)
    lengths, masses = rng.uniform(0.2, 1.0, n).tolist(), rng.uniform(0.5, 2.0, n).tolist()
    stiffness, mass = chain_stiffness_and_mass(lengths, masses)
    squares, tilts = eigh(stiffness, mass)
    angles = [-1.5] * n
    found = mbdkit.modes(spec({"name": "n-pendulum", "n": n, "lengths": lengths, "masses": masses, "angles": angles}))
    np.testing.assert_allclose(found.natural_frequency, np.sqrt(squares), rtol=1e-11)
    sign = np.sign(np.sum(tilts.T * found.shapes[:, :, 2].real, axis=1))
    np.testing.assert_allclose(found.shapes[:, :, 2].real, sign[:, None] * tilts.T, rtol=0, atol=1e-8)


def test_of_a_large_chain_the_slowest_modes_are_found() -> None:
    # expected: minimal coordinates, as above
    n = 300
    stiffness, mass = chain_stiffness_and_mass([1.0] * n, [1.0] * n)
    squares = eigh(stiffness, mass, eigvals_only=True, subset_by_index=(0, 4))
    found = mbdkit.modes(spec({"name": "n-pendulum", "n": n, "angle": -math.pi / 2}), count=5)
    np.testing.assert_allclose(found.natural_frequency, np.sqrt(squares), rtol=1e-9)
    with pytest.raises(mbdkit.SpecError, match="501 bodies is too large"):
        mbdkit.linearize(spec({"name": "n-pendulum", "n": 501, "angle": -math.pi / 2}))


def test_shapes_stay_on_the_constraints_and_are_of_unit_modal_mass() -> None:
    for source in (hung_between(2.0, 8, 0.4), "double-wishbone", "car-axis"):
        found = mbdkit.modes(source)
        mechanism = source if isinstance(source, mbdkit.Mechanism) else load_spec(source).mechanism()
        p = mbdkit.EquationsOfMotion.of(mechanism)
        jacobian = p.constraint_jacobian(0.0, found.position.ravel())
        shapes = found.shapes.reshape(len(found.shapes), -1)
        np.testing.assert_allclose(jacobian @ shapes.T, 0.0, rtol=0, atol=1e-11 * np.abs(shapes).max())
        np.testing.assert_allclose(np.abs(shapes) ** 2 @ p.mass, 1.0, rtol=1e-12)


def test_an_inverted_pendulum_falls_at_its_rate() -> None:
    # expected: theta'' = 3 g / (2 L) theta
    found = mbdkit.modes(spec({"name": "single-pendulum", "angle": math.pi / 2}))
    np.testing.assert_allclose(found.eigenvalues, np.sqrt(1.5 * G) * np.array([1, -1]), rtol=1e-13)
    assert found.unstable.tolist() == [True, False]


def test_free_bodies_have_modes_of_frequency_zero() -> None:
    # expected: two bodies on a spring in space: k (1/m1 + 1/m2); all other motions are free
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("a", mass=1.0, inertia=0.2)
    m.body("b", mass=3.0, inertia=0.4, position=(1.0, 0.0))
    for damping in (0.0, 0.3):
        spring = {"points": ((0, 0), (0, 0)), "stiffness": 15.0, "damping": damping, "free_length": 1.0}
        m.spring_damper(f"spring{len(m.forces)}", "a", "b", **spring)
        found = mbdkit.modes(m)
        np.testing.assert_array_equal(found.eigenvalues[:5], 0.0)
        assert len(found.eigenvalues) == 6
        springs = 1.0 if damping == 0 else 2.0
        assert found.natural_frequency[5] == pytest.approx(math.sqrt(springs * 15.0 * (1 + 1 / 3)), rel=1e-12)
        assert found.damping_ratio[5] == pytest.approx(
            damping * (1 + 1 / 3) / (2 * found.natural_frequency[5]), abs=1e-12
        )


def test_a_dragged_free_body_stops_and_stays() -> None:
    # expected: m x'' + c x' = 0 has the roots 0 and -c/m
    values, _ = oscillations(np.array([[0.0]]), np.array([[0.5]]))
    np.testing.assert_allclose(np.sort(values.real), [-0.5, 0.0], atol=1e-15)
    assert len(values) == 2


def test_a_point_mass_on_a_turning_arm_swings_by_centrifugal_force() -> None:
    # expected: in the frame of the arm, turning at W, a pendulum of length L pinned at radius R has W sqrt(R / L);
    # written down by hand for a rod of mass m, half length l, inertia J: w^2 = W^2 m R l / (J + m l^2)
    speed, radius, half, mass, inertia = 3.0, 0.8, 0.25, 2.0, 0.07
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("arm", mass=1.0, inertia=1.0, angular_velocity=speed)
    m.body(
        "rod", mass=mass, inertia=inertia, position=(radius + half, 0.0), velocity=(0.0, speed * (radius + half)),
        angular_velocity=speed,
    )  # fmt: skip
    m.revolute("axle", m.ground, "arm", at=(0.0, 0.0))
    m.driver("motor", m.ground, "arm", coordinate="angle", motion=f"{speed}*t")
    m.revolute("pin", "arm", "rod", at=(radius, 0.0))
    found = mbdkit.modes(m, at="start")
    expected = speed * math.sqrt(mass * radius * half / (inertia + mass * half**2))
    assert found.natural_frequency[0] == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("name", ["knee", "hung chain"])
def test_a_run_of_small_amplitude_shows_frequency_and_damping(name: str) -> None:
    # expected: the run, by gauss of 3 stages, let go from 1e-5 rad beside the equilibrium along the mode's shape;
    # its angle is compared with the mode's oscillation, whose error is the square of the amplitude
    mechanism = load_spec(name).mechanism() if name == "knee" else hung_between(2.0, 8, 0.4)
    found = mbdkit.modes(mechanism)
    rest = mbdkit.equilibrium(mechanism)
    shape, value = found.shapes[0], found.eigenvalues[0]
    mover = int(np.argmax(np.abs(shape[:, 2])))
    scale = 1e-5 / shape[mover, 2]
    for body, q, u in zip(found.bodies, rest.position, shape * scale, strict=True):
        place, rate = q + u.real, (value * u).real
        mechanism.bodies[body] = mechanism.bodies[body].model_copy(
            update={
                "position": (place[0], place[1]), "angle": place[2],
                "velocity": (rate[0], rate[1]), "angular_velocity": rate[2],
            }
        )  # fmt: skip
    run = mbdkit.run(mechanism, integrator={"name": "gauss", "stages": 3}, time={"end": 3.0, "step": 0.005})
    seen = run[found.bodies[mover]].angle - rest.position[mover, 2]
    expected = (1e-5 * np.exp(value * run.time)).real
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-9)


def test_a_linearization_gives_the_modes_as_its_state_matrix() -> None:
    # expected: eigenvalues of A of x' = A x, by NumPy
    line, found = mbdkit.linearize("double-wishbone"), mbdkit.modes("double-wishbone")
    values = np.linalg.eigvals(line.state_matrix())
    np.testing.assert_allclose(np.sort_complex(values[values.imag > 0]), np.sort_complex(found.eigenvalues), rtol=1e-12)
    assert np.abs(line.acceleration).max() == 0


def test_a_knee_in_motion_is_linearised_along_its_path() -> None:
    # expected: with one freedom, the path's length s in the mass metric obeys s'' = f(s, s'); the derivatives of f by
    # central differences of the accelerations at neighbouring flexions and speeds
    flexion, speed, step = 0.6, 1.3, 1e-4

    def along(flexion: float, speed: float) -> tuple[float, float]:
        """Return f, and the length of path to a radian of flexion."""
        knee = load_spec("knee", [f"model.flexion={flexion!r}", "model.flexion_rate=1.0"])
        p = mbdkit.EquationsOfMotion.of(knee.mechanism())
        metric = math.sqrt(float(p.v0 @ (p.mass * p.v0)))
        v = p.v0 * speed / metric
        return float(v @ (p.mass * p.accelerations(0.0, p.q0, v)[0])) / speed, metric

    metric = along(flexion, speed)[1]
    stiffness = -(along(flexion + step, speed)[0] - along(flexion - step, speed)[0]) / (2 * step * metric)
    damping = -(along(flexion, speed + step)[0] - along(flexion, speed - step)[0]) / (2 * step)
    knee = load_spec("knee", [f"model.flexion={flexion!r}", f"model.flexion_rate={speed / metric!r}"])
    found = mbdkit.linearize(knee, at="start")
    assert found.stiffness[0, 0] == pytest.approx(stiffness, rel=1e-6)
    assert found.damping[0, 0] == pytest.approx(damping, rel=1e-6)


def damped_strip(tau: float, *, is_clamped: bool) -> mbdkit.Mechanism:
    """Return a strip of steel 0.5 mm thick and 0.5 m long, whose mesh has frequencies up to 1e7 rad/s."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    width, thickness = 0.03, 5e-4
    strip = m.beam(
        "strip", a=(0, 0), b=(0.5, 0), elements=16, nodes=3, E=2.1e11, nu=0.3, A=width * thickness,
        I=width * thickness**3 / 12, density=7850.0, damping=tau,
    )  # fmt: skip
    if is_clamped:
        m.weld("clamp", m.ground, strip[0], at=(0, 0))
    return m


@pytest.mark.parametrize(("tau", "is_clamped"), [(1e-4, True), (1e-2, True), (1e-4, False)])
def test_a_damped_strip_has_the_frequencies_and_damping_ratios_of_kelvin_and_voigt(
    tau: float, is_clamped: bool
) -> None:
    # expected: omega = x^2 sqrt(E I / (rho A L^4)) with x of the textbooks for Bernoulli's beam, and
    # lambda^2 + tau omega^2 lambda + omega^2 = 0, so that the damping ratio is omega tau / 2 below 1
    x = np.array([1.87510407, 4.69409113, 7.85475744] if is_clamped else [4.73004074, 7.85320462, 10.9956078])
    omega = x**2 * math.sqrt(2.1e11 * 5e-4**2 / 12 / 7850) / 0.5**2
    found = mbdkit.modes(damped_strip(tau, is_clamped=is_clamped), at="start")
    if not is_clamped:
        np.testing.assert_array_equal(found.eigenvalues[:3], 0.0)
    values = found.eigenvalues[np.abs(found.eigenvalues) > 0]
    swinging = values[values.imag > 0]
    ratios = omega * tau / 2
    below = ratios < 1
    expected = omega[below] * (-ratios[below] + 1j * np.sqrt(1 - ratios[below] ** 2))
    np.testing.assert_allclose(swinging[: len(expected)], expected, rtol=1e-3)  # of 16 elements
    np.testing.assert_allclose(
        -2 * swinging.real / np.abs(swinging) ** 2, tau, rtol=3e-5
    )  # up to 7e-6 on four processors
    for one in omega[~below]:
        slow = -one * (one * tau / 2 - math.sqrt((one * tau / 2) ** 2 - 1))
        assert_within(np.min(np.abs(values - slow)), 1e-3 * abs(slow))


def test_eigenvalues_of_all_sizes_are_accurate_whatever_the_damping_couples() -> None:
    # expected: the roots of the characteristic polynomial, with 60 digits
    squares, ways = [2, 3 * 10**5, 10**15], sympy.Matrix([[1, 2, 5], [3, -4, 2000], [70, 11, -600000]])
    damping = ways * ways.T / 10**4
    symbol = sympy.Symbol("x")
    polynomial = (symbol**2 * sympy.eye(3) + symbol * damping + sympy.diag(*squares)).det()
    exact = np.array([complex(root) for root in sympy.Poly(polynomial, symbol).nroots(n=60, maxsteps=500)])
    found, shapes = oscillations(np.diag(np.array(squares, dtype=float)), np.array(damping, dtype=float))
    for value, shape in zip(found, shapes.T, strict=True):
        assert_within(np.min(np.abs(exact - value)), 1e-9 * abs(value))
        terms = value**2 * shape, np.array(damping, dtype=float) @ (value * shape), np.array(squares) * shape
        assert_within(np.linalg.norm(sum(terms)), 1e-8 * sum(np.linalg.norm(one) for one in terms))
    assert np.sum(found.imag > 0) + len(found) == 6


@pytest.mark.parametrize(("elements", "nodes", "warns"), [(4, 2, True), (16, 2, False), (4, 3, False)])
def test_modes_say_which_elements_of_a_beam_are_too_coarse(elements: int, nodes: int, warns: bool) -> None:
    """The frequency of a clamped beam by Euler and Bernoulli is (1.87510 / L)^2 sqrt(EI / m)."""
    m = mbdkit.Mechanism()
    stiffness = {"axial": 1e6, "shear": "none", "bending": 4.0}
    m.beam("blade", a=(0, 0), b=(2, 0), elements=elements, nodes=nodes, mass_per_length=0.5, stiffness=stiffness)
    m.weld("clamp", m.ground, "blade.0", at=(0, 0))
    found = mbdkit.modes(m, at="start", count=1)
    error = abs(found.natural_frequency[0] / ((1.8751040687 / 2) ** 2 * math.sqrt(4.0 / 0.5)) - 1)
    assert (error > 0.01) == warns == bool(found.warnings)
    if warns:
        (told,) = found.warnings
        estimate = float(told.partition("up to about ")[2].partition(" %")[0]) / 100
        assert error < estimate < 2 * error
        assert "too coarse for mode 1: " in told


def test_motions_of_rigid_bodies_are_not_modes_for_which_elements_are_too_coarse() -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("apart", mass=1.0, inertia=0.1, position=(5.0, 0.0))
    stiffness = {"axial": 1e4, "shear": 1e4, "bending": 4.0}
    m.beam("blade", a=(0, 0), b=(2, 0), elements=4, mass_per_length=0.5, stiffness=stiffness)
    found = mbdkit.modes(m, at="start")
    first = 1 + int(np.argmax(found.natural_frequency > 1e-6))
    assert first == 7
    assert f"too coarse for mode {first} " in found.warnings[0]


def test_the_input_matrix_is_the_acceleration_for_a_unit_of_each_input():
    # an arm about a pivot, moment of inertia J + m l^2 = 0.08 + 1.5*0.5^2, and a filter z' = (u - z)/0.1
    m = mbdkit.Mechanism()
    m.body("arm", mass=1.5, inertia=0.08, position=(0.0, -0.5), angle=-math.pi / 2)
    m.revolute("hub", m.ground, "arm", at=(0.0, 0.0))
    m.input("torque", unit="N*m")
    m.input("signal", hold="linear")
    m.state("filtered", rate="(inputs.signal - states.filtered)/0.1")
    m.torque("motor", "arm", value="inputs.torque + 2*states.filtered")
    linear = mbdkit.linearize(m)
    turn = linear.basis[2, 0]
    acceleration = 1.0 / (0.08 + 1.5 * 0.25)
    np.testing.assert_allclose(turn * linear.input_matrix()[1], [acceleration, 0.0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(linear.input_matrix()[[0, 2]], [[0.0, 0.0], [0.0, 10.0]], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(turn * linear.state_matrix()[1, 2], 2.0 * acceleration, rtol=1e-9)
