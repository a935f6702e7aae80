"""The runs of the packaged study `misfit`: a leg without mass moves as in a packaged example and wears a device.

Because thigh and shank have hardly any mass, the force in the knee is that which the device adds: the device's weight,
inertia and spring, and what the misfit of its axis presses through the cuffs. The torque of the driver at the knee is
the help that arrives there. In a person, both are added to the force and the moment without the device, while motion
and ground force stay as they are.

Each coordinate of the limbs is a Fourier series in time that is fitted to the motion of the example, so that it has no
discontinuities at which steps would have to end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mbdkit
from mbdkit import load_spec
from mbdkit.plugin import Mechanism
from mbdkit.plugin.specs import read_source
from mbdkit_wearable.device import turned

#: Models of devices by the name in families of the study.
DEVICES: Mapping[str, str] = {
    "hinge": "hinge-orthosis", "four-bar": "four-bar-orthosis", "self-aligning": "self-aligning-orthosis",
}  # fmt: skip

#: Misfit of the device forward and upward [m] and its rotation [rad], and factor of the stiffness of the cuffs.
VARIABLES: Mapping[str, object] = {
    "parameters.forward": {"uniform": [-0.03, 0.03]},
    "parameters.upward": {"uniform": [-0.03, 0.03]},
    "parameters.turn": {"uniform": [-np.pi / 18, np.pi / 18]},
    "parameters.tissue": {"loguniform": {"a": 1 / 3, "b": 3.0}},
}

MEMBERS, FEW = 64, 4  #: Number of members of each sample, and that of the short form.

HARMONICS = 8  #: Number of harmonics of the series.

#: Time before a stride in which vibrations of the start decay [s]; measures do not contain them. A squat needs none: it
#: begins in the straight posture, in which the tissue is at rest.
SETTLING = 0.25


@dataclass(frozen=True)
class LimbSeries:
    """The motion of a leg: duration and time to settle before it [s], position and angle (T, 3) of the thigh, and angle
    (T,) of the shank, at times (T,), and the mechanism of the leg.
    """

    duration: float
    settling: float
    time: np.ndarray
    thigh: np.ndarray
    shank: np.ndarray
    leg: Mechanism

    def series(self, values: np.ndarray) -> tuple[str, float, float]:
        """Return a Fourier series with a linear term as an expression of time, and its value and rate at the start of
        runs, before the motion of the example.
        """
        w = 2 * np.pi / self.duration
        columns = [np.ones_like(self.time), self.time / self.duration]
        texts = ["1", f"t/{self.duration!r}"]
        for k in range(1, HARMONICS + 1):
            columns += [np.cos(k * w * self.time), np.sin(k * w * self.time)]
            texts += [f"{name}({k}*2*pi*t/{self.duration!r})" for name in ("cos", "sin")]
        factors = np.linalg.lstsq(np.column_stack(columns), values, rcond=None)[0]
        text = " + ".join(f"({factor:.8g})*{text}" for factor, text in zip(factors, texts, strict=True))
        rates, (a, b) = w * np.arange(1, HARMONICS + 1), (factors[2::2], factors[3::2])
        c, s = np.cos(-rates * self.settling), np.sin(-rates * self.settling)
        value = factors[0] - factors[1] * self.settling / self.duration + np.sum(a * c + b * s)
        return text, float(value), float(factors[1] / self.duration + np.sum(rates * (b * c - a * s)))


def squat() -> LimbSeries:
    """Return the motion of the example `squat`."""
    spec = load_spec("squat")
    run = mbdkit.run(spec)
    return _limbs(run, spec.mechanism(), np.arange(len(run.time)), 0.0)


def walking() -> LimbSeries:
    """Return the first stride of the example `walking`."""
    document = read_source("walking")
    motion = document.data["motion"]
    motion |= {"errors": "none", "file": str(document.folder / motion["file"])}
    run = mbdkit.inverse(document.data)
    time, height = np.asarray(run.time), run["thigh"].angle
    # a stride is the time after which the motion is most like that at its beginning, between 0.8 and 1.5 s
    lags = np.flatnonzero((time - time[0] > 0.8) & (time - time[0] < 1.5))
    differences = [np.sum((height[lag:] - height[: len(height) - lag]) ** 2) / (len(height) - lag) for lag in lags]
    return _limbs(run, load_spec("squat").mechanism(), np.arange(int(lags[int(np.argmin(differences))]) + 1), SETTLING)


def _limbs(run: Any, leg: Mechanism, rows: np.ndarray, settling: float) -> LimbSeries:
    time = np.asarray(run.time)[rows]
    thigh = np.column_stack([np.asarray(run["thigh"].position), run["thigh"].angle])[rows]
    shank = np.asarray(run["shank"].angle)[rows]
    return LimbSeries(float(time[-1] - time[0]), settling, time - time[0], thigh, shank, leg)


MOTIONS = {"squat": squat, "walking": walking}


def base(motion: LimbSeries, device: str) -> dict[str, Any]:
    """Return the run spec of a leg without mass that wears a device."""
    knee = motion.leg.joints["knee"]
    assert knee.points is not None
    thigh_point, shank_point = knee.points
    series = [motion.series(values) for values in motion.thigh.T]
    flexion, bent, bending = motion.series(motion.shank - motion.thigh[:, 2])
    (x, y, angle), (vx, vy, spin) = ([one[k] for _, *one in series] for k in range(2))
    bend, turning = angle + bent, spin + bending
    arms = turned(angle, thigh_point), turned(bend, shank_point)
    shank = x + arms[0][0] - arms[1][0], y + arms[0][1] - arms[1][1]
    rate = vx - spin * arms[0][1] + turning * arms[1][1], vy + spin * arms[0][0] - turning * arms[1][0]
    spec = read_source(Path(__file__).with_name("leg.yaml")).data
    model: dict[str, Any] = spec["model"]
    thigh, lower_leg = model["bodies"].values()
    thigh |= {"position": [x, y], "angle": angle, "velocity": [vx, vy], "angular_velocity": spin}
    lower_leg |= {"position": list(shank), "angle": bend, "velocity": list(rate), "angular_velocity": turning}
    for axis, (text, *_) in zip(("x", "y", "angle"), series, strict=True):
        model["joints"][f"thigh_{axis}"]["motion"] = text
    model["joints"]["knee"]["points"] = [list(thigh_point), list(shank_point)]
    model["joints"]["flexion"]["motion"] = flexion
    brace = model["devices"]["brace"]
    brace["mechanism"]["name"], arm = DEVICES[device], 0.09 * brace["mechanism"]["height"]
    brace["attach"]["upper"]["at"] = [thigh_point[0], thigh_point[1] + arm]
    brace["attach"]["lower"]["at"] = [shank_point[0], shank_point[1] - arm]
    spec["time"] |= {"start": -motion.settling, "end": motion.duration}
    return spec


def study(quick: bool) -> dict[str, object]:
    """Return the spec of the study; `quick`: with few members."""
    size = FEW if quick else MEMBERS
    motions = {name: make() for name, make in MOTIONS.items()}
    return {
        "mbdkit_study": 1,
        "verdict": "misfit",
        "title": "Misfit of three orthoses of the knee" + (", short form" if quick else ""),
        "sample": {"n": size, "method": "sobol", "seed": 1, "design": "saltelli", "variables": VARIABLES},
        "store": "summary",
        "families": {
            f"{name}-{device}": {"title": f"{device} orthosis, {name}", "base": base(motion, device)}
            for name, motion in motions.items()
            for device in DEVICES
        },
    }
