"""Coverage of the error bars of inverse dynamics near the ends of a record and in gaps.

``python -m tests.benchmarks.ends_and_gaps [--motions N]`` compares a pendulum with random motions, whose torques are
known in closed form, with inverse dynamics from noisy angles: for each smoothing, the share of frames within 0.1 s of
an end whose bars cover the truth, and the share of largest torques that the errors of a measure cover, also for motions
that start suddenly from rest; then, for gaps of several lengths, the share of frames whose errors are unknown, and the
coverage of the others. Random chains with three markers on each link follow, of which one is missing for 0.3 s.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any

import numpy as np
from tests.inverse_dynamics.chain_with_gaps import DEVIATION, FILTER, TIME, chain_with_gap, measured, start, swing

import mbdkit

SMOOTHINGS: tuple[dict[str, Any], ...] = (
    FILTER,
    {"name": "opensim", "cutoff": 6.0},
    {"name": "spline"},
    {"name": "quintic"},
)
COLUMNS = {"hip.angle": {"column": "hip", "deviation": DEVIATION}}
"""Without smoothing, the noise has to be stated."""
STARTS = ((1.0, 1.0), (2.0, 1.0), (2.0, 0.8))
"""Rates of decay [1/s] and frequencies [Hz] of the oscillations of motions that start suddenly from rest."""
START_COLUMNS = {"hip.angle": {"column": "hip", "deviation": 1e-3}}
GAPS = (3, 7, 16, 50)
"""Lengths of gaps [rows], with 100 rows per second; half a period of the cutoff has 8.3 rows."""


def main() -> None:
    """Print the shares."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.ends_and_gaps")
    parser.add_argument("--motions", type=int, default=60)
    motions = range(1000, 1000 + parser.parse_args().motions)
    for smooth in SMOOTHINGS:
        found = []
        for seed in motions:
            angle, torque, random = swing(seed)
            stated = {"columns": COLUMNS} if smooth["name"] == "quintic" else {}
            run = measured(angle, random, smooth=smooth, **stated)
            found.append(covered(run, torque, np.r_[0:10, len(TIME) - 10 : len(TIME)]))
        near, peaks, doubts = np.mean(found, axis=0)
        print(
            f"{smooth['name']}: near the ends {near:.1%}, largest torques {peaks:.1%}, doubted {doubts:.1%}", flush=True
        )
        if smooth["name"] != "quintic":
            print_starts(smooth, len(motions) // len(STARTS))
    for rows in GAPS:
        known, inside = [], []
        for seed in motions:
            angle, torque, random = swing(seed)
            begin = int(random.integers(40, len(TIME) - 40 - rows))
            gap = slice(begin, begin + rows)
            one = measured(angle, random, gap).actuators["hip"]
            error = one.value_error[gap]
            known.append(np.isfinite(error))
            inside.append((np.abs(one.value - torque)[gap] <= error)[known[-1]])
        share, bars = np.mean(np.concatenate(known)), np.concatenate(inside)
        told = f"{np.mean(bars):.1%} of the others covered" if bars.size else ""
        print(f"gap of {rows / 100 + 0.01:g} s: {1 - share:.1%} unknown, {told}", flush=True)
    print_gaps_of_markers(motions)


def covered(run: mbdkit.Run, torque: np.ndarray, rows: Any) -> tuple[float, bool, bool]:
    """Return the share of some rows whose error bars cover the torque, whether that of the peak does, and whether the
    criterion `ends` is not met.
    """
    one = run.actuators["hip"]
    near = np.mean((np.abs(one.value - torque) <= one.value_error)[rows])
    peak = abs(run.measures["peak"] - np.max(np.abs(torque))) <= run.measure_errors["peak"]
    return float(near), bool(peak), any(told.startswith("ends") for told in run.verdict_reasons)


def print_starts(smooth: dict[str, Any], seeds: int) -> None:
    """Print the coverage of motions that start suddenly from rest, within 0.1 s of the start and of their peaks."""
    found = []
    for decay, frequency in STARTS:
        angle, torque = start(decay, frequency)
        for seed in range(seeds):
            run = measured(angle, np.random.default_rng(seed), deviation=1e-3, smooth=smooth, columns=START_COLUMNS)
            found.append(covered(run, torque, slice(10)))
    near, peaks, doubts = np.mean(found, axis=0)
    print(
        f"{smooth['name']}, starts from rest: near the start {near:.1%}, largest torques {peaks:.1%}, doubted "
        f"{doubts:.1%}",
        flush=True,
    )


def print_gaps_of_markers(seeds: Iterable[int]) -> None:
    """Print the errors of torques in a gap of a marker, compared with those of complete data, and their coverage."""
    ratios, inside, unknown = [], [], []
    for seed in seeds:
        rows = slice(70, 106)
        drawn, complete, run = chain_with_gap(seed, rows)
        for name, torque in drawn.torques.items():
            off, whole = (np.abs(one.actuators[name].value - torque)[rows] for one in (run, complete))
            error = run.actuators[name].value_error[rows]
            ratios.append(np.sqrt(np.mean(off**2) / np.mean(whole**2)))
            unknown.append(np.isnan(error))
            inside.append((off <= error)[~unknown[-1]])
    print(
        f"marker missing for 0.3 s: {np.mean(unknown):.1%} unknown, {np.mean(np.concatenate(inside)):.1%} of the "
        f"others covered, errors {np.median(ratios):.2g} times those of complete data (median)"
    )


if __name__ == "__main__":
    main()
