"""`python -m tests.identify.acrobot_records FOLDER OUTPUT`: swings of the robot AcroMonk between two contacts.

FOLDER is a clone of https://github.com/dfki-ric-underactuated-lab/acromonk. For each of its records in
`results/real_system/csvs`, a table with the first swing is written to the folder OUTPUT: from `AFTER` after the free
hook has left the bars, until it comes near to one again, as the measured angles show.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

ARM, BARS = 0.31401, 0.34
"""Length of the arms, and distance of the bars [m], by the robot's published model."""
NEAR = 0.06
"""Distance from a bar up to which the free hook may touch it [m]."""
AFTER, BEFORE, LEAST = 0.08, 0.04, 1.0
"""Times that are left out after the release and before the next contact, and least duration of a swing [s]."""
SAMPLING = 0.02
COMMIT = "ea0b53d2ac50cf6ac2939ffa207c0790be5f3baa"


def swing_of(record: Path) -> np.ndarray:
    """Return times from the beginning of the first swing [s], angles of the inertial sensor and of the elbow [rad], and
    torque of the motor [N m], (T, 4).
    """
    table = np.genfromtxt(record, delimiter=",", names=True)
    names = ("meas_time", "shoulder_meas_pos", "elbow_meas_pos", "elbow_meas_tau")
    time, shoulder, elbow, torque = (table[name] for name in names)
    reach = shoulder + elbow
    across, up = ARM * (np.sin(shoulder) + np.sin(reach)), -ARM * (np.cos(shoulder) + np.cos(reach))
    is_free = np.hypot(across - BARS * np.round(across / BARS), up) > NEAR
    ends = np.flatnonzero(np.diff(np.concatenate([[0], is_free, [0]])))
    swings = ((time[a], time[b - 1]) for a, b in zip(ends[::2], ends[1::2], strict=True))
    begin, end = next((a, b) for a, b in swings if b - a > LEAST)
    begin, end = np.ceil((begin + AFTER) / SAMPLING) * SAMPLING, end - BEFORE
    some = (time > begin - 0.2) & (time < end + 0.2)
    time, reach, elbow, torque = time[some], np.unwrap(reach[some]), elbow[some], np.nan_to_num(torque[some])
    at = np.arange(begin, end, SAMPLING)
    impulse = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (torque[1:] + torque[:-1]))])
    later, earlier = (np.interp(at + side * SAMPLING / 2, time, impulse) for side in (1, -1))
    columns = at - begin, np.interp(at, time, reach), np.interp(at, time, elbow), (later - earlier) / SAMPLING
    return np.column_stack(columns)


def main(folder: str, output: str) -> None:
    """Write the tables."""
    for record in sorted(Path(folder, "results/real_system/csvs").glob("*.csv")):
        name = record.stem.strip("_").lower().replace("_", "-").removesuffix("-1x")
        lines = [
            "# A swing of the robot AcroMonk. Angles [rad] are interpolated, torques [N m] averaged to 50 Hz.",
            f"# Source: https://github.com/dfki-ric-underactuated-lab/acromonk at {COMMIT},",
            f"# results/real_system/csvs/{record.name}: columns shoulder_meas_pos + elbow_meas_pos (imu),",
            "# elbow_meas_pos and elbow_meas_tau; copyright (c) 2022, underactuated-robotics, BSD 3-Clause License.",
            "time,imu,elbow,torque",
        ]
        rows = [f"{t:.2f}," + ",".join(f"{x:.5g}" for x in own) for t, *own in swing_of(record).tolist()]
        Path(output, f"brachiating-acrobot-{name}.csv").write_text("\n".join([*lines, *rows]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
