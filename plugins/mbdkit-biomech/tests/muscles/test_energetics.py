"""Energetics of muscles: against OpenSim's models of Umberger (2010) and of Bhargava (2004), the printed formula, and
energy balances.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import simpson
from tests.muscles import leg
from tests.muscles.arm import FORCE, WIDTH, arm
from tests.muscles.forearm import forearm
from tests.muscles.models import leg_mechanism
from tests.muscles.recruited import leg_spec

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.muscles.energetics import metabolic_power

OPENSIM = json.loads((Path(__file__).parent / "opensim_muscles.json").read_text())["energetics"]
ENERGETIC = [(0.3, 0.7), (0.6, 0.2), (0.05, 0.05), (0.9, 1.0)]
"""Activations and excitations of `tests.benchmarks.muscles_of_opensim`."""


@pytest.mark.parametrize(("model", "key"), [("umberger", "power"), ("bhargava", "bhargava")])
@pytest.mark.parametrize("name", leg.MUSCLES)
def test_muscles_consume_the_power_of_opensims_models(name, model, key):
    muscle = leg_mechanism(metabolics={"model": model, "slow_fibers": 0.4}).muscles[name]
    theirs = {key: np.array(values) for key, values in OPENSIM[name].items()}
    activation, excitation = np.array([ENERGETIC[k % len(ENERGETIC)] for k in range(len(leg.ANGLES))]).T
    found = metabolic_power(muscle, activation, excitation, theirs["length"], theirs["rate"])
    np.testing.assert_allclose(found, theirs[key], rtol=1e-8, atol=1e-9)


def held_at(activation: float, options: object = "umberger") -> mbdkit.Run:
    spec = forearm()
    biceps = spec["model"]["muscles"]["biceps"]
    biceps["metabolics"] = options
    biceps["max_force"] = 1.5 * 9.81 * 0.15 / 0.04 / activation
    return mbdkit.inverse(
        spec | {"recruitment": {}}, measures={"energy": {"value": "integral(muscles.biceps.metabolic_power)"}}
    )


def test_a_muscle_that_holds_consumes_the_heat_of_activation():
    # expected: Umberger et al. (2003), equations for fibres at rest and at their optimal length: 1.5 A^0.6 (128 fast +
    # 25) per mass; the path of the forearm gives fibres of the optimal length
    from mbdkit_biomech.muscles.force_curves import CURVES

    one = np.array([1.0])
    curves = CURVES["de-groote-fregly"]
    activation = 0.3 / (curves.active(one)[0] * curves.velocity(0 * one)[0])[0]
    force = 1.5 * 9.81 * 0.15 / 0.04 / 0.3
    for options, mass, fast in (
        ("umberger", 1059.7 * force / 250000.0 * 0.12, 0.5),
        ({"mass": 0.4, "slow_fibers": 0.9}, 0.4, 0.1),
    ):
        run = held_at(0.3, options)
        wanted = mass * 1.5 * activation**0.6 * (128 * fast + 25)
        np.testing.assert_allclose(run.muscles["biceps"].metabolic_power, wanted, rtol=1e-9)
        np.testing.assert_allclose(run.muscles["biceps"].fiber_power, 0.0, atol=1e-9)
        assert run.measures["energy"] == pytest.approx(wanted, rel=1e-9)


def test_fibres_on_rigid_tendons_supply_the_power_of_their_muscles():
    with mbdkit.inverse(leg_spec(reserves=1.0, changed={"pennation": 0.2})) as run:
        for muscle in run.muscles.values():
            np.testing.assert_allclose(muscle.fiber_power, muscle.power, rtol=0, atol=1e-10)
            assert np.all(np.isnan(muscle.metabolic_power))


def test_an_elastic_tendon_stores_what_fibres_supply_and_the_muscle_does_not():
    # expected: the integral of De Groote's force of the tendon, 0.2 exp(s (x - 1)) - 0.2 with s = log(6) / 0.049
    options = {"integrator": {"name": "radau-iia", "stages": 3}, "time": {"end": 0.05, "step": 1e-4}}
    run = mbdkit.run(arm("elastic", metabolics="umberger"), **options).check()
    muscle, steep = run.muscles["biceps"], np.log(6) / 0.049
    along = np.sqrt(muscle.fiber_length**2 - WIDTH**2)
    x = (muscle.length - along) / 0.18
    stored = FORCE * 0.18 * (0.2 / steep * np.exp(steep * (x - 1)) - 0.2 * x)
    lost = simpson(muscle.fiber_power - muscle.power, x=run.time)
    assert lost == pytest.approx(stored[-1] - stored[0], rel=1e-5)
    assert np.all(muscle.metabolic_power > muscle.fiber_power)


def test_gradients_say_that_energetics_have_none():
    with pytest.raises(SpecError, match="derivatives of fiber_power of muscles with respect to parameters are not "):
        mbdkit.inverse_gradient(leg_spec(reserves=1.0), "mean(muscles.via.fiber_power)", "model.bodies.shank.mass")


@pytest.mark.parametrize(
    ("metabolics", "key", "message"),
    [
        ("lichtwark", "model", "umberger"),
        ({"slow_fibers": 1.2}, "slow_fibers", "at most 1"),
        ({"mass": 0.0}, "mass", "greater than 0"),
        ({"model": "bhargava", "aerobic_factor": 1.0}, "aerobic_factor", "no effect on the model bhargava"),
    ],
)
def test_wrong_metabolics_get_one_sentence_with_their_key(metabolics, key, message):
    with pytest.raises(SpecError) as error:
        held_at(0.3, metabolics)
    assert error.value.key == f"model.muscles.biceps.metabolics.{key}"
    assert message in str(error.value)
