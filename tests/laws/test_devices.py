"""Support devices: laws against closed forms; cables over several joints in specs, pictures and inverse dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import mbdkit
from mbdkit import Mechanism, SpecError
from tests.laws.walker import SWEEP, walker

T = np.linspace(0.0, 1.0, 101)


def sweep(law: str, first: float, last: float, **options: Any) -> mbdkit.Run:
    """Return a run that drives a mass along x from `first` to `last` in a second, with a law on its coordinate."""
    m = Mechanism(gravity=(0.0, 0.0))
    m.body("mass", mass=1.0, position=(first, 0.0))
    motion = {"table": [[0, 1], [first, last]], "interpolation": "linear"}
    m.driver("x", m.ground, "mass", coordinate="x", motion=motion)
    m.driver("y", m.ground, "mass", coordinate="y", motion=0.0)
    m.law("device", m.ground, "mass", law=law, along="x", **options)
    return mbdkit.run(m, integrator={"name": "rk4"}, time=SWEEP).check()


def stored_by_quadrature(force: Any, lengths: np.ndarray, begin: float) -> np.ndarray:
    return np.array([quad(force, begin, x, epsabs=1e-13, epsrel=1e-13, limit=200)[0] for x in lengths])


@pytest.mark.parametrize(("acts", "side"), [("tension", 1.0), ("compression", -1.0)])
def test_an_exponential_spring_stiffens_with_its_force(acts: str, side: float) -> None:
    # expected: dF/dx = growth (F + scale), here as F = scale (exp(growth x) - 1), and zero on the other side
    device = sweep("exponential", -0.2, 0.2, scale=3.0, growth=12.0, free_length=0.05, acts=acts).forces["device"]
    stretch = np.maximum(side * (device.length - 0.05), 0.0)
    np.testing.assert_allclose(device.value, side * 3.0 * np.expm1(12.0 * stretch), rtol=1e-12, atol=1e-13)

    def force(x: float) -> float:
        return side * 3.0 * np.expm1(12.0 * max(side * (x - 0.05), 0.0))

    expected = stored_by_quadrature(force, device.length, 0.05)
    np.testing.assert_allclose(device.potential, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.4])
def test_a_gas_spring_follows_the_polytropic_law_from_preload_to_progression(exponent: float) -> None:
    # expected: p V^n = constant with p ~ push and V linear in the length, from V_1 to V_2 = V_1 progression^(-1/n)
    options = {"preload": 400.0, "progression": 1.5, "extended_length": 0.6, "stroke": 0.25, "exponent": exponent}
    device = sweep("gas-spring", 0.6, 0.35, **options).forces["device"]
    push = -device.value
    assert push[0] == pytest.approx(400.0, rel=1e-12)
    assert push[-1] == pytest.approx(600.0, rel=1e-12)
    volume = np.interp(device.length, [0.35, 0.6], [1.5 ** (-1 / exponent), 1.0])
    np.testing.assert_allclose(push * volume**exponent, 400.0, rtol=1e-12)

    def force(x: float) -> float:
        return float(-400.0 * np.interp(x, [0.35, 0.6], [1.5 ** (-1 / exponent), 1.0]) ** -exponent)

    np.testing.assert_allclose(device.potential, stored_by_quadrature(force, device.length, 0.6), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("exponent", [1.0, 1.4])
def test_a_gas_spring_that_is_pressed_beyond_its_stroke_continues_linearly(exponent: float) -> None:
    # expected: stiffness n F_2 q / v_2 at full stroke, with q = (1 - v_2) / stroke and v_2 = progression^(-1/n)
    options = {"preload": 400.0, "progression": 1.5, "extended_length": 0.6, "stroke": 0.25, "exponent": exponent}
    device = sweep("gas-spring", 0.35, -0.2, **options).forces["device"]
    volume = 1.5 ** (-1 / exponent)
    stiffness = exponent * 600.0 * (1 - volume) / 0.25 / volume
    beyond = 0.35 - device.length
    np.testing.assert_allclose(device.value, -600.0 - stiffness * beyond, rtol=1e-12)
    stored = device.potential - device.potential[0]
    np.testing.assert_allclose(stored, 600.0 * beyond + stiffness * beyond**2 / 2, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(("acts", "side"), [("tension", 1.0), ("compression", -1.0)])
def test_a_spring_that_engages_late_begins_with_its_full_force(acts: str, side: float) -> None:
    # expected: k (s - s_0) beyond the engagement, nothing before; the energy begins at zero there
    options = {"stiffness": 50.0, "free_length": -0.02 * side, "engages_at": 0.0501 * side, "acts": acts}
    device = sweep("one-sided", -0.2, 0.2, **options).forces["device"]
    engaged = side * device.length > 0.0501
    x = device.length + 0.02 * side
    np.testing.assert_allclose(device.value, np.where(engaged, 50.0 * x, 0.0), rtol=1e-12, atol=1e-14)
    stored = 25.0 * (x**2 - 0.0701**2)
    np.testing.assert_allclose(device.potential, np.where(engaged, stored, 0.0), rtol=1e-10, atol=1e-13)
    assert 0 < np.count_nonzero(engaged) < len(engaged)


@pytest.mark.parametrize(
    ("law", "options", "words"),
    [
        ("one-sided", {"stiffness": 1.0, "acts": "tension", "engages_at": -0.1}, "should be above the free length 0"),
        ("one-sided", {"stiffness": 1.0, "acts": "compression", "engages_at": 0.1}, "should be below the free length"),
        ("gas-spring", {"preload": 1.0, "progression": 1.0, "extended_length": 1.0, "stroke": 0.5}, "progression: "),
        ("exponential", {"scale": 1.0, "growth": 0.0, "acts": "tension"}, "growth: "),
    ],
)
def test_options_that_make_no_device_are_refused(law: str, options: dict[str, Any], words: str) -> None:
    m = Mechanism()
    m.body("mass", mass=1.0)
    with pytest.raises(SpecError, match=words):
        m.law("device", m.ground, "mass", law=law, along="x", **options)


def test_a_cable_in_a_spec_is_the_cable_of_the_builder() -> None:
    m = walker()
    m.cable("tendon", {"hip": 0.05, "knee": -0.03}, stiffness=1e4, free_length=0.08, acts="tension", length=0.01)
    spec = m.to_spec()
    pathway = {"type": "joint-angles", "angles": {"hip": 0.05, "knee": -0.03}, "length": 0.01}
    assert spec["forces"]["tendon"]["pathway"] == pathway
    assert Mechanism.from_spec(spec).forces == m.forces


def test_devices_take_their_torques_from_the_actuators_of_a_measured_motion() -> None:
    # expected: actuators with a device = actuators without it - radius * tension, at each joint
    data = {"time": T, "hip": -np.pi / 2 + 0.4 * np.sin(6 * T), "knee": -0.5 + 0.5 * np.cos(6 * T)}
    motion = {"data": data, "columns": {"hip.angle": "hip", "knee.angle": "knee"}, "smooth": "quintic"}
    radii, options = {"hip": 0.05, "knee": -0.03}, {"stiffness": 1e4, "free_length": 0.08, "acts": "tension"}
    bare, helped = walker(), walker()
    helped.cable("tendon", radii, **options)
    helped.torsion_spring("brace", "thigh", "shank", stiffness=7.0, free_angle=-0.2)
    without, found = (mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion}) for m in (bare, helped))
    tension = 1e4 * np.maximum(-sum(r * found.joints[name].angle for name, r in radii.items()) - 0.08, 0.0)
    assert 0 < np.count_nonzero(tension) < len(tension)
    np.testing.assert_allclose(found.forces["tendon"].value, tension, rtol=1e-9, atol=1e-7)
    brace = -7.0 * (found.joints["knee"].angle + 0.2)
    for name, others in (("hip", 0.0), ("knee", brace)):
        expected = without.actuators[name].value - radii[name] * tension - others
        np.testing.assert_allclose(found.actuators[name].value, expected, rtol=0, atol=1e-9 * np.max(abs(expected)))
