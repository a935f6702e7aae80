"""Results of equilibrium, modes and kinematics as text for the terminal and as plain data for JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mbdkit.plugin import counted, listed, table
from mbdkit.plugin.mechanisms import beam_of, gravity_text
from mbdkit_statics.equilibrium import Equilibrium
from mbdkit_statics.kinematics import Kinematics
from mbdkit_statics.modes import Modes

SHOWN = 20
"""Largest number of rows in a printed table."""

AT_REST = 1e-9
"""A state counts as at rest if no velocity or acceleration exceeds this [m/s, rad/s, m/s^2, rad/s^2]."""

STABILITY = {
    "stable": "stable",
    "neutral": "neutral: a motion without restoring force exists",
    "fixed": "fixed: joints and drivers leave no degree of freedom",
    "unknown": "unknown: the lowest motions do not grow, but higher ones were not examined",
}


def equilibrium_text(found: Equilibrium) -> str:
    """Return an equilibrium as text: accuracy, positions, reactions in joints, forces in beams, first-order states."""
    lines = [f"{label:<12} {fact}" for label, fact in equilibrium_facts(found)]
    ends = beam_ends(found)
    places = [
        (name, *(f"{x:.9g}" for x in clean(place)))
        for name, place in zip(found.bodies, found.position, strict=True)
        if beam_of(name) not in found.beams
    ]
    if places:
        lines += ["", table(_some([("BODY", "X [m]", "Y [m]", "ANGLE [rad]"), *places]))]
    if ends:
        moved = [(name, *(f"{x:.9g}" for x in place), *(f"{x:.6g}" for x in by)) for name, place, by in ends]
        heads = ("END OF BEAM", "X [m]", "Y [m]", "ANGLE [rad]", "MOVED BY X [m]", "Y [m]", "TURNED BY [rad]")
        lines += ["", table(_some([heads, *moved]))]
    if found.joints:
        force = found.reaction_force
        largest = max(float(np.max(np.abs(force))), float(np.max(np.abs(found.reaction_torque))))
        loads = [
            (name, *(f"{0.0 if abs(x) < 1e-12 * largest else x:.6g}" for x in (*force[j], found.reaction_torque[j])))
            for j, name in enumerate(found.joints)
        ]
        lines += ["", table(_some([("JOINT", "FORCE X [N]", "FORCE Y [N]", "TORQUE [N m]"), *loads]))]
    if found.beams:
        lines += ["", table(_some([("BEAM", "AT [m]", "MOMENT [N m]", "SHEAR [N]", "AXIAL [N]"), *beam_rows(found)]))]
    if found.states:
        values = [(name, f"{value:.9g}") for name, value in zip(found.states, found.state, strict=True)]
        lines += ["", table(_some([("STATE", "VALUE"), *values]))]
    lines += [note for note in [sharing(found)] if note]
    return "\n".join(lines)


def beam_ends(found: Equilibrium) -> list[tuple[str, list[float], list[float]]]:
    """Return name, position and displacement from the start, for the first and the last node of each beam."""
    nodes = {name: [k for k, body in enumerate(found.bodies) if beam_of(body) == name] for name in found.beams}
    places = [place for own in nodes.values() for place in (own[0], own[-1])]
    return [(found.bodies[k], clean(found.position[k]), clean(found.displacement[k])) for k in places]


def beam_rows(found: Equilibrium) -> list[tuple[str, ...]]:
    """Return as text the internal forces of each beam at its ends, and at the points where their magnitudes are
    largest.
    """
    rows = []
    for name, values in found.beams.items():
        largest = np.max(np.abs(values[:, 1:]))
        places = {0, len(values) - 1, *(int(place) for place in np.argmax(np.abs(values[:, 1:]), axis=0))}
        for place in sorted(places):
            at, axial, shear, moment = values[place].tolist()
            forces = (f"{0.0 if abs(x) < 1e-9 * largest else x:.6g}" for x in (moment, shear, axial))
            rows.append((name, f"{at:.4g}", *forces))
    return rows


def equilibrium_facts(found: Equilibrium) -> list[tuple[str, str]]:
    """Return stability, time, accuracy and stiffness of an equilibrium, each with its label."""
    left = f"remaining accelerations {found.imbalance:.1e}, misalignment of the joints {found.residual:.1e} (m, rad, s)"
    stiffness = f"{found.stiffness:.6g} 1/s^2 (lowest eigenvalue of the stiffness for unit mass)"
    return [
        ("equilibrium", stability_text(found)),
        ("time", f"{found.time:g} s, for drivers and loads"),
        *([("gravity", gravity_text(found.mechanism.gravity))] if found.mechanism is not None else []),
        ("found in", f"{counted(found.iterations, 'step')}; {left}"),
        *([("stiffness", stiffness)] if found.stability != "fixed" else []),
    ]


def stability_text(found: Equilibrium) -> str:
    """Return the stability of an equilibrium as a sentence; if it is unstable, with how it is lost."""
    if found.stability != "unstable":
        return STABILITY[found.stability]
    if found.growth == 0:
        return "UNSTABLE: small displacements drive it away"
    within = f"e-fold in {1 / found.growth.real:.4g} s"
    if found.flutters:
        return f"UNSTABLE by flutter: oscillations of {abs(found.growth.imag):.4g} rad/s grow {within}"
    return f"UNSTABLE: any small disturbance grows, {within}"


def sharing(found: Equilibrium) -> str:
    """Return a remark on reactions that are not unique; empty if all are unique."""
    if not found.shared:
        return ""
    return f"not unique, because joints are redundant: the reactions of {listed(found.shared, 'and')}"


def equilibrium_data(found: Equilibrium) -> dict[str, Any]:
    """Return an equilibrium as plain data."""
    return {
        "time": found.time,
        "stability": found.stability,
        "growth": [found.growth.real, found.growth.imag],
        "flutters": found.flutters,
        "stiffness": _number(found.stiffness),
        "imbalance": found.imbalance,
        "residual": found.residual,
        "iterations": found.iterations,
        "bodies": _by_name(found.bodies, found.position),
        "displacements": _by_name(found.bodies, found.displacement),
        "reactions": {
            name: {"force": force, "torque": torque}
            for name, force, torque in zip(
                found.joints, found.reaction_force.tolist(), found.reaction_torque.tolist(), strict=True
            )
        },
        "multipliers": dict(zip(found.constraints, found.multiplier.tolist(), strict=True)),
        "beams": {
            name: dict(zip(("at", "axial", "shear", "moment"), values.T.tolist(), strict=True))
            for name, values in found.beams.items()
        },
        "not_unique": list(found.shared),
        "states": dict(zip(found.states, found.state.tolist(), strict=True)),
    }


def modes_text(found: Modes) -> str:
    """Return modes as text: the state about which the mechanism is linearised, then one row per mode."""
    lines = [f"{label:<12} {fact}" for label, fact in modes_facts(found)]
    rows: list[tuple[str, ...]] = [("MODE", "RAD/S", "HZ", "DAMPING RATIO", "MOVES MOST", "")]
    for k, value in enumerate(found.eigenvalues.tolist()):
        ratio = "" if value == 0 else f"{found.damping_ratio[k] + 0.0:.6g}"
        frequency = (f"{found.natural_frequency[k]:.9g}", f"{found.frequency_hz[k]:.9g}") if value.imag else ("", "")
        rows.append((str(k + 1), *frequency, ratio if value.imag else "", moves_most(found, k), remark(value)))
    return "\n".join([*lines, "", table(_some(rows))])


def modes_facts(found: Modes) -> list[tuple[str, str]]:
    """Return the state about which the modes are computed, and the number of degrees of freedom, each with its
    label.
    """
    speed, push = (float(np.max(np.abs(x), initial=0.0)) for x in (found.velocity, found.acceleration))
    if speed > AT_REST or push > AT_REST:
        what = " and ".join(
            [f"moves at up to {speed:.3g}"] * (speed > AT_REST)
            + [f"accelerates at up to {push:.3g}"] * (push > AT_REST)
        )
        state = f"the start, not at rest: it {what} (in m, rad and s); the modes are valid at this instant only"
    else:
        state = "at rest"
    many = f", {len(found.eigenvalues)} modes computed" if len(found.eigenvalues) < found.freedoms else ""
    return [
        ("linearised", f"at t = {found.time:g} s, {state}"),
        ("freedoms", f"{counted(found.freedoms, 'degree of freedom', 'degrees of freedom')}{many}"),
    ]


def modes_data(found: Modes) -> dict[str, Any]:
    """Return modes as plain data; complex numbers become [real, imaginary]."""
    return {
        "time": found.time,
        "freedoms": found.freedoms,
        "state": {
            "position": _by_name(found.bodies, found.position),
            "velocity": _by_name(found.bodies, found.velocity),
            "acceleration": _by_name(found.bodies, found.acceleration),
        },
        "modes": [
            {
                "eigenvalue": [value.real, value.imag],
                "natural_frequency": abs(value),
                "frequency_hz": abs(value) / (2 * math.pi),
                "damping_ratio": _number(float(ratio)),
                "shape": {
                    name: np.column_stack([u.real, u.imag]).tolist()
                    for name, u in zip(found.bodies, shape, strict=True)
                },
            }
            for value, ratio, shape in zip(found.eigenvalues.tolist(), found.damping_ratio, found.shapes, strict=True)
        ],
    }


def kinematics_text(found: Kinematics) -> str:
    """Return as text the range of motion and the largest speed, rate and acceleration of each body."""
    rows: list[tuple[str, ...]] = [
        ("BODY", "X [m]", "Y [m]", "ANGLE [rad]", "SPEED [m/s]", "RATE [rad/s]", "ACCELERATION [m/s^2]")
    ]
    for name in found.bodies:
        motion = found[name]
        low, high = motion.position.min(axis=0), motion.position.max(axis=0)
        ranges = [f"{a:.5g} to {b:.5g}" for a, b in zip(clean(low), clean(high), strict=True)]
        speed, push = (np.hypot(x[:, 0], x[:, 1]).max() for x in (motion.velocity, motion.acceleration))
        rows.append((name, *ranges, f"{speed:.5g}", f"{np.abs(motion.velocity[:, 2]).max():.5g}", f"{push:.5g}"))
    first, last = found.time[[0, -1]]
    return f"kinematics   {len(found.time)} times from {first:g} to {last:g} s; ranges and largest values\n\n" + table(
        _some(rows)
    )


def kinematics_data(found: Kinematics) -> dict[str, Any]:
    """Return a motion as plain data."""
    return {
        "time": found.time.tolist(),
        "bodies": {
            name: {
                "position": found[name].position.tolist(),
                "velocity": found[name].velocity.tolist(),
                "acceleration": found[name].acceleration.tolist(),
            }
            for name in found.bodies
        },
    }


def remark(value: complex) -> str:
    """Return a remark on a mode that is not a steady or decaying oscillation; otherwise an empty text."""
    if value == 0:
        return "free: no restoring force"
    if value.imag == 0:
        verb = "UNSTABLE: grows" if value.real > 0 else "decays"
        return f"{verb} without oscillation, e-fold in {1 / abs(value.real):.4g} s"
    return f"UNSTABLE: grows e-fold in {1 / value.real:.4g} s" if value.real > 1e-9 * abs(value) else ""


def moves_most(found: Modes, k: int) -> str:
    """Return the name of the body with the coordinate that changes most in a mode [m or rad]."""
    size = np.abs(found.shapes[k]).max(axis=1)
    return found.bodies[int(np.argmax(size))]


def _by_name(names: tuple[str, ...], rows: np.ndarray) -> dict[str, list[float]]:
    return dict(zip(names, rows.tolist(), strict=True))


def _some(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the heading and the first `SHOWN` rows, followed by the number of rows left out, if any."""
    more = len(rows) - 1 - SHOWN
    return rows if more <= 0 else [*rows[: SHOWN + 1], (f"and {more} more", *[""] * (len(rows[0]) - 1))]


def clean(values: np.ndarray) -> list[float]:
    """Return the numbers as a list, with zero in place of magnitudes below 1e-12, which are rounding errors."""
    return [0.0 if abs(x) < 1e-12 else x for x in values.tolist()]


def _number(x: float) -> float | None:
    return None if math.isnan(x) else x
