"""`python -m tests.benchmarks.person_markers FOLDER`: the table of the example `person-walking`.

Markers on the person of the example `walking-two-legs`, whose joint centres, angles and ground forces are known. The
markers move with their segments and, as skin does, about them: each coordinate of each marker has an artefact, a
Gaussian process with the standard deviation `SKIN` of the segment and a correlation time of 0.08 s.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.signal import butter, filtfilt
from tests.inverse_dynamics.running import table_of

from mbdkit.spec.loading import example_files

Array = np.ndarray
THIGH, SHANK, ANKLE = 0.441, 0.4428, 0.0702
"""Lengths of thigh and shank, and height of the ankle of the flat foot, by Winter's fractions of 1.8 m [m]."""
WIDTH, DEPTH = 0.24, 0.16
"""Width and depth of the pelvis [m]; by the regression of Harrington et al. (2007), which gives the hips `HIP`."""
HIP = (-0.24 * DEPTH - 0.0099, -0.30 * WIDTH - 0.0109, 0.33 * WIDTH + 0.0073)
"""The right hip relative to the middle of the anterior superior iliac spines: forward, up and right [m]."""
SKIN = {"trunk": 0.002, "thigh": 0.006, "shank": 0.003, "foot": 0.002}
"""Standard deviation of the artefact of a marker by segment [m]."""
IN_STEP = {"thigh": (0.006, 0.061), "shank": (0.006, 0.044)}
"""Standard deviations of the translation along and the turn about each axis of a cluster in step with a joint over the
range of its angle, of thighs and of other segments [m, rad]."""
CORRELATION = 0.08
"""Time in which the artefact of a marker changes [s]."""
MARKERS: dict[str, dict[str, tuple[float, float, float]]] = {
    "thigh": {"THU": (0.06, -0.12, 0.06), "THF": (0.09, -0.24, 0.02), "THL": (-0.01, -0.33, 0.08),
              "KNE": (0.0, -THIGH, 0.05), "KNM": (0.0, -THIGH, -0.05)},
    "shank": {"SHU": (0.05, -0.08, 0.03), "SHF": (0.06, -0.25, 0.01), "SHL": (-0.02, -0.28, 0.06),
              "ANK": (0.0, -SHANK, 0.04), "ANM": (0.0, -SHANK, -0.04)},
    "foot": {"HEE": (-0.06, -0.04, 0.0), "TOE": (0.17, -0.05, 0.01), "MT5": (0.1, -0.055, 0.05),
             "MT1": (0.12, -0.045, -0.045)},
}  # fmt: skip
"""Markers of the right leg, without the side, in the frames of the segments: origin at the proximal joint [m]."""
PELVIS = {"RASI": (0.0, 0.0, WIDTH / 2), "LASI": (0.0, 0.0, -WIDTH / 2), "RPSI": (-DEPTH, 0.0, 0.05),
          "LPSI": (-DEPTH, 0.0, -0.05)}  # fmt: skip
"""Markers of the pelvis relative to the middle of the anterior superior iliac spines [m]."""


def cluster(body: str) -> list[str]:
    """Return the names of the markers of a body, without those on the medial and lateral sides of the joints."""
    if body == "trunk":
        return [*PELVIS]
    side, kind = ("L" if body.endswith("_left") else "R"), body.removesuffix("_left")
    return [side + name for name in MARKERS[kind] if name not in ("KNE", "KNM", "ANK", "ANM")]


COMMENT = """Markers [mm] and force plates [N, mm, N mm] of the person of the example walking-two-legs, whose joint
centres are known: the markers move with the segments, and about them by a Gaussian process with a correlation time of
0.08 s (standard deviations of 2, 6, 3 and 2 mm on pelvis, thighs, shanks and feet). The person walks towards -x; z is
up. Written by `python -m tests.benchmarks.person_markers`. Source of the gait: D. A. Winter (1991), as tabulated in
https://github.com/mechmotum/gait-closed-loop-id."""
"""Comment in the table of the example."""

CLUSTERS = {body: cluster(body) for body in ("trunk", *(f"{name}{leg}" for leg in ("", "_left") for name in MARKERS))}


class RandomNumbers(Protocol):
    """A source of random numbers."""

    def standard_normal(self, size: int) -> Array:
        """Return Gaussian numbers with a mean of 0."""


@dataclass
class Walker:
    """A person who walks, with known joints; positions are (forward, up, right).

    Parameters
    ----------
    time
        (T,) [s].
    angles
        (T,) angles of trunk and segments by body, counter-clockwise [rad].
    hip
        (T, 2) middle of the hips [m].
    loads
        Force (T, 2) [N] and point of application (T, 2) [m] by foot.
    size
        Factor of all lengths.
    """

    time: Array
    angles: Mapping[str, Array]
    hip: Array
    loads: Mapping[str, tuple[Array, Array]]
    size: float = 1.0
    joints: dict[str, Array] = field(init=False)

    def __post_init__(self) -> None:
        middle = np.column_stack([self.hip, np.zeros(len(self.time))])
        self.joints = {}
        for leg, side in (("", 1.0), ("_left", -1.0)):
            at = self.joints[f"hip{leg}"] = middle + np.array([0.0, 0.0, side * self.size * HIP[2]])
            for joint, body, length in (("knee", "thigh", THIGH), ("ankle", "shank", SHANK)):
                at = self.joints[f"{joint}{leg}"] = at + self.turned(f"{body}{leg}", (0.0, -length, 0.0))

    @classmethod
    def of_example(cls, step: int = 1, rows: slice = slice(None), size: float = 1.0) -> Walker:
        """Return every `step`-th of the rows of the example `walking-two-legs`."""
        table = table_of(example_files("walking-two-legs")["walking-two-legs.csv"])[rows][::step]
        angles = {"trunk": np.radians(table["trunk_tilt"])}
        for leg in ("", "_left"):
            flexions = [np.radians(table[name + leg]) for name in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion")]
            angles[f"thigh{leg}"] = angles["trunk"] + flexions[0]
            angles[f"shank{leg}"] = angles[f"thigh{leg}"] - flexions[1]
            angles[f"foot{leg}"] = angles[f"shank{leg}"] + flexions[2]
        loads = {
            f"foot{leg}": (
                np.column_stack([table[f"force_x{leg}"], table[f"force_y{leg}"]])
                * (table[f"force_y{leg}"] > 10.0)[:, None],  # plates show no smaller forces
                size * np.column_stack([table[f"pressure_x{leg}"], 0.0 * table["time"]]),
            )
            for leg in ("", "_left")
        }
        return cls(table["time"], angles, size * np.column_stack([table["hip_x"], table["hip_y"]]), loads, size)

    def turned(self, body: str, point: tuple[float, float, float]) -> Array:
        """Return a vector of a segment, (T, 3)."""
        x, y, z = (self.size * one for one in point)
        c, s = np.cos(self.angles[body]), np.sin(self.angles[body])
        return np.column_stack([c * x - s * y, s * x + c * y, np.full(len(self.time), z)])

    @cached_property
    def _root(self) -> Array:
        lag = (self.time[:, None] - self.time) / CORRELATION
        return np.asarray(np.linalg.cholesky(np.exp(-0.5 * lag * lag) + 1e-8 * np.eye(len(self.time))))

    def skin(self, random: np.random.Generator) -> Array:
        """Return an artefact (T, 3) with the standard deviation 1."""
        return np.asarray(self._root @ random.standard_normal((len(self.time), 3)))

    def markers(self, random: np.random.Generator | None = None, skin: float = 1.0) -> dict[str, Array]:
        """Return the markers (T, 3) by name, with artefacts of `skin` times their standard deviations."""
        found = {}
        noise = (lambda size: skin * size * self.skin(random)) if random else np.zeros
        to_pelvis = np.array([HIP[0], HIP[1], 0.0])
        for name, point in PELVIS.items():
            middle = np.column_stack([self.hip, 0.0 * self.time])
            own = self.turned("trunk", tuple(np.array(point) - to_pelvis))
            found[name] = middle + own + (noise(SKIN["trunk"]) if random else 0.0)
        for leg, side, sign in (("", "R", 1.0), ("_left", "L", -1.0)):
            for kind, joint in (("thigh", "hip"), ("shank", "knee"), ("foot", "ankle")):
                for name, (x, y, z) in MARKERS[kind].items():
                    own = self.turned(f"{kind}{leg}", (x, y, sign * z))
                    found[side + name] = self.joints[joint + leg] + own + (noise(SKIN[kind]) if random else 0.0)
        return found

    def filtered(self, cutoff: float) -> dict[str, tuple[Array, Array]]:
        """Return the loads without what exceeds a frequency [Hz], as plates show them: none below 10 N."""
        interval, found = float(self.time[1] - self.time[0]), {}
        b, a = butter(2, 2.0 * interval * cutoff / (np.sqrt(2) - 1) ** 0.25)  # two passes
        for foot, (force, point) in self.loads.items():
            columns = np.column_stack([force, np.nan_to_num(point[:, 0]) * force[:, 1]])
            x, y, moment = filtfilt(b, a, columns, axis=0, padlen=int(np.ceil(2.0 / cutoff / interval))).T
            acts = y > 10.0
            pressed = np.where(acts, moment / np.where(acts, y, 1.0), 0.0)
            found[foot] = np.column_stack([x, y]) * acts[:, None], np.column_stack([pressed, 0.0 * pressed])
        return found

    def move_in_step(self, markers: dict[str, Array], joint: str, random: RandomNumbers) -> None:
        """Move and turn the clusters of both segments of a joint by random amounts in step with its flexion."""
        kind, leg = joint.removesuffix("_left"), "_left" if joint.endswith("_left") else ""
        bodies = {"hip": ("trunk", "thigh"), "knee": ("thigh", "shank"), "ankle": ("shank", "foot")}[kind]
        bodies = tuple(body if body == "trunk" else f"{body}{leg}" for body in bodies)
        flexion = self.angles[bodies[0]] - self.angles[bodies[1]]
        share = ((flexion - np.mean(flexion)) / np.ptp(flexion))[:, None]
        for body in bodies:
            along, about = IN_STEP["thigh" if body.startswith("thigh") else "shank"]
            x, y, turn = (np.array([along, along, about]) * random.standard_normal(3)).tolist()
            middle = np.mean([markers[name] for name in CLUSTERS[body]], axis=0)
            for name in CLUSTERS[body]:
                turned = np.cross([0.0, 0.0, turn], markers[name] - middle)
                markers[name] = markers[name] + share * (self.turned(body, (x, y, 0.0)) + turned)

    def contacts(self) -> list[tuple[str, int, int]]:
        """Return foot, first frame and the frame after the last one of each contact."""
        found = []
        for foot, (force, _) in self.loads.items():
            edges = np.flatnonzero(np.diff(np.concatenate([[False], force[:, 1] > 0, [False]])))
            found += [(foot, *pair) for pair in edges.reshape(-1, 2).tolist()]
        return sorted(found, key=lambda one: one[1])

    def plates(self) -> list[tuple[Array, Array]]:
        """Return force and point of application, (T, 3), of a plate below each contact; nan without force."""
        found = []
        for foot, first, end in self.contacts():
            force, point = np.zeros((len(self.time), 3)), np.full((len(self.time), 3), np.nan)
            force[first:end, :2], point[first:end, :2] = (one[first:end] for one in self.loads[foot])
            point[first:end, 2] = (1.0 if foot == "foot" else -1.0) * self.size * HIP[2]
            found.append((force, point))
        return found


def in_laboratory(points: Array, heading: float = 0.0, up: str = "z") -> Array:
    """Return points (..., 3), as (forward, up, right), in a laboratory, for a heading [rad] from its x axis."""
    forward, above, right = np.moveaxis(points, -1, 0)
    x, y = np.cos(heading) * forward + np.sin(heading) * right, np.sin(heading) * forward - np.cos(heading) * right
    return np.stack([x, y, above] if up == "z" else [x, above, -y], axis=-1)


def table_text(time: Array, columns: Mapping[str, Array], comment: str = "") -> str:
    """Return a table of markers [mm], and of forces [N], points [mm] and torques [N mm] of plates, (T, 3) each."""
    lines = [f"# {line}" for line in comment.splitlines()]
    unit = {name: "N" if name.endswith("force") else "N mm" if name.endswith("torque") else "mm" for name in columns}
    lines.append(",".join(["time", *(f"{name}.{axis}" for name in columns for axis in "xyz")]))
    lines.append(",".join(["s", *(unit[name] for name in columns for _ in "xyz")]))
    for row, at in enumerate(time):
        values = [one for name, own in columns.items() for one in own[row] * (1.0 if unit[name] == "N" else 1000.0)]
        lines.append(",".join([f"{at:.6f}", *("" if np.isnan(one) else f"{one:.1f}" for one in values)]))
    return "\n".join(lines) + "\n"


def columns_of(walker: Walker, markers: Mapping[str, Array], heading: float = 0.0, up: str = "z") -> dict[str, Array]:
    """Return the columns of a table with markers and plates in a laboratory."""
    found = {name: in_laboratory(points, heading, up) for name, points in markers.items()}
    for number, (force, point) in enumerate(walker.plates(), 1):
        found |= {
            f"plate{number}.force": in_laboratory(force, heading, up),
            f"plate{number}.point": in_laboratory(point, heading, up),
            f"plate{number}.torque": 0.0 * force,
        }
    return found


def main(folder: str) -> None:
    """Write the table: every second row of two strides, in a laboratory in which the person walks towards -x."""
    walker = Walker.of_example(2, slice(24, 230))
    text = table_text(walker.time, columns_of(walker, walker.markers(np.random.default_rng(56)), np.pi), COMMENT)
    (Path(folder) / "person-walking.csv").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
