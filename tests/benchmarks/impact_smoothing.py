"""Errors of joint loads at the impact of a running step by smoothing: a table, and a picture.

``python -m tests.benchmarks.impact_smoothing PICTURE.png``
"""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from tests.inverse_dynamics.running import differences, reference, running_spec, table

import mbdkit
from mbdkit.base.text import table as text_table

CHOICES = {
    "none": "none",
    "quintic": "quintic",
    "butterworth 100 Hz": {"name": "butterworth", "cutoff": 100.0},
    "butterworth 20 Hz": {"name": "butterworth", "cutoff": 20.0},
    "opensim 20 Hz": {"name": "opensim", "cutoff": 20.0},
    "spline": "spline",
}
ROWS = slice(51, 2800)


def main(picture: str) -> None:
    """Print the table and draw the force in the knee around heel strike."""
    path = reference("isb_running.csv")
    truth = table(path)
    lines = [("SMOOTHING", "FORCE, MAX [N]", "MOMENT, MAX [N m]", "FORCE, MEDIAN [N]", "MOMENT, MEDIAN [N m]")]
    _, axes = plt.subplots(figsize=(7, 4))
    axes.plot(truth["time"], truth["force_knee"], color="black", linewidth=2.5, alpha=0.4, label="published")
    for name, smooth in CHOICES.items():
        run = mbdkit.inverse(running_spec(path, smooth))
        force, moment = differences(run, truth, ROWS)["knee"]
        numbers = np.max(force), np.max(moment), np.median(force), np.median(moment)
        lines.append((name, *(f"{number:.3g}" for number in numbers)))
        axes.plot(run.time, np.linalg.norm(run.joints["knee"].reaction_force, axis=1), linewidth=0.9, label=name)
    print(text_table(lines))
    axes.set(xlim=(0.29, 0.36), xlabel="time [s]", ylabel="force in the knee [N]")
    axes.legend()
    plt.savefig(picture, dpi=150)


if __name__ == "__main__":
    main(sys.argv[1])
