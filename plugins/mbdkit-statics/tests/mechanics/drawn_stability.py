"""Chains drawn at random whose loads can supply energy, and whether small motions grow in a run."""

from __future__ import annotations

from typing import Any

import numpy as np

import mbdkit
from mbdkit import Equilibrium

DISTURBED = 1e-7
"""Size of the angular velocities with which runs start [rad/s]."""
SPAN = 25.0
"""Duration of the first run [s]; a run that does not decide is repeated four times as long."""


def drawn(seed: int) -> mbdkit.Mechanism:
    """Return a chain of one to three rods, hanging or without gravity, with springs, dampers and loads."""
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 4))
    m = mbdkit.Mechanism(gravity=(0.0, -9.81 if random.random() < 0.4 else 0.0))
    heading = -np.pi / 2 if m.gravity[1] else 0.0
    way, end, below = np.array([np.cos(heading), np.sin(heading)]), np.zeros(2), m.ground
    for i in range(count):
        length, mass = float(random.uniform(0.6, 1.4)), float(random.uniform(0.5, 2.0))
        place = tuple((end + way * length / 2).tolist())
        rod = m.body(f"b{i}", mass=mass, inertia=mass * length**2 / 12, position=place, angle=heading)
        m.revolute(f"j{i}", below, rod, at=tuple(end.tolist()))
        free_angle, stiffness = 0.0 if i else heading, float(random.uniform(3.0, 30.0))
        damping = float(
            random.choice([0.0, random.uniform(0.05, 1.0), -random.uniform(0.02, 0.3)], p=[0.35, 0.45, 0.2])
        )
        m.torsion_spring(
            f"t{i}", below, rod, stiffness=stiffness, damping=max(damping, 0.0), free_angle=free_angle
        )  # fmt: skip
        if damping < 0:  # springs refuse it
            rate = f"b{i}.angular_velocity" + (f" - b{i - 1}.angular_velocity" if i else "")
            m.torque(f"d{i}", rod, value=f"{-damping!r}*({rate})")
            if i:
                m.torque(f"e{i}", below, value=f"{damping!r}*({rate})")
        below, end = rod, end + way * length

    def pair() -> tuple[str, str]:
        first, second = random.integers(0, count, 2)
        return f"b{first}", f"b{second}"

    if random.random() < 0.7:
        value = (-float(random.uniform(2.0, 60.0)), float(0.5 * random.normal()))
        m.force("follower", pair()[0], point=(float(random.uniform(0.0, 0.4)), 0.0), value=value, frame="body")
    if random.random() < 0.4:
        a, b = pair()
        m.torque("couple", a, value=f"{8 * random.normal()!r}*sin({b}.angle - {heading!r})")
    if random.random() < 0.3:
        a, b = pair()
        m.torque("rate", a, value=f"{0.6 * random.normal()!r}*{b}.angular_velocity")
    if random.random() < 0.3:
        a, b = pair()
        lag = float(random.uniform(0.02, 0.5))
        m.state("s", rate=f"(sin({b}.angle - {heading!r}) - states.s)/{lag!r}")
        m.torque("lagging", a, value=f"{8 * random.normal()!r}*states.s")
    return m


def run_grows(start: dict[str, Any], found: Equilibrium, seed: int, longest: float) -> bool | None:
    """Return whether a small disturbance of an equilibrium grows: in the last fifth of a run, it is eight times what it
    was in the first. None if no run of up to `longest` [s] decides.

    Parameters
    ----------
    start
        The spec with the chain in the equilibrium `found`.
    """
    spins = DISTURBED * np.random.default_rng(1000 + seed).standard_normal(len(found.bodies))
    end, end_velocity = np.zeros(2), np.zeros(2)
    for spin, place, body in zip(spins, found.position[:, :2], start["model"]["bodies"].values(), strict=True):
        x, y = place - end
        half = spin * np.array([-y, x])
        body |= {"velocity": (end_velocity + half).tolist(), "angular_velocity": float(spin)}
        end, end_velocity = 2 * place - end, end_velocity + 2 * half
    start["integrator"], span = {"name": "gauss", "stages": 3}, SPAN
    while True:
        start["time"] = {"end": span, "step": 0.02}
        run = mbdkit.run(start)
        away = np.max([np.abs(run[name].angle - found[name][2]) for name in found.bodies], axis=0)
        fifth = len(away) // 5
        ratio = float(np.max(away[-fifth:]) / np.max(away[:fifth]))
        if ratio > 8 or ratio < 1 / 8 or (span > SPAN and abs(ratio - 1) < 0.02):
            return ratio > 8
        span *= 4
        if span > longest:
            return None
