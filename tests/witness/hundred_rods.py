"""A chain of 100 rods of 1 cm, let go at rest from 0.5 rad off the vertical: where it is after 1 s, to 16 digits.

Uniform rods of 0.01 kg, g = 9.81 m/s^2 (each the nearest double), angles from the +x axis, all 0.5 - pi/2 at the start.
Made in extended precision in two ways that share nothing but these numbers: the forces in the joints, a banded system,
by Gragg-Bulirsch-Stoer extrapolation of order 20, and Lagrange's equations, a dense one, by Gauss collocation of order
16, both in 500 steps. Angles differ by 5e-15 rad at most, the rods' centres by 2e-16 m.
`tests/benchmarks/test_precision.py` makes them anew.
"""

from pathlib import Path

import numpy as np

START = 0.5 - 1.5707963267948966  # rad
END = 1.0  # s

ANGLES = tuple(np.loadtxt(Path(__file__).parent / "digits" / "hundred_rods.txt").tolist())
