"""``python tests/benchmarks/walking_muscles.py gait10dof18musc.osim``: the muscles of the example `walking-muscles`.

Prints them as YAML. Needs ``pip install opensim pyyaml``, and the model Gait10dof18musc of
https://github.com/opensim-org/opensim-models, the right leg of which has nine muscles. Points are scaled to the
segments of the model `leg` for 1.8 m, each along its segment, and moved to its frames, whose origins are the centres of
mass. The knee of OpenSim's model slides and rolls: from 0 to 70 degrees, a point of its femur stays within 0.7 mm of
a point of its tibia. Here, the knee is a pin at this point. Fibres and tendons are scaled with the length of the whole
muscle in upright posture. Insertions of the quadriceps move with the knee; their splines become polynomials of fifth
degree that fit them between -10 and 110 degrees within 0.4 mm.
"""

from __future__ import annotations

import math
import sys

import numpy as np
import opensim as osim
import yaml

from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.models.leg import LegOptions, build
from mbdkit_biomech.muscles.muscle_path import MusclePath

HEIGHT = 1.8
THIGH, SHANK, FOOT = 0.245 * HEIGHT, 0.246 * HEIGHT, 0.152 * HEIGHT
TRUNK_CENTRE = 0.3155
"""Height of the centre of mass of the trunk above the hip."""
CENTRES = {"thigh": -0.433 * THIGH, "shank": -0.433 * SHANK}
TALUS = np.array([0.0, -0.43])
"""Ankle in the frame of the tibia in OpenSim's model [m]."""
ANKLE = np.array([-0.04877, -0.04195, 0.00792])
"""Origin of calcn from the ankle in OpenSim's model."""
BENT = np.radians(np.linspace(-10, 110, 25))
NAMES = {
    "hamstrings": "hamstrings",
    "bifemsh": "biceps femoris short head",
    "glut_max": "gluteus maximus",
    "iliopsoas": "iliopsoas",
    "rect_fem": "rectus femoris",
    "vasti": "vasti",
    "gastroc": "gastrocnemius",
    "soleus": "soleus",
    "tib_ant": "tibialis anterior",
}


class Leg:
    """The right leg of OpenSim's model and the frames of `leg`."""

    def __init__(self, file: str, foot_centre: tuple[float, float]):
        osim.Logger.setLevelString("Off")
        self.model = osim.Model(file)
        self.state = self.model.initSystem()
        self.knee = self.model.getCoordinateSet().get("knee_angle_r")
        self.pin, self.pin_of_tibia = self.pins()
        self.bend(0.0)
        self.foot_centre = foot_centre

    def bend(self, flexion: float) -> None:
        """Bend the knee."""
        self.knee.setValue(self.state, -flexion)
        self.model.realizePosition(self.state)

    def tibia(self, flexion: float) -> np.ndarray:
        """Return the origin of the tibia in the frame of the femur."""
        self.bend(flexion)
        bodies = self.model.getBodySet()
        place = bodies.get("tibia_r").findStationLocationInAnotherFrame(self.state, osim.Vec3(0), bodies.get("femur_r"))
        return np.array([place.get(0), place.get(1)])

    def pins(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (2,) of femur and tibia that stay closest to each other while the knee bends."""
        rows, places = [], []
        for flexion in np.radians(np.linspace(0, 70, 15)):
            c, s = np.cos(flexion), np.sin(flexion)
            rows.append(np.hstack([np.eye(2), -np.array([[c, s], [-s, c]])]))
            places.append(self.tibia(flexion))
        found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(places))[0]
        left = np.reshape(np.concatenate(rows) @ found, (-1, 2)) - places
        print(f"# distance of both points: {1e3 * np.max(np.hypot(*left.T)):.2g} mm", file=sys.stderr)
        return found[:2], found[2:]

    def moved(self, body: str, point: np.ndarray) -> tuple[str, list[float]]:
        """Return body and point of `leg`."""
        x, y, z = point
        if body == "pelvis":
            return "trunk", [x + 0.0707, y + 0.0661 - TRUNK_CENTRE, z - 0.0835]
        if body == "femur_r":
            return "thigh", [x - self.pin[0] * y / self.pin[1], y * THIGH / -self.pin[1] - CENTRES["thigh"], z]
        if body == "tibia_r":
            x, y = np.array([x, y]) - self.pin_of_tibia
            along = self.pin_of_tibia - TALUS
            return "shank", [x - along[0] * y / along[1], y * SHANK / along[1] - CENTRES["shank"], z]
        x, y, z = point + ANKLE
        return "foot", [x - self.foot_centre[0], y - self.foot_centre[1], z]

    def muscle(self, short: str) -> dict[str, object]:
        """Return a muscle; its fibres and tendon have the lengths of OpenSim's model."""
        self.bend(0.0)
        own = self.model.getMuscles().get(f"{short}_r")
        points, path = own.getGeometryPath().getPathPointSet(), []
        for index in range(points.getSize()):
            point = points.get(index)
            body = point.getParentFrame().getName()
            on, at = self.moved(body, self.location(point))
            item: dict[str, object] = {"body": on, "point": [round(float(x), 4) for x in at]}
            if point.getConcreteClassName() == "ConditionalPathPoint":
                bound = osim.ConditionalPathPoint.safeDownCast(point)
                low, high = bound.get_range(0), bound.get_range(1)
                name = "hip_flexion" if "hip" in bound.getCoordinate().getName() else "knee_flexion"
                if name == "knee_flexion":
                    low, high = -high, -low
                item["when"] = {name: [round(low, 4), round(high, 4)]}
            elif point.getConcreteClassName() == "MovingPathPoint":
                item["point"] = [*self.polynomials(point, body), round(float(at[2]), 4)]
            path.append(item)
        self.bend(0.0)
        return {
            "path": path,
            "max_force": own.getMaxIsometricForce(),
            "optimal_length": own.getOptimalFiberLength(),
            "tendon_length": own.getTendonSlackLength(),
            "pennation": round(own.getPennationAngleAtOptimalFiberLength(), 4),
            "curves": "millard",
            "upright": own.getLength(self.state),
        }

    def location(self, point: osim.AbstractPathPoint) -> np.ndarray:
        """Return a point in the frame of its body."""
        place = point.getLocation(self.state)
        return np.array([place.get(k) for k in range(3)])

    def polynomials(self, point: osim.AbstractPathPoint, body: str) -> list[str]:
        """Return the functions of knee flexion along which a point moves."""
        places = []
        for angle in BENT:
            self.bend(float(angle))
            places.append(self.moved(body, self.location(point))[1])
        found = []
        for axis in range(2):
            numbers = np.polynomial.polynomial.polyfit(BENT, np.array(places)[:, axis], 5)
            left = np.polynomial.polynomial.polyval(BENT, numbers) - np.array(places)[:, axis]
            print(f"# fit of a moving point: {1e3 * np.max(np.abs(left)):.2g} mm", file=sys.stderr)
            terms = [f"{numbers[0]:.5f}"]
            for power, number in enumerate(numbers[1:], start=1):
                bend = "knee_flexion" if power == 1 else f"knee_flexion**{power}"
                terms.append(f"{'+' if number >= 0 else '-'} {abs(number):.5f}*{bend}")
            found.append(" ".join(terms))
        return found


def main() -> None:
    """Print the muscles."""
    upright = build(LegOptions(root="trunk", height=HEIGHT))
    ankle = upright.markers["ankle"].held
    leg = Leg(sys.argv[1], (-ankle[0], -ankle[1]))
    muscles = {}
    for short, name in NAMES.items():
        data = leg.muscle(short)
        whole = data.pop("upright")
        upright.muscle(name, data["path"], **{k: v for k, v in data.items() if k != "path"})
        q = np.array([x for body in upright.bodies.values() for x in (*body.position, body.angle)])[None]
        own = float(MusclePath(name, upright.muscles[name], QuantityNames(upright)).at(np.zeros(1), q).length[0])
        for key in ("optimal_length", "tendon_length"):
            data[key] = round(float(data[key]) * own / whole, 4)
        muscles[name] = data
        print(f"# {name}: {own:.4f} m upright, {whole:.4f} m in OpenSim's model", file=sys.stderr)
    print(yaml.safe_dump({"muscles": muscles}, sort_keys=False, width=math.inf, default_flow_style=None))


if __name__ == "__main__":
    main()
