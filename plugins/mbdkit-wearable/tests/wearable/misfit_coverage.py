"""How often bars of the force that a device adds contain the true force: ``python -m tests.wearable.misfit_coverage``.

Synthetic persons of drawn mass, height and motion squat with an orthosis whose misfit and tissue are drawn from the
deviations that mbdkit assumes. The inverse dynamics of each person assumes a device that fits and the usual tissue; its
bar at a drawn time is compared with the force that the true device adds to the knee.
"""

from __future__ import annotations

import sys

import numpy as np
from tests.wearable.walking_with_brace import squat_spec

import mbdkit
from mbdkit_wearable.worn.worn_device import DEVIATIONS


def person(random: np.random.Generator) -> dict[str, object]:
    """Return the spec of a synthetic person."""
    spec = squat_spec(worn=False)
    model, data = spec["model"], spec["motion"]["data"]  # type: ignore[index]
    height, depth = random.uniform(1.7, 1.9), random.uniform(0.6, 1.1)
    model |= {"body_mass": random.uniform(55.0, 95.0), "height": height}
    model["devices"]["brace"]["mechanism"]["height"] = height
    for name in ("trunk_tilt", "hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
        data[name] = [depth * value for value in data[name]]
    return spec


def true_added(spec: dict[str, object], misfit: np.ndarray) -> np.ndarray:
    """Return the force (T, 2) that a device with a misfit (x, y, angle) and a logarithm of the stiffness adds [N]."""
    brace = dict(spec["model"]["devices"]["brace"])  # type: ignore[index]
    stiffness = np.exp(misfit[3])
    attach = {}
    for link, one in brace["attach"].items():
        values = {name: stiffness * value for name, value in one["cuff"]["stiffness"].items()}
        attach[link] = {**one, "cuff": {**one["cuff"], "stiffness": values}}
    model = {**spec["model"], "devices": {"brace": {**brace, "offset": misfit[:3].tolist(), "attach": attach}}}  # type: ignore[dict-item]
    return mbdkit.inverse(spec | {"model": model}).added_force("knee").added


def coverage(persons: int, misfits: int, seed: int = 0) -> float:
    """Return the share of bars that contain the true force, for a number of misfits of each of several persons."""
    random, hits = np.random.default_rng(seed), 0
    sizes = np.array(list(DEVIATIONS.values()))
    for _ in range(persons):
        spec = person(random)
        motion = {**spec["motion"], "errors": {"samples": 20}}  # type: ignore[dict-item]
        own = mbdkit.inverse(spec | {"motion": motion, "uncertainty": {"samples": 400}}).added_force("knee")
        for _ in range(misfits):
            row = int(random.integers(len(own.time)))
            error = true_added(spec, sizes * random.standard_normal(len(sizes)))[row] - own.added[row]
            hits += bool(np.hypot(*error) <= own.added_error[row])
    return hits / (persons * misfits)


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"{coverage(number, 50):.1%} of {50 * number} bars of 95 % contain the true force")
