"""A flexible rod that hangs from a pin, stretched by its weight, and is let go of at 5 rad/s; also in Exudyn.

It starts in the state of a rod that turns at this speed forever, so that its motion is smooth from the start.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

import mbdkit

from .exudyn_beams import ExudynBeams, cable, straight_beam

AXIAL, SHEAR, BENDING = 1e4, 5e3, 2.0
MASS, INERTIA = 1.0, 2e-4
GRAVITY, OMEGA = 9.81, 5.0


def depth(s: np.ndarray) -> np.ndarray:
    """Return how far below the pin the cross-sections start: EA x'' = -rho A (omega^2 x + g), x(0) = 0, x'(1) = 1."""
    k = OMEGA * np.sqrt(MASS / AXIAL)
    fall = GRAVITY / OMEGA**2
    return np.asarray(fall * (np.cos(k * s) - 1) + (1 / k + fall * np.sin(k)) / np.cos(k) * np.sin(k * s))


def stretch(s: np.ndarray) -> np.ndarray:
    """Return the derivative of `depth`."""
    k = OMEGA * np.sqrt(MASS / AXIAL)
    fall = GRAVITY / OMEGA**2
    return np.asarray((1 + k * fall * np.sin(k)) / np.cos(k) * np.cos(k * s) - k * fall * np.sin(k * s))


def rod(elements: int, nodes: Literal[2, 3], *, corrected: bool = False) -> mbdkit.Mechanism:
    """Return the rod."""
    m = mbdkit.Mechanism(gravity=(0.0, -GRAVITY))
    below = depth(np.linspace(0.0, 1.0, elements * (nodes - 1) + 1))
    m.beam(
        "rod", a=(0, 0), b=(0, -1), elements=elements, nodes=nodes, corrected=corrected, mass_per_length=MASS,
        rotary_inertia=INERTIA, stiffness={"axial": AXIAL, "shear": SHEAR, "bending": BENDING}, angular_velocity=OMEGA,
        start=[(0.0, -y, -np.pi / 2) for y in below.tolist()],
    )  # fmt: skip
    m.revolute("pin", m.ground, "rod.0", at=(0, 0))
    return m


def exudyn_rod(elements: int) -> ExudynBeams:
    """Return the rod in Exudyn."""
    beam = straight_beam(((0.0, 0.0), (0.0, -1.0)), elements, (AXIAL, SHEAR, BENDING), (MASS, INERTIA))
    below = depth(np.linspace(0.0, 1.0, elements + 1)).tolist()
    beam.start([(0.0, -y, -np.pi / 2) for y in below], [(OMEGA * y, 0.0, OMEGA) for y in below])
    return _hung(beam)


def exudyn_cable(elements: int) -> ExudynBeams:
    """Return the rod in Exudyn as a cable, without shear and rotary inertia."""
    beam = cable(((0.0, 0.0), (0.0, -1.0)), elements, (AXIAL, BENDING), MASS)
    s = np.linspace(0.0, 1.0, elements + 1)
    state = list(zip(depth(s).tolist(), stretch(s).tolist(), strict=True))
    beam.start(
        [(0.0, -y, 0.0, -slope) for y, slope in state], [(OMEGA * y, 0.0, OMEGA * slope, 0.0) for y, slope in state]
    )
    return _hung(beam)


def _hung(beam: ExudynBeams) -> ExudynBeams:
    beam.hold(0, 1)
    beam.weigh(GRAVITY)
    beam.system.Assemble()
    return beam
