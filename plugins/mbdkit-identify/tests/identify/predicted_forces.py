"""How often bars contain the joint forces of an identified rig: ``python -m tests.identify.predicted_forces``.

Each repeat draws a pendulum on a pin, with friction and damping, and a record of its swing with noise. The identified
parameters predict the force in the pin with another start, and with a torque that was not seen. With `bound`, there is
no friction, so that its estimate is at or near its bound; with `curved`, the rate at which friction builds up is
estimated from a short record.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mbdkit
from mbdkit_identify.archive import write_identification

CASES = ("plain", "bound", "curved")
NOISE = 0.01  #: rad


def rig(parameters: dict[str, Any], end: float) -> dict[str, Any]:
    """Return the spec of a run of the rig."""
    bodies = {
        "arm": {
            "mass": "mass", "inertia": "inertia", "angle": "start", "position": ["0.25*sin(start)", "-0.25*cos(start)"],
        }
    }  # fmt: skip
    forces = {
        "dry": {"type": "torque", "body": "arm", "value": "-friction*tanh(arm.angular_velocity/rate)"},
        "oil": {"type": "torsion-spring", "bodies": ["ground", "arm"], "damping": "damping"},
        "motor": {"type": "torque", "body": "arm", "value": "inputs.motor"},
    }
    pin = {"type": "revolute", "bodies": ["ground", "arm"], "points": [[0, 0], [0, 0.25]]}
    return {
        "mbdkit": 1, "parameters": parameters, "integrator": {"name": "rk4"}, "time": {"end": end, "step": 0.02},
        "model": {
            "name": "mechanism", "inputs": {"motor": {"unit": "N*m", "hold": "linear"}}, "bodies": bodies,
            "joints": {"pin": pin}, "forces": forces,
        },
    }  # fmt: skip


@dataclass(frozen=True)
class Prediction:
    """The identification of a drawn rig, the spec of a run with its parameters, this run, and the run of the rig."""

    fit: Any
    spec: dict[str, Any]
    run: mbdkit.Run
    truth: mbdkit.Run

    @property
    def bar(self) -> np.ndarray:
        """(T,) bar of the force in the pin [N]."""
        return self.run.accuracy.reaction_error_parameters[:, 0]


def prediction(case: str, number: int, folder: Path) -> Prediction:
    """Draw a rig, identify it, and predict its motion from another start."""
    dice = np.random.default_rng([CASES.index(case), number])
    true = {
        "mass": dice.uniform(0.8, 1.5), "inertia": dice.uniform(0.02, 0.05), "damping": dice.uniform(0.01, 0.03),
        "friction": 0.0 if case == "bound" else dice.uniform(0.05, 0.1), "rate": 0.3, "start": dice.uniform(0.8, 1.5),
    }  # fmt: skip
    end = 1.5 if case == "curved" else 2.0
    run = mbdkit.run(rig(true, end))
    shown = run["arm"].angle + dice.normal(0.0, NOISE, len(run.time))
    np.savetxt(folder / "a.csv", np.column_stack([run.time, shown]), delimiter=",", header="time,angle", comments="")
    free = {"inertia": {"bounds": [0.005, 0.2]}, "friction": {"bounds": [0, 0.5]}, "damping": {"bounds": [0, 0.5]}}
    free |= {"rate": {"bounds": [0.05, 1.5]}} if case == "curved" else {}
    first = true | {"inertia": 0.03, "friction": 0.05, "damping": 0.02}
    record = {"file": str(folder / "a.csv"), "observed": {"arm.angle": {"column": "angle", "correlation": "none"}}}
    fit = mbdkit.identify(
        {
            "mbdkit_identify": 1, "base": rig(first, end), "experiments": {"a": record}, "parameters": free,
            "intervals": {"method": "linear"},
        }
    )  # fmt: skip
    write_identification(fit, folder / "fit.h5", overwrite=True)
    later = {name: value for name, value in true.items() if name not in free} | {"start": dice.uniform(-1.5, 1.5)}
    unseen = {"motor": {"table": [[0.0, 0.5, 1.0], dice.uniform(-0.5, 0.5, 3).tolist()]}}
    mean = rig({"from": str(folder / "fit.h5"), **later}, 1.0) | {"inputs": unseen, "check": True}
    truth = mbdkit.run(rig(true | later, 1.0) | {"inputs": unseen})
    return Prediction(fit, mean, mbdkit.run(mean), truth)


def coverage(case: str, number: int, folder: Path) -> float:
    """Return the share of times at which the bar of the predicted joint force contains the true force."""
    found = prediction(case, number, folder)
    error = np.linalg.norm(found.run.joints["pin"].reaction_force - found.truth.joints["pin"].reaction_force, axis=1)
    some = slice(len(found.bar) // 4, None)  # at the start, the parameters matter little
    return float(np.mean(error[some] <= found.bar[some]))


def coverages(case: str, repeats: int) -> np.ndarray:
    """Return the coverage (R,) of each repeat; nan where parameters have no covariance."""
    found = np.full(repeats, np.nan)
    for number in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            try:
                found[number] = coverage(case, number, Path(folder))
            except mbdkit.SpecError as error:
                if "no estimate with a covariance" not in error.message:
                    raise
    return found


def main() -> None:
    """Print the coverage of each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--cases", nargs="*", default=CASES)
    asked = parser.parse_args()
    for case in asked.cases:
        found = coverages(case, asked.repeats)
        known = found[np.isfinite(found)]
        print(f"{case:8} {100 * np.mean(known):.1f} % in {len(known)} of {len(found)} repeats", flush=True)


if __name__ == "__main__":
    main()
