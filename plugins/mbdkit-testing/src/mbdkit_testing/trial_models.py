"""Test problems as models of a spec."""

from __future__ import annotations

import math
from typing import Any

Model = dict[str, Any]


def _model(bodies: Model, forces: Model, **sections: object) -> Model:
    return {"name": "mechanism", "bodies": bodies, "forces": forces, **sections}


def _floating(bodies: Model, forces: Model, **sections: object) -> Model:
    """Return a model without gravity."""
    return _model(bodies, forces, gravity=[0.0, 0.0], **sections)


def _pin(first: str, second: str, on_first: float, on_second: float) -> Model:
    """Return a revolute joint at these places [m] on the x axes of both bodies."""
    return {"type": "revolute", "bodies": [first, second], "points": [[on_first, 0.0], [on_second, 0.0]]}


def _spring(first: str, second: str, points: list[list[float]], **options: float) -> Model:
    return {"type": "spring-damper", "bodies": [first, second], "points": points, **options}


def _torque(body: str, value: str) -> Model:
    return {"type": "torque", "body": body, "value": value}


def _push(body: str, point: list[float], *value: str) -> Model:
    return {"type": "force", "body": body, "point": point, "value": list(value)}


def _rod(length: float, mass: float, joint: tuple[float, float], angle: float, rate: float = 0.0) -> Model:
    """Return a uniform rod whose left end is at rest at `joint`; the rod rotates at `rate` [rad/s]."""
    c, s, r = math.cos(angle), math.sin(angle), length / 2
    return {
        "mass": mass,
        "inertia": mass * length**2 / 12,
        "position": [joint[0] + r * c, joint[1] + r * s],
        "angle": angle,
        "velocity": [-r * s * rate, r * c * rate],
        "angular_velocity": rate,
    }


def _forces(start: float = 0.0) -> Model:
    t = f"(t - {start:g})" if start else "t"
    springs = ((["ground", "rod1"], 3.0, 0.2, -1.2), (["rod1", "rod2"], 2.0, 0.1, 0.3))
    return {
        f"spring{i + 1}": {"type": "torsion-spring", "bodies": pair, "stiffness": k, "damping": c, "free_angle": angle}
        for i, (pair, k, c, angle) in enumerate(springs)
    } | {
        "torque": _torque("rod2", f"1.5*sin(4*{t})") | {"reaction_body": "rod1"},
        "push": _push("rod2", [0.4, 0.0], f"0.8*cos(3*{t})", f"0.5*sin(2*{t})"),
    }


def _two_rods(angles: tuple[float, float], first_rate: float = 0.0, forces: Model | None = None) -> Model:
    elbow = (math.cos(angles[0]), math.sin(angles[0]))
    second = _rod(0.8, 0.7, elbow, angles[1])
    second["velocity"] = [-elbow[1] * first_rate, elbow[0] * first_rate]
    bodies = {"rod1": _rod(1.0, 1.0, (0.0, 0.0), angles[0], first_rate), "rod2": second}
    joints = {"J1": _pin("ground", "rod1", 0.0, -0.5), "J2": _pin("rod1", "rod2", 0.5, -0.4)}
    return _model(bodies, forces or {}, joints=joints)


#: Two rods with springs and dampers, a torque and a force that depend on time: nonlinear and not autonomous.
FORCED_PENDULUM = _two_rods((-0.6, 0.1), forces=_forces())


#: The forced pendulum with first-order states that depend on its motion, and a torque that is one of them; there are
#: several, because the error of a single one may change its sign.
LAGGING_PENDULUM = {
    **FORCED_PENDULUM,
    "forces": _forces() | {"drive": _torque("rod1", "1.5*states.lag")},
    "states": {
        "lag": {"rate": "cos(3*t) + sin(rod2.angle) - 2*states.lag - states.lag**2", "initial": 0.5},
        "fast": {"rate": "6*(sin(4*t + 1) + states.lag - states.fast)", "initial": -0.3},
        "free": {"rate": "states.free*cos(5*t) + rod1.angular_velocity", "initial": 1.0},
    },
}


def forced_pendulum(start: float) -> Model:
    """Return the forced pendulum with forces that begin at the time `start` [s] instead of 0."""
    return {**FORCED_PENDULUM, "forces": _forces(start)}


#: The forced pendulum with a driver on its first rod: constraints that depend on time.
DRIVEN_PENDULUM = _two_rods((-1.2, 0.1), 1.5, _forces())
_MOTOR = {"type": "driver", "bodies": ["ground", "rod1"], "coordinate": "angle", "motion": "-1.2 + 0.6*sin(2.5*t)"}
DRIVEN_PENDULUM["joints"]["motor"] = _MOTOR

#: A closed loop under a torque that depends on time, with a spring between a body and a point that is not a joint.
FOUR_BAR = _model(
    {
        "crank": _rod(0.4, 1.0, (0.0, 0.0), 1.2),
        "coupler": _rod(1.0, 2.0, (0.4 * math.cos(1.2), 0.4 * math.sin(1.2)), 0.35),
        "rocker": _rod(0.8, 1.5, (1.0, 0.0), 1.4),
    },
    {
        "motor": _torque("crank", "2 + sin(5*t)"),
        "slip": {"type": "torsion-spring", "bodies": ["ground", "crank"], "damping": 1.0},
        "return": _spring("ground", "coupler", [[0.5, 1.5], [0.1, 0.1]], stiffness=30.0, damping=1.0, free_length=0.6),
    },
    joints={
        "A": _pin("ground", "crank", 0.0, -0.2),
        "B": _pin("crank", "coupler", 0.2, -0.5),
        "C": _pin("coupler", "rocker", 0.5, 0.4),
        "D": _pin("ground", "rocker", 1.0, -0.4),
    },
    assembly={"fix": ["crank"]},
)

_CLAMP = [0.4 * math.cos(0.3), 0.4 * math.sin(0.3)]
#: A soft beam of two elements, clamped to a crank under a time-dependent torque.
BEAM = _model(
    {"crank": _rod(0.4, 1.0, (0.0, 0.0), 0.3)},
    {"motor": _torque("crank", "4 + 2*sin(5*t)")},
    beams={
        "blade": {
            "a": _CLAMP,
            "b": [1.2, 0.5],
            "elements": 2,
            "nodes": 3,
            "mass_per_length": 1.0,
            "rotary_inertia": 0.1,
            "damping": 0.01,
            "stiffness": {"axial": 20.0, "shear": 10.0, "bending": 1.0},
        }
    },
    joints={
        "hub": _pin("ground", "crank", 0.0, -0.2),
        "clamp": {"type": "weld", "bodies": ["crank", "blade.0"], "at": _CLAMP},
    },
)

#: A conservative double pendulum with large swings, which are not chaotic within some seconds.
SWINGING = _two_rods((-1.0, -1.9))

#: The four-bar linkage without loads in weak gravity, a conservative closed loop.
FREE_FOUR_BAR = {**FOUR_BAR, "forces": {}, "gravity": [0.0, -2.0]}

_ORIGIN = [[0.0, 0.0], [0.0, 0.0]]
_ORBITING = {"mass": {"mass": 1.0, "position": [1.0, 0.0], "velocity": [0.0, 0.7]}}
#: A point mass on a spring that is fixed at the origin: no joints, nonlinear, conserves energy and angular momentum.
ORBIT = _floating(_ORBITING, {"spring": _spring("ground", "mass", _ORIGIN, stiffness=2.0, free_length=0.3)})

#: A point mass on a spring without a free length: linear, so that its energy is a quadratic invariant.
HARMONIC = _floating(_ORBITING, {"spring": _spring("ground", "mass", _ORIGIN, stiffness=2.0, free_length=0.0)})

#: Two free bodies on the ends of a spring beside their centers: conserves energy and both momenta, without joints.
FLOATING = _floating(
    {
        "one": {"mass": 1.0, "inertia": 0.2, "position": [-0.6, 0.1], "velocity": [0.3, -0.8], "angular_velocity": 1.5},
        "two": {
            "mass": 1.7,
            "inertia": 0.4,
            "position": [0.7, -0.2],
            "velocity": [-0.1, 0.9],
            "angular_velocity": -1.0,
        },
    },
    {"spring": _spring("one", "two", [[0.2, 0.1], [-0.3, 0.2]], stiffness=5.0, free_length=0.6)},
)

SLIPPING = _two_rods((-0.6, 0.1), 4.0) | {"gravity": [0.0, -1.0]}
#: Two rods with friction in the first joint, whose slip is always far above the transition speed, so that the motion is
#: smooth. Friction depends on the reaction of the joint.
SLIPPING["joints"]["J1"]["friction"] = {"coefficient": 0.3, "radius": 0.1}

_ELBOW_VELOCITY = [-0.6 * math.sin(0.4) - 0.2 * math.sin(0.5), 0.6 * math.cos(0.4) - 0.2 * math.cos(0.5)]
#: Two free rods with a joint and a torsion spring between them: conserves energy and both momenta.
FLOATING_RODS = _floating(
    {
        "left": _rod(1.0, 1.0, (0.0, 0.0), 0.4, 0.6),
        "right": _rod(0.8, 0.7, (math.cos(0.4), math.sin(0.4)), -0.5, -0.5) | {"velocity": _ELBOW_VELOCITY},
    },
    {"spring": {"type": "torsion-spring", "bodies": ["left", "right"], "stiffness": 0.2}},
    joints={"J": _pin("left", "right", 0.5, -0.4)},
)

COASTING = {**SWINGING, "gravity": [0.0, 0.0]}
#: Two moving rods without applied forces.
COASTING["bodies"] = {
    "rod1": _rod(1.0, 1.0, (0.0, 0.0), -1.0, 1.0),
    "rod2": {**_rod(0.8, 0.7, (math.cos(1.0), -math.sin(1.0)), -1.9), "velocity": [math.sin(1.0), math.cos(1.0)]},
}

#: A torque that is undefined after half a second.
NO_NUMBER = {**SWINGING, "forces": {"torque": _torque("rod1", "sqrt(0.5 - t)")}}

#: Two rods; a driver pulls their far end beyond their reach within a second.
OUT_OF_REACH = _two_rods((-0.8, 0.8))
OUT_OF_REACH["joints"]["pull"] = {
    "type": "driver",
    "bodies": ["ground", "rod2"],
    "coordinate": "x",
    "points": [[0.0, 0.0], [0.4, 0.0]],
    "motion": f"{math.cos(0.8) + 0.8 * math.cos(0.8):.15f} + t**2",
}

#: Two rods with a joint at a point far out of reach.
CANNOT_MEET = SWINGING | {"joints": SWINGING["joints"] | {"far": _pin("ground", "rod2", 9.0, 0.4)}}


_SPINNING = {"mass": 2.0, "inertia": 0.3, "position": [0.4, -0.2], "velocity": [30.0, -7.0], "angular_velocity": 9.0}
#: A free body in free fall that rotates fast; its acceleration is constant.
COASTING_BODY = _model({"mass": _SPINNING}, {}, gravity=[0.0, -9.81])

_BESIDE = _spring("ground", "rod1", [[0.5, -0.5], [0.0, 0.0]], stiffness=40.0, free_length=0.5)
#: Starts at rest at which derivatives of the motion vanish, by symmetry or in equilibrium.
#:
#: At such a start, an error estimate may vanish by accident.
RESTING: dict[str, Model] = {
    "a horizontal rod": _model(
        {"rod1": _rod(1.0, 1.0, (0.0, 0.0), 0.0)}, {}, joints={"J1": _pin("ground", "rod1", 0.0, -0.5)}
    ),
    "two horizontal rods": _two_rods((0.0, 0.0)),
    "a horizontal rod with a vertical one": _two_rods((0.0, -math.pi / 2)),
    "rods hanging straight that a slowly rising torque moves": _two_rods(
        (-math.pi / 2, -math.pi / 2), forces={"torque": _torque("rod2", "8*t**4*exp(-t)")}
    ),
    "a spring in equilibrium beside a rod that swings": _two_rods((-math.pi / 2, 0.3), forces={"spring": _BESIDE}),
}


def pushed(power: int) -> Model:
    """Return a point mass of 1 kg under the force ``t**power`` along x: its motion is a polynomial."""
    force = _push("mass", [0.0, 0.0], f"t**{power}" if power else "1", "0")
    return _floating({"mass": {"mass": 1.0, "position": [0.0, 0.0]}}, {"push": force})


def oscillators(frequency: float, damping: tuple[float, ...], deflection: float = 1.0) -> Model:
    """Return masses of 1 kg, each `deflection` [m] from its equilibrium at x = 1 m on a linear spring along x, of one
    undamped frequency [rad/s] and of the given damping ratios.
    """
    along_x = {"type": "coordinate", "coordinate": "x"}
    linear = {"type": "law", "law": "mbdkit:linear", "stiffness": frequency**2, "free_length": 1.0}
    return _floating(
        {f"mass{i}": {"mass": 1.0, "position": [1.0 + deflection, 0.0]} for i in range(len(damping))},
        {
            f"spring{i}": linear
            | {"pathway": along_x | {"bodies": ["ground", f"mass{i}"]}, "damping": 2.0 * ratio * frequency}
            for i, ratio in enumerate(damping)
        },
    )


#: A mass under a force that is a first-order state.
WITH_STATE = pushed(0) | {
    "forces": {"push": _push("mass", [0.0, 0.0], "states.lag", "0")},
    "states": {"lag": {"rate": "cos(3*t) - 2*states.lag", "initial": 0.5}},
}
#: Closed form of this state after 1 s.
LAG_AT_1 = (2.0 * math.cos(3.0) + 3.0 * math.sin(3.0)) / 13.0 + (0.5 - 2.0 / 13.0) * math.exp(-2.0)
