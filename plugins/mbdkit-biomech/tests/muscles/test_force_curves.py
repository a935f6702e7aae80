"""Curves of muscles against OpenSim 4.6 and published values."""

import numpy as np
import pytest

from mbdkit_biomech.muscles.force_curves import CURVES

OPENSIM = {
    "active": {0.6: 0.4511018783255816, 0.75: 0.8260375363513255, 0.9: 0.9567598325429589, 1.0: 1.0}
    | {1.02: 0.9998613526775124, 1.2: 0.823680970871459},
    "passive": {0.9: 0.0, 1.01: 9.529054962971643e-05, 1.03: 0.002508390232745325, 1.1: 0.01704483509737836}
    | {1.3: 0.12611118348262854, 1.6: 0.7170695270830669, 1.7: 1.0, 1.8: 1.285714285714286},
    "velocity": {-1.2: 0.0, -0.95: 0.0028515625000000164, -0.9: 0.0125, -0.5: 0.15808560444169842}
    | {-0.1: 0.6252142843129728, 0.0: 1.0, 0.1: 1.225153837753858, 0.5: 1.3311315693144758, 0.9: 1.3925}
    | {0.95: 1.3991328124999998, 1.2: 1.4},
    "tendon": {0.99: 0.0, 1.005: 0.03760449363141661, 1.01: 0.09967827012198324, 1.02: 0.2609359826149298}
    | {1.03: 0.47939871234804565, 1.049: 1.0, 1.06: 1.3086734693877569},
}
"""Values of the default curves of Millard2012EquilibriumMuscle in OpenSim 4.6."""


@pytest.mark.parametrize("name", OPENSIM)
def test_the_curves_of_millard_are_those_of_opensim(name):
    x, y = np.array(list(OPENSIM[name].items())).T
    np.testing.assert_allclose(getattr(CURVES["millard"], name)(x)[0], y, rtol=0, atol=3e-14)


@pytest.mark.parametrize("name", OPENSIM)
def test_the_curves_of_millard_in_runs_are_those_of_opensim_and_of_recruitment(name):
    curve = CURVES["millard"].curves[name]
    x, y = np.array(list(OPENSIM[name].items())).T
    np.testing.assert_allclose(curve.value(x), y, rtol=0, atol=1e-13)
    low, high = curve.x[0, 0], curve.x[-1, -1]
    x = np.concatenate([np.linspace(1.2 * low - 0.2 * high, 1.2 * high - 0.2 * low, 20001), curve.x.ravel()])
    np.testing.assert_allclose(curve.value(x), curve.at(x)[0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("damping", [0.001, 0.1, 1.0])
def test_fibres_of_millard_have_the_velocity_of_equilibrium(damping):
    # expected: the velocities from which the forces were computed
    curve = CURVES["millard"].curves["velocity"]
    velocity = np.concatenate([np.linspace(-1.6, 1.6, 2001), curve.x.ravel()])
    for active in (0.0, 1e-6, 1e-3, 0.05, 0.5, 1.0, 1.5):
        force = active * curve.at(velocity)[0] + damping * velocity
        np.testing.assert_allclose(curve.x_where(active, damping, force), velocity, rtol=0, atol=3e-12)


def test_the_curves_of_de_groote_and_fregly_have_their_published_values():
    curves = CURVES["de-groote-fregly"]
    one = np.ones(1)
    assert curves.active(one)[0] == pytest.approx(1.0, abs=1e-3)
    assert curves.velocity(0 * one)[0] == pytest.approx(1.0, abs=5e-3)
    assert curves.velocity(-one)[0] == pytest.approx(0.0, abs=2e-3)
    assert curves.passive(1.6 * one)[0] == pytest.approx(1.0, abs=4e-15)
    assert curves.passive(0.2 * one)[0] == pytest.approx(0.0, abs=1e-15)
    assert curves.tendon(1.049 * one)[0] == pytest.approx(1.0, abs=1e-14)
    assert curves.tendon(one)[0] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("curves", CURVES)
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("active", 0.3, 1.9), ("passive", 0.3, 1.9), ("velocity", -1.2, 1.2), ("tendon", 0.9, 1.1)],
)
def test_slopes_are_derivatives(curves, name, low, high):
    x, step, curve = np.linspace(low, high, 301) + 1e-4, 1e-6, getattr(CURVES[curves], name)
    slope = curve(x)[1]
    difference = (curve(x + step)[0] - curve(x - step)[0]) / (2 * step)
    np.testing.assert_allclose(slope, difference, rtol=0, atol=2e-7 * np.max(np.abs(slope)) + 1e-8)
