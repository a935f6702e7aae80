"""Predicted walking beside measured walking; run as a script, prints the tables of the page `walking`.

    PYTHONPATH=plugins/mbdkit-predict/tests python -m predict.measured_walking FOLDER [-o FOLDER_OF_ARCHIVES]

The folder is a copy of https://github.com/MaartenAfschrift/predsim_benchmark_data: means of R. Browning et al. (2007)
and A. D. Koelewijn et al. (2019), without dimensions: frequencies times sqrt(l/g), forces over the weight, moments over
the weight and the length l of the leg, half of the height. The person of `predicted-walking` walks with the same speed
over sqrt(g l). Times are counted from the heel strike. Two first guesses lead to two local optima at 1.25 m/s, from
which both are followed to the other speeds: what is predicted is the walk with less effort, and its bar the difference
from the other one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mbdkit
from mbdkit.plugin.specs import read_source

GRAVITY, LEG = 9.81, 0.9  #: Half of the height of the person [m].
#: Duration [s] and intervals of the first guess that leads to the other walk.
OTHER: dict[str, Any] = {"duration": 0.55, "collocation": {"points": 3, "intervals": 14}}
SPEED = 1.25  #: Of the walks that are followed [m/s].
INTERVALS = 10  #: Of first meshes that begin with a walk.
TOUCHES = 0.02  #: Share of the weight on a foot from which it touches the ground.
TRIALS = (
    "browning2008/browning2008_default", "koelewijn2019/Koelewijn2019_13ms", "koelewijn2019/Koelewijn2019_08ms",
)  # fmt: skip
JOINTS = {"hip": ("thigh", "trunk", 1), "knee": ("shank", "thigh", -1), "ankle": ("foot", "shank", 1)}
COORDINATES = {"hip": "hip_flexion", "knee": "knee_flexion", "ankle": "ankle_dorsiflexion"}
COLUMNS = {"hip": "hip_flexion", "knee": "knee_angle", "ankle": "ankle_angle"}


class Feature(NamedTuple):
    """An extremum of a curve in a part of the stride."""

    name: str
    curve: str
    sign: int  #: 1 for a maximum.
    begin: float  #: Shares of the stride.
    end: float


FEATURES = (
    Feature("vertical force, first peak", "up", 1, 0.0, 0.3),
    Feature("vertical force between the peaks", "up", -1, 0.15, 0.45),
    Feature("vertical force, second peak", "up", 1, 0.35, 0.6),
    Feature("largest braking force", "forward", -1, 0.0, 0.3),
    Feature("largest propulsive force", "forward", 1, 0.3, 0.7),
    Feature("moment of hip extension in stance", "hip", -1, 0.02, 0.4),
    Feature("moment of hip flexion", "hip", 1, 0.4, 0.8),
    Feature("moment of knee extension in stance", "knee", 1, 0.05, 0.3),
    Feature("moment of knee flexion in stance", "knee", -1, 0.3, 0.55),
    Feature("moment of ankle plantarflexion", "ankle", -1, 0.2, 0.7),
)


def predicted(run: mbdkit.Run) -> tuple[float, np.ndarray, dict[str, np.ndarray]]:
    """Return the dimensionless stride frequency, the shares of a stride from a heel strike, and curves of one leg."""
    time, half = run.time, float(run.time[-1])
    weight = GRAVITY * sum(body.mass for body in run.mechanism.bodies.values())
    legs = list[dict[str, np.ndarray]]()
    for side in ("", "_left"):
        contacts = [run.contacts[name + side] for name in ("heel", "ball")]
        curves = {"up": sum(x.normal_force for x in contacts), "forward": sum(x.friction_force for x in contacts)}
        for joint, (_, _, sign) in JOINTS.items():
            moment = np.ravel(run.forces[f"{joint}_tissue{side}"].value).copy()
            for name in [name for name in run.muscles if name.endswith("_left") == bool(side)]:
                moment += sign * run.moment_arms(name, COORDINATES[joint] + side) * run.muscles[name].force
            curves[joint] = moment / LEG
        legs.append({name: np.ravel(x) / weight for name, x in curves.items()})
    whole = {name: np.concatenate([legs[0][name], legs[1][name][1:]]) for name in legs[0]}
    times = np.concatenate([time, time[1:] + half])
    touches = whole["up"] >= TOUCHES
    (strikes,) = np.nonzero(touches & ~np.roll(touches, 1))
    share = ((times - times[strikes[0]]) / (2.0 * half)) % 1.0
    order = np.argsort(share, kind="stable")
    return np.sqrt(LEG / GRAVITY) / (2.0 * half), share[order], {name: x[order] for name, x in whole.items()}


def measured(folder: Path, trial: str) -> dict[str, Any]:
    """Return a trial: its numbers, and `curves` and `deviations` by name; without curves where none were measured."""
    data = json.loads((folder / f"{trial}.json").read_text())
    curves: dict[str, np.ndarray] = {}
    deviations: dict[str, np.ndarray] = {}
    if data["grf_r"]:
        for target, ending in ((curves, ""), (deviations, "_std")):
            force, moments = np.array(data[f"grf_r{ending}"]), np.array(data[f"id{ending}"])
            target |= {"forward": force[:, 0], "up": force[:, 1]}
            target |= {joint: moments[:, data["id_header"].index(name)] for joint, name in COLUMNS.items()}
    return data | {"curves": curves, "deviations": deviations}


def extremum(share: np.ndarray, curve: np.ndarray, feature: Feature) -> int:
    """Return the index of a feature."""
    (inside,) = np.nonzero((share >= feature.begin) & (share <= feature.end))
    return int(inside[np.argmax(feature.sign * curve[inside])])


def prediction(speed: float, archive: Path, guess: object = None, intervals: int = 0) -> mbdkit.Run:
    """Return the prediction of an archive, which is computed if it does not exist."""
    if not archive.exists():
        sections: dict[str, Any] = {"guess": guess} if guess else {}
        if intervals:
            sections["collocation"] = {"points": 5, "intervals": intervals}
        values = {"parameters.speed": float(speed)}
        mbdkit.predict("predicted-walking", archive=archive, overrides=values, **sections)
    return mbdkit.load(archive)


def rows(run: mbdkit.Run) -> list[float]:
    """Return the stride frequency and all features of a prediction."""
    frequency, share, curves = predicted(run)
    return [frequency, *(curves[f.curve][extremum(share, curves[f.curve], f)] for f in FEATURES)]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Compare predicted with measured walking.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path(), help="folder of archives, which are kept")
    chosen = parser.parse_args()
    folder: Path = chosen.output.resolve()
    walks = (None, read_source("predicted-walking").data["guess"] | OTHER)
    firsts = [folder / f"walk-{k}.h5" for k in range(len(walks))]
    for first, guess in zip(firsts, walks, strict=True):
        prediction(SPEED, first, guess)
    for trial in TRIALS:
        data, name = measured(chosen.folder, trial), Path(trial).name
        speed = data["speed"] * np.sqrt(LEG / data["leglength"])
        found = [prediction(speed, folder / f"{name}-{first.name}", str(first), INTERVALS) for first in firsts]
        run, other = sorted(found, key=lambda x: x.objective)
        print(f"{trial}, {speed:.3f} m/s: {run.verdict}, effort {run.objective:.5g} +- {run.objective_error:.1g}")
        print(f"  the other walk: {other.verdict}, effort {other.objective:.5g} +- {other.objective_error:.1g}")
        values = rows(run)
        bars = np.abs(np.subtract(values, rows(other)))
        print(f"  {'stride frequency':<36} {values[0]:8.4f} +- {bars[0]:.4f} {data['stride_frequency']:8.4f}")
        for feature, value, bar in zip(FEATURES, values[1:], bars[1:], strict=True):
            text = f"  {feature.name:<36} {value:8.4f} +- {bar:.4f}"
            if data["curves"]:
                curve = data["curves"][feature.curve]
                k = extremum(np.linspace(0.0, 1.0, len(curve)), curve, feature)
                deviation = data["deviations"][feature.curve][k]
                text += f" {curve[k]:8.4f} +- {deviation:.4f} {(value - curve[k]) / deviation:6.1f}"
            print(text, flush=True)


if __name__ == "__main__":
    main()
