"""Results of equilibrium, modes and kinematics as text for the terminal and as plain data for JSON."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.base.text import counted, listed, table
from mbdkit.mechanism.beams import beam_of
from mbdkit.mechanism.mechanism import gravity_text
from mbdkit_statics.equilibrium import Equilibrium
from mbdkit_statics.kinematics import Kinematics
from mbdkit_statics.modes import Modes

SHOWN = 20  #: Largest number of rows in a printed table.

#: A state counts as at rest if no velocity or acceleration exceeds this [m/s, rad/s, m/s^2, rad/s^2].
AT_REST = 1e-9

STABILITY = {
    "stable": "stable",
    "neutral": "neutral: a motion without restoring force exists",
    "fixed": "fixed: joints and drivers leave no degree of freedom",
    "corner": "undecided: a force has a corner here, and some of its sides are soft",
    "unknown": "unknown: the lowest motions do not grow, but higher ones were not examined",
}


def equilibrium_text(rest: Equilibrium) -> str:
    """Return an equilibrium as text: accuracy, positions, reactions in joints, forces in beams, first-order states."""
    lines = [f"{label:<12} {fact}" for label, fact in equilibrium_facts(rest)]
    ends = beam_ends(rest)
    places = [
        (name, *(f"{x:.9g}" for x in clean(position)))
        for name, position in zip(rest.bodies, rest.position, strict=True)
        if beam_of(name) not in rest.beams
    ]
    if places:
        lines += ["", table(_some([("BODY", "X [m]", "Y [m]", "ANGLE [rad]"), *places]))]
    if ends:
        moved = [(name, *(f"{x:.9g}" for x in position), *(f"{x:.6g}" for x in by)) for name, position, by in ends]
        heads = ("END OF BEAM", "X [m]", "Y [m]", "ANGLE [rad]", "MOVED BY X [m]", "Y [m]", "TURNED BY [rad]")
        lines += ["", table(_some([heads, *moved]))]
    if rest.joints:
        force = rest.reaction_force
        largest = max(float(np.max(np.abs(force))), float(np.max(np.abs(rest.reaction_torque))))
        loads = [
            (name, *(f"{0.0 if abs(x) < 1e-12 * largest else x:.6g}" for x in (*force[j], rest.reaction_torque[j])))
            for j, name in enumerate(rest.joints)
        ]
        lines += ["", table(_some([("JOINT", "FORCE X [N]", "FORCE Y [N]", "TORQUE [N m]"), *loads]))]
    if rest.beams:
        lines += ["", table(_some([("BEAM", "AT [m]", "MOMENT [N m]", "SHEAR [N]", "AXIAL [N]"), *beam_rows(rest)]))]
    if rest.states:
        values = [(name, f"{value:.9g}") for name, value in zip(rest.states, rest.state, strict=True)]
        lines += ["", table(_some([("STATE", "VALUE"), *values]))]
    lines += [note for note in [sharing(rest)] if note]
    return "\n".join(lines)


def beam_ends(rest: Equilibrium) -> list[tuple[str, list[float], list[float]]]:
    """Return name, position and displacement from the start, for the first and the last node of each beam."""
    nodes = {name: [k for k, body in enumerate(rest.bodies) if beam_of(body) == name] for name in rest.beams}
    ends = [node for own in nodes.values() for node in (own[0], own[-1])]
    return [(rest.bodies[k], clean(rest.position[k]), clean(rest.displacement[k])) for k in ends]


def beam_rows(rest: Equilibrium) -> list[tuple[str, ...]]:
    """Return as text the internal forces of each beam at its ends, and at the points where their magnitudes are
    largest.
    """
    rows = []
    for name, values in rest.beams.items():
        largest = np.max(np.abs(values[:, 1:]))
        rows_shown = {0, len(values) - 1, *(int(row) for row in np.argmax(np.abs(values[:, 1:]), axis=0))}
        for row in sorted(rows_shown):
            at, axial, shear, moment = values[row].tolist()
            forces = (f"{0.0 if abs(x) < 1e-9 * largest else x:.6g}" for x in (moment, shear, axial))
            rows.append((name, f"{at:.4g}", *forces))
    return rows


def equilibrium_facts(rest: Equilibrium) -> list[tuple[str, str]]:
    """Return stability, time, accuracy and stiffness of an equilibrium, each with its label."""
    left = f"remaining accelerations {rest.imbalance:.1e}, misalignment of the joints {rest.residual:.1e} (m, rad, s)"
    stiffness = f"{rest.stiffness:.6g} 1/s^2 (lowest eigenvalue of the stiffness for unit mass)"
    return [
        ("equilibrium", stability_text(rest)),
        *(("free motion", motion) for motion in rest.neutral_motions),
        ("time", f"{rest.time:g} s, for drivers and loads"),
        *([("gravity", gravity_text(rest.mechanism.gravity))] if rest.mechanism is not None else []),
        ("found in", f"{counted(rest.iterations, 'step')}; {left}"),
        *([("stiffness", stiffness)] if rest.stability != "fixed" else []),
    ]


def stability_text(rest: Equilibrium) -> str:
    """Return the stability of an equilibrium as a sentence; if it is unstable, with how it is lost."""
    if rest.stability != "unstable":
        return STABILITY[rest.stability]
    if rest.growth == 0:
        return "UNSTABLE: small displacements drive it away"
    within = f"e-fold in {1 / rest.growth.real:.4g} s"
    if rest.flutters:
        return f"UNSTABLE by flutter: oscillations of {abs(rest.growth.imag):.4g} rad/s grow {within}"
    return f"UNSTABLE: any small disturbance grows, {within}"


def sharing(rest: Equilibrium) -> str:
    """Return a remark on reactions that are not unique; empty if all are unique."""
    if not rest.shared:
        return ""
    return f"not unique, because joints are redundant: the reactions of {listed(rest.shared, 'and')}"


def equilibrium_data(rest: Equilibrium) -> dict[str, object]:
    """Return an equilibrium as plain data."""
    reactions = zip(rest.joints, rest.reaction_force.tolist(), rest.reaction_torque.tolist(), strict=True)
    return {
        "time": rest.time,
        "stability": rest.stability,
        "neutral_motions": list(rest.neutral_motions),
        "growth": [rest.growth.real, rest.growth.imag],
        "flutters": rest.flutters,
        "stiffness": rest.stiffness,
        "imbalance": rest.imbalance,
        "residual": rest.residual,
        "iterations": rest.iterations,
        "bodies": _by_name(rest.bodies, rest.position),
        "displacements": _by_name(rest.bodies, rest.displacement),
        "reactions": {name: {"force": force, "torque": torque} for name, force, torque in reactions},
        "multipliers": dict(zip(rest.constraints, rest.multiplier.tolist(), strict=True)),
        "beams": {
            name: dict(zip(("at", "axial", "shear", "moment"), values.T.tolist(), strict=True))
            for name, values in rest.beams.items()
        },
        "not_unique": list(rest.shared),
        "states": dict(zip(rest.states, rest.state.tolist(), strict=True)),
    }


def modes_text(modes: Modes) -> str:
    """Return modes as text: the state about which the mechanism is linearised, then one row per mode."""
    lines = [f"{label:<12} {fact}" for label, fact in modes_facts(modes)]
    rows: list[tuple[str, ...]] = [("MODE", "RAD/S", "HZ", "DAMPING RATIO", "MOVES MOST", "")]
    for k, value in enumerate(modes.eigenvalues.tolist()):
        ratio = "" if value == 0 else f"{modes.damping_ratio[k] + 0.0:.6g}"
        frequency = (f"{modes.natural_frequency[k]:.9g}", f"{modes.frequency_hz[k]:.9g}") if value.imag else ("", "")
        rows.append((str(k + 1), *frequency, ratio if value.imag else "", moves_most(modes, k), remark(value)))
    return "\n".join([*lines, "", table(_some(rows))])


def modes_facts(shown: Modes) -> list[tuple[str, str]]:
    """Return the state about which the modes are computed, and the number of degrees of freedom, each with its
    label.
    """
    speed, push = (float(np.max(np.abs(x), initial=0.0)) for x in (shown.velocity, shown.acceleration))
    if speed > AT_REST or push > AT_REST:
        what = " and ".join(
            [f"moves at up to {speed:.3g}"] * (speed > AT_REST)
            + [f"accelerates at up to {push:.3g}"] * (push > AT_REST)
        )
        state = f"the start, not at rest: it {what} (in m, rad and s); the modes are valid at this instant only"
    else:
        state = "at rest"
    many = f", {len(shown.eigenvalues)} modes computed" if len(shown.eigenvalues) < shown.freedoms else ""
    return [
        ("linearised", f"at t = {shown.time:g} s, {state}"),
        ("freedoms", f"{counted(shown.freedoms, 'degree of freedom', 'degrees of freedom')}{many}"),
    ]


def modes_data(modes: Modes) -> dict[str, object]:
    """Return modes as plain data; complex numbers become [real, imaginary]."""
    return {
        "time": modes.time,
        "freedoms": modes.freedoms,
        "state": {key: _by_name(modes.bodies, getattr(modes, key)) for key in ("position", "velocity", "acceleration")},
        "modes": [
            {
                "eigenvalue": [value.real, value.imag],
                "natural_frequency": abs(value),
                "frequency_hz": abs(value) / (2 * math.pi),
                "damping_ratio": float(ratio),
                "shape": {
                    name: np.column_stack([u.real, u.imag]).tolist()
                    for name, u in zip(modes.bodies, shape, strict=True)
                },
            }
            for value, ratio, shape in zip(modes.eigenvalues.tolist(), modes.damping_ratio, modes.shapes, strict=True)
        ],
    }


def kinematics_text(motions: Kinematics) -> str:
    """Return as text the range of motion and the largest speed, rate and acceleration of each body."""
    rows: list[tuple[str, ...]] = [
        ("BODY", "X [m]", "Y [m]", "ANGLE [rad]", "SPEED [m/s]", "RATE [rad/s]", "ACCELERATION [m/s^2]")
    ]
    for name in motions.bodies:
        motion = motions[name]
        low, high = motion.position.min(axis=0), motion.position.max(axis=0)
        ranges = [f"{a:.5g} to {b:.5g}" for a, b in zip(clean(low), clean(high), strict=True)]
        speed, push = (np.hypot(x[:, 0], x[:, 1]).max() for x in (motion.velocity, motion.acceleration))
        rows.append((name, *ranges, f"{speed:.5g}", f"{np.abs(motion.velocity[:, 2]).max():.5g}", f"{push:.5g}"))
    first, last = motions.time[[0, -1]]
    return (
        f"kinematics   {len(motions.time)} times from {first:g} to {last:g} s; ranges and largest values\n\n"
        + table(_some(rows))
    )


def kinematics_data(motions: Kinematics) -> dict[str, object]:
    """Return a motion as plain data."""
    return {
        "time": motions.time.tolist(),
        "bodies": {name: {key: x.tolist() for key, x in vars(motions[name]).items()} for name in motions.bodies},
    }


def remark(value: complex) -> str:
    """Return a remark on a mode that is not a steady or decaying oscillation; otherwise an empty text."""
    if value == 0:
        return "free: no restoring force"
    if value.imag == 0:
        verb = "UNSTABLE: grows" if value.real > 0 else "decays"
        return f"{verb} without oscillation, e-fold in {1 / abs(value.real):.4g} s"
    return f"UNSTABLE: grows e-fold in {1 / value.real:.4g} s" if value.real > 1e-9 * abs(value) else ""


def moves_most(modes: Modes, k: int) -> str:
    """Return the name of the body with the coordinate that changes most in a mode [m or rad]."""
    return modes.bodies[int(np.argmax(np.abs(modes.shapes[k]).max(axis=1)))]


def _by_name(names: tuple[str, ...], rows: np.ndarray) -> dict[str, list[float]]:
    return dict(zip(names, rows.tolist(), strict=True))


def _some(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the heading and the first `SHOWN` rows, followed by the number of rows left out, if any."""
    more = len(rows) - 1 - SHOWN
    return rows if more <= 0 else [*rows[: SHOWN + 1], (f"and {more} more", *[""] * (len(rows[0]) - 1))]


def clean(values: np.ndarray) -> list[float]:
    """Return the numbers as a list, with zero in place of magnitudes below 1e-12, which are rounding errors."""
    return [0.0 if abs(x) < 1e-12 else x for x in values.tolist()]
