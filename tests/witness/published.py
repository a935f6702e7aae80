"""Problems with published results, solved without constraints: in one or a few coordinates, or by quadrature.

The functions return results by the names of the table ``problems.yaml`` of the part `mbdkit_paper`.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import brentq

from . import ode
from .dyads import Dyad, Link, Linkage
from .minimal_coordinates import MinimalSystem, coordinates
from .n_four_bar import Windows
from .pendulum import Pendulum

Array = NDArray[np.floating[Any]]


def andrews_linkage() -> Linkage:
    """Return Andrews' mechanism as a crank, whose ends are A and B here, and three dyads that meet in E."""
    zt, zf, u, e = 0.04, 0.02, 0.04, 0.02
    at_e, at_g, at_h = 1j * (e - 0.01421 - e), 1j * (e - 0.01421), complex(-(zf - 0.01421))
    links = {
        "K1": Link(0.04325, 2.194e-6, {"A": -0.00092 + 0j, "B": 0.007 - 0.00092 + 0j}),
        "K2": Link(0.00365, 4.41e-7, {"B": 0.0115 + 0j, "E": 0.0115 - 0.028 + 0j}),
        "K3": Link(0.02373, 5.255e-6, {"P": -0.01043 + 0.01874j, "E": -0.01043 + 1j * (0.01874 - 0.035)}),
        "K4": Link(0.00706, 5.667e-7, {"E": at_e, "G": at_g}),
        "K5": Link(0.0705, 1.169e-5, {"Q": -0.02308 - 0.00916j, "G": zt - 0.02308 - 0.00916j}),
        "K6": Link(0.00706, 5.667e-7, {"E": 0.01421 + 0j, "H": at_h}),
        "K7": Link(0.05498, 1.912e-5, {"Q": -0.00449 + 0.01228j, "H": -0.00449 + 1j * (0.01228 - u)}),
    }
    dyads = (
        Dyad("K2", "K3", "K1", "ground", ("B", "P", "E"), 1),
        Dyad("K4", "K5", "K2", "ground", ("E", "Q", "G"), -1),
        Dyad("K6", "K7", "K2", "ground", ("E", "Q", "H"), 1),
    )
    ground = {"A": 0j, "P": -0.03635 + 0.03273j, "Q": -0.06934 - 0.00227j}
    return Linkage(ground, links, dyads, lambda time: 0.033, "0.033", gravity=0.0)


def andrews(beta: float, end: float) -> dict[str, float]:
    """Return the angles of crank and plate, and the rate of the crank, at `end` [s], by Eksergian's equation."""
    linkage = andrews_linkage()
    hook, anchor = 0.02 - 0.01043 + 1j * (0.01874 - 0.018), 0.014 + 0.072j

    def right_side(time: Any, state: Any) -> Any:
        poses = linkage.poses(state[0])
        inertia, slope, _ = linkage.equation(state[0])
        at, rate, _ = poses["K3"].point(hook)
        pull = -4530.0 * (1 - 0.07785 / abs(at - anchor)) * (at - anchor)
        return np.array([state[1], (0.033 + (pull * rate.conjugate()).real - slope * state[1] ** 2 / 2) / inertia])

    phi, rate = ode.dop853(right_side, np.array([beta, 0.0]), np.array([end]))[-1]
    return {"beta": phi, "gamma": linkage.poses(phi)["K3"].angle[0], "beta_rate": rate}


def point_pendulum(side: float, end: float) -> dict[str, float]:
    """Return place and speed at `end` [s] of a point mass that starts at x = `side` [m]."""
    angle, rate = Pendulum(arm=1.0, inertia=0.0, angle=math.pi if side < 0 else 0.0).motion([end])
    return {"x": math.cos(angle[0]), "vx": -math.sin(angle[0]) * rate[0]}


def windows(n: int, end: float) -> dict[str, float]:
    """Return the angle of the cranks at `end` [s], and the end of the first one."""
    angle = Windows(n, math.pi / 2, -1.0).angle(end)
    return {"angle": angle, "x": math.cos(angle), "y": math.sin(angle)}


def light_cart_pole(end: float) -> dict[str, float]:
    """Return the place of the cart and the angle of the link at `end` [s], by quadrature.

    With m the mass of the cart and that of the bob 1, the centre of mass stays at x = 1 / (1 + m), so that
    x = (1 - sin(a)) / (1 + m), and the energy gives a'^2 (1 - cos(a)^2 / (1 + m)) = 2 g cos(a). The integral of dt is
    smooth in w, with a = pi/2 - w^2, but for a sharp minimum where the bob passes below the cart.
    """
    mass, gravity = 1e-6, 9.81

    def slowness(w: float) -> float:
        a = math.pi / 2 - w**2
        inertia = (math.sin(a) ** 2 + mass) / (1 + mass)
        return 2 * w * math.sqrt(inertia / (2 * gravity * math.sin(w**2))) if w else 2 * math.sqrt(0.5 / gravity)

    lowest = math.sqrt(math.pi / 2)

    def time(w: float) -> float:
        """Return the time from rest to w, at most to the lowest position [s]."""
        near = [lowest - d for d in (0.1, 0.01, 0.002, 5e-4, 1e-4) if lowest - d < w]
        ends = [0.0, *near, w]
        return sum(quad(slowness, a, b, epsabs=1e-15, epsrel=1e-13)[0] for a, b in pairwise(ends))

    quarter = time(lowest)
    swings, left = divmod(end, 2 * quarter)
    early = min(left, 2 * quarter - left)  # time from the nearer end of the swing
    w = brentq(lambda w: time(w) - early, 0.0, lowest, xtol=1e-15, rtol=1e-14)
    angle = math.pi / 2 - w**2
    if (left > quarter) != (swings % 2 == 1):
        angle = -angle
    return {"x": (1 - math.sin(angle)) / (1 + mass), "angle": angle}


def floating_slider_crank(end: float) -> dict[str, float]:
    """Return the x of both sliders at `end` [s]: in the angle of one crank, and with three coordinates of a frame."""
    on_ground, x, y, phi, crank = coordinates(5)

    def poses(origin: tuple[Any, Any], tilt: Any, angle: Any) -> list[tuple[Any, Any, Any]]:
        turn = angle - tilt
        rod = tilt - sympy.asin(sympy.sin(turn) / 3)
        reach = sympy.cos(turn) / 10 + sympy.sqrt(9 - sympy.sin(turn) ** 2) / 10
        pin = origin[0] + sympy.cos(angle) / 10, origin[1] + sympy.sin(angle) / 10
        return [
            (origin[0] + sympy.cos(angle) / 20, origin[1] + sympy.sin(angle) / 20, angle),
            (pin[0] + sympy.cos(rod) * 3 / 20, pin[1] + sympy.sin(rod) * 3 / 20, rod),
            (origin[0] + reach * sympy.cos(tilt), origin[1] + reach * sympy.sin(tilt), tilt),
        ]

    def load(time: float, q: Array, v: Array) -> Array:
        force = np.zeros(21)
        force[[2, 14]] = 0.1
        force[9:12] = -5000.0 * q[9:12] - 50.0 * v[9:12]
        return force

    parts, inertias = [0.2, 0.2, 0.4], [0.2 * 0.01 / 12, 0.2 * 0.09 / 12, 4e-4]
    system = MinimalSystem(
        [*poses((0, 0), 0, on_ground), (x, y, phi), *poses((x, y), phi, crank)],
        [*parts, 2.0, *parts], [*inertias, 1.0, *inertias], [0.0] * 5, [0.0] * 5, load, gravity=0.0,
    )  # fmt: skip
    q = system.solve(np.array([end]))[0][-1]
    return {"sum": abs(q[2, 0]) + abs(q[6, 0]), "x": q[2, 0]}


def spring_slider_crank(end: float) -> dict[str, float]:
    """Return angle and rate of the crank, and the place of the second mass, at `end` [s]."""
    phi, x = coordinates(2)
    rod = -sympy.asin(sympy.sin(phi) / 2)
    slider = 0.3 * sympy.cos(phi) + 0.6 * sympy.cos(rod)
    system = MinimalSystem(
        [
            (0.15 * sympy.cos(phi), 0.15 * sympy.sin(phi), phi),
            (0.3 * sympy.cos(phi) + 0.3 * sympy.cos(rod), 0.15 * sympy.sin(phi), rod),
            (slider, 0, 0),
            (x, 0, 0),
        ],
        [0.36, 0.15, 0.1, 0.7], [0.36 * 0.09 / 12 * 1e-10, 0.15 * 0.36 / 12 * 1e-10, 0.0, 0.0],
        [math.pi / 2, math.sqrt(0.27) + 0.2], [0.0, 0.0],
        lambda time, q, v: np.array([0, 0, 1.0, 0, 0, 0, k := 1000 * (q[9] - q[6] - 0.2), 0, 0, -k, 0, 0]),
        gravity=0.0,
    )  # fmt: skip
    q, v = (part[-1] for part in system.solve(np.array([end])))
    return {"phi": q[0, 2], "x": q[3, 0], "phi_rate": v[0, 2]}


def hinged_beam_accelerations(time: float, angle: Array, rate: Array) -> Array:
    """Return the angular accelerations (n,) of the hinged beam by the equations of Hairer and Wanner, section IV.1."""
    n = len(angle)
    k = np.arange(1, n + 1)
    weight = n + 0.5 - np.maximum(k[:, None], k[None, :])
    apart = angle[:, None] - angle[None, :]
    push = 1.5 * math.sin(time) ** 2 if time <= math.pi else 0.0
    padded = np.concatenate([[-angle[0]], angle, angle[-1:]])
    right = n**4 * (padded[:-2] - 2 * angle + padded[2:]) + n**2 * push * (np.cos(angle) + np.sin(angle))
    return np.linalg.solve(weight * np.cos(apart), right - (weight * np.sin(apart)) @ rate**2)
