"""A pair of walking legs for mbdkit: an example of a model with drivers.

The hips are fixed in space, as if walking on a treadmill. Each leg consists of a thigh and of a shank with its foot;
the legs move half a cycle apart. The angles of the hips are driven by measured data. The knees are driven in the same
way, or swing against a damper, as in a simple prosthesis.

Masses and lengths of the segments are fractions of body mass and height (Winter 2009, table 4.1). The angles are means
over 39 boys at 20 points of the cycle (Olshen et al. 1989), approximated by a trigonometric polynomial with six
harmonics.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit.plugin.seams import model_builder

REFERENCES = tuple(Path(__file__).with_name("references.bib").read_text("utf-8").strip().split("\n\n"))
# Means over the 39 boys in degrees, flexion positive, at 2.5 %, 7.5 %, ... 97.5 % of the cycle from heel strike; the
# measurements are in hip.txt and knee.txt of the R package fda.
HIP, KNEE = np.loadtxt(Path(__file__).with_name("gait.csv"), delimiter=",", skiprows=1, unpack=True)
HARMONICS = 6

# Mass as a fraction of body mass, length as a fraction of body height; distance of the centre of mass from the upper
# joint, and radius of gyration about the centre of mass, as fractions of the segment length.
THIGH = {"mass": 0.100, "length": 0.245, "centre": 0.433, "gyration": 0.323}
SHANK_AND_FOOT = {"mass": 0.061, "length": 0.246 + 0.039, "centre": 0.606, "gyration": 0.416}

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class WalkerOptions(BaseModel):
    """Mass and height of the person, period of the walk, and type of the knees."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)

    body_mass: Positive = 70.0
    """Mass of the whole person [kg]."""
    height: Positive = 1.75
    """Height of the person [m]."""
    period: Positive = 1.1
    """Time from one heel strike of a foot to the next one of the same foot [s]."""
    knees: Literal["driven", "damped"] = "driven"
    """Whether the knees follow the measured angles (`driven`), or swing freely with `damping` (`damped`)."""
    damping: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 2.0
    """Damping constant of a knee that is not driven [N m s/rad]."""
    pelvic_tilt: Annotated[float, Field(ge=-0.6, le=0.6)] = 0.3
    """Forward tilt of the pelvis [rad]. Hip angles are measured relative to the pelvis; with a tilt of 0.3 the thighs
    swing symmetrically about the vertical.
    """


def angle(degrees: np.ndarray, period: float, ahead: float) -> tuple[str, float]:
    """Return a measured angle [rad] as an expression of t, and its value at t = 0.

    Parameters
    ----------
    degrees
        Values of the angle at 2.5 %, 7.5 %, ... of the cycle [deg].
    period
        Time of a cycle [s].
    ahead
        Fraction of the cycle that is completed at t = 0.
    """
    waves = (np.fft.rfft(np.radians(degrees)) / len(degrees)).tolist()
    terms, start = [repr(waves[0].real)], waves[0].real
    for k in range(1, HARMONICS + 1):
        size, phase = 2 * abs(waves[k]), math.atan2(waves[k].imag, waves[k].real) + 2 * math.pi * k * (ahead - 0.025)
        terms.append(f"{size!r}*cos({2 * math.pi * k / period!r}*t + ({phase!r}))")
        start += size * math.cos(phase)
    return " + ".join(terms), start


@model_builder
def build(options: WalkerOptions) -> mbdkit.Mechanism:
    """Return the mechanism: bodies `left_thigh`, `left_shank`, ..., joints `left_hip`, `left_knee`, ..., and their
    drivers.
    """
    m = mbdkit.Mechanism()
    for side, ahead in (("left", 0.0), ("right", 0.5)):
        hip, hip_now = angle(HIP, options.period, ahead)
        knee, knee_now = angle(KNEE, options.period, ahead)
        # angle of a thigh without flexion; its x axis points from hip to knee
        down = -0.5 * math.pi - options.pelvic_tilt
        upper, lower = np.zeros(2), np.zeros(2)
        tilts = {"thigh": down + hip_now, "shank": down + hip_now - knee_now}
        for name, segment in (("thigh", THIGH), ("shank", SHANK_AND_FOOT)):
            mass, length = segment["mass"] * options.body_mass, segment["length"] * options.height
            along = np.array([math.cos(tilts[name]), math.sin(tilts[name])])
            centre = upper + segment["centre"] * length * along
            lower = upper + length * along
            m.body(
                f"{side}_{name}",
                mass=mass,
                inertia=mass * (segment["gyration"] * length) ** 2,
                position=(float(centre[0]), float(centre[1])),
                angle=tilts[name],
            )
            where = (float(upper[0]), float(upper[1]))
            if name == "thigh":
                m.revolute(f"{side}_hip", m.ground, f"{side}_thigh", at=where)
            else:
                m.revolute(f"{side}_knee", f"{side}_thigh", f"{side}_shank", at=where)
            upper = lower
        m.driver(f"{side}_hip_motor", m.ground, f"{side}_thigh", coordinate="angle", motion=f"{down!r} + {hip}")
        if options.knees == "driven":
            m.driver(f"{side}_knee_motor", f"{side}_thigh", f"{side}_shank", coordinate="angle", motion=f"-({knee})")
        else:
            m.torsion_spring(f"{side}_damper", f"{side}_thigh", f"{side}_shank", stiffness=0.0, damping=options.damping)
    return m
