"""Wrong models with known places of the misfit, and sound ones: ``python -m tests.identify.wrong_models``.

Data are simulated with a true mechanism and a quarter of the step of the fit, and have white noise or autoregressive
noise with a correlation of 0.7 from sample to sample. The model that is fitted lacks an effect of the truth, has
another law or a wrong fixed number, or the sensors do not show the truth. Other parameters are estimated. Several true
effects are none of those that identifications test: friction depends on the load or has a Stribeck curve, drag acts at
the tip, and a spring is exponential. With `--robots`, all models are those of the brachiating robot of three links.

A wrong model is named rightly if the first doubt has one of the places that are stated here.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from tests.identify.synthetic_cases import SyntheticCase, synthetic_cases

import mbdkit
from mbdkit_identify.identification import Identification
from mbdkit_identify.identify import identify
from mbdkit_identify.loading import data_of as data_of_spec
from mbdkit_identify.loading import load_identify_spec

NOISES = {"white": 0.0, "ar": 0.7}
FINER = 4
"""Steps of the simulation of data for each step of the fit."""
NO_MORE: Mapping[str, Any] = {}
"""No further keys of a joint."""
BOUNDS = 5.0
"""Bounds of parameters relative to the true values, and their inverse."""


@dataclass(frozen=True)
class Wrong:
    """A wrong model of a mechanism.

    Attributes
    ----------
    case
        The true mechanism, and what is estimated.
    right
        Places of doubts that are right.
    model
        Elements of the model that differ from those of the truth, by section and name; None if the model lacks them.
    values
        Parameters of the model that differ from the truth.
    sensors
        What the sensors of the truth do: `gain` and `delay` [s] by quantity, or `clock` [s/s].
    noise
        Key of `NOISES`.
    """

    case: SyntheticCase
    right: tuple[str, ...]
    model: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    noise: str = "white"


def _case(
    model: dict[str, Any], values: dict[str, float], observed: Mapping[str, float], free: str, end: float, initial: Any
) -> SyntheticCase:
    """Return a mechanism sampled at 100 Hz; searches begin 10 % above the true values of the `free` parameters."""
    base = {
        "mbdkit": 1, "parameters": values, "model": {"name": "mechanism", **model},
        "integrator": {"name": "gauss", "stages": 2}, "time": {"end": end, "step": 0.01},
    }  # fmt: skip
    return SyntheticCase(base, observed, dict.fromkeys(free.split(), 1.1), initial=initial)


def _pin(a: str, b: str, at: list[Any], **more: Any) -> dict[str, Any]:
    return {"type": "revolute", "bodies": [a, b], "at": at, **more}


def _spring(a: str, b: str, **law: Any) -> dict[str, Any]:
    return {"type": "torsion-spring", "bodies": [a, b], **law}


def _torque(a: str, b: str, value: str) -> dict[str, Any]:
    return {"type": "torque", "body": b, "value": value} | ({} if a == "ground" else {"reaction_body": a})


def _force(body: str, x: str, y: str = "0", **more: Any) -> dict[str, Any]:
    return {"type": "force", "body": body, "value": [x, y], **more}


def double_pendulum(*, free: str = "J1 J2 c1 c2", hub: Mapping[str, Any] = NO_MORE, **forces: Any) -> SyntheticCase:
    """A free double pendulum with encoders at both links and an unknown start."""
    values = {"m2": 0.7, "J1": 0.05, "J2": 0.03, "l1": 0.5, "c1": 0.05, "c2": 0.03, "start": 0.9}
    a, b = ["0.25*sin(start)", "-0.25*cos(start)"], ["l1*sin(start)", "-l1*cos(start)"]
    model = {
        "bodies": {
            "upper": {"mass": 1.0, "inertia": "J1", "position": a, "angle": "start"},
            "lower": {"mass": "m2", "inertia": "J2", "position": [b[0], f"{b[1]} - 0.2"]},
        },
        "joints": {
            "hub": _pin("ground", "upper", [0, 0], **hub),
            "elbow": _pin("upper", "lower", b),
        },
        "forces": {
            "hub grease": _spring("ground", "upper", damping="c1"),
            "elbow grease": _spring("upper", "lower", damping="c2"), **forces,
        },
        "markers": {"tip": {"body": "lower", "point": [0, -0.2]}},
    }  # fmt: skip
    return _case(model, values, {"upper.angle": 0.003, "lower.angle": 0.004}, free, 5.0, "estimated")


def slider_crank(*, free: str = "J1 m3 c1", guide: Mapping[str, Any] = NO_MORE, **forces: Any) -> SyntheticCase:
    """A slider-crank in the vertical plane with a known torque; crank and slider are measured."""
    values = {"J1": 0.02, "m2": 0.8, "m3": 0.6, "c1": 0.05, "l1": 0.2, "gain": 1.0}
    model = {
        "bodies": {
            "crank": {"mass": 1.0, "inertia": "J1", "position": [0.1, 0]},
            "rod": {"mass": "m2", "inertia": 0.03, "position": ["l1 + 0.25", 0]},
            "slider": {"mass": "m3", "inertia": 0.01, "position": ["l1 + 0.6", 0]},
        },
        "joints": {
            "bearing": _pin("ground", "crank", [0, 0]),
            "crank pin": _pin("crank", "rod", ["l1", 0]),
            "wrist pin": _pin("rod", "slider", ["l1 + 0.6", 0]),
            "guide": {
                "type": "prismatic", "bodies": ["ground", "slider"], "at": ["l1 + 0.6", 0], "axis": [1, 0], **guide
            },
        },
        "forces": {
            "drive": _torque("ground", "crank", "gain*(1.6 + 1.2*sin(4*t) + 0.5*sin(9*t))"),
            "bearing grease": _spring("ground", "crank", damping="c1"), **forces,
        },
    }  # fmt: skip
    return _case(model, values, {"crank.angle": 0.004, "slider.x": 5e-4}, free, 3.0, None)


def four_bar(*, free: str = "J1 c1 k phi", **forces: Any) -> SyntheticCase:
    """A four-bar linkage with a torsion spring at the rocker and a known torque at the crank."""
    values = {"J1": 0.012, "c1": 0.04, "k": 9.0, "phi": 0.1, "tilt": 0.0}
    angle = "atan2(0.6, 0.8)"
    model = {
        "gravity": ["9.81*sin(tilt)", "-9.81*cos(tilt)"],
        "bodies": {
            "crank": {"mass": 0.6, "inertia": "J1", "position": [0.1, 0]},
            "coupler": {"mass": 0.8, "inertia": 0.03, "position": [0.4, 0.15], "angle": angle},
            "rocker": {"mass": 0.6, "inertia": 0.02, "position": [0.53, 0.16], "angle": "atan2(0.8, 0.6)"},
        },
        "joints": {
            "A": _pin("ground", "crank", [0, 0]), "B": _pin("crank", "coupler", [0.2, 0]),
            "C": _pin("coupler", "rocker", [0.68, 0.36]), "D": _pin("ground", "rocker", [0.38, -0.04]),
        },
        "forces": {
            "drive": _torque("ground", "crank", "1.5*sin(2.2*t) + sin(5*t)"),
            "grease": _spring("ground", "crank", damping="c1"),
            "return": _spring("ground", "rocker", stiffness="k", free_angle="phi + 0.9"), **forces,
        },
    }  # fmt: skip
    return _case(model, values, {"crank.angle": 0.004, "rocker.angle": 0.002}, free, 4.0, None)


def cart(*, free: str = "M J k b", end: float = 5.0, **forces: Any) -> SyntheticCase:
    """A cart on a spring with a pendulum and a known force."""
    values = {"M": 1.5, "m": 0.4, "J": 0.02, "c": 0.3, "k": 25.0, "b": 0.8, "bp": 0.01, "gain": 1.0}
    tether = {
        "type": "spring-damper", "bodies": ["ground", "cart"], "points": [[-1, 0], [0, 0]], "stiffness": "k",
        "free_length": 1.0,
    }  # fmt: skip
    model = {
        "bodies": {
            "cart": {"mass": "M", "inertia": 0.05, "position": [0, 0]},
            "pole": {"mass": "m", "inertia": "J", "position": [0, "-c"]},
        },
        "joints": {
            "rail": {"type": "prismatic", "bodies": ["ground", "cart"], "at": [0, 0], "axis": [1, 0]},
            "hinge": _pin("cart", "pole", [0, 0]),
        },
        "forces": {
            "push": _force("cart", "gain*(5*sin(3*t) + 4*cos(6.5*t))"),
            "tether": tether,
            "oil": _force("cart", "-b*cart.vx"),
            "hinge grease": _spring("cart", "pole", damping="bp"), **forces,
        },
    }  # fmt: skip
    return _case(model, values, {"cart.x": 0.001, "pole.angle": 0.004}, free, end, None)


def motor(*, free: str = "R K J b", **forces: Any) -> SyntheticCase:
    """A motor at a known voltage, whose current is a state, and which turns an arm under gravity."""
    values = {"R": 1.0, "K": 0.5, "J": 0.02, "b": 0.02, "gain": 1.0}
    time = 0.01 * np.arange(301)
    table = {"table": [time.tolist(), (6 * np.sin(5 * time) + 5 * np.sin(12 * time)).tolist()]}
    rate = "(gain*inputs.voltage - R*states.i - K*rotor.angular_velocity)/0.05"
    model = {
        "bodies": {"rotor": {"mass": 1.0, "inertia": "J", "position": [0, -0.1]}},
        "joints": {"shaft": _pin("ground", "rotor", [0, 0])},
        "forces": {"motor": _torque("ground", "rotor", "K*states.i - b*rotor.angular_velocity"), **forces},
        "states": {"i": {"rate": rate, "initial": 0.0}},
        "inputs": {"voltage": {"unit": "V", "hold": "linear"}},
    }
    case = _case(model, values, {"states.i": 0.08, "rotor.angle": 0.005}, free, 3.0, None)
    case.base["inputs"] = {"voltage": table}
    return case


def robot(*, free: str = "", **forces: Any) -> SyntheticCase:
    """The brachiating robot of three links, from rest, with known torques and the sensors of its records."""
    base: dict[str, Any] = deepcopy(data_of_spec(load_identify_spec("brachiating-robot").run_spec))
    time = 0.02 * np.arange(151)
    torques = {
        "tail_torque": 1.2 * np.sin(5.1 * time) + 0.5 * np.sin(11.0 * time),
        "lower_torque": 0.25 * np.sin(4.3 * time) - 0.15 * np.sin(9.0 * time),
    }
    base["inputs"] = {name: {"table": [time.tolist(), values.tolist()]} for name, values in torques.items()}
    base["time"] = {"end": 3.0, "step": 0.02}
    base["parameters"] |= {"bar_damping": 0.01, "lower_friction": 0.03, "tilt": 0.0}
    model = base["model"]
    model["gravity"] = ["9.81*sin(tilt)", "-9.81*cos(tilt)"]
    model["forces"] |= {"bar_damping": _spring("ground", "upper", damping="bar_damping"), **forces}
    model["markers"] = {"tip": {"body": "lower", "point": [0, -0.12]}}
    observed = {"tail.angle": 0.004, "joints.shoulder.angle": 0.004, "joints.elbow.angle": 0.004}
    names = free or "tail_center tail_inertia lower_inertia tail_damping lower_damping lower_friction bar_damping"
    return SyntheticCase(base, observed, dict.fromkeys(names.split(), 1.1))


def wrong_robots() -> dict[str, Wrong]:
    """Return 20 wrong models of the robot by name."""

    def without(force: str) -> dict[str, Any]:
        return {"forces": {force: None}}

    def dry(a: str, b: str, rate: str) -> dict[str, Any]:
        return _torque(a, b, f"-0.08*tanh({rate}/0.2)")

    def less(*names: str) -> str:
        every = "tail_center tail_inertia lower_inertia tail_damping lower_damping lower_friction bar_damping"
        return " ".join(name for name in every.split() if name not in names)

    def drag(body: str, size: float, at: str) -> dict[str, Any]:
        speed = f"sqrt({at}.vx**2 + {at}.vy**2 + 1e-8)"
        return _force(body, *(f"-{size}*{at}.{axis}*{speed}" for axis in ("vx", "vy")))

    shoulder, bar = ("friction in the joint 'shoulder'",), ("friction in the joint 'bar'",)
    elbow = ("friction in the joint 'elbow'",)
    gains = {
        name: (f"gain of the load '{name}_motor'", f"gain of the input '{name}_torque'") for name in ("tail", "lower")
    }
    return {
        "dry friction missing in the elbow": Wrong(
            robot(free=less("lower_friction")), elbow, without("lower_friction")
        ),
        "viscous friction missing in the shoulder": Wrong(
            robot(free=less("tail_damping")), shoulder, without("tail_damping"), noise="ar"
        ),
        "viscous friction missing in the bar": Wrong(
            _with(robot(free=less("bar_damping")), bar_damping=0.05), bar, without("bar_damping")
        ),
        "dry friction missing in the bar": Wrong(
            robot(rust=dry("ground", "upper", "upper.angular_velocity")), bar, without("rust"), noise="ar"
        ),
        "dry friction missing in the shoulder": Wrong(
            robot(rust=dry("upper", "tail", "(tail.angular_velocity - upper.angular_velocity)")), shoulder,
            without("rust"),
        ),
        "cable missing in the shoulder": Wrong(
            robot(cable=_spring("upper", "tail", stiffness=0.15)), ("stiffness in the joint 'shoulder'",),
            without("cable"), noise="ar",
        ),
        "cable missing in the elbow": Wrong(
            robot(cable=_spring("tail", "lower", stiffness=0.05)), ("stiffness in the joint 'elbow'",), without("cable")
        ),
        "torsion spring missing in the bar": Wrong(
            robot(cable=_spring("ground", "upper", stiffness=0.4)), ("stiffness in the joint 'bar'",), without("cable"),
            noise="ar",
        ),
        "drag missing at the tip of the free arm": Wrong(
            robot(air=drag("lower", 0.02, "markers.tip") | {"point": [0, -0.12]}), ("drag on the body 'lower'",),
            without("air"),
        ),
        "drag missing on the tail": Wrong(
            robot(air=drag("tail", 0.3, "tail")), ("drag on the body 'tail'",), without("air"), noise="ar"
        ),
        "inertia of the tail 15 % too large": Wrong(
            robot(free=less("tail_inertia")), ("inertia of the body 'tail'",), values={"tail_inertia": 0.115}
        ),
        "inertia of the free arm 15 % too small": Wrong(
            robot(free=less("lower_inertia")), ("inertia of the body 'lower'",), values={"lower_inertia": 0.0055},
            noise="ar",
        ),
        "mass centre of the tail 5 % too far": Wrong(
            robot(free=less("tail_center")), ("centre of mass of the body 'tail'",), values={"tail_center": 0.189}
        ),
        "mass centre of the free arm 5 % too near": Wrong(
            robot(), ("centre of mass of the body 'lower'",), values={"lower_center": 0.184}, noise="ar"
        ),
        "upper arm 2 % too long": Wrong(
            robot(), ("position of the joint 'shoulder' on the body 'upper'",), values={"arm": 0.3203}
        ),
        "gravity tilted by 2 degrees": Wrong(
            _with(robot(), tilt=np.radians(2)), ("direction of gravity",), values={"tilt": 0.0}, noise="ar"
        ),
        "motor of the tail 6 % stronger than assumed": Wrong(
            _with(robot(), tail_gain=0.954), gains["tail"], values={"tail_gain": 0.9}
        ),
        "motor of the free arm 6 % weaker than assumed": Wrong(
            _with(robot(), lower_gain=0.94), gains["lower"], values={"lower_gain": 1.0}, noise="ar"
        ),
        "gain of the encoder of the elbow 2 % too large": Wrong(
            robot(), ("gain of the sensor of joints.elbow.angle",), sensors={"joints.elbow.angle": {"gain": 1.02}}
        ),
        "inertial sensor 12 ms late": Wrong(
            robot(), ("delay of the sensor of tail.angle",), sensors={"tail.angle": {"delay": 0.012}}, noise="ar"
        ),
    }  # fmt: skip


def sound_robots() -> dict[str, SyntheticCase]:
    """Return ten mechanisms of the robot whose models are right."""
    every = wrong_robots()
    return {f"robot, {name.replace('missing', 'known')}": every[name].case for name in [*every][:10]}


PIN = {"friction": {"coefficient": 0.25, "radius": 0.03}}
GUIDE = {"friction": {"coefficient": 0.15}}
STRIBECK = "(0.5 + 0.4*exp(-(cart.vx/0.1)**2))*tanh(cart.vx/0.02)"


def wrong_models() -> dict[str, Wrong]:
    """Return the 20 wrong models by name."""

    def without(force: str) -> dict[str, Any]:
        return {"forces": {force: None}}

    def joints_of(case: SyntheticCase) -> dict[str, Any]:
        return {"joints": case.base["model"]["joints"]}

    return {
        "viscous friction missing in the elbow": Wrong(
            double_pendulum(free="J1 J2 c1"), ("friction in the joint 'elbow'",), without("elbow grease"), noise="ar"
        ),
        "dry friction in the hub taken as viscous": Wrong(
            double_pendulum(hub=PIN), ("friction in the joint 'hub'",), joints_of(double_pendulum())
        ),
        "torsion spring missing at the hub": Wrong(
            double_pendulum(cable=_spring("ground", "upper", stiffness=0.25)), ("stiffness in the joint 'hub'",),
            without("cable"), noise="ar",
        ),
        "air drag missing at the tip": Wrong(
            double_pendulum(air=_force(
                "lower", *(f"-0.03*{v}*sqrt(markers.tip.vx**2 + markers.tip.vy**2 + 1e-8)" for v in (
                    "markers.tip.vx", "markers.tip.vy")), point=[0, -0.2])),
            ("drag on the body 'lower'",), without("air"),
        ),
        "inertia of the lower link 15 % too large": Wrong(
            double_pendulum(free="J1 c1 c2"), ("inertia of the body 'lower'",), values={"J2": 0.0345}, noise="ar"
        ),
        "dry friction missing in the guide": Wrong(
            slider_crank(guide=GUIDE), ("friction in the joint 'guide'",), joints_of(slider_crank())
        ),
        "crank 2 % too long": Wrong(
            slider_crank(), ("position of the joint 'crank pin' on the body 'crank'",), values={"l1": 0.204}, noise="ar"
        ),
        "mass of the slider 15 % too small": Wrong(
            slider_crank(free="J1 c1"), ("mass of the body 'slider'",), values={"m3": 0.51}
        ),
        "drive 8 % stronger than commanded": Wrong(
            _with(slider_crank(), gain=1.08), ("gain of the load 'drive'",), values={"gain": 1.0}, noise="ar"
        ),
        "viscous friction missing at the rocker": Wrong(
            four_bar(grit=_spring("ground", "rocker", damping=0.08)), ("friction in the joint 'D'",), without("grit")
        ),
        "hardening spring taken as linear": Wrong(
            four_bar(hard=_torque("ground", "rocker", "-12*(rocker.angle - 1.0)**3")),
            ("stiffness of the spring 'return'", "stiffness in the joint 'D'"), without("hard"), noise="ar",
        ),
        "gravity tilted by 3 degrees": Wrong(
            _with(four_bar(), tilt=np.radians(3)), ("direction of gravity",), values={"tilt": 0.0}
        ),
        "Stribeck friction of the rail taken as viscous": Wrong(
            cart(seal=_force("cart", f"-{STRIBECK}")), ("friction in the joint 'rail'",), without("seal"), noise="ar"
        ),
        "centre of mass of the pole 5 % too near": Wrong(
            cart(free="J k b"), ("centre of mass of the body 'pole'",), values={"c": 0.285}
        ),
        "gain of the encoder of the pole 2 % too large": Wrong(
            cart(), ("gain of the sensor of pole.angle",), sensors={"pole.angle": {"gain": 1.02}}, noise="ar"
        ),
        "exponential tether taken as linear": Wrong(
            cart(elastic=_force("cart", "-25*(0.5*(exp(cart.x/0.5) - 1) - cart.x)")),
            ("stiffness of the spring 'tether'", "stiffness in the joint 'rail'"), without("elastic"),
        ),
        "encoder of the pole 4 ms late": Wrong(
            cart(), ("delay of the sensor of pole.angle",), sensors={"pole.angle": {"delay": 0.004}}, noise="ar"
        ),
        "clock 0.2 % slow": Wrong(cart(end=8.0), ("clock of the experiment 'record'",), sensors={"clock": 1.002}),
        "dry friction of the shaft taken as viscous": Wrong(
            motor(seal=_torque("ground", "rotor", "-0.15*tanh(rotor.angular_velocity/0.1)")),
            ("friction in the joint 'shaft'",), without("seal"), noise="ar",
        ),
        "amplifier 5 % stronger than assumed": Wrong(
            _with(motor(free="K J b"), gain=1.05), ("gain of the input 'voltage'",), values={"gain": 1.0}
        ),
    }  # fmt: skip


def sound_cases() -> dict[str, SyntheticCase]:
    """Return ten mechanisms whose models are right; with both noises and two seeds, they are 40 sets of data."""
    hard = four_bar(hard=_torque("ground", "rocker", "-12*(rocker.angle - 1.0)**3"))
    return synthetic_cases() | {
        "pendulum with pin friction": double_pendulum(hub=PIN, cable=_spring("ground", "upper", stiffness=0.25)),
        "vertical slider-crank with friction": slider_crank(guide=GUIDE),
        "four-bar linkage with a hard spring": hard,
        "cart with Stribeck friction": cart(seal=_force("cart", f"-{STRIBECK}")),
    }


def _with(case: SyntheticCase, **values: float) -> SyntheticCase:
    """Return a case with other true values."""
    return SyntheticCase(
        case.base | {"parameters": case.base["parameters"] | values}, case.deviations, case.starts, case.initial
    )


def data_of(case: SyntheticCase, sensors: Mapping[str, Any], correlation: float, seed: int) -> np.ndarray:
    """Return times and measured values (T, 1 + Q)."""
    section = case.base["time"]
    step, count = section["step"], round(section["end"] / section["step"]) + 1
    fine = case.base | {"time": {"end": section["end"], "step": step / FINER}}
    times = step * np.arange(count)
    values = mbdkit.sensitivities(fine, [*case.deviations], times, [*case.base["parameters"]][:1]).values
    dice, columns = np.random.default_rng(seed), [times * sensors.get("clock", 1.0)]
    for (quantity, deviation), value in zip(case.deviations.items(), values, strict=True):
        noise = dice.normal(size=count)
        for k in range(1, count):
            noise[k] = correlation * noise[k - 1] + np.sqrt(1 - correlation**2) * noise[k]
        known = case.sensors.get(quantity, {})
        value = known.get("gain", 1.0) * value + case.of_sensors.get(known.get("offset", ""), 0.0)
        own = sensors.get(quantity, {})
        value = make_interp_spline(times, value, k=5)(np.maximum(times - own.get("delay", 0.0), 0.0))
        columns.append(own.get("gain", 1.0) * value + deviation * noise)
    return np.column_stack(columns)


def identified(case: SyntheticCase, base: dict[str, Any], data: np.ndarray) -> Identification:
    """Return the identification of a model from data."""
    with tempfile.TemporaryDirectory() as folder:
        file, headings = Path(folder) / "record.csv", ["time", *map(str, range(data.shape[1] - 1))]
        np.savetxt(file, data, delimiter=",", header=",".join(headings), comments="")
        spec = case.spec(str(file), "linear") | {"base": base}
        for name, one in spec["parameters"].items():
            one["bounds"] = [case.truth[name] / BOUNDS, case.truth[name] * BOUNDS]
        return identify(spec)


def judge_wrong(name: str, seed: int) -> tuple[bool, Identification]:
    """Return whether the first doubt about a wrong model has a right place, and the identification."""
    wrong = {**wrong_models(), **wrong_robots()}[name]
    base = deepcopy(wrong.case.base)
    for section, elements in wrong.model.items():
        base["model"][section] = {k: v for k, v in (base["model"][section] | elements).items() if v is not None}
    base["parameters"] |= wrong.values
    fit = identified(wrong.case, base, data_of(wrong.case, wrong.sensors, NOISES[wrong.noise], seed))
    return fit.verdict == "doubtful" and fit.doubts[0].place in wrong.right, fit


def judge_sound(name: str, noise: str, seed: int) -> tuple[bool, Identification]:
    """Return whether a sound model is doubtful, and the identification."""
    case = {**sound_cases(), **sound_robots()}[name]
    fit = identified(case, case.base, data_of(case, {}, NOISES[noise], seed))
    return fit.verdict != "good", fit


def campaign(seed: int, *, robots: bool = False) -> tuple[list[tuple[Any, ...]], list[tuple[Any, ...]]]:
    """Return names and seeds of the 20 wrong models, and names, noises and seeds of the 40 sound sets of data."""
    models, sounds = (wrong_robots(), sound_robots()) if robots else (wrong_models(), sound_cases())
    wrong = [(name, seed + k) for k, name in enumerate(models)]
    sound = [(name, noise, seed + k) for name in sounds for noise in NOISES for k in (100, 101)]
    return wrong, sound


def main() -> None:
    """Print the doubts about all models."""
    parser = argparse.ArgumentParser(prog="python -m tests.identify.wrong_models")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--robots", action="store_true", help="models of the brachiating robot")
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.jobs) as pool:
        for judge, cases in zip((judge_wrong, judge_sound), campaign(asked.seed, robots=asked.robots), strict=True):
            count = 0
            for case, (is_counted, fit) in zip(cases, pool.map(judge, *zip(*cases, strict=True)), strict=True):
                count += is_counted
                print(f"{'*' if is_counted else ' '} {', '.join(map(str, case))}: {fit.verdict}, {fit.seconds:.1f} s")
                for doubt in fit.doubts:
                    print(f"      [{doubt.place}] {doubt.text}", flush=True)
            print(f"{judge.__name__}: {count} of {len(cases)}", flush=True)


if __name__ == "__main__":
    main()
