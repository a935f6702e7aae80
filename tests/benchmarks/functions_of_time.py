"""Drawn functions of time: corners that expressions hide, pulses far shorter than a step, and loads at rest.

``python -m tests.benchmarks.functions_of_time [--functions N] [--runs N]`` draws sums and products of triangular waves
written as ``asin(sin(...))``, ``acos(cos(...))`` or roots of squares, sawtooth waves, pulses and steps of 1e-4 to
1e-2 s, rounded corners, and smooth functions. It compares their corners with those of the closed forms and the integral
of the force of a joint, on a slide that carries such a load and does not move, with quadrature of the closed form
between all corners and pulses, for every adaptive method. A body that is free until a pulse pushes it has to have the
momentum of the pulse.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

import mbdkit
from mbdkit.mechanism.motion_corners import corners_of

END = 2.0
METHODS: tuple[dict[str, Any], ...] = (
    {"name": "dopri5", "adaptive": True},
    {"name": "dop853", "adaptive": True},
    {"name": "radau-iia", "stages": 2, "adaptive": True},
    {"name": "radau-iia", "stages": 3, "adaptive": True},
    {"name": "radau-iia", "stages": 5, "adaptive": True},
    {"name": "gauss", "stages": 3, "adaptive": True},
    {"name": "scipy-dop853"},
    {"name": "scipy-radau"},
    {"name": "scipy-lsoda"},
)
AT_CORNER = 1e-8
"""Largest error of the time of a corner [s]."""
ERROR = 1e-3
"""Largest error of an integral, relative to the integral of the absolute value."""


@dataclass(frozen=True)
class Part:
    """A function of time: its text, its closed form, the times of its corners, and further times that matter."""

    text: str
    at: Callable[[np.ndarray], np.ndarray]
    corners: tuple[float, ...] = ()
    marks: tuple[float, ...] = ()


def _multiples(rate: float, phase: float, first: float) -> tuple[float, ...]:
    """Return the times in the run at which ``rate t + phase`` is `first` plus a multiple of pi."""
    times = (first + np.pi * np.arange(-50, 200) - phase) / rate
    return tuple(times[(times > 1e-6) & (times < END - 1e-6)].tolist())


def part(draw: np.random.Generator) -> Part:
    """Draw a function of time."""
    kind = int(draw.integers(9))
    w, p = round(float(draw.uniform(2.0, 9.0)), 3), round(float(draw.uniform(0.1, 3.0)), 3)
    c, width = round(float(draw.uniform(0.2, 1.8)), 5), float(f"{10 ** draw.uniform(-4.0, -2.0):.3g}")
    x, pulse = f"({w}*t + {p})", (c - 6 * width, c - 2 * width, c, c + 2 * width, c + 6 * width)

    def triangle(t: np.ndarray) -> np.ndarray:
        return np.abs((w * t + p + np.pi / 2) % (2 * np.pi) - np.pi) - np.pi / 2

    if kind == 0:
        return Part(f"asin(sin{x})", lambda t: -triangle(t), _multiples(w, p, np.pi / 2))
    if kind == 1:
        return Part(f"acos(cos{x})", lambda t: np.abs((w * t + p + np.pi) % (2 * np.pi) - np.pi), _multiples(w, p, 0.0))
    if kind == 2:
        return Part(f"sqrt(1 - cos{x}**2)", lambda t: np.abs(np.sin(w * t + p)), _multiples(w, p, 0.0))
    if kind == 3:
        root = "sqrt((t - {})**2)" if draw.integers(2) else "((t - {})**2)**0.5"
        return Part(root.format(c), lambda t: np.abs(t - c), (c,))
    if kind == 4:
        return Part(f"atan(tan{x})", lambda t: (w * t + p + np.pi / 2) % np.pi - np.pi / 2, _multiples(w, p, np.pi / 2))
    if kind == 5:
        return Part(f"exp(-((t - {c})/{width})**2)", lambda t: np.exp(-(((t - c) / width) ** 2)), (), pulse)
    if kind == 6:
        return Part(f"tanh((t - {c})/{width})", lambda t: np.tanh((t - c) / width), (), pulse)
    if kind == 7:
        return Part(f"sqrt((t - {c})**2 + {width}**2)", lambda t: np.hypot(t - c, width), (), pulse)
    return Part(f"sin{x}", lambda t: np.sin(w * t + p))


def function(seed: int) -> Part:
    """Draw a sum of one to three functions of time, one of them perhaps times a smooth function."""
    draw = np.random.default_rng(seed)
    parts = [part(draw) for _ in range(int(draw.integers(1, 4)))]
    weights = [round(float(draw.uniform(0.5, 5.0)), 3) for _ in parts]
    r = round(float(draw.uniform(1.0, 4.0)), 3) if draw.integers(2) else 0.0
    text = " + ".join(f"{weight}*{x.text}" for weight, x in zip(weights, parts, strict=True))
    return Part(
        f"(2 + sin({r}*t))*({text})" if r else text,
        lambda t: (2.0 + np.sin(r * t) if r else 1.0) * sum(a * x.at(t) for a, x in zip(weights, parts, strict=True)),
        tuple(sorted({time for x in parts for time in x.corners})),
        tuple(sorted({time for x in parts for time in x.marks})),
    )


def wrong_corners(seed: int) -> str:
    """Return what is wrong with the corners of a drawn function; empty if they are right."""
    drawn = function(seed)
    found = [corner.time for corner in corners_of(drawn.text, 0.0, END) if corner.jumps[0] or corner.jumps[1]]
    missed = [time for time in drawn.corners if not any(abs(time - other) <= AT_CORNER for other in found)]
    false = [time for time in found if not any(abs(time - other) <= AT_CORNER for other in drawn.corners)]
    return f"{drawn.text}: missed {missed}, false {false}" if missed or false else ""


def integrals(values: Callable[[np.ndarray], np.ndarray], marks: tuple[float, ...]) -> tuple[float, float]:
    """Return the integrals of a function and of its absolute value over the run, by Gauss quadrature between marks."""
    ends = np.unique(np.clip([0.0, *marks, END], 0.0, END))
    ends = np.unique(np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(ends)]))
    nodes, weights = np.polynomial.legendre.leggauss(10)
    half = 0.5 * np.diff(ends)[:, None]
    at = values(0.5 * (ends[1:] + ends[:-1])[:, None] + half * nodes) * half * weights
    return float(np.sum(at)), float(np.sum(np.abs(at)))


def wrong_integrals(seed: int, method: dict[str, Any]) -> str:
    """Return what is wrong with integral, mean and rms of the force of a joint at rest; empty if they are right."""
    drawn = function(seed)
    model = {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"b": {"mass": 1.0, "inertia": 0.1}},
        "joints": {"s": {"type": "prismatic", "bodies": ["ground", "b"], "at": [0, 0], "axis": [1, 0]}},
        "forces": {"F": {"type": "force", "body": "b", "value": ["0", drawn.text]}},
    }
    names = {"I": "integral(joints.s.force_y)", "m": "mean(joints.s.force_y)", "r": "rms(joints.s.force_y)"}
    values = _run(model, method, measures=names).measures
    marks = (*drawn.corners, *drawn.marks)
    (first, size), (square, _) = (integrals(lambda t, k=k: drawn.at(t) ** k, marks) for k in (1, 2))  # type: ignore[misc]
    errors = {
        "integral": abs(abs(values["I"]) - abs(first)) / size,
        "mean": abs(abs(values["m"]) * END - abs(first)) / size,
        "rms": abs(values["r"] / math.sqrt(square / END) - 1.0),
    }
    wrong = [f"{name} by {error:.1e}" for name, error in errors.items() if not error <= ERROR]
    return f"{drawn.text} with {method['name']}: {', '.join(wrong)}" if wrong else ""


def wrong_momentum(seed: int, method: dict[str, Any]) -> str:
    """Return what is wrong with the velocity of a body that a pulse pushes; empty if it is right."""
    draw = np.random.default_rng(seed)
    c, width = round(float(draw.uniform(0.3, 1.7)), 5), float(f"{10 ** draw.uniform(-4.0, -2.0):.3g}")
    model = {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"b": {"mass": 1.0, "inertia": 0.1}},
        "forces": {"F": {"type": "force", "body": "b", "value": [f"{1 / width}*exp(-((t - {c})/{width})**2)", "0"]}},
    }
    velocity = float(_run(model, method)["b"].velocity[-1, 0])
    error = abs(velocity - math.sqrt(math.pi))
    return f"pulse of {width} s at {c} s with {method['name']}: velocity {velocity}" if not error <= ERROR else ""


def _run(model: dict[str, Any], method: dict[str, Any], **more: Any) -> Any:
    spec = {"mbdkit": 1, "model": model, "integrator": method, "time": {"end": END}, **more}
    with contextlib.redirect_stderr(io.StringIO()):
        return mbdkit.run(spec)


def wrong(functions: int, runs: int) -> Iterator[str]:
    """Yield what is wrong: corners of `functions` drawn functions, and `runs` drawn runs with every method."""
    for seed in range(functions):
        yield wrong_corners(seed)
    for seed in range(runs):
        for method in METHODS:
            yield wrong_integrals(seed, method)
            yield wrong_momentum(seed, method)


def main() -> None:
    """Print what is wrong, and how many cases there are."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.functions_of_time")
    parser.add_argument("--functions", type=int, default=400)
    parser.add_argument("--runs", type=int, default=40)
    given = parser.parse_args()
    found = list(wrong(given.functions, given.runs))
    for sentence in filter(None, found):
        print(sentence)
    print(f"{len(found)} cases, {sum(map(bool, found))} wrong")


if __name__ == "__main__":
    main()
