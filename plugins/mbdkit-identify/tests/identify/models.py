"""Models with parameters that data do not determine, and models that only look so.

Each model returns signals as a function of its parameters. What is determined is known from the equations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import mbdkit
from mbdkit.plugin import RunSpec

NOISE = 1e-3
T = np.linspace(0.1, 3.0, 30)
Model = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Case:
    """Parameters, signals as a function of them, and the combinations that are determined, with `;` between them."""

    name: str
    values: Mapping[str, float]
    model: Model
    determined: str = ""
    spec: RunSpec | None = None

    def exact(self, values: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals by complex steps."""
        steps = 1e-30j * np.eye(len(values))
        return np.array([self.model(*(values + step)).imag / 1e-30 for step in steps]).T / NOISE

    def differences(self, values: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals by central differences."""
        sizes = 1e-4 * np.where(values == 0, 1.0, np.abs(values))
        pairs = [(self.model(*(values + step)), self.model(*(values - step))) for step in np.diag(sizes)]
        return np.array([(a - b).real / (2 * size) for (a, b), size in zip(pairs, sizes, strict=True)]).T / NOISE


def motion(rate: Callable[[float, Any], list[Any]], start: list[Any], column: int = 0) -> np.ndarray:
    """Return one column of a state over time, by RK4, which is analytic in the parameters."""
    states, state, h = [], np.array(start, dtype=complex), T[1] - T[0]
    for t in T:
        states.append(state[column])
        a = np.array(rate(t, state))
        b = np.array(rate(t + h / 2, state + h / 2 * a))
        c = np.array(rate(t + h / 2, state + h / 2 * b))
        d = np.array(rate(t + h, state + h * c))
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
    return np.array(states)


def swing(ratio: Any, damping: Any = 0.0, start: Any = 0.3) -> np.ndarray:
    """Free oscillation with the given ratios of stiffness and damping to mass."""
    return motion(lambda t, x: [x[1], -ratio * x[0] - damping * x[1]], [start, 0.0])


def shaken(m: Any, c: Any, k: Any) -> np.ndarray:
    """Oscillation under a known force."""
    return motion(lambda t, x: [x[1], (np.sin(2 * t) - c * x[1] - k * x[0]) / m], [0.1, 0.0])


def rotor(torque: Any, damping: Any, J: Any, start: Any = 0.0) -> np.ndarray:
    return motion(lambda t, x: [x[1], (torque * np.sin(t) - damping * x[1]) / J], [start, 0.0])


def motor(R: Any, L: Any, K: Any, J: Any, b: Any, gain: Any = 1.0) -> np.ndarray:
    """Current and speed of a motor at a known voltage, times the gain of an amplifier."""
    return np.concatenate([
        motion(lambda t, x: [(gain * (2 + np.sin(3 * t)) - R * x[0] - K * x[1]) / L, (K * x[0] - b * x[1]) / J],
               [0.0, 0.0], column) for column in (0, 1)
    ])  # fmt: skip


def friction(m: Any, k: Any, mu: Any, force: float) -> np.ndarray:
    """Oscillation of a base, and the motion of a block on it that slips if a force exceeds its largest dry friction."""
    slip = np.sin(T) * force - mu * m * 9.81
    return swing(k / m) + np.where(slip.real > 0, slip, 0.0)


def simulated(
    name: str, values: Mapping[str, float], free: tuple[str, ...], determined: str, model: dict[str, Any], *seen: str
) -> Case:
    """Return a mechanism whose angles are measured, with some of its named parameters unknown."""
    spec = RunSpec(
        mbdkit=1, parameters=dict(values), model={"name": "mechanism", **model}, time={"end": 1.0, "step": 0.02},
        integrator={"name": "gauss", "stages": 3}, output={"every": 2},
    )  # fmt: skip
    prepared = mbdkit.prepare(spec)

    def angles(*numbers: float) -> np.ndarray:
        run = prepared.run(parameters=dict(zip(free, map(float, numbers), strict=True)))
        return np.concatenate([run.bodies[body].angle[:] for body in seen or model["bodies"]])

    return Case(name, {name: values[name] for name in free}, angles, determined, spec)


def double_pendulum(name: str, free: str, determined: str, **loads: Any) -> Case:
    values = {"m1": 1.2, "c1": 0.3, "J1": 0.05, "m2": 0.8, "c2": 0.2, "J2": 0.02, "b1": 0.1, "b2": 0.05, "l1": 0.6}
    return simulated(name, values, tuple(free.split()), determined, {
        "bodies": {
            "a": {"mass": "m1", "inertia": "J1", "position": ["c1", 0]},
            "b": {"mass": "m2", "inertia": "J2", "position": ["l1 + c2*cos(0.3)", "c2*sin(0.3)"], "angle": 0.3},
        },
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "a"], "points": [[0, 0], ["-c1", 0]]},
            "B": {"type": "revolute", "bodies": ["a", "b"], "at": ["l1", 0]},
        },
        "forces": {
            "fa": {"type": "torsion-spring", "bodies": ["ground", "a"], "stiffness": 0, "damping": "b1"},
            "fb": {"type": "torsion-spring", "bodies": ["a", "b"], "stiffness": 0, "damping": "b2"}, **loads,
        },
    })  # fmt: skip


def linkage(name: str, free: str, determined: str, *, slides: bool) -> Case:
    """Return a slider-crank or a four-bar linkage without gravity, with a known torque at the crank.

    The pins are at (0, 0), (l1, 0) and (l1 + l2, 0), or (l1, 0) + l2 (0.8, 0.6); the rocker has the length 0.5.
    """
    values = {"m1": 1.0, "J1": 0.01, "m2": 0.8, "J2": 0.03, "c2": 0.25, "m3": 0.6, "J3": 0.02, "l1": 0.2, "l2": 0.6}
    rod: dict[str, Any] = {"mass": "m2", "inertia": "J2", "position": ["l1 + c2", 0]}
    last: dict[str, Any] = {"mass": "m3", "inertia": "J3", "position": ["l1 + l2", 0]}
    points, ground = [["l2 - c2", 0], [0, 0]], {"type": "prismatic", "points": [[0, 0], [0, 0]], "axis": [1, 0]}
    if not slides:
        rod |= {"position": ["l1 + 0.8*c2", "0.6*c2"], "angle": "atan2(0.6, 0.8)"}
        last |= {"position": [0.53, 0.16], "angle": "atan2(0.8, 0.6)"}
        points, ground = [["l2 - c2", 0], [0.25, 0]], {"type": "revolute", "points": [[0.38, -0.04], [-0.25, 0]]}
    return simulated(name, values, tuple(free.split()), determined, {
        "gravity": [0, 0],
        "bodies": {"crank": {"mass": "m1", "inertia": "J1", "position": ["l1/2", 0]}, "rod": rod, "last": last},
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], ["-l1/2", 0]]},
            "B": {"type": "revolute", "bodies": ["crank", "rod"], "points": [["l1/2", 0], ["-c2", 0]]},
            "C": {"type": "revolute", "bodies": ["rod", "last"], "points": points},
            "D": {"bodies": ["ground", "last"], **ground},
        },
        "forces": {"drive": {"type": "torque", "body": "crank", "value": "0.4 + 0.2*sin(5*t)"}},
    }, "crank")  # fmt: skip


def pendulum(name: str, free: str, determined: str, **sections: Any) -> Case:
    values = {"m": 1.2, "c": 0.3, "J": 0.05, "b": 0.1, "k": 2.0, "M": 3.0, "d": 0.4}
    joints = {"A": {"type": "revolute", "bodies": ["ground", "a"], "points": [[0, 0], ["-c", 0]]}}
    forces = {"b": {"type": "torsion-spring", "bodies": ["ground", "a"], "stiffness": "k", "damping": "b"}}
    model = {"bodies": {"a": {"mass": "m", "inertia": "J", "position": ["c", 0]}}, "joints": joints, "forces": forces}
    for section, elements in sections.items():
        model[section] |= elements
    return simulated(name, values, tuple(free.split()), determined, model, "a")


TORQUE = {"type": "torque", "body": "a", "value": "3*sin(5*t)"}
FOUR = "J1 + m1*c1**2 + m2*l1**2; m1*c1 + m2*l1; J2 + m2*c2**2; m2*c2"
RATIOS = "(J1 + m1*c1**2 + m2*l1**2)/(m2*c2); (m1*c1 + m2*l1)/(m2*c2); (J2 + m2*c2**2)/(m2*c2); b1/(m2*c2); b2/(m2*c2)"
COUPLER = "J1 + l1**2*m2*(1 - c2/l2); J2 + m2*c2*(c2 - l2)"
WHEEL = {"mass": "M", "inertia": 0.1, "position": [1, 0]}

UNIDENTIFIABLE = [
    Case("springs in parallel", {"k1": 3.0, "k2": 3.0}, lambda a, b: swing(a + b), "k1 + k2"),
    Case("springs in series", {"k1": 3.0, "k2": 5.0}, lambda a, b: swing(a * b / (a + b)), "1/k1 + 1/k2"),
    Case("oscillator without force", {"m": 2.0, "k": 8.0}, lambda m, k: swing(k / m), "k/m"),
    Case("free damped oscillator", {"m": 2.0, "c": 0.3, "k": 8.0, "x0": 0.3},
         lambda m, c, k, x0: swing(k / m, c / m, x0), "k/m; c/m; x0"),
    Case("parallel springs and a mass", {"k1": 3.0, "k2": 5.0, "m": 2.0},
         lambda a, b, m: swing((a + b) / m), "(k1 + k2)/m"),
    Case("springs in series and a mass", {"k1": 3.0, "k2": 5.0, "m": 2.0},
         lambda a, b, m: swing(1 / (1 / a + 1 / b) / m), "m/k1 + m/k2"),
    Case("inertia and mass on an unknown arm", {"J": 0.4, "m": 2.0, "c": 0.5},
         lambda J, m, c: swing(5 / (J + m * c**2)), "J + m*c**2"),
    Case("inertia and mass on an arm", {"J": 0.4, "m": 2.0, "l": 1.0},
         lambda J, m, length: length * swing(5 / (J + m * length**2)), "J + m*l**2; l"),
    Case("two inertias of a gear", {"J1": 0.4, "J2": 2.0, "n": 2.0},
         lambda J1, J2, n: n * swing(5 / (J1 + n**2 * J2)), "J1 + n**2*J2; n"),
    Case("gear ratio and motor constant", {"n": 20.0, "K": 0.05, "J": 0.4},
         lambda n, K, J: rotor(n * K, 1.0, J), "n*K; J"),
    Case("gear ratio and back-emf", {"n": 20.0, "K": 0.05, "J": 0.4},
         lambda n, K, J: rotor(n * K, n**2 * K**2, J), "n*K; J"),
    Case("friction never active", {"m": 2.0, "k": 8.0, "mu": 0.5}, lambda m, k, mu: friction(m, k, mu, 0.5), "k/m"),
    Case("gain of a sensor and length", {"gain": 2.0, "l": 0.7, "k": 5.0},
         lambda gain, length, k: gain * length * np.sin(swing(k)), "gain*l; k"),
    Case("offset of a sensor and initial angle", {"offset": 0.1, "phi0": 0.0, "J": 0.4},
         lambda offset, phi0, J: offset + rotor(1.0, 0.0, J, phi0), "offset + phi0; J"),
    Case("motor, speed measured", {"R": 1.2, "L": 0.3, "K": 0.5, "J": 0.1, "b": 0.2},
         lambda R, L, K, J, b: motor(R, L, K, J, b)[len(T) :], "K/(L*J); R/L + b/J; (R*b + K**2)/(L*J)"),
    Case("motor and amplifier", {"R": 1.2, "L": 0.3, "K": 0.5, "J": 0.1, "b": 0.2, "gain": 1.0},
         motor, "L/R; J/b; gain/R; J/K; K/R"),
    Case("exponential spring", {"a": 2.0, "b": 3.0, "x0": 0.1},
         lambda a, b, x0: motion(lambda t, x: [x[1], -a * np.exp(b * (x[0] - x0))], [0.1, 0.5]), "a*exp(-b*x0); b"),
    Case("power law behind an amplifier", {"a": 2.0, "g": 1.5, "n": 3.0},
         lambda a, g, n: a * (g * (1.5 + np.sin(T))) ** n, "a*g**n; n"),
    Case("beam", {"E": 7e10, "I": 2e-9, "rho": 2700.0, "A": 3e-4},
         lambda E, area, rho, A: swing(0.05 * E * area / (rho * A)), "E*I/(rho*A)"),
    Case("falling body in air", {"CdA": 0.3, "rho": 1.2, "m": 2.0},
         lambda CdA, rho, m: motion(lambda t, x: [x[1], 9.81 - rho * CdA * x[1] ** 2 / (2 * m)], [0.0, 0.5]),
         "CdA*rho/m"),
    Case("amplitude of two signals", {"a": 0.3, "b": 0.4, "k": 4.0},
         lambda a, b, k: np.sqrt(a * a + b * b) * swing(k), "a**2 + b**2; k"),
    Case("delay and phase", {"omega": 2.0, "delay": 0.1, "phase": 0.3},
         lambda omega, delay, phase: np.sin(omega * (T - delay) + phase), "phase - omega*delay; omega"),
    Case("sag and period", {"m": 2.0, "k": 8.0, "g": 9.8},
         lambda m, k, g: motion(lambda t, x: [x[1], g - k / m * x[0]], [0.0, 0.0]), "k/m; g"),
    Case("rolling disc", {"J": 0.02, "m": 1.0, "r": 0.2}, lambda J, m, r: T**2 / (1 + J / (m * r * r)), "J/(m*r**2)"),
    Case("belt, angles measured", {"r1": 0.2, "r2": 0.3}, lambda a, b: a / b * np.sin(T), "r1/r2"),
    Case("piston", {"p": 2e5, "A": 1e-4, "m": 2.0},
         lambda p, A, m: motion(lambda t, x: [x[1], (p * A - 30 * x[0]) / m], [0.0, 0.0]), "p*A; m"),
    Case("two groups", {"k1": 3.0, "k2": 2.0, "n": 4.0, "K": 0.1},
         lambda a, b, n, K: np.concatenate([swing(a + b), n * K * np.sin(T)]), "k1 + k2; n*K"),
]  # fmt: skip

SIMULATED = [
    pendulum("pendulum", "m c J", "J + m*c**2; m*c"),
    pendulum("masses and forces of a free motion", "m J k b", "J/m; k/m; b/m"),
    pendulum("mass that does not move", "b M", "b", bodies={"w": WHEEL},
             joints={"W": {"type": "revolute", "bodies": ["ground", "w"], "points": [[1, 0], [0, 0]]}}),
    pendulum("damping of a locked joint", "b d", "b", bodies={"w": WHEEL},
             joints={"W": {"type": "weld", "bodies": ["ground", "w"], "points": [[1, 0], [0, 0]]}},
             forces={"d": {"type": "torsion-spring", "bodies": ["ground", "w"], "stiffness": 0, "damping": "d"}}),
    double_pendulum("double pendulum with a known torque", "m1 c1 J1 m2 c2 J2", FOUR, u=TORQUE),
    double_pendulum("double pendulum of unknown length", "m1 J1 m2 c2 J2 l1", f"{FOUR}; l1", u=TORQUE),
    double_pendulum("free double pendulum", "m1 c1 J1 m2 c2 J2 b1 b2", RATIOS),
    linkage("slider-crank", "J1 m2 c2 J2 m3 J3", f"{COUPLER}; m3 + m2*c2/l2", slides=True),
    linkage("four-bar linkage", "J1 m2 c2 J2 m3 J3", f"{COUPLER}; J3 + m3/16 + m2*c2/(4*l2)", slides=False),
]  # fmt: skip

IDENTIFIABLE = [
    Case("driven oscillator", {"m": 2.0, "c": 0.3, "k": 8.0}, shaken),
    Case("nearly equal decays", {"a": 1.0, "b": 2.0, "p": 1.0, "q": 1.02},
         lambda a, b, p, q: a * np.exp(-p * T) + b * np.exp(-q * T)),
    Case("polynomial", {f"a{i}": 1.0 + i for i in range(8)}, lambda *a: sum(x * (T / 3) ** i for i, x in enumerate(a))),
    Case("symmetric optimum", {"k": 4.0, "c": 0.0}, lambda k, c: swing(k + c * c) * (1 + c * c * T)),
    Case("fourth power", {"k": 4.0, "c": 0.0}, lambda k, c: swing(k) + c**4 * T),
    Case("different sizes", {"E": 2e11, "offset": 1e-6}, lambda E, offset: swing(E / 5e10) + offset * T),
    Case("small effect", {"k": 4.0, "m": 2.0, "e": 1.0}, lambda k, m, e: shaken(m, 0.1, k) + 1e-7 * e * T),
    Case("nearly linear spring", {"k1": 4.0, "k2": 2.0},
         lambda k1, k2: motion(lambda t, x: [x[1], -k1 * x[0] - k2 * (x[0] + 1e-4 * x[0] ** 3)], [0.3, 0.0])),
    Case("offset of a sensor of a pendulum", {"offset": 0.1, "phi0": 0.2, "k": 8.0},
         lambda offset, phi0, k: offset + motion(lambda t, x: [x[1], -k * np.sin(x[0])], [phi0, 0.0])),
    Case("active friction", {"m": 2.0, "k": 8.0, "mu": 0.01}, lambda m, k, mu: friction(m, k, mu, 2.0) * m),
    Case("motor, current and speed measured", {"R": 1.2, "L": 0.3, "K": 0.5, "J": 0.1, "b": 0.2}, motor),
    double_pendulum("masses of a double pendulum", "m1 c1 m2 c2 b1", "", u=TORQUE),
]  # fmt: skip
