"""Recruitment with activation dynamics: against an interior-point method of CasADi on the whole problem."""

import casadi
import numpy as np
import pytest
from tests.muscles.forearm import forearm
from tests.muscles.recruited import leg_spec
from tests.muscles.shared_loads import FRAMES, MUSCLES, problems

import mbdkit
from mbdkit import RunError, SpecError
from mbdkit_biomech.inverse_dynamics.muscles.loads_over_time import (
    ActivationDynamics,
    share_over_time,
    smallest_supplement_over_time,
)
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import share_loads
from tests.margins import assert_within

TIME = np.linspace(0.0, 0.3, FRAMES)
FALL, RISE = 0.04, 0.01


def swinging(reserves: float) -> Programme:
    """Return programmes whose right sides swing faster than activations can fall."""
    one = problems(reserves)
    right = one.right[0] * (0.5 + 0.45 * np.sin(2 * np.pi * TIME / 0.15))[:, None]
    return Programme(np.repeat(one.matrix[:1], FRAMES, 0), right, one.low, one.high, one.weight)


def by_casadi(programme: Programme, p: int) -> np.ndarray:
    """Return the solution (T, N) of the whole problem, stated frame by frame."""
    frames, _, count = programme.matrix.shape
    x = casadi.SX.sym("x", count, frames)
    share = x / casadi.repmat(casadi.DM(programme.weight), 1, frames)
    equal, less, h = [], [], TIME[1] - TIME[0]
    for k in range(frames):
        equal.append((programme.matrix[k] @ x[:, k] - programme.right[k]) / programme.size[k])
        if k:
            now, before = x[:MUSCLES, k], x[:MUSCLES, k - 1]
            less += [before * np.exp(-h / FALL) - now, (1 - before) * np.exp(-h / RISE) - (1 - now)]
    rows = casadi.vertcat(*equal, *less)
    low = np.append(np.zeros(programme.right.size), np.full(rows.shape[0] - programme.right.size, -np.inf))
    cost = casadi.sum1(casadi.vec(share**2 if p == 2 else casadi.fabs(share) ** p))
    options = {"print_level": 0, "sb": "yes", "tol": 1e-13, "constr_viol_tol": 1e-13, "acceptable_iter": 0}
    more = {"bound_relax_factor": 0.0, "dual_inf_tol": 1e-13, "compl_inf_tol": 1e-13}
    problem = {"x": casadi.vec(x), "f": cost, "g": rows}
    solver = casadi.nlpsol("s", "ipopt", problem, {"ipopt": options | more, "print_time": False})
    bounds = {"lbx": np.ravel(programme.low), "ubx": np.ravel(programme.high)}
    return np.array(solver(x0=0.3, lbg=low, ubg=np.zeros(len(low)), **bounds)["x"]).reshape(frames, count)


@pytest.mark.parametrize("p", [2, 3])
@pytest.mark.parametrize("reserves", [0.0, 20.0])
def test_the_whole_problem_has_the_solution_of_another_solver(p, reserves):
    programme = swinging(reserves)
    alone = share_loads(programme, float(p)).value
    dynamics = ActivationDynamics.of(TIME, np.full(MUSCLES, FALL), np.full(MUSCLES, RISE))
    found = share_over_time(programme, float(p), dynamics, alone)
    assert_within(found.certificate, 1e-12)
    np.testing.assert_allclose(found.value, by_casadi(programme, p), rtol=0, atol=1e-9)
    assert np.max(np.abs(found.value - alone)) > 0.1  # the dynamics matter


def test_the_smallest_supplement_is_what_a_muscle_that_falls_too_slowly_exerts():
    # expected: a muscle alone has 0.9, then at least 0.9 exp(-h / fall) = 0.45 instead of 0.1
    two = np.array([0.0, FALL * np.log(2)])
    right, one = np.array([[0.9], [0.1]]), np.ones((2, 1))
    programme = Programme(np.ones((2, 1, 1)), right, 0.01 * one, one, np.ones(1))
    dynamics = ActivationDynamics.of(two, np.array([FALL]), np.array([RISE]))
    lacking = smallest_supplement_over_time(programme, dynamics)
    np.testing.assert_allclose(np.sort(np.abs(lacking).ravel()), [0.0, 0.35], atol=1e-9)
    assert np.all(np.isinf(share_over_time(programme, 2.0, dynamics, right).certificate))


def test_slow_muscles_keep_their_activation_and_antagonists_balance_it():
    with mbdkit.inverse(leg_spec(reserves=1.0)) as free:
        spec = leg_spec(changed={"activation": {"rise": 0.01, "fall": 0.5}}, dynamics="activation", reserves=1.0)
        with mbdkit.inverse(spec) as slow:
            assert_within(slow.array("muscles/certificate"), 1e-11)
            least = np.exp(-np.diff(slow.time) / 0.5)
            for muscle in slow.muscles.values():
                a = muscle.activation
                assert np.all(a[1:] >= least * a[:-1] - 1e-12)
                assert np.all(a >= 0.01 - 1e-12)
            moments = (sum(run.moment_arms(name, "knee.angle") * one.force for name, one in run.muscles.items())
                       + run.actuators["reserve.knee"].value for run in (free, slow))  # fmt: skip
            np.testing.assert_allclose(*moments, rtol=0, atol=1e-8)
            efforts = [sum(np.sum(one.activation**2) for one in run.muscles.values()) for run in (free, slow)]
            assert efforts[1] > efforts[0] * 1.01


def test_a_load_that_vanishes_faster_than_activation_names_the_frames():
    spec = forearm(recruitment={"capacity": "isometric", "dynamics": "activation"})
    time = spec["motion"]["data"]["time"]
    push = [-10.0 if t < 0.45 else 0.0 for t in time]
    spec["loads"] = {"push": {"body": "forearm", "force": [0.0, "push"], "data": {"time": time, "push": push}}}
    spec["model"]["muscles"]["biceps"]["activation"] = {"fall": 1.0}
    with pytest.raises(RunError, match="with activations that change as fast as their dynamics allow") as error:
        mbdkit.inverse(spec)
    assert "`recruitment.reserves` should be at least elbow" in str(error.value)
    spec["model"]["muscles"]["biceps"]["activation"] = {"fall": 0.04}
    mbdkit.inverse(spec).close()


def test_what_activation_dynamics_cannot_have_gets_one_sentence():
    with pytest.raises(SpecError, match="need an exponent of 2 or more, not 1") as error:
        mbdkit.inverse(forearm(recruitment={"dynamics": "activation", "exponent": 1}))
    assert error.value.key == "recruitment.exponent"
    spec = forearm(recruitment={"dynamics": "activation"})
    with pytest.raises(SpecError, match="not available with `dynamics: activation`") as error:
        mbdkit.inverse_gradient(spec, "final(muscles.biceps.force)", "model.bodies.forearm.mass")
    assert error.value.key == "recruitment.dynamics"
