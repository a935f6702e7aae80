"""The beam of Hairer and Wanner as forty hinged links with torsion springs, against the published end values.

Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.1 (the discretized beam) and IV.10; also in
the Test Set for IVP Solvers, Bari. An elastic inextensible beam of length 1, density 1 and bending stiffness 1 is
clamped at the origin along the x axis. Its n = 40 links of length l = 1/n have half their mass l at either end, hence
the inertia m (l/2)^2 about the middle; the springs between links have the stiffness n, and the one at the clamp 2 n,
for the clamp lies half a link away. The force (-F, F) acts on the tip, F = 1.5 sin(t)^2 up to t = pi and nothing
afterwards. In the links' tilts, which are absolute angles, the book writes

    theta'' = C v + D u,    C u = D v + theta'^2,
    v_l = n^4 (theta_(l-1) - 2 theta_l + theta_(l+1)) + n^2 (F_y cos(theta_l) - F_x sin(theta_l)),
    theta_0 = -theta_1,  theta_(n+1) = theta_n,

with C tridiagonal and symmetric, C_11 = 1, C_ll = 2, C_nn = 3, C_(l,l+1) = -cos(theta_l - theta_(l+1)), and D
tridiagonal and antisymmetric, D_(l,l+1) = -sin(theta_l - theta_(l+1)).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.slow_cases import slow_but

from .running import gauss, run

N = 40

#: theta and theta' at t = 5 as the test set prints them, from RADAU in quadruple precision with tolerances of 1.1e-18.
THETA, RATE = np.loadtxt(Path(__file__).parent / "digits" / "beam.txt", unpack=True)


def beam(theta: Any, rate: Any, force: tuple[Any, Any]) -> dict[str, Any]:
    """Return the beam as a free-form model at the tilts `theta` and their `rate`s, with `force` on its tip."""
    length = 1.0 / N
    bodies: dict[str, Any] = {}
    joints: dict[str, Any] = {}
    forces: dict[str, Any] = {}
    end, speed = np.zeros(2), np.zeros(2)
    for k, (angle, turning) in enumerate(zip(theta, rate, strict=True), start=1):
        half = length / 2 * np.array([np.cos(angle), np.sin(angle)])
        half_speed = turning * np.array([-half[1], half[0]])
        bodies[f"link{k}"] = {
            "mass": length,
            "inertia": length * length**2 / 4,
            "position": (end + half).tolist(),
            "angle": float(angle),
            "velocity": (speed + half_speed).tolist(),
            "angular_velocity": float(turning),
        }
        end, speed = end + 2 * half, speed + 2 * half_speed
        pair = [f"link{k - 1}" if k > 1 else "ground", f"link{k}"]
        inner = [length / 2 if k > 1 else 0.0, 0.0]
        joints[f"hinge{k}"] = {"type": "revolute", "bodies": pair, "points": [inner, [-length / 2, 0.0]]}
        forces[f"spring{k}"] = {"type": "torsion-spring", "bodies": pair, "stiffness": float(N if k > 1 else 2 * N)}
    forces["tip"] = {"type": "force", "body": f"link{N}", "point": [length / 2, 0.0], "value": list(force)}
    return {"name": "mechanism", "gravity": [0.0, 0.0], "bodies": bodies, "joints": joints, "forces": forces}


def pushed_beam() -> dict[str, Any]:
    """Return the beam of the test set: straight, at rest, pushed until t = pi."""
    push = "1.5*sin(min(t, pi))**2"
    return beam(np.zeros(N), np.zeros(N), (f"-{push}", push))


def ends(result: mbdkit.Run) -> tuple[Any, Any]:
    """Return theta and theta' of all links at the last recorded time, each (40,)."""
    links = [result[f"link{k}"] for k in range(1, N + 1)]
    return np.array([link.angle[-1] for link in links]), np.array([link.angular_velocity[-1] for link in links])


def stated_acceleration(theta: Any, rate: Any, fx: float, fy: float) -> Any:
    """Return theta'' (40,) as the book writes it, by its tridiagonal matrices C and D."""
    difference = theta[:-1] - theta[1:]
    C = np.diag([1.0] + [2.0] * (N - 2) + [3.0]) - np.diag(np.cos(difference), 1) - np.diag(np.cos(difference), -1)
    D = np.diag(np.sin(difference), -1) - np.diag(np.sin(difference), 1)
    wide = np.concatenate([[-theta[0]], theta, [theta[-1]]])
    v = N**4 * np.diff(wide, 2) + N**2 * (fy * np.cos(theta) - fx * np.sin(theta))
    return C @ v + D @ np.linalg.solve(C, D @ v + rate**2)


@pytest.mark.parametrize("seed", range(4))
def test_hinged_links_obey_the_equations_with_the_tridiagonal_matrices(seed: int) -> None:
    # expected: theta'' = C v + D u of the book at a random state, under a force on the tip
    random = np.random.default_rng(seed)
    theta, rate = np.cumsum(random.normal(0.0, 0.2, N)), random.normal(0.0, 3.0, N)
    fx, fy = random.normal(0.0, 1.5, 2)
    result = run(beam(theta, rate, (float(fx), float(fy))), {"name": "rk4"}, end=1e-9, step=1e-9)
    seen = np.array([result[f"link{k}"].angular_acceleration[0] for k in range(1, N + 1)])
    expected = stated_acceleration(theta, rate, fx, fy)
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


METHODS: dict[str, tuple[dict[str, Any], int]] = {
    "gauss4": (gauss(4), 10240),
    "gauss6": (gauss(6), 5120),
    "radau-iia5": ({"name": "radau-iia", "stages": 5}, 10240),
    "rk4": ({"name": "rk4"}, 163840),
}


@pytest.mark.parametrize("name", slow_but(METHODS, "gauss6"))
def test_beam_ends_at_the_published_digits_of_all_forty_links(name: str) -> None:
    # expected: the published end values; the corner of the force at t = pi falls on the end of a step
    integrator, steps_to_pi = METHODS[name]
    result = run(pushed_beam(), integrator, end=5.0, step=math.pi / steps_to_pi, every=10**6)
    theta, rate = ends(result)
    np.testing.assert_allclose(theta, THETA, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rate, RATE, rtol=0, atol=1e-9)
