"""Recruitment of muscles with elastic tendons, against equations written from the paper and solved by CasADi."""

import casadi
import numpy as np
import pytest
from tests.muscles.arm import FIBER, FORCE, SPEED, WIDTH, active, arm, by_velocity, passive

import mbdkit
from mbdkit import RunError, SpecError
from mbdkit_biomech.muscles.force_curves import CURVES
from tests.margins import assert_within

TIME = np.linspace(0.0, 0.4, 41)
OTHER = {"max_force": 900.0, "optimal_length": 0.1, "tendon_length": 0.12, "pennation": 0.0}
"""Properties of a second muscle, from (0.03, 0.2) to a point 0.05 m from the elbow."""


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    w = 2 * np.pi / 0.4
    return 0.08 * np.sin(w * TIME), 0.08 * w * np.cos(w * TIME), -0.08 * w**2 * np.sin(w * TIME)


def moving(both: bool = False, tendon: str = "elastic", **recruitment: object) -> dict:
    """Return a forearm that moves up and down, with a muscle or two."""
    m = arm(tendon)
    if both:
        path = [{"body": "ground", "point": (0.03, 0.2)}, {"body": "forearm", "point": (-0.1, 0.0)}]
        m.muscle("other", path, tendon=tendon, **OTHER)
    data = {"time": TIME.tolist()} | {key: x.tolist() for key, x in zip("abc", motion(), strict=True)}
    columns = {"elbow.angle": {"column": "a", "rate": "b", "acceleration": "c"}}
    given = {"minimum": 0.001} | recruitment
    return {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": data, "columns": columns}, "recruitment": given}


def geometry(x: float, y: float, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the length (T,) of a path from a point to one on the forearm, and its derivative with respect to the
    angle.
    """
    angle = motion()[0]
    dx, dy = at * np.cos(angle) - x, at * np.sin(angle) - y
    length = np.hypot(dx, dy)
    return length, (-at * np.sin(angle) * dx + at * np.cos(angle) * dy) / length


def needed() -> np.ndarray:
    """Return the torque (T,) that moves the forearm."""
    angle, _, acceleration = motion()
    return (0.02 + 1.5 * 0.15**2) * acceleration + 1.5 * 9.81 * 0.15 * np.cos(angle)


def activation_of(share, path, before, step, *, width, slack, optimal, rest=0.0):
    """Return the length of the fibres and the activation for a tension over max_force; without `before`, fibres have
    the velocity `step`."""
    along = path - slack * (1 + 0.049 / np.log(6) * np.log((share + 0.2) / 0.2))
    fiber = np.sqrt(along * along + width * width)
    v = step * along / fiber if before is None else (fiber - before) / step
    pull = share * fiber / along - rest * passive(fiber / optimal)
    return fiber, pull / (active(fiber / optimal) * by_velocity(v / (SPEED * optimal)))


@pytest.mark.parametrize("with_passive", [False, True])
def test_one_muscle_has_the_activation_of_its_tension(with_passive):
    path, slope = geometry(0.04, 0.3, 0.04)
    share = -needed() / slope / FORCE
    with mbdkit.inverse(moving(passive=with_passive)) as run:
        muscle = run.muscles["biceps"]
        np.testing.assert_allclose(muscle.force, FORCE * share, rtol=1e-9)
        before = None
        for k in range(len(TIME)):
            step = slope[0] * motion()[1][0] if before is None else TIME[k] - TIME[k - 1]
            more = {"width": WIDTH, "slack": 0.18, "optimal": FIBER, "rest": float(with_passive)}
            fiber, activation = activation_of(share[k], path[k], before, step, **more)
            assert muscle.fiber_length[k] == pytest.approx(fiber, rel=1e-9)
            assert muscle.activation[k] == pytest.approx(activation, rel=1e-6)
            before = fiber


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_two_muscles_share_the_moment_as_by_a_nonlinear_programme():
    paths = geometry(0.04, 0.3, 0.04), geometry(0.03, 0.2, 0.05)
    sizes = {"width": WIDTH, "slack": 0.18, "optimal": FIBER}, {"width": 0.0, "slack": 0.12, "optimal": 0.1}
    options = {"print_level": 0, "sb": "yes", "tol": 1e-13, "acceptable_iter": 0, "bound_relax_factor": 0.0}
    with mbdkit.inverse(moving(both=True)) as run:
        muscles = [run.muscles[name] for name in ("biceps", "other")]
        assert_within(run.array("muscles/certificate"), 1e-10)
        for k in range(1, len(TIME)):
            x = casadi.SX.sym("x", 2)
            a = [
                activation_of(x[i], paths[i][0][k], muscles[i].fiber_length[k - 1], TIME[k] - TIME[k - 1], **sizes[i])[
                    1
                ]
                for i in range(2)
            ]
            moment = -(x[0] * FORCE * paths[0][1][k] + x[1] * 900.0 * paths[1][1][k])
            rows = casadi.vertcat(moment - needed()[k], *a)
            problem = {"x": x, "f": a[0] ** 2 + a[1] ** 2, "g": rows}
            solver = casadi.nlpsol("s", "ipopt", problem, {"ipopt": options, "print_time": False})
            start = [muscles[0].force[k] / FORCE * 1.05, muscles[1].force[k] / 900.0 * 0.95]
            found = solver(x0=start, lbx=1e-6, ubx=1.5, lbg=[0, 0.001, 0.001], ubg=[0, 1, 1])
            wanted = np.array(found["x"]).ravel() * (FORCE, 900.0)
            np.testing.assert_allclose([one.force[k] for one in muscles], wanted, rtol=1e-6)


@pytest.mark.parametrize("name", CURVES)
def test_stretch_is_the_inverse_of_the_force_of_tendons(name):
    curves, force = CURVES[name], np.array([1e-9, 1e-3, 0.1, 0.5, 0.7, 1.0, 1.4])
    length, slope = curves.stretch(force)
    value, stiffness = curves.tendon(length)
    np.testing.assert_allclose(value, force, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(slope[1:], 1 / stiffness[1:], rtol=1e-9)


def test_what_needs_rigid_tendons_and_a_tendon_beyond_its_path_get_one_sentence():
    for key, value in (("exponent", 1), ("dynamics", "activation")):
        with pytest.raises(SpecError, match="needs rigid tendons; the tendon of muscle 'biceps' is elastic") as error:
            mbdkit.inverse(moving(**{key: value}))
        assert error.value.key == f"recruitment.{key}"
    spec = moving()
    spec["model"]["muscles"]["biceps"]["tendon_length"] = 0.0
    with pytest.raises(SpecError, match="an elastic tendon needs a length") as error:
        mbdkit.inverse(spec)
    assert error.value.key == "model.muscles.biceps.tendon_length"
    with pytest.raises(SpecError, match="are not available with elastic tendons"):
        mbdkit.inverse_gradient(moving(), "max(muscles.biceps.force)", "model.bodies.forearm.mass")
    spec = moving()
    spec["model"]["muscles"]["biceps"]["tendon_length"] = 0.4
    with pytest.raises(RunError, match=r"the tendon of muscle 'biceps' is longer \(0.4 m\) than its path"):
        mbdkit.inverse(spec)
