"""A double pendulum whose joints a program drives, one by a held torque and one by a torque that changes linearly."""

import mbdkit

METHODS = {
    "rk4": ({"name": "rk4"}, 0.01),
    "gauss": ({"name": "gauss", "stages": 2}, 0.01),
    "dopri5": ({"name": "dopri5", "adaptive": True, "rtol": 1e-6, "atol": 1e-8}, None),
    "radau": ({"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-6, "atol": 1e-8}, None),
    "scipy-dop853": ({"name": "scipy-dop853", "rtol": 1e-6, "atol": 1e-8}, None),
}


def driven_pendulum() -> mbdkit.Mechanism:
    """Return the mechanism; its inputs are `held` and `ramp` [N m]."""
    m = mbdkit.Mechanism()
    upper = m.body("upper", mass=1.2, inertia=0.05, position=[0.25, 0.0], angle=0.1)
    lower = m.body("lower", mass=0.8, inertia=0.03, position=[0.75, 0.0], angle=-0.2)
    m.revolute("shoulder", "ground", upper, at=[0.0, 0.0])
    m.revolute("elbow", upper, lower, at=[0.5, 0.0])
    m.input("held", unit="N*m", bounds=[-5.0, 5.0], initial=0.2)
    m.input("ramp", unit="N*m", hold="linear")
    m.torque("drive", upper, value="inputs.held - 0.1*upper.angular_velocity")
    m.torque("assist", lower, value="inputs.ramp")
    return m


def sections(method: str, end: float = 1.0, **further: object) -> dict[str, object]:
    """Return the sections of a spec with one of the `METHODS`."""
    integrator, step = METHODS[method]
    return {"integrator": integrator, "time": {"end": end, **({} if step is None else {"step": step})}, **further}
