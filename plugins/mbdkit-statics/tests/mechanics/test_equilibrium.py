"""Static equilibria, with first-order states too, compared with statics, minimisation and long damped runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import mbdkit
from mbdkit import SpecError
from mbdkit_statics.equilibrium import equilibrium_of, spec_at
from mbdkit_statics.mechanics_summary import equilibrium_text
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from tests.margins import assert_within

from .chains import G, hung_between, spec, weight_on_a_spring


def test_a_weight_stretches_its_spring_by_its_weight_over_the_stiffness() -> None:
    # expected: Hooke's law
    found = mbdkit.equilibrium(weight_on_a_spring(stiffness=400.0, damping=3.0, mass=2.0))
    assert found["block"][1] == pytest.approx(-1.0 - 2.0 * G / 400.0, rel=1e-14)
    assert found.stability == "stable"
    assert found.stiffness == pytest.approx(400.0 / 2.0, rel=1e-13)


@pytest.mark.parametrize("angles", [[0.0, 0.0], [2.0, -3.0], [1.5, 1.6], [-1.5, 0.3]])
def test_two_rods_end_hanging_wherever_they_start(angles: list[float]) -> None:
    # expected: both tilts are -pi/2 up to whole turns; the upper joint carries both weights
    found = mbdkit.equilibrium(spec({"name": "double-pendulum", "angles": angles}))
    np.testing.assert_allclose(np.sin(found.position[:, 2]), -1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.cos(found.position[:, 2]), 0.0, rtol=0, atol=3e-13)
    np.testing.assert_allclose(found.reaction_force, [[0.0, 2 * G], [0.0, G]], rtol=0, atol=1e-11)
    assert found.stability == "stable"
    assert_within(found.residual, 1e-14)


def test_an_inverted_pendulum_is_in_balance_and_said_to_be_unstable() -> None:
    # expected: theta'' = +3 g / (2 L) theta
    found = mbdkit.equilibrium(spec({"name": "single-pendulum", "angle": math.pi / 2}))
    assert found.stability == "unstable"
    assert found["rod1"][2] == math.pi / 2
    assert found.stiffness == pytest.approx(-1.5 * G, rel=1e-13)


def test_a_body_without_forces_is_in_neutral_balance() -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("puck", mass=1.0, inertia=0.1, position=(1.0, 2.0), angle=0.5)
    found = mbdkit.equilibrium(m)
    assert found.stability == "neutral"
    np.testing.assert_array_equal(found["puck"], [1.0, 2.0, 0.5])


def test_rods_between_two_supports_obey_the_statics_of_each_rod() -> None:
    # expected: statics: one horizontal force H throughout, and on rod i tan(tilt) = (vertical force at its middle) / H
    n = 12
    found = mbdkit.equilibrium(hung_between(2.0, n, 0.25))
    horizontal, vertical = found.reaction_force.T
    np.testing.assert_allclose(horizontal, horizontal[0], rtol=1e-12)
    middle = 0.5 * (vertical[:-1] + vertical[1:])  # joint i is at the left end of rod i
    np.testing.assert_allclose(np.tan(found.position[:, 2]), middle / horizontal[0], rtol=0, atol=1e-12)
    assert vertical[0] - vertical[-1] == pytest.approx(n * G, rel=1e-13)


def test_the_knee_rests_where_a_long_damped_run_comes_to_rest() -> None:
    # expected: a run of 40 s at the example's own step, in which motion decays by exp(-1.5 t); its joints drift 3e-11 m
    # apart, which is 1e-9 of the rods' length and so of the forces
    found = mbdkit.equilibrium("knee")
    run = mbdkit.run("knee", time={"end": 40.0, "step": 0.005})
    assert_within(run.misalignment_max, 1e-10)
    for i, name in enumerate(found.bodies):
        np.testing.assert_allclose(run[name].position[-1], found.position[i, :2], rtol=0, atol=2e-10)
        np.testing.assert_allclose(run[name].angle[-1], found.position[i, 2], rtol=0, atol=3e-9)
    for j, name in enumerate(found.joints):
        np.testing.assert_allclose(run.joints[name].reaction_force[-1], found.reaction_force[j], rtol=1e-8)


def test_drivers_are_held_where_they_are_at_the_start_time() -> None:
    # expected: a pendulum on a support at x = sin(t) hangs below it
    m = mbdkit.Mechanism()
    m.body("cart", mass=1.0, inertia=0.1)
    m.body("bob", mass=1.0, inertia=0.02, position=(0.3, -0.4))
    m.prismatic("rail", m.ground, "cart", at=(0.0, 0.0), axis=(1.0, 0.0), angle=0.0)
    m.driver("push", m.ground, "cart", coordinate="x", motion="sin(t)")
    m.revolute("pin", "cart", "bob", points=((0.0, 0.0), (-0.3, 0.4)))
    found = mbdkit.equilibrium(m, time={"start": 1.0, "end": 2.0, "step": 1.0})
    np.testing.assert_allclose(found["bob"][:2], [math.sin(1.0), -0.5], rtol=0, atol=1e-14)
    assert_within(found.reaction_force[found.joints.index("push"), 0], 1e-12)


def test_redundant_supports_are_balanced_and_named() -> None:
    # expected: two equal cranks carry a weight between them; a third crank, in the middle, is redundant
    m = mbdkit.Mechanism()
    m.body("beam", mass=3.0, inertia=1.0, position=(0.8, 0.6))
    for i, x in enumerate((-1.0, 0.0, 1.0)):
        m.body(f"crank{i}", mass=1.0, inertia=0.1, position=(x + 0.4, 0.3), angle=math.atan2(0.6, 0.8))
        m.revolute(f"A{i}", m.ground, f"crank{i}", at=(x, 0.0))
        m.revolute(f"B{i}", f"crank{i}", "beam", at=(x + 0.8, 0.6))
    found = mbdkit.equilibrium(m)
    np.testing.assert_allclose(found["beam"], [0.0, -1.0, 0.0], rtol=0, atol=1e-12)
    assert found.shared
    assert found.reaction_force[::2, 1].sum() == pytest.approx(6.0 * G, rel=1e-12)


def test_what_falls_for_ever_has_no_equilibrium_and_is_named() -> None:
    m = mbdkit.Mechanism()
    m.body("stone", mass=1.0, inertia=0.1)
    with pytest.raises(mbdkit.SpecError, match=r"no static equilibrium.*body 'stone'.*9\.81 m/s\^2"):
        mbdkit.equilibrium(m)


@pytest.mark.parametrize("n", [30, pytest.param(100, marks=pytest.mark.slow)])
def test_long_chains_fall_from_a_tangle_into_a_stable_equilibrium(n: int) -> None:
    # expected: every rod hangs, whichever way it was turned
    angles = (-1.0 + np.random.default_rng(5).standard_normal(n)).tolist()
    found = mbdkit.equilibrium(spec({"name": "n-pendulum", "n": n, "angles": angles}))
    np.testing.assert_allclose(np.sin(found.position[:, 2]), -1.0, rtol=0, atol=1e-12)
    assert found.stability == "stable"


@pytest.mark.parametrize(
    ("angle", "stability", "sign"),
    [pytest.param(0.0, "stable", 1, marks=pytest.mark.slow), (math.pi / 2, "unstable", -1)],
)
def test_a_chain_too_large_for_dense_matrices_hangs_or_stands_too(angle: float, stability: str, sign: int) -> None:
    # expected: the lowest frequency of a heavy hanging cord, j0 / 2 sqrt(g / L), with j0 the first zero of J0;
    # 600 rods come within 1e-5 of it. Standing upright, gravity has the other sign
    n = 600
    found = mbdkit.equilibrium(spec({"name": "n-pendulum", "n": n, "length": 1.0 / n, "mass": 1.0 / n, "angle": angle}))
    assert found.stability == stability
    assert found.stiffness == pytest.approx(sign * (2.404825557695773 / 2) ** 2 * G, rel=1e-5)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 12))])
def test_a_column_that_buckles_ends_beside_its_upright_position(seed: int) -> None:
    # a search that starts near the upright position ends on it, a saddle, as if it were stable: the weight exceeds what
    # the soft hinges carry
    random = np.random.default_rng(seed)
    m = mbdkit.Mechanism()
    below = m.ground
    for i in range(3):
        tilt = math.pi / 2 + random.normal() * 10 ** random.uniform(-5, -1)
        rod = m.body(f"b{i}", mass=1.0, inertia=1 / 12, position=(0.0, 0.5 + i), angle=tilt)
        m.revolute(f"j{i}", below, rod, points=[(0.0, 0.0) if i == 0 else (0.5, 0.0), (-0.5, 0.0)])
        m.torsion_spring(f"t{i}", below, rod, stiffness=10.0, free_angle=math.pi / 2 if i == 0 else 0.0)
        below = rod
    found = mbdkit.equilibrium(m)
    assert found.stability == "stable"
    assert found.stiffness > 0


@pytest.mark.parametrize("nodes", [2, 3])
def test_internal_forces_of_a_beam_at_rest_reach_its_ends(nodes: int) -> None:
    """Beam theory, small deflections: moment w L^2 / 2 + P L and shear force w L + P at the clamp, P at the tip."""
    length, weight, force = 2.0, 7850 * 1e-3 * 9.81, 10.0
    m = mbdkit.Mechanism()
    m.beam("bar", a=(0, 0), b=(length, 0), elements=8, nodes=nodes, E=2.1e13, nu=0.3, A=1e-3, I=5e-7, density=7850)
    tip = m.beams["bar"].node_names("bar")[-1]
    m.weld("clamp", m.ground, "bar.0", at=(0, 0))
    m.force("tip", tip, value=(0, -force))
    found = mbdkit.equilibrium(m, integrator={"name": "radau-iia"}, time={"end": 1.0, "step": 0.1})
    at, axial, shear, moment = found.beams["bar"].T
    assert at[[0, 1, -1]] == pytest.approx([0, length / 16, length])
    assert -moment[0] == pytest.approx(weight * length**2 / 2 + force * length, rel=1e-6)
    assert -moment[0] == pytest.approx(found.reaction_torque[0], rel=1e-6)
    assert -shear[[0, -1]] == pytest.approx([weight * length + force, force], rel=1e-6)
    assert [moment[-1], axial[0]] == pytest.approx([0, 0], abs=1e-5 * weight)
    (row,) = (line.split() for line in equilibrium_text(found).splitlines() if line.startswith(f"{tip} "))
    sag = weight * length**4 / (8 * 2.1e13 * 5e-7) + force * length**3 / (3 * 2.1e13 * 5e-7)
    # margin: shear, which is left out
    assert float(row[5]) == pytest.approx(-sag, rel=0.01 if nodes == 2 else 2e-3)  # shear adds 0.12 %


def test_a_beam_without_weight_carries_a_load_that_rounding_errors_of_its_axial_force_exceed() -> None:
    # expected: Euler and Bernoulli's cantilever, of which shear and elements change 1e-4, and statics at its clamp
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    steel: dict[str, Any] = {"E": 2.1e11, "nu": 0.3, "A": 2e-5, "I": 0.02e-9 / 12.0, "density": 7850.0}
    nodes = m.beam("blade", a=(0, 0), b=(1, 0), elements=24, nodes=3, **steel)
    m.weld("clamp", m.ground, nodes[0], at=(0, 0))
    m.force("push", nodes[-1], value=(0.0, -1e-4))
    found = mbdkit.equilibrium(m)
    assert found["blade.last"][1] == pytest.approx(-1e-4 / (3.0 * steel["E"] * steel["I"]), rel=1e-4)
    np.testing.assert_allclose(found.reaction_force, [[0.0, 1e-4]], atol=1e-7)
    assert found.reaction_torque[0] == pytest.approx(1e-4, rel=1e-5)


@pytest.mark.parametrize("stiff", ["blade", "grain"])
@pytest.mark.parametrize(("mass", "stiffness", "load"), [(10.0, 10.0, 0.1), (100.0, 1.0, 0.1), (0.01, 0.01, 1e-4)])
def test_a_soft_spring_yields_beside_what_is_stiff(stiff: str, mass: float, stiffness: float, load: float) -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    slide = m.body("slide", mass=mass, position=(0.5, 0.0))
    m.driver("rail", m.ground, slide, coordinate="y", motion=0.0)
    m.spring_damper("soft", m.ground, slide, points=((0, 0), (0, 0)), stiffness=stiffness, free_length=0.5)
    m.force("push", slide, value=(load, 0.0))
    if stiff == "blade":
        blade = m.beam("blade", a=(0, 1), b=(1, 1), elements=10, E=2.1e11, nu=0.3, A=2e-5, I=1.7e-12, density=7850.0)
        m.weld("clamp", m.ground, blade[0], at=(0, 1))
    else:
        grain = m.body("grain", mass=1e-3, position=(0.5, 1.0))
        m.driver("rail of the grain", m.ground, grain, coordinate="y", motion=1.0)
        m.spring_damper("hard", m.ground, grain, points=((0, 1), (0, 0)), stiffness=1e8, free_length=0.5)
    assert mbdkit.equilibrium(m)["slide"][0] == pytest.approx(0.5 + load / stiffness, abs=1e-12)


@pytest.mark.parametrize("mass", [1.0, 1.59])
def test_a_ball_that_just_touches_sinks_into_its_floor_however_far_away_other_bodies_are(mass: float) -> None:
    stiffness, radius = 2.9e6, 0.29
    ball = {"mass": mass, "inertia": 1.6e-4, "position": [-239.0, radius]}
    pendulum = {"mass": 1.0, "inertia": 0.1, "position": [5.0, -1e-3]}
    law = {"law": "hunt-crossley", "stiffness": stiffness}
    shapes = [{"line": {"normal": [0, 1]}}, {"circle": {"radius": radius}}]
    model = {
        "name": "mechanism",
        "bodies": {"ball": ball, "pendulum": pendulum},
        "contacts": {"c": {"bodies": ["ground", "ball"], "shapes": shapes, "compliance": law}},
        "joints": {"q": {"type": "revolute", "bodies": ["ground", "pendulum"], "points": [[5.0, 0], [0, 1e-3]]}},
    }
    found = mbdkit.equilibrium({"mbdkit": 1, "model": model})
    assert radius - found["ball"][1] == pytest.approx((mass * G / stiffness) ** (2 / 3), rel=1e-6)
    assert len(found.neutral_motions) == 2


def test_coarse_corrected_elements_bend_far() -> None:
    # expected: 0.74457 L under the force 6 EI/L^2 across the tip, in Mattiasson's table of the elastica (1981)
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 4e6, "bending": 4 / 3, "shear": "none"}
    rod = m.beam("rod", a=(0, 0), b=(1, 0), elements=4, corrected=True, stiffness=stiffness, mass_per_length=0.157)
    m.weld("clamp", m.ground, rod[0], at=(0.0, 0.0))
    m.force("tip", rod[-1], value=(0.0, 8.0))
    found = mbdkit.equilibrium(m)
    assert found[rod[-1]][1] == pytest.approx(0.74457, rel=0.012)  # margin: error of these elements
    assert found.stability == "stable"
    assert "too coarse: its moments or deflections may be wrong by about 1.5 %" in found.warnings[0]


@pytest.mark.parametrize(("elements", "nodes", "is_coarse"), [(8, 3, True), (20, 2, True), (60, 2, False)])
def test_beams_that_bend_within_an_element_are_told(
    elements: int, nodes: int, is_coarse: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    # expected: elastica under a force P across its tip, M^2 = 2 P EI sin(angle of the tip) at the clamp
    force, bending = 3000.0, 2.75
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 1e7, "bending": bending, "shear": "none"}
    shape = {"a": (0.0, 0.0), "b": (0.5, 0.0), "elements": elements, "nodes": nodes}
    blade = m.beam("blade", **shape, stiffness=stiffness, mass_per_length=0.2)
    m.weld("clamp", m.ground, blade[0], at=(0.0, 0.0))
    m.force("tip", blade[-1], value=(0.0, -force))
    found = mbdkit.equilibrium(m)
    expected = np.sqrt(2.0 * force * bending * np.sin(-found[blade[-1]][2]))
    assert (abs(found.reaction_torque[0] / expected - 1.0) > 0.01) == is_coarse
    assert [warning.partition(":")[0] for warning in found.warnings] == [
        "the elements of beam 'blade' are too coarse"
    ] * is_coarse
    assert capsys.readouterr().err.count("too coarse") == is_coarse


INERTIA, GRAVITY = 0.05 + 3.0 * 0.2**2, 3.0 * 9.81 * 0.2
STIFFNESS, DAMPING, LAG = 12.0, 0.4, 0.05


def leg(value: str, **states: Any) -> dict[str, Any]:
    """A leg of 3 kg on a hip 0.2 m above its centre of mass, under feedback."""
    model = {
        "name": "mechanism", "bodies": {"leg": {"mass": 3.0, "inertia": 0.05, "position": [0.0, -0.2]}},
        "joints": {"hip": {"type": "revolute", "bodies": ["ground", "leg"], "points": [[0, 0], [0, 0.2]]}},
        "forces": {"motor": {"type": "torque", "body": "leg", "value": value}}, "states": states,
    }  # fmt: skip
    return {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}}


def filtered(gain: float) -> dict[str, Any]:
    """Damping directly, and stiffness by the nonlinearly filtered difference from 0.5 rad."""
    rate = f"(0.5 - leg.angle - 0.2*leg.angular_velocity - states.e - states.e**3)/{LAG}"
    return leg(f"{gain}*states.e - {DAMPING}*leg.angular_velocity", e={"rate": rate})


def at_rest(gain: float) -> tuple[float, float]:
    """Return angle and state at rest: gain e = m g l sin(angle), 0.5 - angle = e + e^3."""

    def unbalanced(e: float) -> float:
        return float(gain * e - GRAVITY * np.sin(0.5 - e - e**3))

    e = float(brentq(unbalanced, 0.0, 0.5, xtol=1e-15))
    return 0.5 - e - e**3, e


def matrix(gain: float) -> np.ndarray:
    """The matrix of small motions of angle, angular velocity and state."""
    angle, e = at_rest(gain)
    return np.array(
        [
            [0, 1, 0],
            [-GRAVITY * np.cos(angle) / INERTIA, -DAMPING / INERTIA, gain / INERTIA],
            [-1 / LAG, -0.2 / LAG, -(1 + 3 * e**2) / LAG],
        ]
    )


def test_an_equilibrium_solves_for_the_states_with_the_mechanism() -> None:
    angle, e = at_rest(STIFFNESS)
    found = mbdkit.equilibrium(filtered(STIFFNESS))
    assert found["leg"][2] == pytest.approx(angle, abs=1e-13)
    assert found.states == ("e",)
    assert found.state[0] == pytest.approx(e, abs=1e-13)
    stiffness = GRAVITY * np.cos(angle) + STIFFNESS / (1 + 3 * e**2)  # the state follows the angle
    assert found.stiffness == pytest.approx(stiffness / INERTIA, rel=1e-10)
    assert found.stability == "stable"
    assert_within(found.imbalance, 1e-10)


@pytest.mark.parametrize("gain", [STIFFNESS, 40.0])
def test_modes_are_those_of_the_coupled_equations(gain: float) -> None:
    wanted = np.linalg.eigvals(matrix(gain))
    linear = mbdkit.linearize(filtered(gain))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(linear.state_matrix())), np.sort_complex(wanted),
                               rtol=1e-9)  # fmt: skip
    found = mbdkit.modes(filtered(gain))
    once = np.sort_complex(wanted[wanted.imag >= 0])
    np.testing.assert_allclose(np.sort_complex(found.eigenvalues), once, rtol=1e-9)


def test_a_linearization_about_a_motion_includes_the_turning_of_the_basis() -> None:
    """About a moving state: the rate of the state contains the velocity of the centre of mass, which turns."""
    angle, speed, e = 0.7, 1.3, 0.2
    spec = leg(f"3*states.e - {DAMPING}*leg.angular_velocity",
               e={"rate": "leg.vx + leg.y - 2*states.e - states.e**3", "initial": e})  # fmt: skip
    c, s = 0.2 * np.cos(angle), 0.2 * np.sin(angle)
    spec["model"]["bodies"]["leg"] |= {
        "angle": angle, "position": [s, -c], "angular_velocity": speed, "velocity": [c * speed, s * speed],
    }  # fmt: skip
    found = mbdkit.linearize(spec, at="start")
    wanted = [
        [0, 1, 0],
        [-GRAVITY * np.cos(angle) / INERTIA, -DAMPING / INERTIA, 3 / INERTIA],
        [s - s * speed, c, -2 - 3 * e**2],
    ]
    scale = np.diag([found.basis[2, 0], found.basis[2, 0], 1.0])  # of a unit of the degree of freedom [rad]
    np.testing.assert_allclose(scale @ found.state_matrix() @ np.linalg.inv(scale), wanted, atol=1e-11)


def test_a_loop_that_oscillates_is_unstable_although_its_stiffness_is_positive() -> None:
    """The torque lags behind the angle: the stiffness is that of rest, but small motions grow."""
    model = leg("20*states.e", e={"rate": f"(-leg.angle - states.e)/{LAG}"})
    found = mbdkit.equilibrium(model)
    values = np.linalg.eigvals([[0, 1, 0], [-GRAVITY / INERTIA, 0, 20 / INERTIA], [-1 / LAG, 0, -1 / LAG]])
    assert values.real.max() > 0.1
    assert found.stiffness == pytest.approx((GRAVITY + 20) / INERTIA, rel=1e-10)
    assert found.stability == "unstable"


def test_the_spec_at_rest_stays_at_rest() -> None:
    """Written with the states of rest, the mechanism does not move."""
    prepared = PreparedMechanism.of(filtered(STIFFNESS))
    run = mbdkit.run(spec_at(prepared, equilibrium_of(prepared))).check()
    assert_within(np.ptp(run["leg"].angle), 1e-13)
    assert_within(np.ptp(run.states["e"].value), 1e-13)


@pytest.mark.parametrize(
    ("spec", "sentence"),
    [
        (leg("states.e", e={"rate": "0.1 - leg.angle"}), "values at rest that the position does not determine"),
        (leg("states.e", e={"rate": "1 + states.e**2"}), "values at rest that the position does not determine"),
    ],
)
def test_states_without_values_at_rest_are_refused(spec: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        mbdkit.equilibrium(spec)


def test_controllers_are_refused() -> None:
    spec = leg("controllers.c.u", e={"rate": "-states.e"})
    spec["model"]["controllers"] = {"c": {"period": 0.01, "outputs": {"u": "-leg.angle"}}}
    for analysis in (mbdkit.equilibrium, mbdkit.modes):
        with pytest.raises(SpecError, match="does not include sampled controllers \\(c\\)"):
            analysis(spec)


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize("lagging", [False, True])
def test_an_equilibrium_holds_inputs_at_their_initial_values(hold: str, lagging: bool) -> None:
    # expected: the torque balances the weight, directly or through a first-order lag
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=1 / 12, position=(0.0, -0.5), angle=-math.pi / 2)
    m.revolute("pin", m.ground, "rod", points=((0.0, 0.0), (-0.5, 0.0)))
    m.input("torque", unit="N m", initial=2.0, hold=hold)
    m.state("lag", rate="(inputs.torque - states.lag)/0.1")
    m.torque("motor", "rod", value="states.lag" if lagging else "inputs.torque")
    found = mbdkit.equilibrium(m)
    assert math.cos(found["rod"][2]) == pytest.approx(2.0 / (0.5 * G), rel=1e-12)
    assert dict(zip(found.states, found.state, strict=True)) == pytest.approx({"lag": 2.0})


def test_inputs_have_no_symbolic_form() -> None:
    m = mbdkit.Mechanism()
    m.body("ball", mass=1.0, inertia=0.1)
    m.input("torque", unit="N m")
    m.torque("motor", "ball", value="inputs.torque")
    with pytest.raises(SpecError, match="inputs have no symbolic form"):
        m.to_sympy()
