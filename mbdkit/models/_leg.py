"""Mass, centre of mass and inertia of the lower leg from body mass and height, with Winter's segment fractions."""

from __future__ import annotations

from dataclasses import dataclass

WINTER = """@book{winter2009,
  author    = {Winter, David A.},
  title     = {Biomechanics and Motor Control of Human Movement},
  edition   = {4},
  publisher = {John Wiley \\& Sons},
  year      = {2009},
  doi       = {10.1002/9780470549148},
  note      = {Segment fractions of body mass, height and segment length}
}"""
FRACTIONS = """@misc{gaitanalysistoolkit,
  author       = {{csu-hmc}},
  title        = {GaitAnalysisToolKit, gaitanalysis/octave/2d\\_inverse\\_dynamics/leg2d.m},
  howpublished = {\\url{https://github.com/csu-hmc/GaitAnalysisToolKit}},
  note         = {Commit 3f1c0a2bb69fff5775b71b1ed809515a6937d16c; Winter's fractions as used here}
}"""
GAIT2D = """@misc{gait2d,
  author       = {{csu-hmc}},
  title        = {gait2d, data/example\\_constants.yml},
  howpublished = {\\url{https://github.com/csu-hmc/gait2d}},
  note         = {Commit 44bb269cc3be09d4c36936d47b15f83a130e1ab3; height 1.8 m, heel 0.06 m behind the ankle}
}"""

SHANK_MASS, FOOT_MASS = 0.0465, 0.0145  # of body mass
SHANK_LENGTH, FOOT_LENGTH, FOOT_HEIGHT = 0.246, 0.152, 0.039  # of body height
SHANK_CENTRE, FOOT_CENTRE = 0.433, 0.5  # of segment length, from the knee and from the heel
SHANK_GYRATION, FOOT_GYRATION = (
    0.302,
    0.475,
)  # radii of gyration as fractions of segment length, about the centre of mass
HEEL_BEHIND_ANKLE = 0.06 / 1.8  # of body height


@dataclass(frozen=True)
class Segment:
    """A rigid segment: mass [kg], centre of mass x + i y [m], moment of inertia about that centre [kg m^2]."""

    mass: float
    centre: complex
    inertia: float

    def __add__(self, other: Segment) -> Segment:
        """Return both segments joined rigidly, as one segment (parallel axis theorem)."""
        mass = self.mass + other.mass
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        reduced = self.mass * other.mass / mass
        inertia = self.inertia + other.inertia + reduced * abs(self.centre - other.centre) ** 2
        return Segment(mass, centre, inertia)


def shank(body_mass: float, height: float) -> Segment:
    """Return the shank of a person with `body_mass` [kg] and `height` [m]; origin at the knee, y up along the shank."""
    length = SHANK_LENGTH * height
    mass = SHANK_MASS * body_mass
    return Segment(mass, complex(0.0, -SHANK_CENTRE * length), mass * (SHANK_GYRATION * length) ** 2)


def foot(body_mass: float, height: float) -> Segment:
    """Return the foot, at a right angle to the shank, in the frame of :func:`shank`.

    Its centre of mass is half the foot length in front of the heel and half the ankle height below the ankle.
    """
    length = FOOT_LENGTH * height
    mass = FOOT_MASS * body_mass
    x = FOOT_CENTRE * length - HEEL_BEHIND_ANKLE * height
    y = -SHANK_LENGTH * height - 0.5 * FOOT_HEIGHT * height
    return Segment(mass, complex(x, y), mass * (FOOT_GYRATION * length) ** 2)
