"""Checks of the packaged examples of kinds of elements and joints: energy, derivatives, checkpoints, archives."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.runs.resuming import resume
from mbdkit.runs.simulation import simulate
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed
from mbdkit_testing.example_under_test import ADAPTIVE, ExampleUnderTest, completed

#: Relative steps of differences, largest relative error of derivatives and of equal values, and smallest divisor.
STEPS, DERIVATIVE, SAME, TINY = (1e-4, 1e-5, 1e-6, 1e-7), 1e-5, 1e-9, 1e-300


@check("energy.balance")
def balance(kind: ExampleUnderTest[Any]) -> Result:
    """The energy balance of the example's run converges to zero with the step, or with the tolerances."""
    found = []
    for factor in (1.0, 0.25):
        fixed = {"time": kind.times(factor), "output": {}}
        adaptive = {"integrator": {**ADAPTIVE, "rtol": 1e-6 * factor**4}}
        with completed(kind.changed(None, **(adaptive if kind.spec.claims.adaptive else fixed))) as run:
            energy = max(float(np.max(np.abs(run.energy.kinetic))), float(np.ptp(run.energy.potential)), TINY)
            found.append(float(np.max(np.abs(run.energy.balance))) / energy)
    if not found[-1] <= max(SAME, found[0] / 4.0):
        return failed("the energy balance of its example does not converge", coarsest=found[0], finest=found[-1])
    return passed(coarsest=found[0], finest=found[-1])


@check("derivatives.tangents")
def tangents(kind: ExampleUnderTest[Any]) -> Result:
    """The derivatives of accelerations and rates of states agree with differences, at states of the example's run."""
    equations, (times, q, v, z) = EquationsOfMotion(kind.workspace), kind.rows
    n = equations.n
    largest = int(np.argmax(np.abs(kind.run.array("trajectory/acceleration")).max(axis=(1, 2))))
    for row in {largest, *np.linspace(1, len(times) - 2, 8).astype(int).tolist()}:
        t, y = float(times[row]), np.concatenate([q[row, :n], v[row, :n], z[row]])

        def rates(y: np.ndarray, t: float = t) -> np.ndarray:
            a, _, change = equations.derivatives(t, y[:n], y[n : 2 * n], y[2 * n :])
            return np.concatenate([y[n : 2 * n], a, change])

        exact = equations.jacobian(t, y[:n], y[n : 2 * n], y[2 * n :])
        scale = np.maximum(np.max(np.abs(exact), axis=1), 1e-3)
        for column, direction in enumerate(np.eye(len(y))):
            steps = [h * max(abs(y[column]), 0.1) * direction for h in STEPS]
            tried = [(rates(y + h) - rates(y - h)) / (2.0 * h[column]) for h in steps]
            off = float(np.min([np.abs(one - exact[:, column]) / scale for one in tried], axis=0).max())
            if not off <= DERIVATIVE:
                of = "a state" if column >= 2 * n else "a velocity" if column >= n else "a position"
                return failed(f"a derivative with respect to {of} differs from differences at t = {t:g} s", off=off)
    return passed()


@check("restart.checkpoint")
def checkpoint(kind: ExampleUnderTest[Any]) -> Result:
    """A run that is interrupted and continued from its checkpoint is bitwise the same, and so is its verdict."""
    # Fixed steps without events return to Python after a known number of steps, so that the run can be interrupted.
    fixed: dict[str, dict[str, str] | dict[str, float]] = (
        {"integrator": {"name": "rk4"}, "time": kind.times(0.05)} if kind.spec.claims.adaptive else {}
    )
    spec = kind.changed(events={}, **fixed)

    def stop(reached: float, end: float) -> None:
        if reached > spec.time.start:
            raise KeyboardInterrupt

    with tempfile.TemporaryDirectory(prefix="mbdkit-example-") as folder, simulate(spec) as whole:
        path = Path(folder) / "run.h5"
        simulate(spec, path=path, progress=stop).close()
        with resume(path, overwrite=True) as run:
            if run.data_sha256 != whole.data_sha256 or run.verdict_reasons != whole.verdict_reasons:
                return failed("the data or the verdict of a run that is continued from its checkpoint are different")
    return passed()


@check("archive.without-plugin", slow=True)
def without_plugin(kind: ExampleUnderTest[Any]) -> Result:
    """Where the plugin is not installed, archives are sound, and a repetition is refused with its name."""
    origin = kind.item.origin
    if (entry_point := origin.entry_point.partition(" = ")[0]) == "builtin":
        raise Skip("it is part of the core")
    alone = os.environ | {"MBDKIT_DISABLE_PLUGINS": f"{origin.distribution}/{entry_point}"}
    with tempfile.TemporaryDirectory(prefix="mbdkit-example-") as folder:
        path = Path(folder) / "run.h5"
        simulate(kind.spec, path=path).close()
        commands = [[sys.executable, "-m", "mbdkit", *words, str(path)] for words in (("archive", "check"), ("rerun",))]
        check, again = (subprocess.run(one, env=alone, capture_output=True, text=True, check=False) for one in commands)
    if check.returncode or again.returncode != 2 or origin.distribution not in again.stderr:
        return failed(f"without the plugin, mbdkit says: {check.stderr.strip()} {again.stderr.strip()}")
    return passed()
