"""Mass, centre of mass and inertia of body segments, from body mass and height, by published tables.

Points of a segment are complex numbers x + i y [m] in the *segment frame*: the origin is the proximal joint, y points
along the segment to this joint (up for a standing person), and x forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import yaml

_ENTRIES = Path(__file__).with_name("references.bib").read_text("utf-8").strip()
WINTER, DE_LEVA, FRACTIONS, GAIT2D, EXOSKELETON = _ENTRIES.split("\n\n")  # in the order of the file

#: Distance of the heel behind the ankle, and height of the ankle, as shares of body height; used with all tables.
HEEL_BEHIND_ANKLE, ANKLE_HEIGHT = 0.06 / 1.8, 0.039
#: Height of the centre of mass of head, arms and trunk above the hips, and their radius of gyration.
#:
#: Both are shares of body height, and are used with all tables. They are computed from the segments of gait2d, which
#: uses Winter's fractions for 75 kg and 1.8 m.
TRUNK_CENTRE, TRUNK_GYRATION = 0.3155 / 1.8, math.sqrt(3.1777 / 50.85) / 1.8


@dataclass(frozen=True)
class RigidSegment:
    """A rigid segment: mass [kg], centre of mass x + i y [m], moment of inertia about that centre [kg m^2]."""

    mass: float
    centre: complex
    inertia: float

    def __rmul__(self, share: float) -> RigidSegment:
        """Return a segment of the same shape with a share of the mass."""
        return RigidSegment(share * self.mass, self.centre, share * self.inertia)

    def __add__(self, other: RigidSegment) -> RigidSegment:
        """Return both segments joined rigidly, as one segment (parallel axis theorem)."""
        mass = self.mass + other.mass
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        reduced = self.mass * other.mass / mass
        arm = self.centre - other.centre
        inertia = self.inertia + other.inertia + reduced * (arm.real * arm.real + arm.imag * arm.imag)
        return RigidSegment(mass, centre, inertia)


class Fractions(NamedTuple):
    """Proportions of a segment.

    Attributes
    ----------
    mass
        Mass, as a share of body mass.
    length
        Length, as a share of body height.
    centre
        Distance of the centre of mass from the proximal end (foot: from the heel), as a share of the length.
    gyration
        Radius of gyration about the centre of mass and the mediolateral axis, as a share of the length.
    """

    mass: float
    length: float
    centre: float
    gyration: float


_TABLES = yaml.safe_load(Path(__file__).with_name("segments.yaml").read_text("utf-8"))


@dataclass(frozen=True)
class BodySegments:
    """The segments of a person.

    Parameters
    ----------
    body_mass
        Body mass [kg].
    height
        Body height [m].
    table
        Name of the table of proportions.
    measured_thigh, measured_shank
        Lengths of thigh and shank [m]; None for those of the table.
    """

    body_mass: float
    height: float
    table: str = "winter"
    measured_thigh: float | None = None
    measured_shank: float | None = None

    @property
    def fractions(self) -> dict[str, Fractions]:
        """Proportions of thigh (hip to knee), shank (knee to ankle) and foot (from the heel), with the measured
        lengths.
        """
        table = dict(_TABLES[self.table])
        height, measured = table.pop("height"), {"thigh": self.measured_thigh, "shank": self.measured_shank}
        results = {}
        for name, (mass, length, centre, gyration) in table.items():
            own = measured.get(name)
            share = length / height if own is None else own / self.height
            results[name] = Fractions(mass, share, centre, gyration)
        return results

    @property
    def thigh_length(self) -> float:
        """Distance from hip to knee [m]."""
        return self.fractions["thigh"].length * self.height

    @property
    def shank_length(self) -> float:
        """Distance from knee to ankle [m]."""
        return self.fractions["shank"].length * self.height

    @property
    def heel(self) -> complex:
        """The heel in the frame of the foot [m], whose origin is the ankle."""
        return complex(-HEEL_BEHIND_ANKLE * self.height, -ANKLE_HEIGHT * self.height)

    @property
    def toe(self) -> complex:
        """The front end of the foot, on the sole, in the frame of the foot [m]."""
        return self.heel + self.fractions["foot"].length * self.height

    @property
    def trunk(self) -> RigidSegment:
        """Head, arms and trunk: the body mass without both legs; origin at the hips."""
        mass = (1.0 - 2 * sum(one.mass for one in self.fractions.values())) * self.body_mass
        gyration = TRUNK_GYRATION * self.height
        return RigidSegment(mass, complex(0.0, TRUNK_CENTRE * self.height), mass * (gyration * gyration))

    @property
    def thigh(self) -> RigidSegment:
        """Thigh; origin at the hip."""
        return self._limb(self.fractions["thigh"])

    @property
    def shank(self) -> RigidSegment:
        """Shank; origin at the knee."""
        return self._limb(self.fractions["shank"])

    @property
    def foot(self) -> RigidSegment:
        """Foot, flat on the ground; origin at the ankle. Its centre of mass is at half the height of the ankle."""
        of = self.fractions["foot"]
        length, mass = of.length * self.height, of.mass * self.body_mass
        centre = complex(of.centre * length - HEEL_BEHIND_ANKLE * self.height, -0.5 * ANKLE_HEIGHT * self.height)
        return RigidSegment(mass, centre, mass * (of.gyration * length) * (of.gyration * length))

    @property
    def foot_on_shank(self) -> RigidSegment:
        """Foot at a right angle to the shank; origin at the knee."""
        foot = self.foot
        return RigidSegment(foot.mass, foot.centre - 1j * self.shank_length, foot.inertia)

    def _limb(self, of: Fractions) -> RigidSegment:
        length, mass = of.length * self.height, of.mass * self.body_mass
        gyration = of.gyration * length
        return RigidSegment(mass, complex(0.0, -of.centre * length), mass * gyration * gyration)
