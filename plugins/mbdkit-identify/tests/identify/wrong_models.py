"""Synthetic measurements of mechanisms that their models describe wrongly, and of others that they describe rightly.

Each case has a true mechanism and sensors, from which noisy data are drawn, and a model whose other parameters are
estimated by Gauss-Newton steps on exact sensitivities. What is wrong is known, as it was put in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from mbdkit.plugin import RunSpec
from mbdkit_gradients import PreparedSensitivities
from mbdkit_identify.identification import Doubt, Residuals
from mbdkit_identify.misfit import doubts_of
from mbdkit_identify.probes import probe_derivatives, probes_of, sensor_derivatives, sensor_probes, start_probes

Sensor = Callable[[Callable[[np.ndarray], np.ndarray], np.ndarray], np.ndarray]
"""What a sensor shows at given times of a quantity that is a function of time."""


@dataclass(frozen=True)
class Rig:
    """A mechanism with its true parameters, its start, what is measured, and what is estimated."""

    name: str
    values: Mapping[str, float]
    model: Mapping[str, Any]
    start: Mapping[str, float]
    observed: Mapping[str, float]
    """Measured quantities with the deviation of their noise."""
    free: tuple[str, ...]
    known: frozenset[str] = frozenset()
    """Quantities of the start that are known."""
    end: float = 4.0
    step: float = 0.01

    def spec(self, model: Mapping[str, Any], values: Mapping[str, float]) -> RunSpec:
        return RunSpec(
            mbdkit=1, parameters=dict(values), model={"name": "mechanism", **model}, integrator={"name": "gauss", "stages": 2},
            time={"end": self.end, "step": self.step},
        )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A rig whose model differs from the truth.

    `places` are those that are right. `values` are parameters of the model that differ from the truth, `true` are
    elements that only the true mechanism has, and `start` are true initial values that differ from those of the model.
    """

    name: str
    rig: Rig
    places: tuple[str, ...] = ()
    true: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    free: tuple[str, ...] | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    correlation: float = 0.0
    noise: float = 1.0
    seed: int = 0


@dataclass
class Fit:
    """A fitted model: values of the unknowns, and its signals."""

    values: dict[str, float]
    start: dict[str, float]
    jacobian: np.ndarray
    residuals: list[Residuals]


def merged(model: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a model with further or changed elements."""
    result = deepcopy(dict(model))
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(value, Mapping) and isinstance(old, Mapping) else deepcopy(value)
    return result


def data_of(case: Case) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times (T,) and measured values (T,) of each quantity."""
    rig = case.rig
    every = np.arange(0.0, rig.end + 1e-9, rig.step)
    truth = rig.spec(merged(rig.model, case.true), rig.values)
    values = PreparedSensitivities(
        truth, [*rig.observed], every, [next(iter(rig.values))], initial={**rig.start, **case.start}
    ).values({})
    times = every[10:-10]
    random = np.random.default_rng(case.seed)
    data = {}
    for (quantity, deviation), value in zip(rig.observed.items(), values, strict=True):
        sensor = case.sensors.get(quantity, lambda y, t: y(t))
        noise, phi = random.standard_normal(len(times)), case.correlation
        for i in range(1, len(times)):
            noise[i] = phi * noise[i - 1] + np.sqrt(1 - phi**2) * noise[i]
        data[quantity] = sensor(CubicSpline(every, value), times) + case.noise * deviation * noise
    return times, data


def whitened(values: np.ndarray, deviation: float, phi: float) -> np.ndarray:
    """Return residuals (T, ...) whose noise is autoregressive of order 1 as independent numbers of deviation 1."""
    rest = (values[1:] - phi * values[:-1]) / np.sqrt(1 - phi**2)
    return np.concatenate([values[:1], rest]) / deviation


def noise_of(residuals: np.ndarray) -> tuple[float, float]:
    """Return deviation and correlation of residuals (T,), by maximum likelihood given the first one."""
    phi = float(residuals[1:] @ residuals[:-1] / (residuals[:-1] @ residuals[:-1]))
    phi = min(max(phi, -0.95), 0.995)
    return float(np.sqrt(np.mean((residuals[1:] - phi * residuals[:-1]) ** 2) / (1 - phi**2))), phi


def fit(case: Case, times: np.ndarray, data: Mapping[str, np.ndarray]) -> tuple[Fit, RunSpec]:
    """Estimate the unknowns of the model of a case, and the noise of each signal."""
    rig = case.rig
    free = [*(rig.free if case.free is None else case.free)]
    held = {**rig.values, **case.values}
    starts = [name for name in rig.start if name not in rig.known]
    names = [*free, *(f"initial.{name}" for name in starts)]
    quantities = [*data]
    prepared = PreparedSensitivities(rig.spec(rig.model, held), quantities, times, names, initial=rig.start)
    size = np.array([abs(held[name]) for name in free] + [1.0] * len(starts))
    unknown = np.array([held[name] for name in free] + [rig.start[name] for name in starts]) / size
    noise = [(float(np.std(data[quantity])), 0.0) for quantity in quantities]
    lowest = np.array([1e-2] * len(free) + [-np.inf] * len(starts))
    for _ in range(3):
        cache: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

        def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            if x.tobytes() not in cache:
                found = prepared.at(dict(zip(names, x * size, strict=True)))
                cache[x.tobytes()] = found.values, found.derivatives * size
            return cache[x.tobytes()]

        def residuals(x: np.ndarray) -> np.ndarray:
            parts = [whitened(data[q] - y, *n) for q, y, n in zip(quantities, at(x)[0], noise, strict=True)]
            return np.concatenate(parts)

        def jacobian(x: np.ndarray) -> np.ndarray:
            return -np.concatenate([whitened(d, *n) for d, n in zip(at(x)[1], noise, strict=True)])

        unknown = least_squares(
            residuals, unknown, jacobian, bounds=(lowest, np.inf), xtol=1e-6, ftol=1e-6, max_nfev=20
        ).x
        values = at(unknown)[0]
        noise = [noise_of(data[q] - y) for q, y in zip(quantities, values, strict=True)]
    signals = [
        Residuals(
            "swing",
            q,
            "",
            times,
            data[q],
            y,
            whitened(data[q] - y, *n),
            *n,
            is_hold_out=False,
            band=1.96 * n[0] + 0 * y,
            covered=0.95,
        )
        for q, y, n in zip(quantities, values, noise, strict=True)
    ]
    found = dict(zip(names, (unknown * size).tolist(), strict=True))
    start = {**rig.start, **{name: found[f"initial.{name}"] for name in starts}}
    result = Fit({name: found[name] for name in free}, start, np.concatenate(at(unknown)[1]), signals)
    return result, rig.spec(rig.model, {**held, **result.values})


def doubts(case: Case) -> tuple[Doubt, ...]:
    """Return the doubts about the model of a case."""
    times, data = data_of(case)
    result, spec = fit(case, times, data)
    mechanical, sensors = probes_of(spec), sensor_probes(dict.fromkeys(data, "SI"), ["swing"])
    starts = start_probes([f"initial.{name}" for name in case.rig.start if name in case.rig.known], "swing")
    columns = [probe_derivatives(spec, mechanical, [*data], times, result.start)]
    if starts:
        names = [probe.name.removesuffix(" of swing") for probe in starts]
        columns.append(PreparedSensitivities(spec, [*data], times, names, initial=result.start).at({}).derivatives)
    columns.append(np.stack([
        sensor_derivatives("swing", one.quantity, times, one.fitted, sensors) for one in result.residuals
    ]))  # fmt: skip
    every = np.concatenate(np.concatenate(columns, axis=-1))
    return doubts_of(result.residuals, result.jacobian, every, [*mechanical, *starts, *sensors])


# ---- rigs ----------------------------------------------------------------------------------------------------------


def pin(a: str, b: str, on_a: Sequence[Any], on_b: Sequence[Any]) -> dict[str, Any]:
    return {"type": "revolute", "bodies": [a, b], "points": [[*on_a], [*on_b]]}


def damper(a: str, b: str, damping: Any, stiffness: Any = 0, **more: Any) -> dict[str, Any]:
    return {"type": "torsion-spring", "bodies": [a, b], "damping": damping, "stiffness": stiffness, **more}


def torque(body: str, value: Any, reaction: str | None = None) -> dict[str, Any]:
    return {"type": "torque", "body": body, "value": value} | ({"reaction_body": reaction} if reaction else {})


PENDULUM = Rig(
    "double pendulum",
    {"m1": 1.2, "c1": 0.3, "J1": 0.05, "m2": 0.8, "c2": 0.25, "J2": 0.03, "l1": 0.6, "b1": 0.04, "b2": 0.02},
    {
        "bodies": {
            "a": {"mass": "m1", "inertia": "J1", "position": ["c1", 0]},
            "b": {"mass": "m2", "inertia": "J2", "position": ["l1 + c2", 0]},
        },
        "joints": {
            "hub": pin("ground", "a", [0, 0], ["-c1", 0]),
            "elbow": pin("a", "b", ["l1 - c1", 0], ["-c2", 0]),
        },
        "forces": {"da": damper("ground", "a", "b1"), "db": damper("a", "b", "b2")},
    },
    {"a.angle": -0.6, "b.angle": -0.9, "a.angular_velocity": 0.0, "b.angular_velocity": 0.0},
    {"hub.angle": 2e-3, "elbow.angle": 3e-3},
    ("b1", "b2", "J1", "J2"),
)  # fmt: skip

ARM = Rig(
    "driven arm",
    {"m1": 1.5, "c1": 0.2, "J1": 0.04, "m2": 1.0, "c2": 0.18, "J2": 0.02, "l1": 0.4, "b1": 0.3, "b2": 0.2, "gain": 1.0, "f1": 0.0, "f2": 0.0},
    {
        "bodies": {
            "upper": {"mass": "m1", "inertia": "J1", "position": ["c1", 0]},
            "lower": {"mass": "m2", "inertia": "J2", "position": ["l1 + c2", 0]},
        },
        "joints": {
            "shoulder": pin("ground", "upper", [0, 0], ["-c1", 0]),
            "elbow": pin("upper", "lower", ["l1 - c1", 0], ["-c2", 0]),
        },
        "forces": {
            "ds": damper("ground", "upper", "b1"), "de": damper("upper", "lower", "b2"),
            "shoulder motor": torque("upper", "4*sin(3*t) + 2*sin(7*t)"),
            "elbow motor": torque("lower", "gain*(1.5*sin(5*t + 1) + sin(2*t))", "upper"),
        },
    },
    {"upper.angle": -1.5, "lower.angle": -1.4, "upper.angular_velocity": 0.0, "lower.angular_velocity": 0.0},
    {"shoulder.angle": 2e-3, "elbow.angle": 2e-3},
    ("b1", "b2", "J1", "J2"),
)  # fmt: skip

SLIDER = Rig(
    "slider-crank",
    {"m1": 1.0, "J1": 0.02, "m2": 0.8, "J2": 0.03, "c2": 0.25, "m3": 0.6, "l1": 0.2, "l2": 0.6, "b1": 0.08},
    {
        "bodies": {
            "crank": {"mass": "m1", "inertia": "J1", "position": ["l1/2", 0]},
            "rod": {"mass": "m2", "inertia": "J2", "position": ["l1 + c2", 0]},
            "slider": {"mass": "m3", "inertia": 0.01, "position": ["l1 + l2", 0]},
        },
        "joints": {
            "A": pin("ground", "crank", [0, 0], ["-l1/2", 0]),
            "B": pin("crank", "rod", ["l1/2", 0], ["-c2", 0]),
            "C": pin("rod", "slider", ["l2 - c2", 0], [0, 0]),
            "guide": {"type": "prismatic", "bodies": ["ground", "slider"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
        },
        "forces": {"da": damper("ground", "crank", "b1"), "motor": torque("crank", "1.2 + 0.8*sin(4*t)")},
    },
    {"crank.angle": 0.9, "crank.angular_velocity": 2.0},
    {"A.angle": 3e-3, "slider.x": 5e-4},
    ("b1", "J1", "m3"),
    end=3.0,
)  # fmt: skip

FOUR_BAR = Rig(
    "four-bar linkage",
    {"m1": 0.6, "J1": 0.01, "m2": 0.8, "J2": 0.03, "c2": 0.25, "m3": 0.6, "J3": 0.02, "l1": 0.2, "l2": 0.6, "b1": 0.03, "k": 8.0, "x0": 0.4},
    {
        "bodies": {
            "crank": {"mass": "m1", "inertia": "J1", "position": ["l1/2", 0]},
            "coupler": {"mass": "m2", "inertia": "J2", "position": ["l1 + 0.8*c2", "0.6*c2"], "angle": "atan2(0.6, 0.8)"},
            "rocker": {"mass": "m3", "inertia": "J3", "position": [0.53, 0.16], "angle": "atan2(0.8, 0.6)"},
        },
        "joints": {
            "A": pin("ground", "crank", [0, 0], ["-l1/2", 0]),
            "B": pin("crank", "coupler", ["l1/2", 0], ["-c2", 0]),
            "C": pin("coupler", "rocker", ["l2 - c2", 0], [0.25, 0]),
            "D": pin("ground", "rocker", [0.38, -0.04], [-0.25, 0]),
        },
        "forces": {
            "da": damper("ground", "crank", "b1"),
            "support": {"type": "torsion-spring", "bodies": ["ground", "rocker"], "stiffness": "k", "free_angle": "x0 + 0.7"},
            "motor": torque("crank", "1.5*sin(2.2*t) + sin(5*t)"),
        },
    },
    {"crank.angle": 0.4, "crank.angular_velocity": 0.0},
    {"A.angle": 3e-3, "D.angle": 1e-3},
    ("b1", "J1", "k", "x0"),
)  # fmt: skip

CART = Rig(
    "cart-pole",
    {"M": 1.5, "m": 0.4, "c": 0.3, "J": 0.02, "bc": 0.6, "bp": 0.01, "gain": 1.0},
    {
        "bodies": {
            "cart": {"mass": "M", "inertia": 0.05, "position": [0, 0]},
            "pole": {"mass": "m", "inertia": "J", "position": [0, "-c"], "angle": "-pi/2"},
        },
        "joints": {
            "rail": {"type": "prismatic", "bodies": ["ground", "cart"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
            "hinge": pin("cart", "pole", [0, 0], ["-c", 0]),
        },
        "forces": {
            "dc": {"type": "law", "law": "linear", "damping": "bc", "pathway": {"type": "coordinate", "coordinate": "x", "bodies": ["ground", "cart"]}},
            "dp": damper("cart", "pole", "bp"),
            "drive": {"type": "force", "body": "cart", "value": ["gain*(6*sin(3*t) + 4*cos(6.5*t))", 0]},
        },
    },
    {"cart.x": 0.0, "pole.angle": -1.2, "cart.vx": 0.0, "pole.angular_velocity": 0.0},
    {"cart.x": 5e-4, "hinge.angle": 3e-3},
    ("M", "bc", "bp", "J"),
)  # fmt: skip

BELT = Rig(
    "arm behind a belt",
    {"Jr": 2e-3, "m": 1.2, "c": 0.25, "J": 0.03, "ratio": 4.0, "b": 0.2, "br": 0.002},
    {
        "bodies": {
            "rotor": {"mass": 0.3, "inertia": "Jr", "position": [0, 0]},
            "arm": {"mass": "m", "inertia": "J", "position": [0.3, "-c"], "angle": "-pi/2"},
        },
        "joints": {
            "shaft": pin("ground", "rotor", [0, 0], [0, 0]),
            "pivot": pin("ground", "arm", [0.3, 0], ["-c", 0]),
            "belt": {"type": "belt", "bodies": ["rotor", "arm"], "points": [[0, 0], ["-c", 0]], "radii": [0.02, "0.02*ratio"]},
        },
        "forces": {"d": damper("ground", "arm", "b"), "motor": torque("rotor", "0.5*sin(2*t) + 0.5*sin(4.5*t)")},
    },
    {},
    {"pivot.angle": 2e-3, "shaft.angle": 4e-3},
    ("b", "J"),
)  # fmt: skip


def dry(pair: Sequence[str], magnitude: float, slip: float = 0.05) -> dict[str, Any]:
    a, b = pair
    rate = f"{b}.angular_velocity" + (f" - {a}.angular_velocity" if a != "ground" else "")
    return torque(b, f"-{magnitude}*tanh(({rate})/{slip})", None if a == "ground" else a)


def gain(factor: float) -> Sensor:
    return lambda y, t: factor * y(t)


def late(delay: float) -> Sensor:
    return lambda y, t: y(t - delay)


def fast(share: float) -> Sensor:
    return lambda y, t: y(t[0] + (1 + share) * (t - t[0]))


def drifting(rate: float) -> Sensor:
    return lambda y, t: y(t) + rate * (t - t[0])


WRONG = [
    Case("friction missing at the hub", PENDULUM, ("friction in the joint 'hub'",), values={"b1": 0.0}, free=("b2", "J1", "J2")),
    Case("friction missing in the elbow", PENDULUM, ("friction in the joint 'elbow'",), values={"b2": 0.0}, free=("b1", "J1", "J2"), correlation=0.6),
    Case("dry friction at the hub taken as viscous", PENDULUM, ("friction in the joint 'hub'",), true={"forces": {"dry": dry(("ground", "a"), 0.15)}}),
    Case("dry friction in the elbow taken as viscous", PENDULUM, ("friction in the joint 'elbow'",), true={"forces": {"dry": dry(("a", "b"), 0.04)}}, correlation=0.6),
    Case("wrong inertia of the lower arm", PENDULUM, ("inertia of the body 'b'",), values={"J2": 0.036}, free=("b1", "b2", "J1")),
    Case("wrong length of the upper arm", PENDULUM, ("position of the joint 'elbow' on the body 'a'",), values={"l1": 0.62}, correlation=0.6),
    Case("wrong mass of the lower arm", ARM, ("mass of the body 'lower'",), values={"m2": 1.1}),
    Case("friction missing in the guide", SLIDER, ("friction in the joint 'guide'",),
         true={"forces": {"dg": {"type": "force", "body": "slider", "value": ["-0.5*slider.vx", 0]}}}),
    Case("wrong mass of the rod", SLIDER, ("mass of the body 'rod'",), values={"m2": 1.0}, correlation=0.6),
    Case("wrong gain of the encoder", SLIDER, ("gain of the sensor of slider.x",), sensors={"slider.x": gain(1.01)}),
    Case("late encoder", SLIDER, ("delay of the sensor of slider.x",), sensors={"slider.x": late(0.004)}, correlation=0.6),
    Case("cubic spring taken as linear", FOUR_BAR, ("stiffness of the spring 'support'",),
         true={"forces": {"cubic": torque("rocker", "-8*(rocker.angle - 1.1)**3")}}),
    Case("friction missing at the rocker", FOUR_BAR, ("friction in the joint 'D'",), true={"forces": {"dd": damper("ground", "rocker", 0.05)}}, correlation=0.6),
    Case("friction missing at the rail", CART, ("friction in the joint 'rail'",), values={"bc": 0.0}, free=("M", "bp", "J")),
    Case("drag missing on the pole", CART, ("drag on the body 'pole'",), correlation=0.6,
         true={"forces": {"air": torque("pole", "-0.004*pole.angular_velocity*abs(pole.angular_velocity)")}}),
    Case("clock runs fast", CART, ("clock of the experiment 'swing'",), sensors={"cart.x": fast(0.003), "hinge.angle": fast(0.003)}),
    Case("wrong centre of mass of the pole", CART, ("centre of mass of the body 'pole'",), values={"c": 0.28}, free=("M", "bc", "bp")),
    Case("wrong gain of the elbow motor", ARM, ("gain of the load 'elbow motor'",), values={"gain": 1.08}),
    Case("drifting offset", ARM, ("drift of the sensor of elbow.angle",), sensors={"elbow.angle": drifting(0.003)}, correlation=0.6),
    Case("dry friction in the shoulder missing", ARM, ("friction in the joint 'shoulder'",), true={"forces": {"dry": dry(("ground", "upper"), 0.3)}}),
    Case("wrong mass of the upper arm", ARM, ("mass of the body 'upper'",), values={"m1": 1.8}, correlation=0.6),
    Case("wrong start", replace(PENDULUM, known=frozenset(PENDULUM.start)), ("start of the experiment 'swing'",),
         start={"b.angle": -0.88}, correlation=0.6),
    Case("dead zone of a spring", FOUR_BAR, ("stiffness of the spring 'support'",),
         true={"forces": {"gap": torque("rocker", "8*(max(-0.06, min(0.06, rocker.angle - 1.1)))")}}),
    Case("wrong ratio of the belt", BELT, ("ratio of the joint 'belt'",), values={"ratio": 4.05}),
]  # fmt: skip

SOUND = [
    Case(f"{rig.name} {seed}", rig, correlation=0.6 * (seed % 2), seed=100 + seed)
    for seed in range(7) for rig in (PENDULUM, ARM, SLIDER, FOUR_BAR, CART, BELT)
][:40]  # fmt: skip
