"""`python -m tests.wearable.common_spring`: the best spring of an orthosis for rising from a squat and from a chair.

Twenty predictions take four minutes. The page `wearable` of the guide has the result.
"""

from __future__ import annotations

from typing import Any

from scipy.optimize import minimize_scalar

import mbdkit
from mbdkit.plugin.specs import read_source

STARTS = {  # joint angles at the start
    "assisted-squat": {"hip": 1.71, "knee": -1.9, "ankle": 0.6},
    "assisted-sit-to-stand": {"hip": 2.097, "knee": -1.8, "ankle": 0.068},
}
BODIES = {"hip": ["trunk", "thigh"], "knee": ["thigh", "shank"], "ankle": ["shank", "foot"]}
CUFF = {"axis": [1, 0], "stiffness": {"normal": 1e4, "tangential": 5e3, "rotation": 60.0},
        "damping": {"normal": 200.0, "tangential": 200.0, "rotation": 2.0}}  # fmt: skip


def brace(stiffness: float) -> dict[str, Any]:
    """Return the device."""
    links = {"height": 1.8, "upper_arm": 0.16, "lower_arm": 0.16, "upper_mass": 1.0, "lower_mass": 1.0}
    at = {"upper": ("thigh", 0.16 - 0.567 * 0.245 * 1.8), "lower": ("shank", 0.433 * 0.246 * 1.8 - 0.16)}
    attach = {link: {"limb": limb, "at": [0, y], "cuff": CUFF} for link, (limb, y) in at.items()}
    return {"mechanism": {"name": "hinge-orthosis", "stiffness": float(stiffness), **links}, "attach": attach}


def settled(model: dict[str, Any], start: dict[str, float]) -> dict[str, float]:
    """Return the start of the device: at rest on the limbs, which drivers hold."""
    held = {f"{name}_held": {"type": "driver", "bodies": pair, "coordinate": "angle", "motion": start[name]}
            for name, pair in BODIES.items()}  # fmt: skip
    model = {key: value for key, value in model.items() if key != "contacts"}
    spec = {"mbdkit": 1, "model": model | {"joints": model["joints"] | held}}
    rest = mbdkit.equilibrium(spec | {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 1.0}})
    upper, lower = (rest.position[rest.bodies.index(f"brace.{link}")].tolist() for link in ("upper", "lower"))
    values = {"x": upper[0], "y": upper[1], "angle": upper[2], "vx": 0.0, "vy": 0.0, "angular_velocity": 0.0}
    initial = {f'bodies["brace.upper"].{key}': value for key, value in values.items()}
    return initial | {'joints["brace.hinge"].angle': lower[2] - upper[2], 'bodies["brace.lower"].angular_velocity': 0.0}


def effort(motion: str, stiffness: float) -> float:
    """Return the least effort of a motion with a spring."""
    spec = read_source(motion).data
    model, start = spec["base"]["model"], STARTS[motion]
    del spec["parameters"], spec["compare"], model["forces"]["spring"]
    model["devices"] = {"brace": brace(stiffness)}
    for free in ("contacts.seat.gap", "trunk.angle"):  # follow from the angles
        spec["initial"].pop(free, None)
    spec["initial"] |= {f"{name}.angle": angle for name, angle in start.items()} | settled(model, start)
    spec["collocation"]["intervals"], spec["tolerance"] = max(8, spec["collocation"]["intervals"]), 1e-2
    prediction: Any = mbdkit.predict(spec).check()
    return float(prediction.objective)


def main() -> None:
    """Print the stiffness [N m/rad], and the effort of each motion relative to that without a spring."""
    without = {motion: effort(motion, 0.0) for motion in STARTS}

    def shares(stiffness: float) -> list[float]:
        return [effort(motion, stiffness) / without[motion] for motion in STARTS]

    best = minimize_scalar(lambda k: sum(shares(k)), bounds=(0.0, 100.0), method="bounded", options={"xatol": 0.5})
    print(best.x, shares(best.x))


if __name__ == "__main__":
    main()
