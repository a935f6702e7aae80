"""`python -m tests.benchmarks.walking_data walking.csv`: the table of the example `walking`.

The table is a fit to D. A. Winter's normal gait at natural cadence, whose means over a stride of 1.1396 s are tabulated
every 2 %. Angles of hip, knee and ankle are Fourier series of the stride; the ground force is a series of sines of the
contact, which vanish at its ends. What Winter's table lacks follows from it and from the walking speed:

- the motion of the hip, by Newton's law for the whole body: both legs take the same steps, half a stride apart, and the
  ground forces on both accelerate the body;
- the tilt of the pelvis, from which hip flexion is counted: one harmonic, with which the ankle comes nearest to resting
  while the foot is flat, from 10 to 40 % of the stride;
- the centre of pressure, from Winter's moment of the ankle, within the length of the foot.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from tests.inverse_dynamics.running import reference, table

from mbdkit_biomech.models._segments import BodySegments

STRIDE = 1.1396
"""Duration of a stride [s]."""
SPEED = 1.325
"""Mean walking speed [m/s]."""
PERSON_MASS = 75.0
"""Body mass [kg]."""
PERSON = BodySegments(PERSON_MASS, 1.8)
GRAVITY = 9.81
HARMONICS = {"hip_flexion": 6, "knee_flexion": 6, "ankle_dorsiflexion": 8}
CONTACT = (-0.005, 0.66)
"""Begin and end of the contact of the foot, in strides after Winter's heel strike."""
SINES = 12
"""Number of sines of each component of the ground force."""
FLAT = np.linspace(0.10, 0.40, 31)
"""Phases at which the foot is flat on the ground."""
MISPRINTS = (46, 94)
"""Rows [%] whose moment of the ankle, 1.688 and 0.087 N m/kg, does not fit between those of their neighbours."""
GRID = np.arange(250) / 250
"""Phases of a stride at which the motion of the hip is computed."""
PHASES = np.arange(-30, 231) / 100
"""Phases of the rows of the table: two strides from heel strike to heel strike, and 30 % on both sides."""

Array = np.ndarray[Any, np.dtype[np.float64]]


def harmonics(phase: Array, count: int, order: int = 0) -> Array:
    """Return the constant, cosines and sines (T, 1 + 2 count) of a Fourier series, or their time derivatives."""
    rate = 2j * np.pi / STRIDE * np.arange(1, count + 1)
    waves = rate**order * np.exp(2j * np.pi * np.arange(1, count + 1) * phase[:, None])
    pairs = np.stack([waves.real, waves.imag], axis=2).reshape(len(phase), -1)
    return np.column_stack([np.full(len(phase), 0.0 if order else 1.0), pairs])


def sines(phase: Array) -> Array:
    """Return the sines (T, SINES) of the contact, zero while the foot is in the air."""
    share = np.mod(phase - CONTACT[0], 1.0) / (CONTACT[1] - CONTACT[0])
    waves = np.sin(np.pi * share[:, None] * np.arange(1, SINES + 1))
    return np.where((share < 1.0 - 1e-9)[:, None], waves, 0.0)


@dataclass(frozen=True)
class Gait:
    """Series of the gait by the names of their columns: coefficients of `harmonics`, or of `sines` for the forces.

    Angles are in rad, lengths in m, forces in N.
    """

    series: dict[str, Array]

    def at(self, name: str, phase: Array, order: int = 0) -> Array:
        """Return values (T,) of a series, or of its time derivatives; the hip also moves on with `SPEED`."""
        own = self.series[name]
        if name.startswith("force"):
            return np.asarray(sines(phase) @ own)
        found = harmonics(phase, len(own) // 2, order) @ own
        if name == "hip_x" and order < 2:
            found = found + SPEED * (STRIDE * phase if order == 0 else 1.0)
        return np.asarray(found)

    def force(self, phase: Array) -> Array:
        """Return the ground force x + i y (T,) on the foot."""
        return np.asarray(self.at("force_x", phase) + 1j * self.at("force_y", phase))

    def angles(self, phase: Array, order: int = 0) -> tuple[Array, Array, Array]:
        """Return the angles (T,) of thigh, shank and foot in space, or their time derivatives."""
        thigh = self.at("trunk_tilt", phase, order) + self.at("hip_flexion", phase, order)
        shank = thigh - self.at("knee_flexion", phase, order)
        return thigh, shank, shank + self.at("ankle_dorsiflexion", phase, order)

    def below_hip(self, phase: Array) -> tuple[Array, Array]:
        """Return the sum of mass times position (T,) of the segments, and the ankle (T,), both from the hip."""
        thigh, shank, foot = (np.exp(1j * angle) for angle in self.angles(phase))
        knee = -1j * PERSON.thigh_length * thigh
        ankle = knee - 1j * PERSON.shank_length * shank
        parts = (
            (PERSON.thigh, PERSON.thigh.centre * thigh),
            (PERSON.shank, knee + PERSON.shank.centre * shank),
            (PERSON.foot, ankle + PERSON.foot.centre * foot),
        )
        return sum(segment.mass * place for segment, place in parts), ankle

    def hip(self, phase: Array) -> Array:
        """Return the place x + i y (T,) of the hip."""
        return np.asarray(self.at("hip_x", phase) + 1j * self.at("hip_y", phase))


def fitted(winter: Any) -> Gait:
    """Return the series that fit Winter's table."""
    phase, once = winter["gait_percent"] / 100, slice(0, -1)  # both ends of the stride are rows
    series = {}
    for name, count in HARMONICS.items():
        column = np.radians(winter[f"{name.partition('_')[0]}_deg"])
        series[name] = np.linalg.lstsq(harmonics(phase, count), column, rcond=None)[0]
    for axis in "xy":
        column = PERSON_MASS * winter[f"grf_{axis}_N_per_kg"]
        series[f"force_{axis}"] = np.linalg.lstsq(sines(phase[once]), column[once], rcond=None)[0]

    def tilted(tilt: Array) -> Gait:
        return with_hip(Gait({"trunk_tilt": np.array([0.0, *tilt]), **series}))

    def slip(tilt: Array) -> Array:
        gait = tilted(tilt)
        ankle = gait.hip(FLAT) + gait.below_hip(FLAT)[1]
        return np.asarray(np.gradient(ankle.real, STRIDE * FLAT))

    return tilted(least_squares(slip, np.zeros(2)).x)


def with_hip(gait: Gait) -> Gait:
    """Return the gait with the motion of the hip, by Newton's law for trunk and both legs.

    The mean of the vertical force, 3 % less than half of the weight, is left out, as is that of the horizontal force.
    The sole is on the ground, y = 0, on average while the foot is flat.
    """
    legs = gait.below_hip(GRID)[0] + gait.below_hip(GRID + 0.5)[0]
    force = gait.force(GRID) + gait.force(GRID + 0.5)
    series = dict(gait.series)
    for axis, part in (("x", np.real), ("y", np.imag)):
        waves = harmonics(GRID, SINES)
        accelerated, carried = (np.linalg.lstsq(waves, part(one), rcond=None)[0] for one in (force, legs))
        square = np.repeat((2 * np.pi / STRIDE * np.arange(1, SINES + 1)) ** 2, 2)
        series[f"hip_{axis}"] = np.array([0.0, *(-(accelerated[1:] / square + carried[1:]) / PERSON_MASS)])
    return with_sole(Gait(series))


def with_sole(gait: Gait) -> Gait:
    """Return the gait at the height of the hip with which the sole is on the ground, on average while it is flat."""
    foot = np.exp(1j * gait.angles(FLAT)[2])
    sole = gait.hip(FLAT) + gait.below_hip(FLAT)[1] + (PERSON.heel + PERSON.toe) / 2 * foot
    raised = gait.series["hip_y"].copy()
    raised[0] -= np.mean(sole.imag)
    return Gait(gait.series | {"hip_y": raised})


def pressure(gait: Gait, winter: Any, phases: Array) -> Array:
    """Return the centre of pressure x (P,) on the ground at phases (P,), nan where the ground does not push."""
    step = 1e-4
    near = [phases - step, phases, phases + step]
    feet = [np.exp(1j * gait.angles(one)[2]) for one in near]
    ankles = [gait.hip(one) + gait.below_hip(one)[1] for one in near]
    centres = [ankle + PERSON.foot.centre * foot for ankle, foot in zip(ankles, feet, strict=True)]
    acceleration = (centres[0] - 2 * centres[1] + centres[2]) / (step * STRIDE) ** 2
    ankle, foot, force = ankles[1], feet[1], gait.force(phases)
    inert = PERSON.foot.mass * (acceleration + 1j * GRAVITY)
    rest = _cross(centres[1] - ankle, inert) + PERSON.foot.inertia * gait.angles(phases, 2)[2]
    kept = ~np.isin(winter["gait_percent"], MISPRINTS)
    percent, published = winter["gait_percent"][kept], winter["ankle_moment"][kept]
    moment = PERSON_MASS * np.interp(np.mod(100 * phases, 100.0), percent, published)
    # about the ankle: (x - ankle_x) F_y + ankle_y F_x - moment = rest
    with np.errstate(divide="ignore", invalid="ignore"):
        arm = (moment + rest - ankle.imag * force.real) / force.imag
    heel, toe = ((end * foot).real for end in (PERSON.heel, PERSON.toe))
    return np.where(np.abs(force) > 0, ankle.real + np.clip(arm, np.minimum(heel, toe), np.maximum(heel, toe)), np.nan)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray((np.conj(a) * b).imag)


COLUMNS = ("hip_x", "hip_y", "trunk_tilt", *HARMONICS, "force_x", "force_y")
ANGLES = ("trunk_tilt", *HARMONICS)


def header(module: str) -> list[str]:
    """Return the first comments of the table that a module of the benchmarks writes."""
    return [
        "# Normal gait at natural cadence, as Fourier series fitted to the means of D. A. Winter, Biomechanics and",
        "# Motor Control of Human Gait, 2nd edition, University of Waterloo Press 1991, as tabulated in",
        "# https://github.com/mechmotum/gait-closed-loop-id (data/Winter_normal.csv), for 75 kg and 1.8 m.",
        f"# Stride {STRIDE} s, walking speed {SPEED} m/s; heel strike of the right foot at 0.3 and 1.3 strides.",
        f"# Written by `python -m tests.benchmarks.{module}`, which tells how it was made; lengths in m, angles in",
        "# degrees, forces in N. Series (rad, m, N): of a motion, the constant, then cosine and sine of each harmonic",
        "# of the stride from heel strike; of a force, sines of the contact, from -0.5 to 66 % of the stride.",
    ]


def text(gait: Gait, cop: Array) -> str:
    """Return the table: comments with the coefficients of all series, headings, and rows."""
    lines = header("walking_data")
    lines += [f"# {name}: {' '.join(f'{round(x, 9):.6g}' for x in gait.series[name])}" for name in COLUMNS]
    lines.append(",".join(("time", *COLUMNS, "pressure_x")))
    return "\n".join([*lines, *map(",".join, rows(gait, PHASES, cop))]) + "\n"


def rows(gait: Gait, phases: Array, cop: Array, digits: tuple[int, int, int] = (4, 2, 5)) -> list[list[str]]:
    """Return the cells of the rows at phases (P,): time from the first one, `COLUMNS` and `cop` (P,).

    Parameters
    ----------
    digits
        Decimal places of angles, forces and lengths; the centre of pressure has one less.
    """
    values = [np.degrees(gait.at(name, phases)) if name in ANGLES else gait.at(name, phases) for name in COLUMNS]
    of_angle, of_force, of_length = digits
    decimals = [of_angle if name in ANGLES else of_force if name.startswith("force") else of_length for name in COLUMNS]
    found = []
    for row, phase in enumerate(phases):
        cells = [f"{column[row]:.{places}f}" for column, places in zip(values, decimals, strict=True)]
        point = "" if np.isnan(cop[row]) else f"{cop[row]:.{of_length - 1}f}"
        found.append([f"{(phase - phases[0]) * STRIDE:.6f}", *cells, point])
    return found


def series_in(table_text: str) -> Gait:
    """Return the series in the comments of the table."""
    found = re.findall(r"^# (\w+): ([-+.e\d ]+)$", table_text, flags=re.MULTILINE)
    return Gait({name: np.array([float(one) for one in numbers.split()]) for name, numbers in found})


def main(path: str) -> None:
    """Write the table."""
    winter = table(reference("winter_normal_gait.csv"))
    gait = fitted(winter)
    Path(path).write_text(text(gait, pressure(gait, winter, PHASES)), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
