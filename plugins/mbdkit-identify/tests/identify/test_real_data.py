"""Identifications from published measurements, compared with the parameters that their authors published.

The published parameters are those of the packaged bases. Predictions of the records that are held out are compared with
the same windows, initial states and zeros of encoders; only the parameters of the model differ.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit_identify.identification import Identification
from mbdkit_identify.identify import identify
from mbdkit_identify.loading import load_identify_spec
from mbdkit_identify.measured_data import read_experiment

SWING, DRIVEN, ROBOT = "double-pendulum-swing", "driven-double-pendulum", "brachiating-robot"

PUBLISHED_SWING = {
    "m1": 0.0938440, "m2": 0.137596, "a1": 0.108565, "a2": 0.116779, "L1": 0.172719, "I1": 4.37529e-4,
    "I2": 1.26883e-3, "k1": 2.37143e-4, "k2": 1.0e-5, "g": 9.80858,
}  # fmt: skip
"""EstimatedParameters_DoublePendulum.mat of https://github.com/dynamicslab/MultiArm-Pendulum, copyright (c) 2022
dynamicslab, MIT License; rounded to six digits."""
PUBLISHED_DRIVEN = {
    "I1": 0.053470810264216295, "I2": 0.02392374528789766, "Ir": 7.659297952841183e-05, "b1": 0.001, "b2": 0.001,
    "cf1": 0.093, "cf2": 0.078, "g": 9.81, "gr": 6.0, "l1": 0.3, "m1": 0.5593806151425046, "m2": 0.6043459469186889,
    "r1": 0.3, "r2": 0.18377686083653508,
}  # fmt: skip
"""data/system_identification/identified_parameters/design_A.0/model_2.0/model_parameters.yml of
https://github.com/dfki-ric-underactuated-lab/double_pendulum, copyright (c) 2022 DFKI RIC Underactuated Robotics Lab,
BSD 3-Clause License."""


INERTIAS = {"upper_center": "a1", "upper_inertia": "I1", "lower_inertia": "I2"}


def swing(t: float, y: np.ndarray) -> list[float]:
    """Equations of the free swing: angles from the upward vertical, damping in both pins."""
    p, (u, w, du, dw) = PUBLISHED_SWING, y
    coupling = p["m2"] * p["L1"] * p["a2"]
    mass = [
        [p["I1"] + p["m1"] * p["a1"] ** 2 + p["m2"] * p["L1"] ** 2, coupling * np.cos(u - w)],
        [coupling * np.cos(u - w), p["I2"] + p["m2"] * p["a2"] ** 2],
    ]
    pin = p["k2"] * (dw - du)
    upper = (p["m1"] * p["a1"] + p["m2"] * p["L1"]) * p["g"] * np.sin(u) - coupling * np.sin(u - w) * dw**2
    lower = p["m2"] * p["a2"] * p["g"] * np.sin(w) + coupling * np.sin(u - w) * du**2
    return [du, dw, *np.linalg.solve(mass, [upper - p["k1"] * du + pin, lower - pin])]


def driven(t: float, y: np.ndarray, torques: Any) -> list[float]:
    """Equations of the driven double pendulum: shoulder from hanging, elbow from the straight arm, rotors, friction."""
    p, (a, b, da, db) = PUBLISHED_DRIVEN, y
    coupling = p["l1"] * p["m2"] * p["r2"]
    across = p["I2"] + coupling * np.cos(b) - p["gr"] * p["Ir"]
    rotors = (p["gr"] ** 2 + 1) * p["Ir"]
    mass = [
        [p["I1"] + p["I2"] + p["l1"] ** 2 * p["m2"] + 2 * coupling * np.cos(b) + rotors, across],
        [across, p["I2"] + p["gr"] ** 2 * p["Ir"]],
    ]
    lower = -p["g"] * p["m2"] * p["r2"] * np.sin(a + b)
    upper = -p["g"] * (p["m1"] * p["r1"] + p["m2"] * p["l1"]) * np.sin(a) + lower
    spin = coupling * np.sin(b) * np.array([(2 * da + db) * db, -(da**2)])
    friction = [p["b1"] * da + p["cf1"] * np.arctan(100 * da), p["b2"] * db + p["cf2"] * np.arctan(100 * db)]
    return [da, db, *np.linalg.solve(mass, np.array([upper, lower]) + spin + torques(t) - friction)]


def brachiating(t: float, y: np.ndarray, p: dict[str, float]) -> np.ndarray:
    """Equations of the brachiating robot with a load of 0.2 kg at (0.05, 0.3), from hanging, with torques of 1 N m and
    -0.3 N m; angles of upper arm, tail and free arm.
    """
    hub = (0.0, -p["arm"])
    bodies = [  # mass, inertia about the centre of mass, and the arms of upper arm, tail and free arm to it
        (p["upper_mass"], p["upper_inertia"], {0: (0.0, -p["upper_center"])}),
        (p["tail_mass"], p["tail_inertia"], {0: hub, 1: (0.0, -p["tail_center"])}),
        (0.2, 0.0, {0: hub, 2: (0.05, -0.3)}),
        (p["lower_mass"], p["lower_inertia"], {0: hub, 2: (0.01, -p["lower_center"])}),
    ]
    angles, rates = y[:3], y[3:]
    elbow = rates[2] - rates[1]
    shoulder_torque = p["tail_gain"] - p["tail_damping"] * (rates[1] - rates[0])
    elbow_torque = -0.3 * p["lower_gain"] - p["lower_damping"] * elbow - p["lower_friction"] * np.tanh(elbow / 0.3)
    mass, forces = np.zeros((3, 3)), np.array([-shoulder_torque, shoulder_torque - elbow_torque, elbow_torque])
    for own, inertia, arms in bodies:
        rows, centripetal = np.zeros((2, 3)), np.array([0.0, 9.81])
        for k, (x, z) in arms.items():
            c, s = np.cos(angles[k]), np.sin(angles[k])
            rows[:, k] = [-s * x - c * z, c * x - s * z]
            centripetal -= rates[k] ** 2 * np.array([c * x - s * z, s * x + c * z])
        mass += own * rows.T @ rows
        mass[max(arms), max(arms)] += inertia
        forces -= own * rows.T @ centripetal
    return np.concatenate([rates, np.linalg.solve(mass, forces)])


def zeros_only(name: str) -> dict[str, Any]:
    """Return the parameters of the zeros of the encoders."""
    return {key: {"start": 0} for key in load_identify_spec(name).parameters if "_zero" in key}


def error(fit: Identification) -> float:
    """Return the root mean square error [rad] of all predictions."""
    return float(np.sqrt(np.mean(np.concatenate([one.measured - one.fitted for one in fit.hold_out]) ** 2)))


def test_the_base_of_the_free_swing_follows_the_published_equations() -> None:
    base = load_identify_spec(SWING, parameters=zeros_only(SWING)).run_spec
    run = mbdkit.run(base)
    start = [run.bodies["upper"].angle[0], run.bodies["lower"].angle[0], base.numbers["upper_rate"],
             base.numbers["lower_rate"]]  # fmt: skip
    exact = solve_ivp(swing, (0, 4), start, t_eval=run.time, method="DOP853", rtol=1e-11, atol=1e-12).y
    assert np.ptp(exact[1]) > 2.0
    for body, angle in zip(("upper", "lower"), exact, strict=False):
        np.testing.assert_allclose(run.bodies[body].angle, angle, atol=1e-5)


def test_the_driven_base_follows_the_published_equations() -> None:
    p = PUBLISHED_DRIVEN
    digits = {
        "upper_mass": p["m1"], "lower_mass": p["m2"], "upper_inertia": p["I1"] - p["m1"] * p["r1"] ** 2,
        "lower_center": p["r2"], "lower_inertia": p["I2"] - p["m2"] * p["r2"] ** 2, "rotor_inertia": p["Ir"],
        "shoulder_angle": np.pi / 2,
    }  # fmt: skip
    spec = load_identify_spec(DRIVEN, parameters=zeros_only(DRIVEN))
    base = spec.run_spec
    for name, value in digits.items():
        assert base.numbers[name] == pytest.approx(value, rel=2e-6, abs=3e-7)  # rounded to six digits
    given = read_experiment(spec, "fast").inputs
    tables = {name: {"table": [times.tolist(), values.tolist()]} for name, (times, values) in given.items()}
    run = mbdkit.run(
        base, parameters={**base.parameters, **digits}, inputs=tables, integrator={"name": "gauss", "stages": 3},
        time={"end": 1.0, "step": 0.0005},
    )  # fmt: skip

    def torques(t: float) -> np.ndarray:
        return np.array([np.interp(t, *given[name]) for name in ("shoulder", "elbow")])

    # between the corners of the tables, where no step is lost and the error of the reference is 4e-10
    corners = np.unique(np.concatenate([run.time[[0, -1]], *(times[times < 1.0] for times, _ in given.values())]))
    state = np.array([np.pi / 2, 0.0, 0.0, 0.0])
    exact = np.empty((4, len(run.time)))
    for begin, end in pairwise(corners):
        piece = solve_ivp(
            driven, (begin, end), state, "DOP853", dense_output=True, args=(torques,), rtol=1e-11, atol=1e-13
        )
        within = (run.time >= begin) & (run.time <= end)
        exact[:, within], state = piece.sol(run.time[within]), piece.y[:, -1]
    assert np.ptp(exact[1]) > 0.5
    np.testing.assert_allclose(run.bodies["upper"].angle, exact[0], rtol=0, atol=3e-6)
    np.testing.assert_allclose(run.joints["elbow"].angle, exact[1], rtol=0, atol=3e-6)


def test_the_base_of_the_brachiating_robot_follows_the_equations_of_lagrange() -> None:
    base = load_identify_spec(ROBOT).run_spec
    added = {"lower_side": 0.01, "load": 0.2, "load_x": 0.05, "load_y": 0.3}
    torques = {"tail_torque": 1.0, "lower_torque": -0.3}
    run = mbdkit.run(
        base, parameters={**base.parameters, **added}, time={"end": 1.0, "step": 0.002},
        inputs={name: {"table": [[0.0, 1.0], [value, value]]} for name, value in torques.items()},
    )  # fmt: skip
    exact = solve_ivp(
        brachiating, (0.0, 1.0), np.zeros(6), "DOP853", run.time, args=(base.numbers,), rtol=1e-10, atol=1e-12
    ).y
    assert np.ptp(exact[2]) > 0.5
    for body, angle in zip(("upper", "tail", "lower"), exact, strict=False):
        np.testing.assert_allclose(run.bodies[body].angle, angle, rtol=0, atol=1e-6)


def test_two_seconds_of_the_swing_give_the_published_inertias() -> None:
    file = "double-pendulum-swing.csv"
    observed = {"upper.angle": "upper", "lower.angle": "lower"}
    piece = {"file": file, "observed": observed, "initial": "estimated", "window": [0, 2]}
    known = {name: {"start": 1.2 * PUBLISHED_SWING[of]} for name, of in INERTIAS.items()}
    fit = identify(SWING, experiments={"start": piece}, parameters=known | zeros_only(SWING))
    for name, of in INERTIAS.items():
        assert fit[name].value == pytest.approx(PUBLISHED_SWING[of], rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("name", [SWING, DRIVEN])
def test_predictions_are_better_than_with_the_published_parameters(name: str) -> None:
    fit, published = identify(name), identify(name, parameters=zeros_only(name))
    assert error(fit) <= error(published)
    assert fit.verdict == published.verdict == "doubtful"
    assert any(doubt.place == "drag on the body 'lower'" for doubt in published.doubts)
