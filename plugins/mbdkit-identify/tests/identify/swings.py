"""Four swings of a damped double pendulum with eight unknown parameters, as mbdkit, lmfit with SciPy's DOP853, and
MuJoCo's `mujoco.sysid` identify them from the same data.

The first link has a known mass and a known spring in the hub, and the second an unknown mass, centre of mass and
inertia, a damper and a spring in the elbow. All start at rest at known angles.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

TRUE = {"J1": 0.08, "m2": 0.8, "d2": 0.45, "J2": 0.07, "c1": 0.2, "c2": 0.1, "k2": 0.6, "phi": 0.3}
START = {"J1": 0.12, "m2": 1.0, "d2": 0.4, "J2": 0.05, "c1": 0.3, "c2": 0.15, "k2": 0.9, "phi": 0.2}
M1, L1, D1, K1, G = 1.0, 1.0, 0.5, 2.0, 9.81
STARTS = ((1.0, 0.3), (-0.8, 0.9), (0.4, -1.2), (1.3, 1.3))
"""Angles of the links from the vertical [rad]."""
RATE, END, NOISE = 500, 5.0, 0.002
TIME = np.arange(0, RATE * END + 1) / RATE


def swing(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the rates of angles and angular velocities (4, ...) in minimal coordinates."""
    J1, m2, d2, J2, c1, c2, k2, phi = p
    a, b, u, v = y
    mixed, gap = m2 * L1 * d2, a - b
    M11, M12, M22 = J1 + M1 * D1**2 + m2 * L1**2, mixed * np.cos(gap), J2 + m2 * d2**2
    sine, elbow = mixed * np.sin(gap), k2 * (b - a - phi) + c2 * (v - u)
    f1 = -sine * v * v - (M1 * D1 + m2 * L1) * G * np.sin(a) - K1 * a - c1 * u + elbow
    f2 = sine * u * u - m2 * d2 * G * np.sin(b) - elbow
    det = M11 * M22 - M12 * M12
    return np.array([u, v, (M22 * f1 - M12 * f2) / det, (M11 * f2 - M12 * f1) / det])


def together(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the rates of the four experiments, one array operation for all."""
    return swing(t, y.reshape(4, -1), p).ravel()


def angles(values: dict[str, float], rtol: float = 1e-8, at_once: bool = True) -> np.ndarray:
    """Return both angles of all experiments (4, 2, T), integrated at once, or one after another."""
    start = np.concatenate([np.transpose(STARTS), np.zeros((2, len(STARTS)))])
    p = np.array([values[name] for name in TRUE])
    options = {"method": "DOP853", "t_eval": TIME, "rtol": rtol, "atol": 0.01 * rtol}
    if not at_once:
        found = [solve_ivp(partial(swing, p=p), (0.0, END), one, **options).y[:2] for one in start.T]
        return np.array(found)
    y = solve_ivp(partial(together, p=p), (0.0, END), start.ravel(), **options).y
    return np.asarray(y.reshape(4, len(STARTS), -1)[:2].transpose(1, 0, 2))


def measured() -> np.ndarray:
    """Return the angles (4, 2, T) with noise."""
    return angles(TRUE, 1e-11) + np.random.default_rng(72).normal(0.0, NOISE, (len(STARTS), 2, len(TIME)))


def spec(folder: Path, data: np.ndarray, step: float, integrator: dict[str, Any]) -> dict[str, Any]:
    """Return the identification, after its files have been written."""
    experiments = {}
    for number, ((a, b), values) in enumerate(zip(STARTS, data, strict=True)):
        file, table = folder / f"swing{number}.csv", np.column_stack([TIME, *values])
        np.savetxt(file, table, delimiter=",", header="time,a,b", comments="")
        observed = {key: {"column": key[0], "correlation": "none"} for key in ("a.angle", "b.angle")}
        rest = {"a.angle": a, "b.angle": b, "a.angular_velocity": 0.0, "b.angular_velocity": 0.0}
        experiments[f"swing{number}"] = {"file": str(file), "observed": observed, "initial": rest}
    hub = {"type": "revolute", "bodies": ["ground", "a"], "at": [0, 0]}
    elbow = {"type": "revolute", "bodies": ["a", "b"], "at": [0, -L1]}
    model = {
        "name": "mechanism",
        "gravity": [0, -G],
        "bodies": {
            "a": {"mass": M1, "inertia": "J1", "position": [0, -D1]},
            "b": {"mass": "m2", "inertia": "J2", "position": [0, f"-{L1} - d2"]},
        },
        "joints": {"hub": hub, "elbow": elbow},
        "forces": {
            "hub": {"type": "torsion-spring", "bodies": ["ground", "a"], "stiffness": K1, "damping": "c1"},
            "elbow": {
                "type": "torsion-spring", "bodies": ["a", "b"], "stiffness": "k2", "damping": "c2", "free_angle": "phi",
            },
        },
    }  # fmt: skip
    base = {"mbdkit": 1, "parameters": dict(START), "model": model, "integrator": integrator}
    return {
        "mbdkit_identify": 1,
        "base": base | {"time": {"end": END, "step": step}},
        "experiments": experiments,
        "parameters": {name: {} for name in TRUE},
        "intervals": {"method": "linear"},
    }


def by_lmfit(data: np.ndarray, at_once: bool = True) -> tuple[np.ndarray, float, int]:
    """Return the estimates (8,) of lmfit, the sum of squares in deviations, and the number of evaluations; see
    `angles`.
    """
    import lmfit

    given = lmfit.Parameters()
    for name, value in START.items():
        given.add(name, value=value, min=0.1 * value, max=5.0 * value)

    def residuals(p: lmfit.Parameters) -> np.ndarray:
        return ((angles(p.valuesdict(), at_once=at_once) - data) / NOISE).ravel()

    found = lmfit.minimize(residuals, given)
    return np.array([found.params[name].value for name in TRUE]), float(found.chisqr), int(found.nfev)


MUJOCO = f"""
<mujoco>
  <compiler angle="radian"/>
  <option integrator="RK4" timestep="{1 / RATE}" gravity="0 0 -{G}"><flag contact="disable"/></option>
  <worldbody>
    <body name="a">
      <inertial pos="0 0 -{D1}" mass="{M1}" diaginertia="0.1 0.1 0.1"/>
      <joint name="hub" type="hinge" axis="0 -1 0" stiffness="{K1}" damping="0.1"/>
      <body name="b" pos="0 0 -{L1}">
        <inertial pos="0 0 -0.5" mass="1" diaginertia="0.1 0.1 0.1"/>
        <joint name="elbow" type="hinge" axis="0 -1 0" stiffness="1" damping="0.1"/>
      </body>
    </body>
  </worldbody>
  <sensor><jointpos name="hub" joint="hub"/><jointpos name="elbow" joint="elbow"/></sensor>
</mujoco>
"""


def _set(spec: Any, name: str, value: float) -> None:
    """Give a parameter of MuJoCo's model a value."""
    a, b, hub, elbow = spec.body("a"), spec.body("b"), spec.joint("hub"), spec.joint("elbow")
    if name in ("J1", "J2"):
        (a if name == "J1" else b).inertia = [value] * 3
    elif name == "m2":
        b.mass = value
    elif name == "d2":
        b.ipos = [0, 0, -value]
    elif name in ("c1", "c2"):
        (hub if name == "c1" else elbow).damping = [value, 0, 0]
    elif name == "k2":
        elbow.stiffness = [value, 0, 0]
    else:
        elbow.springref = value


def by_mujoco(data: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Return the estimates (8,) of `mujoco.sysid` on one core, the sum of squares, and the number of rollouts."""
    import mujoco
    from mujoco import sysid

    spec = mujoco.MjSpec.from_string(MUJOCO)
    model, count = spec.compile(), 0
    joints = data.copy()
    joints[:, 1] -= joints[:, 0]  # elbow angles
    sequences = sysid.ModelSequences(
        "swings",
        spec,
        [f"swing{k}" for k in range(len(STARTS))],
        [sysid.create_initial_state(model, np.array([a, b - a]), np.zeros(2)) for a, b in STARTS],
        [sysid.TimeSeries(TIME, np.zeros((len(TIME), 0)))] * len(STARTS),
        [sysid.TimeSeries.from_names(TIME, one.T, model) for one in joints],
    )
    parameters = sysid.ParameterDict()
    for name, value in START.items():
        change = partial(lambda spec, one, name: _set(spec, name, float(one.value[0])), name=name)
        parameters.add(sysid.Parameter(name, value, 0.1 * value, 5.0 * value, modifier=change))

    def difference(_: Any, predicted: Any, observed: Any, *rest: Any, state: np.ndarray) -> tuple[Any, Any, Any]:
        nonlocal count
        count += 1
        absolute = np.cumsum(state[:, 1:3] - observed.data[1:], axis=1)
        return absolute / NOISE, observed, observed

    residual = sysid.build_residual_fn(models_sequences=[sequences], modify_residual=difference, n_threads=1)
    # of the optimizers, the faster one here; unscaled, the other one ends at once, far from the data
    scale = np.array([*START.values()])
    found, _ = sysid.optimize(parameters, residual, verbose=False, optimizer="scipy", x_scale=scale)
    x = np.array([found[name].value[0] for name in TRUE])
    squares = float(np.sum(np.concatenate(residual(x, found)[0]) ** 2))
    return x, squares, count
