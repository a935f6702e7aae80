"""Beams as they are written down: nodes, masses, cross-sections, shapes, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.mechanism.beam_shape import with_ends
from mbdkit.mechanism.beams import beam_of
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec

STEEL = {"E": 2.0e11, "nu": 0.25, "density": 8000.0}
STRIP = {"A": 2.0e-4, "I": 4.0e-10}
DIRECT = {"stiffness": {"axial": 100.0, "shear": 50.0, "bending": 2.0}, "mass_per_length": 3.0}


def positions(m: Mechanism, nodes: tuple[str, ...]) -> np.ndarray:
    """Return x, y and angle of some bodies."""
    return np.array([(*m.bodies[node].position, m.bodies[node].angle) for node in nodes])


@pytest.mark.parametrize(("nodes", "shares"), [(2, [1, 2, 2, 1]), (3, [1, 4, 2, 4, 2, 4, 1])])
def test_nodes_have_the_mass_of_the_beam_by_the_trapezoidal_rule_and_by_simpsons(nodes: int, shares: list[int]) -> None:
    m = Mechanism()
    names = m.beam("link", a=(1.0, 1.0), b=(1.0, 4.0), elements=3, nodes=nodes, **STEEL, **STRIP)
    assert names == tuple(m.bodies) == tuple(f"link.{i}" for i in range(len(shares)))
    mass = np.array([m.bodies[name].mass for name in names])
    inertia = np.array([m.bodies[name].inertia for name in names])
    np.testing.assert_allclose(mass, 8000.0 * 2.0e-4 * 3.0 * np.array(shares) / sum(shares), rtol=1e-14)
    np.testing.assert_allclose(inertia, mass * 4.0e-10 / 2.0e-4, rtol=1e-14)
    expected = np.column_stack([np.ones(len(names)), np.linspace(1.0, 4.0, len(names)), np.full(len(names), np.pi / 2)])
    np.testing.assert_allclose(positions(m, names), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("elements", [2, 3, 4, 5, 9])
def test_nodes_of_corrected_elements_have_the_inertia_of_a_rigid_rod(elements: int) -> None:
    # expected: mass, first and second moment of a uniform rod about its end, m, m L/2 and m L^2/3
    m = Mechanism()
    names = m.beam("rod", a=(0.0, 0.0), b=(2.0, 0.0), elements=elements, corrected=True, **DIRECT)
    mass, x = np.array([(m.bodies[name].mass, m.bodies[name].position[0]) for name in names]).T
    assert np.all(mass > 0)
    np.testing.assert_allclose([np.sum(mass * x**k) for k in range(3)], [6.0, 6.0, 8.0], rtol=1e-14)


def test_only_two_node_elements_are_corrected() -> None:
    with pytest.raises(SpecError, match=r"beams\.rod\.corrected: is for elements with two nodes"):
        Mechanism().beam("rod", a=(0.0, 0.0), b=(2.0, 0.0), nodes=3, corrected=True, **DIRECT)


def test_stiffnesses_follow_from_the_material_unless_they_are_given() -> None:
    # expected: EA, k G A with G = E / (2 (1 + nu)), EI
    ends = {"a": (0.0, 0.0), "b": (2.0, 0.0)}
    m = Mechanism()
    m.beam("steel", **ends, **STEEL, **STRIP)
    m.beam("stiff", **ends, **STEEL, **STRIP, stiffness={"axial": 7.0})
    m.beam("slender", **ends, **STRIP, E=2.0e11, density=8000.0, stiffness={"shear": "none"})
    m.beam("direct", **ends, **DIRECT)
    assert m.beams["steel"].section_stiffness == pytest.approx((4.0e7, 5 / 6 * 8.0e10 * 2.0e-4, 80.0))
    assert m.beams["stiff"].section_stiffness == pytest.approx((7.0, 5 / 6 * 8.0e10 * 2.0e-4, 80.0))
    assert m.beams["direct"].section_stiffness == (100.0, 50.0, 2.0)
    assert m.beams["direct"].inertia_per_length == (3.0, 3.0 * 2.0 / 100.0)
    bending, shear = 80.0, m.beams["slender"].section_stiffness.shear
    # a force P deflects a cantilever by P L^3 / 3 EI in bending and by P L / GA in shear
    assert (2.0 / shear) / (2.0**3 / (3 * bending)) == pytest.approx(1e-6)


def test_a_curved_beam_lies_on_its_points_with_its_nodes_at_equal_lengths() -> None:
    # expected: one and a half turns of a circle of radius 2; angles are not wrapped
    turn = np.linspace(0.0, 3 * np.pi, 301)
    m = Mechanism()
    nodes = m.beam("ring", points=np.column_stack([2 * np.cos(turn), 2 * np.sin(turn)]), elements=12, **DIRECT)
    at = np.linspace(0.0, 3 * np.pi, 13)
    expected = np.column_stack([2 * np.cos(at), 2 * np.sin(at), at + np.pi / 2])
    np.testing.assert_allclose(positions(m, nodes), expected, rtol=0, atol=2e-5)
    assert m.beams["ring"].length == pytest.approx(6 * np.pi, rel=1e-7)


def test_a_parabola_through_three_points_has_its_arc_length() -> None:
    # expected: the length of y = x^2 from -1 to 1, sqrt(5) + asinh(2)/2
    m = Mechanism()
    nodes = m.beam("bow", points=[(-1.0, 1.0), (0.0, 0.0), (1.0, 1.0)], elements=4, nodes=3, **DIRECT)
    assert m.beams["bow"].length == pytest.approx(math.sqrt(5) + math.asinh(2) / 2, rel=1e-9)
    x, y, angle = positions(m, nodes).T
    np.testing.assert_allclose(y, x**2, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.tan(angle), 2 * x, rtol=0, atol=1e-13)
    lengths = x * np.sqrt(1 + 4 * x**2) / 2 + np.arcsinh(2 * x) / 4
    np.testing.assert_allclose(np.diff(lengths), m.beams["bow"].length / 8, rtol=1e-9)


def test_a_beam_moves_as_a_rigid_body_at_the_start() -> None:
    m = Mechanism()
    m.beam("rotor", a=(1.0, 0.0), b=(3.0, 0.0), elements=2, velocity=(0.5, 0.0), angular_velocity=4.0, **DIRECT)
    assert [body.velocity for body in m.bodies.values()] == [(0.5, 0.0), (0.5, 4.0), (0.5, 8.0)]
    assert {body.angular_velocity for body in m.bodies.values()} == {4.0}


def test_a_distributed_load_becomes_forces_on_the_nodes() -> None:
    m = Mechanism()
    table = {"table": [[0.0, 1.0], [0.0, 8.0]]}
    m.beam("wing", a=(0, 0), b=(4, 0), elements=2, load=("3*t", table), load_frame="body", **DIRECT)
    assert list(m.forces) == ["wing.0.load", "wing.1.load", "wing.2.load"]
    middle = m.forces["wing.1.load"]
    assert (middle.body, middle.frame, middle.value[0]) == ("wing.1", "body", "(3*t)*2.0")
    assert middle.value[1].table[1] == (0.0, 16.0)


def test_a_beam_survives_the_way_through_a_spec() -> None:
    m = Mechanism()
    m.body("hub", mass=1.0, inertia=1.0)
    m.beam("spoke", a=(0, 0), b=(1, 0), elements=3, nu=0.0, E=1e9, **STRIP, density=1.0, load=(0.0, -2.0))
    m.weld("root", "hub", "spoke.0", at=(0, 0))
    spec = m.to_spec()
    assert list(spec["bodies"]) == ["hub"]
    assert "forces" not in spec
    again = Mechanism.from_spec(spec)
    assert again.to_spec() == spec
    assert (again.bodies, again.forces, again.beams) == (m.bodies, m.forces, m.beams)
    assert m.description() == "1 body, 1 beam, 1 joint, 0 drivers, 4 forces; 3 constraint rows"


ENDS = {"a": [0, 0], "b": [1, 0]}


def test_a_beam_with_numbers_that_overflow_is_refused() -> None:
    for extreme in ({"b": [1e-300, 0.0]}, {"stiffness": {"axial": 1e308, "shear": 1e308, "bending": 1e308}}):
        with pytest.raises(SpecError, match="too large") as caught:
            Mechanism.from_spec({"beams": {"link": {**ENDS, **DIRECT, **extreme}}})
        assert caught.value.key == "model.beams.link"


def test_a_joint_to_a_node_that_does_not_exist_is_told_the_nodes() -> None:
    m = Mechanism()
    m.beam("link", a=(0, 0), b=(1, 0), elements=4, **DIRECT)
    with pytest.raises(SpecError, match=r"no node 'link\.5'; the beam 'link' has 'link\.0' to 'link\.4'"):
        m.revolute("pin", m.ground, "link.5", at=(0, 0))


def test_a_joint_to_a_whole_beam_is_told_the_names_of_its_nodes() -> None:
    m = Mechanism()
    m.beam("link", a=(0, 0), b=(1, 0), elements=4, **DIRECT)
    with pytest.raises(SpecError, match=r"'link' is a beam; name one of its nodes, 'link.0' to 'link.4'"):
        m.revolute("pin", m.ground, "link", at=(0, 0))


def test_a_body_is_not_named_like_a_node() -> None:
    m = Mechanism()
    m.beam("a.b", a=(0, 0), b=(1, 0), elements=2, **DIRECT)
    m.body("a.toe", mass=1)
    assert [beam_of(name) for name in m.bodies] == ["a.b", "a.b", "a.b", ""]
    m.body("a.b.7", mass=1)
    with pytest.raises(SpecError, match=r'bodies."a.b.7": .* a node of the beam'):
        m.validate()


@pytest.mark.parametrize(("nodes", "corrected", "nearly"), [(2, False, 0.9), (2, True, 0.8), (3, False, 0.9)])
def test_no_mode_is_faster_than_an_element_alone(nodes: int, corrected: bool, nearly: float) -> None:
    # expected: Irons' bound, which the fastest mode of many elements nearly reaches
    m = Mechanism(gravity=(0.0, 0.0))
    m.beam("link", a=(0.0, 0.0), b=(2.0, 1.0), elements=12, nodes=nodes, corrected=corrected, **STEEL, **STRIP)
    bound = m.beams["link"].highest_frequency
    found = mbdkit.modes(m, at="start", time={"end": 1.0, "step": 0.1}).natural_frequency[-1]
    assert nearly * bound < found <= bound * (1 + 1e-12)


@pytest.mark.parametrize("nodes", [2, 3])
def test_internal_forces_at_the_clamp_of_an_elastica_are_those_of_the_load(nodes: int) -> None:
    """A cantilever of length 1 and stiffness 1 with a load of 10 at its tip: theta'' = 10 cos(theta), by SciPy. At the
    clamp, the shear force is the load, and the axial force is zero.
    """
    elastica = solve_bvp(
        lambda s, y: np.vstack([y[1], 10.0 * np.cos(y[0])]),
        lambda a, b: np.array([a[0], b[1]]),
        np.linspace(0.0, 1.0, 101),
        np.vstack([np.linspace(0.0, -1.0, 101), -np.ones(101)]),
        tol=1e-9,
    )
    gauss = np.array([0.0] if nodes == 2 else [-1.0, 1.0]) / np.sqrt(3.0)
    errors = []
    for elements in (8, 16, 32):
        angles = elastica.sol(np.linspace(0.0, 1.0, (nodes - 1) * elements + 1))[0]
        ends = angles[: -1 : nodes - 1, None], angles[nodes - 1 :: nodes - 1, None]
        middle = (ends[0] + ends[1]) / 2 if nodes == 2 else angles[1::2, None]
        sections = middle + gauss * (ends[1] - ends[0]) / 2 + gauss**2 * ((ends[0] + ends[1]) / 2 - middle)
        moment = elastica.sol((np.arange(elements)[:, None] + 0.5 + gauss / 2) / elements)[1]
        forces = np.stack([-10.0 * np.sin(sections), -10.0 * np.cos(sections), moment], axis=-1).mean(axis=1)
        axial, shear, bending = with_ends(forces, angles, 1.0 / elements)[0]
        assert (axial, shear) == pytest.approx((0.0, -10.0), abs=1e-12)
        errors.append(abs(bending - elastica.sol(0.0)[1]))
    assert errors[0] < 5e-3 * abs(elastica.sol(0.0)[1])
    assert np.all(np.divide(errors[:-1], errors[1:]) > 6.0)


def test_the_last_node_has_a_name_for_any_number_of_elements() -> None:
    model = {"name": "mechanism", "bodies": {"block": {"mass": 1.0, "inertia": 1.0, "position": [2.0, 0.0]}}}
    model["beams"] = {"link": {"a": [0.0, 0.0], "b": [1.0, 0.0], "elements": "n", **DIRECT}}
    model["joints"] = {"end": {"type": "weld", "bodies": ["link.last", "block"], "at": [1.0, 0.0]}}
    pathway = {"type": "two-points", "bodies": ["ground", "link.last"], "points": [[0.0, 1.0], [0.0, 0.0]]}
    model["forces"] = {"tip": {"type": "force", "body": "link.last", "value": [0.0, "-bodies['link.last'].vy"]}}
    model["forces"] |= {"rope": {"type": "law", "law": "linear", "stiffness": 1.0, "pathway": pathway}}
    model["markers"] = {"tip": {"body": "link.last"}}
    model["coordinates"] = {"height": "link.last.y"}
    spec = {"mbdkit": 1, "parameters": {"n": 4}, "model": model, "integrator": {"name": "rk4"}}
    spec |= {"events": {"low": {"when": "bodies['link.last'].y + 1"}}, "time": {"end": 1e-3, "step": 1e-4}}
    spec |= {"measures": {"tip": "final(bodies['link.last'].x)"}}
    for count in (4, 8):
        loaded = load_spec(spec, [f"parameters.n={count}"])
        mechanism, node = loaded.mechanism(), f"link.{count}"
        assert mechanism.joints["end"].bodies == (node, "block")
        assert mechanism.forces["rope"].pathway.bodies == ("ground", node)
        assert mechanism.forces["tip"].body == mechanism.markers["tip"].body == node
        assert mechanism.coordinates["height"].of == f"{node}.y"
        run = mbdkit.run(loaded)
        assert run.measures["tip"] == run[node].position[-1, 0]


def test_the_last_node_has_the_same_name_in_inverse_dynamics_and_results() -> None:
    t = np.linspace(0.0, 1.0, 21)
    data = {"t": t, "x": 1.0 + 0.0 * t, "y": -0.01 * np.sin(t), "angle": -0.02 * np.sin(t)}
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 1e5, "shear": "none", "bending": 1.0}
    bar = m.beam("bar", a=(0, 0), b=(1, 0), elements=1, stiffness=stiffness, mass_per_length=0.2)
    m.weld("clamp", m.ground, bar[0], at=(0, 0))

    def inverse(end: str) -> mbdkit.Run:
        columns = {f"{end}.{name}": name for name in ("x", "y", "angle")}
        motion = {"data": data, "time": "t", "columns": columns, "smooth": "none"}
        load = {"body": end, "point_frame": end, "point": [0.0, 0.0], "force": [0.0, -2.0]}
        return mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": {"weight": load}})

    run, other = inverse("bar.last"), inverse("bar.1")
    np.testing.assert_array_equal(run.joints["clamp"].reaction_force, other.joints["clamp"].reaction_force)
    assert run["bar.last"].name == "bar.1"
    with pytest.raises(KeyError, match=r"no body 'rod\.last'"):
        run["rod.last"]
    np.testing.assert_array_equal(mbdkit.equilibrium(m)["bar.last"], mbdkit.equilibrium(m)["bar.1"])
