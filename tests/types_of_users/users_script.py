"""A script as a user writes it; `mypy --strict` and pyright accept it against an installed mbdkit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

import mbdkit
from mbdkit import Mechanism, Run, SpecError
from mbdkit.plugin import Accessor, Target
from mbdkit.testing import Case, conformance


def slider_crank(radius: float) -> Mechanism:
    """Return a crank that turns at a constant rate, a rod and a slide."""
    m = Mechanism(gravity=(0.0, -9.81))
    crank = m.body("crank", mass=1.0, inertia=0.01, position=(radius / 2, 0.0))
    m.revolute("A", m.ground, crank, at=(0.0, 0.0))
    m.driver("motor", m.ground, crank, coordinate="angle", motion="6*t")
    return m


def largest_force(run: Run, joint: str) -> float:
    """Return the largest force in a joint [N]."""
    force: npt.NDArray[np.float64] = run.joints[joint].reaction_force
    return float(np.max(np.hypot(force[:, 0], force[:, 1])))


def main(folder: Path) -> None:
    """Run, read, and judge."""
    run = mbdkit.run(
        slider_crank(0.1),
        integrator={"name": "gauss", "stages": 2},
        time={"end": 1.0, "step": 0.01},
        archive=folder / "crank.h5",
    )
    print(run.status, run.misalignment_max, largest_force(run, "A"))
    again = mbdkit.load(folder / "crank.h5")
    times: list[float] = again.time.tolist()
    axes: Axes = again.plot.reactions(joints=["A"], components="body")
    mbdkit.plot.compare([run, again], "torques", axes, labels=["run", "again"])
    try:
        example: Run = mbdkit.run("knee").check()
    except SpecError as error:
        print(error.key, len(times))
    else:
        print(example.summary())
    found = mbdkit.equilibrium("knee")
    print(found.stability)
    print(mbdkit.modes("knee", count=2).frequency_hz[0])
    study: mbdkit.Study = mbdkit.study("convergence", workers=2)
    for point in study.points:
        print(point.axes, point.status)
    gradient = mbdkit.inverse_gradient("walking", "max(abs(joints.knee.force))", ["body_mass"])
    print(mbdkit.inverse("walking").kind, gradient, mbdkit.workload(again).text())


def peak(run: Run) -> float:
    """Return an attribute of runs that a plugin adds."""
    return float(np.max(run.energy.kinetic))


added = Accessor(name="peak", summary="Largest kinetic energy.", of="Run", target=Target("users_script:peak"))


@conformance(integrator="rk4", quick=True)
def test_it_conforms(case: Case) -> None:
    """Run a check of the kit."""
    case()
