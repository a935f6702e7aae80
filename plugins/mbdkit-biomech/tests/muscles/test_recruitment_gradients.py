"""Derivatives of recruitment: against an independent solver, closed forms, and differences."""

from dataclasses import replace

import numpy as np
import pytest
from tests.muscles.forearm import forearm
from tests.muscles.recruited import leg_spec
from tests.muscles.shared_loads import FRAMES, by_casadi, problems

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import share_loads
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads_derivative import ProgrammeChange, change_of_shares


@pytest.mark.parametrize("reserves", [0.0, 20.0])
def test_derivatives_of_shares_are_differences_of_an_active_set_method(reserves):
    programme = problems(reserves)
    random = np.random.default_rng(8)
    matrix = programme.matrix * random.uniform(-1, 1, programme.matrix.shape)
    right, weight = 0.1 * programme.size * random.uniform(-1, 1, programme.right.shape), 0 * programme.weight
    found = change_of_shares(programme, share_loads(programme, 2.0), 2.0, ProgrammeChange(matrix, right, weight))
    for row in range(0, FRAMES, 3):

        def at(step, row=row):
            return by_casadi(
                replace(programme, matrix=programme.matrix + step * matrix, right=programme.right + step * right),
                row,
                2,
            )

        near, far = ((at(step) - at(-step)) / (2 * step) for step in (2e-4, 4e-4))
        np.testing.assert_allclose(found[row], (4 * near - far) / 3, rtol=0, atol=1e-7 * np.max(np.abs(found[row])))


def test_contact_force_of_a_held_forearm_has_the_derivatives_of_its_closed_form():
    # minimise (F / C)^2 + (r / 2)^2 subject to 0.04 F + r = 0.15 m g: r = M / (1 + (0.04 C / 2)^2); the elbow carries
    # m g - F
    spec = forearm(recruitment={"capacity": "isometric", "reserves": {"elbow": 2.0}})
    mass, capacity = "model.bodies.forearm.mass", "model.muscles.biceps.max_force"
    share = 1 / (1 + (0.04 * 600 / 2) ** 2)
    pull = 9.81 * 0.15 * (1 - share) / 0.04
    by_capacity = 1.5 * 9.81 * 0.15 / 0.04 * share**2 * 2 * (0.04 / 2) ** 2 * 600
    measures = ["final(joints.elbow.force_y)", 'final(actuators["reserve.elbow"].value)', "final(muscles.biceps.force)"]
    found = mbdkit.inverse_gradient(spec, measures, [mass, capacity])
    expected = [[9.81 - pull, -by_capacity], [9.81 * 0.15 * share, -0.04 * by_capacity], [pull, by_capacity]]
    np.testing.assert_allclose(found.jacobian, expected, rtol=1e-9)
    assert found.check is not None
    assert found.check.is_passed


MEASURES = [
    "mean(joints.knee.force_x**2)", "final(joints.hip.force_y)", "mean(muscles.wrapped.force)",
    "mean(muscles.via.activation)", "at(muscles.straight.power, 0.3)", 'mean(actuators["reserve.knee"].power)',
    "final(energy.work)",
]  # fmt: skip
PARAMETERS = [
    "model.forces.spring.stiffness",
    "model.muscles.via.optimal_length",
    "model.muscles.straight.weight",
    "model.joints.knee.points.1.1",  # moves the leg
]


@pytest.mark.parametrize(("exponent", "parameters"), [(2, PARAMETERS), (3, PARAMETERS[:1])])
def test_contact_forces_and_muscles_have_the_derivatives_of_differences(exponent, parameters):
    spec = leg_spec(changed={"curves": "de-groote-fregly"}, exponent=exponent, reserves=200.0, passive=True)
    spring = {"type": "torsion-spring", "bodies": ["thigh", "shank"], "stiffness": 20.0, "free_angle": -0.2}
    spec["model"]["forces"] = {"spring": spring}
    found = mbdkit.inverse_gradient(spec, MEASURES, parameters)
    check = found.check
    assert check is not None
    assert check.is_passed, str(found)
    np.testing.assert_allclose(check.derivative, check.extrapolated, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("exponent", [1, "inf"])
def test_linear_programmes_have_no_gradient(exponent):
    with pytest.raises(SpecError, match=f"an exponent of 2 or more, not {exponent}") as error:
        mbdkit.inverse_gradient(
            forearm(recruitment={"exponent": exponent}), "final(muscles.biceps.force)", "model.bodies.forearm.mass"
        )
    assert error.value.key == "recruitment.exponent"
