"""Random data sets of measured motion and loads, and faults that such data have, for the verdict on measured data."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit import MbdkitError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import doubts_about_data
from mbdkit_biomech.inverse_dynamics.errors.error_bars import error_bars
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.benchmarks.drawn_mechanisms import RATE, Drawn, draw
from tests.benchmarks.drawn_plate_faults import glitch, lost_point

SETS = (
    ("chain", "exact"),
    ("chain", "other"),
    ("chain", "markers"),
    ("four-bar", "more"),
    ("five-bar", "markers"),
    ("plate", "exact"),
    ("biped", "exact"),
    ("biped", "markers"),
)
"""Kinds of data sets; `plate` is a chain whose last link stands on a force plate for a part of the time."""

CHANGED, WITHOUT_BAR = 0.05, 0.05
"""A result is changed if an actuator exceeds its bar in more than this share of the frames; without a bar, it is the
second share of the largest value."""


@dataclass
class DataSet:
    """A spec of inverse dynamics with its data, and what these contain."""

    drawn: Drawn
    spec: dict[str, Any]
    cutoff: float

    @property
    def motion(self) -> dict[str, Any]:
        """The section `motion`."""
        found: dict[str, Any] = self.spec["motion"]
        return found

    @property
    def data(self) -> dict[str, np.ndarray]:
        """The columns of the motion."""
        found: dict[str, np.ndarray] = self.motion["data"]
        return found

    @property
    def loads(self) -> dict[str, Any]:
        """The section `loads`."""
        return self.spec.get("loads", {})

    @property
    def is_free(self) -> bool:
        """Whether the mechanism is free in the plane, so that loads must balance its motion."""
        return self.drawn.kind == "biped"

    @property
    def has_more(self) -> bool:
        """Whether there are more columns than degrees of freedom."""
        return self.drawn.columns in ("more", "markers")

    def names(self, ending: tuple[str, ...] = (".x", ".y", ".angle")) -> list[str]:
        """Return the names of the columns of the motion with one of these endings."""
        return [name for name in self.data if name.endswith(ending)]


def data_set(number: int) -> DataSet:
    """Return the data set of a number: a mechanism, its motion and loads with noise, and a smoothing."""
    random = np.random.default_rng(number)
    kind, columns = SETS[number % len(SETS)]
    drawn = draw(random, "chain" if kind == "plate" else kind, columns)
    loads: dict[str, Any] = {}
    if kind == "plate":
        loads = _stance(drawn, random)
    elif kind == "biped":
        loads = _two_plates(drawn, random)
    deviation, cutoff = 10 ** random.uniform(-3.5, -2.5), drawn.highest * random.uniform(2.5, 5.0)
    butterworth = {"name": "butterworth", "cutoff": cutoff}
    smooth = (butterworth, {"name": "opensim", "cutoff": cutoff}, {"name": "spline"})[random.integers(3)]
    stated = {"deviation": deviation} if random.random() < 0.5 else {}
    names = [name for name in drawn.values if name != "time"]
    data = {name: drawn.values[name] + deviation * random.standard_normal(len(drawn.values["time"])) for name in names}
    motion = {
        "data": {"time": drawn.values["time"], **data},
        "columns": {name: {"column": name, **stated} for name in names},
        "smooth": smooth,
        "errors": {"samples": 30},
    }
    spec = {"mbdkit": 1, "model": drawn.model, "actuators": drawn.actuators, "motion": motion}
    spec["accept"] = ["ends"]  # peaks near an end of a record are no fault of its data
    return DataSet(drawn, spec | ({"loads": loads} if loads else {}), cutoff)


def _load(drawn: Drawn, random: np.random.Generator, body: str, force: np.ndarray, point: np.ndarray) -> dict[str, Any]:
    """Return a load with noise, whose point is in the global frame, and missing while there is no force."""
    acts, peak = np.any(force != 0, axis=1), np.max(np.abs(force))
    noisy = force + acts[:, None] * 0.003 * peak * random.standard_normal(force.shape)
    at = point + 0.002 * random.standard_normal(point.shape)
    columns = {"fx": noisy[:, 0], "fy": noisy[:, 1], "px": at[:, 0], "py": at[:, 1]}
    data = {name: np.where(acts, x, np.nan if name[0] == "p" else 0.0) for name, x in columns.items()}
    noise = {"fx": 0.003 * peak, "fy": 0.003 * peak, "px": 0.002, "py": 0.002}
    column = {name: {"column": name, "deviation": deviation} for name, deviation in noise.items()}
    return {
        "body": body,
        "data": {"time": drawn.values["time"], **data},
        "force": [column["fx"], column["fy"]],
        "point": [column["px"], column["py"]],
    }


def _along(pose: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return points (T, 2) of a body at `x` (T,) on its axis."""
    return pose[:, :2] + x[:, None] * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)


def _stance(drawn: Drawn, random: np.random.Generator) -> dict[str, Any]:
    """Return a load on the last link, up to 20 times its weight, that moves from one end to the other."""
    body, time = list(drawn.poses)[-1], drawn.values["time"]
    phase = np.sin(2 * np.pi * 0.8 * time + random.uniform(0, 2 * np.pi))
    up = random.uniform(5, 20) * 9.81 * drawn.model["bodies"][body]["mass"] * np.maximum(0.0, phase) ** 0.5
    reach = 0.4 * _length(drawn, body)
    force = np.stack([0.15 * up * np.cos(5 * time), up], axis=1)
    return {"plate": _load(drawn, random, body, force, _along(drawn.poses[body], reach * np.cos(3 * time)))}


def _length(drawn: Drawn, body: str) -> float:
    markers = [one["point"] for one in drawn.model["markers"].values() if one["body"] == body]
    return float(max(abs(x) for x, _ in markers)) / 0.4


def _two_plates(drawn: Drawn, random: np.random.Generator) -> dict[str, Any]:
    """Return the forces on both feet that balance the motion, each foot being in the air for some time."""
    time, (x, y, _) = drawn.values["time"], drawn.poses["link0"].T
    fx, fy, moment = (drawn.torques[f"root.{axis}"] for axis in ("x", "y", "angle"))
    about_origin = moment + x * fy - y * fx
    wave = np.sin(2 * np.pi * random.uniform(0.5, 0.9) * time + random.uniform(0, 6))
    share = np.clip(0.5 + 0.8 * wave, 0.0, 1.0)
    feet = {"left": share, "right": 1 - share}
    # both points move along their feet by the same distance, so that the moments balance as well
    centres = {side: drawn.poses[f"foot {side}"][:, 0] for side in feet}
    along = (about_origin - sum(part * centres[side] * fy for side, part in feet.items())) / fy
    drawn.torques |= {f"root.{axis}": 0 * time for axis in ("x", "y", "angle")}
    found = {}
    for side, part in feet.items():
        point = np.stack([centres[side] + along, 0 * time], axis=1)
        found[side] = _load(drawn, random, f"foot {side}", part[:, None] * np.stack([fx, fy], axis=1), point)
    return found


Fault = Callable[[DataSet, np.random.Generator], bool | None]
"""Changes a data set in place; returns whether something in data or model contradicts it, or None if there is no such
fault in this data set."""


def degrees(one: DataSet, random: np.random.Generator) -> bool | None:
    """Angles in degrees without a unit."""
    names = one.names((".angle",))
    for name in names:
        one.data[name] = np.degrees(one.data[name])
    return True if names else None


def millimetres(one: DataSet, random: np.random.Generator) -> bool | None:
    """Lengths in millimetres without a unit."""
    names = one.names((".x", ".y"))
    for name in names:
        one.data[name] = 1000 * one.data[name]
    return True if names else None


def frame_of_load(one: DataSet, random: np.random.Generator) -> bool | None:
    """Points of application in the frame of a laboratory."""
    for load in one.loads.values():
        load["data"]["px"] = load["data"]["px"] + random.uniform(0.7, 2.0)
    return True if one.loads else None


def frame_of_markers(one: DataSet, random: np.random.Generator) -> bool | None:
    """Markers in a frame that is turned by a quarter turn; a pinned chain may hang that way as well."""
    if one.drawn.columns != "markers":
        return None
    for name in one.names((".x",)):
        other = name[:-2] + ".y"
        one.data[name], one.data[other] = -one.data[other], one.data[name]
    return one.drawn.kind != "chain"


def sign_of_load(one: DataSet, random: np.random.Generator) -> bool | None:
    """Forces on the plate in place of those on the body."""
    for load in one.loads.values():
        for name in ("fx", "fy"):
            load["data"][name] = -load["data"][name]
    return True if one.loads else None


def exchanged_columns(one: DataSet, random: np.random.Generator) -> bool | None:
    """Two columns of one kind exchanged; nothing contradicts it if there are no more columns than needed."""
    names = one.names((".angle",)) if one.drawn.columns == "exact" else one.names((".x",))
    if len(names) < 2:
        return None
    first, second = random.permutation(len(names))[:2]
    a, b = names[first], names[second]
    one.data[a], one.data[b] = one.data[b], one.data[a]
    return one.has_more


def mirrored_column(one: DataSet, random: np.random.Generator) -> bool | None:
    """A column with the wrong sign."""
    name = one.names()[random.integers(len(one.names()))]
    one.data[name] = -one.data[name]
    return one.has_more


def wrap(one: DataSet, random: np.random.Generator) -> bool | None:
    """An angle that jumps by a turn in the middle of its range, with empty cells there."""
    names = one.names((".angle",))
    if not names:
        return None
    name = names[random.integers(len(names))]
    x = one.data[name]
    wrapped = np.mod(x - np.median(x), 2 * np.pi)
    jumps = np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi)
    inside = jumps[(jumps > 5) & (jumps < len(x) - 6)]
    column = (wrapped + np.median(x)).astype(object)
    for at in inside[:2]:
        column[at - 1 : at + 3] = None
    one.data[name] = column
    one.motion["gaps"] = {"longest": 0.1}
    return True


def filled_gap(one: DataSet, random: np.random.Generator) -> bool | None:
    """A gap of 0.1 to 0.3 s filled with zeros, or with the value before it."""
    name = one.names()[random.integers(len(one.names()))]
    x = one.data[name].copy()
    long = int(random.uniform(0.1, 0.3) * RATE)
    at = int(random.integers(len(x) // 5, len(x) - len(x) // 5 - long))
    x[at : at + long] = 0.0 if random.random() < 0.5 else x[at - 1]
    one.data[name] = x
    return True


def jitter(one: DataSet, random: np.random.Generator) -> bool | None:
    """Times with jitter, though the samples were taken evenly."""
    time = one.data["time"]
    one.data["time"] = time + random.uniform(0.05, 0.3) / RATE * random.uniform(-1, 1, len(time))
    if one.motion["smooth"]["name"] == "butterworth" and random.random() < 0.7:
        one.motion["smooth"] = {"name": "spline"}
    return _cut_to_loads(one)


def rounded_times(one: DataSet, random: np.random.Generator) -> bool | None:
    """Times rounded to the millisecond."""
    one.data["time"] = np.round(one.data["time"], 3)
    if one.motion["smooth"]["name"] == "butterworth" and random.random() < 0.7:
        one.motion["smooth"] = {"name": ("spline", "quintic")[random.integers(2)]}
    return _cut_to_loads(one)


def _cut_to_loads(one: DataSet) -> bool:
    if one.loads:
        time = one.drawn.values["time"]
        one.spec["time"] = {"start": float(time[1]), "end": float(time[-2])}
    return True


def late_load(one: DataSet, random: np.random.Generator) -> bool | None:
    """Loads that are late by 20 to 50 ms; on the ground, nothing contradicts this unless they leave the sole."""
    _delay(one, random.uniform(0.02, 0.05))
    return one.is_free if one.loads else None


def very_late_load(one: DataSet, random: np.random.Generator) -> bool | None:
    """Loads that are late by 50 to 100 ms."""
    _delay(one, random.uniform(0.05, 0.1))
    return True if one.loads else None


def _delay(one: DataSet, late: float) -> None:
    for load in one.loads.values():
        time = load["data"]["time"]
        for name in ("fx", "fy", "px", "py"):
            x = load["data"][name]
            known = ~np.isnan(x)
            load["data"][name] = np.interp(time - late, time[known], x[known])


def offset_of_plate(one: DataSet, random: np.random.Generator) -> bool | None:
    """A constant force of 2 to 10 % of the peak in addition."""
    for load in one.loads.values():
        data = load["data"]
        peak = np.max(np.abs(data["fy"]))
        data["fy"] = data["fy"] + random.uniform(0.02, 0.1) * peak
        for name in ("px", "py"):  # the point is known at all times then, as it seems
            known = ~np.isnan(data[name])
            data[name] = np.interp(data["time"], data["time"][known], data[name][known])
        break
    return True if one.loads else None


def scale_of_plate(one: DataSet, random: np.random.Generator) -> bool | None:
    """Forces that are wrong by 15 to 40 %."""
    factor = 1 + random.choice([-1, 1]) * random.uniform(0.15, 0.4)
    for load in one.loads.values():
        for name in ("fx", "fy"):
            load["data"][name] = factor * load["data"][name]
    return one.is_free if one.loads else None


def point_off_foot(one: DataSet, random: np.random.Generator) -> bool | None:
    """A centre of pressure that is wrong by 0.8 to 1.5 lengths of the body."""
    for load in one.loads.values():
        far = random.uniform(0.8, 1.5) * _length(one.drawn, load["body"])
        load["data"]["px"] = load["data"]["px"] + random.choice([-1, 1]) * far
        break
    return True if one.loads else None


def wrong_foot(one: DataSet, random: np.random.Generator) -> bool | None:
    """Loads on another body."""
    if not one.loads:
        return None
    if "plate" in one.loads:
        bodies = list(one.drawn.poses)
        one.loads["plate"]["body"] = bodies[0]
        return True if len(bodies) > 2 else None
    one.loads["left"]["body"], one.loads["right"]["body"] = "foot right", "foot left"
    return True


def exchanged_markers(one: DataSet, random: np.random.Generator) -> bool | None:
    """Two markers exchanged for 0.2 to 0.5 s."""
    markers = [name[:-2] for name in one.names((".x",)) if name[:-2] + ".y" in one.data]
    markers = [name for name in markers if name in one.drawn.model["markers"]]
    if len(markers) < 2:
        return None
    first, second = (markers[place] for place in random.permutation(len(markers))[:2])
    count = len(one.data["time"])
    long = int(random.uniform(0.2, 0.5) * RATE)
    at = int(random.integers(0, count - long))
    for axis in (".x", ".y"):
        a, b = one.data[first + axis].copy(), one.data[second + axis].copy()
        a[at : at + long], b[at : at + long] = b[at : at + long].copy(), a[at : at + long].copy()
        one.data[first + axis], one.data[second + axis] = a, b
    return True


def outliers(one: DataSet, random: np.random.Generator) -> bool | None:
    """One to three samples that are off by 5 to 50 % of the range."""
    name = one.names()[random.integers(len(one.names()))]
    x = one.data[name].copy()
    for _ in range(random.integers(1, 4)):
        x[random.integers(10, len(x) - 10)] += random.choice([-1, 1]) * random.uniform(0.05, 0.5) * np.ptp(x)
    one.data[name] = x
    return True


def constant_column(one: DataSet, random: np.random.Generator) -> bool | None:
    """A column that stays constant, the whole time or from some time on."""
    name = one.names()[random.integers(len(one.names()))]
    x = one.data[name].copy()
    at = 0 if random.random() < 0.5 else int(random.integers(len(x) // 3, len(x) - len(x) // 4))
    x[at:] = x[at]
    one.data[name] = x
    return len(one.names()) > 1


def inertia_unit(one: DataSet, random: np.random.Generator) -> bool | None:
    """An inertia in kg cm^2, without its unit, of a body with a mass and a length like the others."""
    bodies = list(one.drawn.poses)
    body = one.spec["model"]["bodies"][bodies[random.integers(len(bodies))]]
    body["inertia"] = 1e4 * body["inertia"]
    return True


def torque_unit(one: DataSet, random: np.random.Generator) -> bool | None:
    """Free torques of plates, of up to 2 % of the force times the length of the body, in N mm without a unit."""
    for load in one.loads.values():
        data, length = load["data"], _length(one.drawn, load["body"])
        data["mz"] = 1000 * 0.02 * length * data["fy"] * np.sin(4 * data["time"] + random.uniform(0, 6))
        load["torque"] = "mz"
    return True if one.loads else None


def neighbouring_body(one: DataSet, random: np.random.Generator) -> bool | None:
    """Loads on the neighbour of their body, as on a shank in place of its foot."""
    bodies = list(one.drawn.poses)
    for load in one.loads.values():
        load["body"] = load["body"].replace("foot", "shank") if one.is_free else bodies[-2:][0]
    return True if one.loads and len(bodies) > 1 else None


def low_cutoff(one: DataSet, random: np.random.Generator) -> bool | None:
    """A cutoff of 0.3 to 0.6 times the highest frequency of the motion."""
    smooth = one.motion["smooth"]
    if "cutoff" not in smooth:
        return None
    one.motion["smooth"] = smooth | {"cutoff": random.uniform(0.3, 0.6) * one.drawn.highest}
    return True


FAULTS: dict[str, Fault] = {
    fault.__name__: fault
    for fault in (
        degrees,
        millimetres,
        frame_of_load,
        frame_of_markers,
        sign_of_load,
        exchanged_columns,
        mirrored_column,
        wrap,
        filled_gap,
        jitter,
        rounded_times,
        late_load,
        offset_of_plate,
        scale_of_plate,
        point_off_foot,
        wrong_foot,
        exchanged_markers,
        outliers,
        constant_column,
        inertia_unit,
        torque_unit,
        low_cutoff,
        neighbouring_body,
        glitch,
        lost_point,
        very_late_load,
    )
}


NEEDS_NEWTON = ("late_load", "scale_of_plate", "very_late_load")
"""Faults that only the motion of a free mechanism contradicts, if its residual forces exceed their noise."""


@dataclass(frozen=True)
class Answer:
    """What mbdkit says of a data set: refused, or doubts; values and bars of the actuators, (T, U), if not refused."""

    refused: str
    doubts: tuple[str, ...]
    names: list[str]
    time: np.ndarray
    values: np.ndarray
    bars: np.ndarray


def answer(one: DataSet) -> Answer:
    """Compute a data set."""
    loads = {
        name: load | {"data": {key: np.where(np.isnan(x), None, x) for key, x in load["data"].items()}}
        for name, load in one.loads.items()
    }
    try:
        result = compute(InverseProblem.of(load_inverse_spec(one.spec | ({"loads": loads} if loads else {}), ())))
        doubts = doubts_about_data(result, None).open  # bars take most of the time
        if one.is_free:  # noise may explain residual forces
            doubts = tuple(doubt for doubt in doubts if not doubt.startswith("residuals:"))
        bars = None if doubts else error_bars(result)
        doubts = doubts or doubts_about_data(result, bars).open
    except MbdkitError as error:
        none = np.zeros((0, 0))
        return Answer(str(error), (), [], np.zeros(0), none, none)
    known = np.full(result.dynamics.value.shape, np.nan) if bars is None else bars.actuators
    names = [one.name for one in result.problem.actuators]
    return Answer("", doubts, names, result.motion.time, result.dynamics.value, known)


def contradicts_newton(faulty: Answer, cutoff: float) -> bool:
    """Return whether residual forces of a free mechanism, which should be zero, are larger than noise makes them."""
    ends = int(np.ceil(RATE / cutoff))
    own = [place for place, name in enumerate(faulty.names) if name.startswith("root.")]
    values, bars = (np.mean(one[ends:-ends, own] ** 2, axis=0) for one in (faulty.values, faulty.bars))
    return bool(np.any(values > bars))  # noise alone gives a quarter


def is_changed(clean: Answer, faulty: Answer, cutoff: float, share: float = CHANGED) -> bool:
    """Return whether a fault changes an actuator by more than its bar in more than a share of the frames, apart from
    the ends of the motion.
    """
    ends = int(np.ceil(RATE / cutoff))
    inside = slice(ends, -ends)
    expected = np.column_stack([np.interp(faulty.time, clean.time, one) for one in clean.values.T])
    bars = np.where(np.isnan(faulty.bars), WITHOUT_BAR * np.max(np.abs(expected), axis=0), faulty.bars)
    off = np.abs(faulty.values - expected) > bars + 1e-9 * np.max(np.abs(expected))
    return bool(np.max(np.mean(off[inside], axis=0)) > share)


@dataclass(frozen=True)
class Outcome:
    """What becomes of a fault, and what mbdkit says first.

    The word is ``none`` if a data set has no such fault; ``refused`` or ``flagged``; otherwise ``same`` if no result
    changes by more than its bar, ``hidden`` if nothing in data and model contradicts the fault, and ``silent``. Clean
    data are ``flagged`` or ``same``.
    """

    number: int
    word: str
    told: str


def outcomes(number: int, faults: Sequence[str]) -> dict[str, Outcome]:
    """Return the outcome of each fault in the data set of a number, and, as ``""``, that of its clean data."""
    with one_thread_of_linear_algebra():
        return _outcomes(number, faults)


def _outcomes(number: int, faults: Sequence[str]) -> dict[str, Outcome]:
    one = data_set(number)
    clean = answer(one)
    if clean.refused:
        raise ValueError(f"the clean data set {number} is refused: {clean.refused}")
    found = {"": Outcome(number, "flagged" if clean.doubts else "same", " | ".join(clean.doubts))}
    for fault in faults:
        faulty = DataSet(one.drawn, copy.deepcopy(one.spec), one.cutoff)
        reveals = FAULTS[fault](faulty, np.random.default_rng([number, list(FAULTS).index(fault)]))
        found[fault] = (
            Outcome(number, "none", "") if reveals is None else _outcome(faulty, clean, number, fault, reveals)
        )
    return found


def _outcome(faulty: DataSet, clean: Answer, number: int, fault: str, reveals: bool) -> Outcome:
    got = answer(faulty)
    if got.refused:
        return Outcome(number, "refused", got.refused)
    known = {doubt.partition(":")[0] for doubt in clean.doubts}
    new = [doubt for doubt in got.doubts if doubt.partition(":")[0] not in known]
    if new:
        return Outcome(number, "flagged", new[0])
    if not is_changed(clean, got, faulty.cutoff, 0.0 if fault == "glitch" else CHANGED):
        return Outcome(number, "same", "")
    if reveals and faulty.is_free and fault in NEEDS_NEWTON:
        reveals = contradicts_newton(got, faulty.cutoff)
    return Outcome(number, "silent" if reveals else "hidden", ", ".join(SETS[number % len(SETS)]))
