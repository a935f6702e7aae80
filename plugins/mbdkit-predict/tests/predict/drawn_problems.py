"""Drawn problems of least effort with pulses, steps, contacts and tables; run as a script, compares predictions with
the optima of an independent method.

    PYTHONPATH=plugins/mbdkit-predict/tests python -m predict.drawn_problems [NUMBER ...]

The optima are those of L. S. Pontryagin's conditions in minimal coordinates, by single shooting: the costates at the
start are found by Newton's method, states and costates are integrated by DOP853 with a tolerance of 1e-11, and the
integration stops at all discontinuities and pulses in time. Linear problems take one iteration. Others are continued
from a problem without disturbances. They may have several local optima: if the prediction has another objective, its
own motion is the second start of the shooting.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline, CubicSpline

import mbdkit
from predict.exact_optima import EFFORT, PUSH, block

PRECISION = 1e-11
"""Relative tolerance of the integration."""
ACCURACY = 1e-9
"""Relative error of the optimum of the witness, at most."""
SMALLEST_STEP, LONGEST = 1e-3, 10.0
"""Smallest step of the continuation, and the longest processor time of a search [s]; stiff contacts may need more."""
WALL = 30.0
"""Time after which a problem without an answer counts as an error [s]."""
COUNT = 60

Rates = Callable[[np.ndarray, np.ndarray, float, float], np.ndarray]
"""Rates (n, K) of K states (n, K), given K controls, the time, and the share of all disturbances; states may be
complex, for derivatives by complex steps.
"""


@dataclass(frozen=True)
class Problem:
    """A problem of least effort.

    Attributes
    ----------
    kind
        What is drawn.
    spec
        Spec of the prediction. Its `initial` and `final` fix all states, in the order of `rates`.
    rates
        The equations, linear in the control.
    stops
        Times at which the integration stops.
    penalty
        Integrand besides the squared control, given the states (n, K) and the time.
    """

    kind: str
    spec: dict[str, Any]
    rates: Rates
    stops: Sequence[float] = ()
    penalty: Callable[[np.ndarray, float], Any] = field(default=lambda y, t: 0.0 * y[0])

    @property
    def ends(self) -> np.ndarray:
        """States (2, n) at the start and at the end."""
        return np.array([[*self.spec[key].values()] for key in ("initial", "final")], dtype=float)

    @property
    def times(self) -> list[float]:
        """Start, stops and end [s]."""
        end = float(self.spec["duration"])
        return [0.0, *sorted({t for t in self.stops if 0.0 < t < end}), end]

    def optimum(self) -> float:
        """Return an optimum, by continuation from the problem without disturbances; nan if none is found."""
        share, step, costates, value = 0.0, 1.0, np.zeros(self.ends.shape[1]), np.nan
        until = time.process_time() + LONGEST
        first = self._shot(costates, 0.0, until)
        if first is None:
            return np.nan
        costates, value = first
        while share < 1.0 and step > SMALLEST_STEP:
            step = min(step, 1.0 - share)
            found = self._shot(costates, share + step, until)
            if found is None:
                step *= 0.5
            else:
                share, step, (costates, value) = share + step, 2.0 * step, found
        return value if share >= 1.0 else np.nan

    def optimum_near(self, run: mbdkit.Run) -> float:
        """Return the optimum near the motion of a prediction; nan if none is found.

        The costates are linear in those at the start, which are fitted to the controls.
        """
        motion, n = CubicHermiteSpline(run.time, *_states(self.spec["final"], run), axis=1), self.ends.shape[1]

        def adjoint(t: float, flat: np.ndarray) -> np.ndarray:
            y, lam = motion(t)[:, None], flat.reshape(n, n + 1)
            u = np.interp(t, run.time, controls)
            jacobian, gradient, _ = self._derivatives(y, np.array([u]), t, 1.0)
            lam = -jacobian[:, :, 0].T @ lam
            lam[:, -1] -= gradient[:, 0]
            return lam.ravel()

        controls = run.controls[next(iter(self.spec["controls"]))].value
        basis, at = np.eye(n, n + 1).ravel(), np.linspace(*run.time[[0, -1]], 200)
        lam = solve_ivp(adjoint, run.time[[0, -1]], basis, t_eval=at, rtol=1e-6, max_step=at[1]).y.reshape(n, n + 1, -1)
        push = np.array([(self._effects(motion(t)[:, None], t, 1.0)[1].T @ lam[..., k])[0] for k, t in enumerate(at)])
        wanted = -2.0 * np.interp(at, run.time, controls) - push[:, -1]
        costates = np.linalg.lstsq(push[:, :-1], wanted, rcond=None)[0]
        found = self._shot(costates, 1.0, time.process_time() + LONGEST)
        return np.nan if found is None else found[1]

    def _effects(self, y: np.ndarray, t: float, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the rates without control, and their derivatives by the control."""
        none = self.rates(y, np.zeros(y.shape[1]), t, share)
        return none, self.rates(y, np.ones(y.shape[1]), t, share) - none

    def _derivatives(self, y: np.ndarray, u: np.ndarray, t: float, share: float) -> tuple[np.ndarray, ...]:
        """Return the derivatives (n, n, K) of rates by states, those (n, K) of the penalty, and the penalty (K,)."""
        n, count = y.shape
        moved = (y[:, None, :] + 1e-30j * np.eye(n)[:, :, None]).reshape(n, -1)
        slopes = self.rates(moved, np.tile(u, n), t, share).imag * 1e30
        penalty = self.penalty(moved, t)
        return slopes.reshape(n, n, count), penalty.imag.reshape(n, count) * 1e30, penalty[:count].real

    def _shot(self, costates: np.ndarray, share: float, until: float) -> tuple[np.ndarray, float] | None:
        """Return the costates at the start of a solution near the given ones, and the objective; None if there is
        none, or if it is not found until a time of `time.process_time`.
        """
        (start, end), n = self.ends, len(costates)
        size, before = np.maximum(1.0, abs(end)), np.inf
        step = np.zeros(n)
        for _ in range(40):
            if time.process_time() > until:
                return None
            change = 1e-6 * np.maximum(1.0, abs(costates).max())
            tried = costates[:, None] + change * np.eye(n, n + 1, 1)
            w = np.vstack([np.repeat(start[:, None], n + 1, axis=1), tried, np.zeros(n + 1)])
            last = self._integrated(w, share, until)
            missed = np.inf if last is None else float(abs((last[:n, 0] - end) / size).max())
            if last is None or missed > max(2.0 * before, 1e-7):  # a shorter step
                step *= 0.25
                costates = costates - 3.0 * step
                if abs(step).max() < 1e-6 * abs(costates).max():
                    return None
                continue
            slopes = (last[:n, 1:] - last[:n, :1]) / change
            step = np.linalg.lstsq(slopes, end - last[:n, 0], rcond=None)[0]
            if missed < 1e-7:  # contacts leave noise of 1e-8
                # the derivatives of the optimum by the end are minus the costates there
                return costates, float(last[-1, 0] + last[n : 2 * n, 0] @ (last[:n, 0] - end))
            costates, before = costates + step, missed
        return None

    def _integrated(self, w: np.ndarray, share: float, until: float) -> np.ndarray | None:
        shape, n = w.shape, len(w) // 2

        def rates(t: float, flat: np.ndarray) -> np.ndarray:
            if time.process_time() > until:
                return np.full(flat.shape, np.nan)
            y, lam = flat.reshape(shape)[:n], flat.reshape(shape)[n : 2 * n]
            free, effect = self._effects(y, t, share)
            u = -0.5 * (lam * effect).sum(axis=0)
            jacobian, gradient, penalty = self._derivatives(y, u, t, share)
            slopes = -np.einsum("ijk,ik->jk", jacobian, lam) - gradient
            return np.vstack([free + effect * u, slopes, u**2 + penalty]).ravel()

        for begin, end in pairwise(self.times):
            inside = 1e-13 * (end - begin)  # values at stops belong to the interval
            sizes = np.maximum(1.0, abs(w).max(axis=1, keepdims=True) + 0.0 * w).ravel()
            with np.errstate(all="ignore"):
                result = solve_ivp(
                    lambda t, x, a=begin + inside, b=end - inside: rates(min(max(t, a), b), x), (begin, end), w.ravel(),
                    "DOP853", rtol=PRECISION, atol=PRECISION * sizes,
                )  # fmt: skip
            if not result.success or not np.all(np.isfinite(result.y[:, -1])) or abs(result.y[:, -1]).max() > 1e12:
                return None
            w = result.y[:, -1].reshape(shape)
        return w


def _states(names: dict[str, Any], run: mbdkit.Run) -> tuple[np.ndarray, np.ndarray]:
    """Return states (n, T) of a motion, and their rates."""
    half = len(names) // 2
    columns = {"x": ("position", 0), "y": ("position", 1), "vx": ("velocity", 0), "vy": ("velocity", 1)}
    values = []
    for name in names:
        body, what = name.split(".")
        kind, column = columns.get(what, (what, None))
        series = getattr(run[body], kind)
        values.append(series if column is None else series[:, column])
    y = np.array(values)
    return y, np.vstack([y[half:], np.gradient(y[half:], run.time, axis=1)])


Disturbance = tuple[Any, Callable[[float], float], list[float]]
"""A function of time: its text or table in a spec, the function, and times at which the integration stops."""


def table(random: np.random.Generator, end: float, size: float) -> Disturbance:
    """Return a table of 4 to 9 points, linear or cubic."""
    times = np.concatenate([[0.0], np.sort(random.uniform(0.05, 0.95, random.integers(2, 8))), [1.0]]) * end
    values, kind = size * random.uniform(-1.0, 1.0, len(times)), str(random.choice(["linear", "cubic"]))
    spline = CubicSpline(times, values)
    function = (lambda t: float(spline(t))) if kind == "cubic" else lambda t: float(np.interp(t, times, values))
    return {"table": [times.tolist(), values.tolist()], "interpolation": kind}, function, times.tolist()


def spike(random: np.random.Generator, end: float, size: float) -> Disturbance:
    """Return a table with a triangle, or a step, of 1e-5 to 1e-2 of the motion."""
    width, at = end * 10.0 ** random.uniform(-5, -2), end * random.uniform(0.1, 0.85)
    if random.uniform() < 0.5:
        times, values = [0.0, at, at + width, at + 2 * width, end], [0.0, 0.0, size * end / width, 0.0, 0.0]
    else:
        times, values = [0.0, at, at + width, end], [0.0, 0.0, 5.0 * size, 5.0 * size]
    return {"table": [times, values], "interpolation": "linear"}, lambda t: float(np.interp(t, times, values)), times


def pulse(random: np.random.Generator, end: float, size: float) -> Disturbance:
    """Return a Gaussian pulse of time, of a width of 1e-4 to 1e-2 of the motion."""
    width, at = end * 10.0 ** random.uniform(-4, -2), end * random.uniform(0.1, 0.9)
    force = size * end / width
    stops = [at + k * width for k in (-8, -4, -2, -1, 0, 1, 2, 4, 8)]
    text = f"{force}*exp(-((t - {at})/{width})**2)"
    return text, lambda t: force * float(np.exp(-(((t - at) / width) ** 2))), stops


def steps(random: np.random.Generator, end: float, size: float) -> Disturbance:
    """Return a force that is switched on and off: by `max` and `min`, with `abs`, or by a steep `tanh` of time."""
    on, off = end * np.sort(random.uniform(0.1, 0.9, 2))
    height, kind = 5.0 * size * random.uniform(0.3, 1.0), random.integers(3)
    if kind == 0:
        rise = end * 10.0 ** random.uniform(-7, -2)
        text = f"{height}*(min(1, max(0, (t - {on})/{rise})) - min(1, max(0, (t - {off})/{rise})))"

        def ramp(t: float) -> float:
            return height * float(np.clip((t - on) / rise, 0, 1) - np.clip((t - off) / rise, 0, 1))

        return text, ramp, [on, on + rise, off, off + rise]
    if kind == 1:
        text = f"{height}*(abs(t - {on}) - abs(t - {off}))"
        return text, lambda t: height * (abs(t - on) - abs(t - off)), [on, off]
    steep = 10.0 ** random.uniform(1, 6) / end
    text = f"{height}*(tanh({steep}*(t - {on})) - tanh({steep}*(t - {off})))"
    stops = [at + k / steep for at in (on, off) for k in (-20, -6, -2, 0, 2, 6, 20)]
    return text, lambda t: height * float(np.tanh(steep * (t - on)) - np.tanh(steep * (t - off))), stops


DISTURBANCES = table, spike, pulse, steps


def _loads(value: Any, body: str = "block") -> dict[str, Any]:
    return {"load": {"type": "force", "body": body, "value": [value, 0]}}


def _problem(random: np.random.Generator, **sections: Any) -> dict[str, Any]:
    """Return a problem of a block, with drawn bounds and collocation."""
    method, points = [("radau", 3), ("radau", 3), ("radau", 5), ("gauss", 2), ("gauss", 3)][random.integers(5)]
    common: dict[str, Any] = {
        "controls": {PUSH: {"bounds": ["none", [-1e5, 1e5]][random.integers(2)]}},
        "collocation": {"method": method, "points": points, "intervals": int(random.integers(8, 30))},
        "limits": {"wall_time": WALL - 5.0},
    }
    return block(**common | sections)


def disturbed(draw: Callable[..., Disturbance], random: np.random.Generator) -> Problem:
    """Return a block that a function of time disturbs."""
    end, mass = random.uniform(0.5, 3.0), random.uniform(0.5, 5.0)
    value, load, stops = draw(random, end, 2.0 * mass / end**2)
    spec = _problem(random, mass=mass, forces=_loads(value), duration=end)
    return Problem(
        f"block, {draw.__name__}", spec, lambda y, u, t, share: np.array([y[1], (u + share * load(t)) / mass]), stops
    )


def oscillator(random: np.random.Generator) -> Problem:
    """Return two blocks, a spring between them, and a disturbance of the second one."""
    end, (first, second), stiffness = random.uniform(0.8, 2.0), random.uniform(0.5, 2.0, 2), random.uniform(1.0, 40.0)
    damping = random.uniform(0.0, 1.0)
    draw = DISTURBANCES[random.integers(4)]
    value, load, stops = draw(random, end, 2.0 * second / end**2)
    forces = _loads(value, "trailer") | {
        "hitch": {
            "type": "spring-damper", "bodies": ["block", "trailer"], "points": [[0, 0], [0, 0]], "free_length": 5.0,
            "stiffness": stiffness, "damping": damping,
        }
    }  # fmt: skip
    still = {"block.x": 0.0, "trailer.x": -5.0, "block.vx": 0.0, "trailer.vx": 0.0}
    spec = _problem(
        random, mass=first, forces=forces, duration=end, initial=still, final=still | {"block.x": 1, "trailer.x": -4.0}
    )
    model = spec["base"]["model"]
    model["bodies"]["trailer"] = {"mass": second, "inertia": 1.0, "position": [-5.0, 0]}
    model["joints"]["track"] = model["joints"]["rail"] | {"bodies": ["ground", "trailer"]}

    def rates(y: np.ndarray, u: np.ndarray, t: float, share: float) -> np.ndarray:
        tension = stiffness * (y[0] - y[1] - 5.0) + damping * (y[2] - y[3])
        return np.array([y[2], y[3], (u - tension) / first, (tension + share * load(t)) / second])

    return Problem(f"two blocks, {draw.__name__}", spec, rates, stops)


def tracking(random: np.random.Generator) -> Problem:
    """Return a block that follows a measured table or spike with little effort."""
    end, mass, weight = random.uniform(0.5, 2.0), random.uniform(0.5, 2.0), 10.0 ** random.uniform(1, 4)
    draw = (table, spike)[random.integers(2)]
    measured, wanted, stops = draw(random, end, 0.1)
    spec = _problem(
        random, mass=mass, duration=end, measured={"wanted": measured},
        minimize=f"{EFFORT} + {weight}*integral((block.x - measured.wanted)**2)",
    )  # fmt: skip
    return Problem(
        f"tracking, {draw.__name__}", spec, lambda y, u, t, share: np.array([y[1], u / mass]), stops,
        lambda y, t: weight * (y[0] - wanted(t)) ** 2,
    )  # fmt: skip


def steep_position(random: np.random.Generator) -> Problem:
    """Return a block with a force that begins at a position, within 0.1 m to 0.01 mm."""
    end, at, force = random.uniform(0.5, 2.0), random.uniform(0.1, 0.9), -random.uniform(1.0, 10.0)
    steep = 10.0 ** random.uniform(1, 5)
    spec = _problem(random, forces=_loads(f"{force}*(1 + tanh({steep}*(block.x - {at})))"), duration=end)
    return Problem(
        f"steep at x, k = {steep:.0e}", spec,
        lambda y, u, t, share: np.array([y[1], u + share * force * (1 + np.tanh(steep * (y[0] - at)))]),
    )  # fmt: skip


def steep_velocity(random: np.random.Generator) -> Problem:
    """Return a block with friction, pushed back by a table in between, so that it may turn."""
    end, friction, steep = random.uniform(0.5, 2.0), random.uniform(0.5, 3.0), 10.0 ** random.uniform(0, 3)
    speed = random.uniform(-2.0, 0.0)
    spec = _problem(
        random, forces=_loads(f"-{friction}*tanh({steep}*block.vx)"), duration=end,
        initial={"block.x": 0, "block.vx": speed},
    )  # fmt: skip
    return Problem(
        f"steep in v, k = {steep:.0e}", spec,
        lambda y, u, t, share: np.array([y[1], u - share * friction * np.tanh(steep * y[1])]),
    )  # fmt: skip


def pendulum(random: np.random.Generator) -> Problem:
    """Return a pendulum with a motor, and a torque that is a table, a spike, a pulse or a step."""
    end, mass, length, angle = (random.uniform(*x) for x in ((0.5, 2.0), (0.5, 2.0), (0.3, 1.0), (0.3, 2.5)))
    inertia = 0.1 * mass * length**2
    draw = DISTURBANCES[random.integers(4)]
    whole = inertia + mass * length**2
    value, load, stops = draw(random, end, whole / end**2)
    model = {
        "name": "mechanism", "gravity": [0, -9.81],
        "bodies": {"bob": {"mass": mass, "inertia": inertia, "position": [0, -length]}},
        "joints": {"pin": {"type": "revolute", "bodies": ["ground", "bob"], "points": [[0, 0], [0, length]]}},
        "forces": {"motor": {"type": "torque", "body": "bob", "value": 0.0},
                   "load": {"type": "torque", "body": "bob", "value": value}},
    }  # fmt: skip
    spec = _problem(
        random, duration=end, controls={"forces.motor.value": {"bounds": "none"}},
        initial={"bob.angle": 0, "bob.angular_velocity": 0}, final={"bob.angle": angle, "bob.angular_velocity": 0},
        minimize="integral(forces.motor.value**2)", base={"model": model},
    )  # fmt: skip

    def rates(y: np.ndarray, u: np.ndarray, t: float, share: float) -> np.ndarray:
        return np.array([y[1], (u + share * (load(t) - mass * 9.81 * length * np.sin(y[0]))) / whole])

    return Problem(f"pendulum, {draw.__name__}", spec, rates, stops)


def crane(random: np.random.Generator) -> Problem:
    """Return a cart with a hanging pole, from rest to rest, and a disturbance of the cart."""
    end, cart, pole, length = (random.uniform(*x) for x in ((1.0, 2.5), (0.5, 2.0), (0.1, 1.0), (0.3, 1.0)))
    inertia = pole * length**2 / 3.0
    draw = DISTURBANCES[random.integers(4)]
    value, load, stops = draw(random, end, 2.0 * cart / end**2)
    still = {"block.x": 0.0, "pole.angle": 0.0, "block.vx": 0.0, "pole.angular_velocity": 0.0}
    spec = _problem(
        random, mass=cart, forces=_loads(value), duration=end, initial=still, final=still | {"block.x": 1.0}
    )
    model = spec["base"]["model"]
    model["gravity"] = [0, -9.81]
    model["bodies"]["pole"] = {"mass": pole, "inertia": inertia, "position": [0, -length]}
    model["joints"]["pin"] = {"type": "revolute", "bodies": ["block", "pole"], "points": [[0, 0], [0, length]]}

    def rates(y: np.ndarray, u: np.ndarray, t: float, share: float) -> np.ndarray:
        # m = cart + pole, J = inertia + pole l^2:  m x'' + pole l (cos a'' - sin a'^2) = u,
        # pole l cos x'' + J a'' = -pole g l sin
        sin, cos = np.sin(y[1]), np.cos(y[1])
        whole, turned, coupled = cart + pole, inertia + pole * length**2, pole * length * cos
        push, turn = u + share * load(t) + pole * length * sin * y[3] ** 2, -pole * 9.81 * length * sin
        det = whole * turned - coupled**2
        return np.array([y[2], y[3], (turned * push - coupled * turn) / det, (whole * turn - coupled * push) / det])

    return Problem(f"crane, {draw.__name__}", spec, rates, stops)


def _contact_law(random: np.random.Generator, radius: float, force: float) -> tuple[dict[str, Any], Callable[..., Any]]:
    """Return a law that pushes with a force of this size at a depth of 2 to 20 mm, and its force as a function of the
    depth and its rate.

    `smooth-sphere-half-space` is that of Simbody, with its constants 1e-5 N, 300 1/m and 50 s/m.
    """
    kind, depth = (
        str(random.choice(["smooth-sphere-half-space", "hunt-crossley", "linear"])),
        random.uniform(2e-3, 2e-2),
    )
    loss = float(random.uniform(0.1, 1.0))
    if kind == "linear":
        k = force / depth
        return {"law": kind, "stiffness": k}, lambda d, rate: k * np.where(d.real > 0.0, d, 0.0)
    k = force / depth**1.5
    if kind == "hunt-crossley":

        def hertz(d: np.ndarray, rate: np.ndarray) -> Any:
            pressed = np.where(d.real > 0.0, d, 0.0)
            whole = k * pressed * np.sqrt(pressed) * (1.0 + 1.5 * loss * rate)
            return np.where(whole.real > 0.0, whole, 0.0)

        return {"law": kind, "stiffness": k, "dissipation": loss}, hertz
    half = (0.75 * k / np.sqrt(radius)) ** (2.0 / 3.0)

    def smooth(d: np.ndarray, rate: np.ndarray) -> Any:
        pressed = k * (d**2 + 1e-5) ** 0.75 * (0.5 + 0.5 * np.tanh(300.0 * d))
        return pressed * (1.0 + 1.5 * loss * rate) * (0.5 + 0.5 * np.tanh(50.0 * (rate + 2.0 / (3.0 * loss))))

    return {"law": kind, "stiffness": float((2.0 * half) ** 1.5), "dissipation": loss}, smooth


def stop(random: np.random.Generator) -> Problem:
    """Return a ball that is pushed into a compliant stop, or thrown back by it."""
    end, mass, radius, at = (random.uniform(*x) for x in ((0.5, 1.5), (0.5, 2.0), (0.05, 0.2), (0.3, 0.8)))
    law, force = _contact_law(random, radius, 20.0 * mass)
    is_thrown = bool(random.integers(2))
    there, back = (
        random.uniform(8.0, 15.0) * at / end,
        -random.uniform(2.0, 8.0) * at / end,
    )  # beyond the stop without it
    last = {"block.x": 0.0, "block.vx": back} if is_thrown else {"block.x": at + 0.003, "block.vx": 0.0}
    first = {"block.x": 0.0, "block.vx": there if is_thrown else 0.0}
    spec = _problem(random, mass=mass, duration=end, initial=first, final=last)
    shapes = [{"line": {"point": [at + radius, 0], "normal": [-1, 0]}}, {"circle": {"radius": radius}}]
    spec["base"]["model"]["contacts"] = {
        "stop": {"bodies": ["ground", "block"], "shapes": shapes, "friction": 0.0, "compliance": law}
    }

    def rates(y: np.ndarray, u: np.ndarray, t: float, share: float) -> np.ndarray:
        return np.array([y[1], (u - share * force(y[0] - at, y[1])) / mass])

    return Problem(f"{'thrown back' if is_thrown else 'pushed'}, {law['law']}", spec, rates)


def bounce(random: np.random.Generator) -> Problem:
    """Return a ball that falls on compliant ground, leaves it, or bounces; it is at rest at the start and the end."""
    mass, radius, height = (random.uniform(*x) for x in ((0.5, 2.0), (0.05, 0.2), (0.2, 1.0)))
    law, force = _contact_law(random, radius, 40.0 * mass)
    kind = ("lands", "leaves", "bounces")[random.integers(3)]
    first, last = (-0.003 if kind == word else height for word in ("leaves", "lands"))
    fall = (1.0 + (kind == "bounces")) * float(np.sqrt(2.0 * height / 9.81))
    spec = _problem(
        random, mass=mass, duration=fall * float(random.uniform(0.8, 1.2)),
        initial={"block.y": first + radius, "block.vy": -3.0 * height / fall * (kind == "bounces")},
        final={"block.y": last + radius, "block.vy": 0.0}, controls={"forces.push.value[1]": {"bounds": "none"}},
    )  # fmt: skip
    model = spec["base"]["model"]
    model["gravity"], model["joints"]["rail"]["axis"] = [0, -9.81], [0, 1]
    model["bodies"]["block"]["position"] = [0, first + radius]
    shapes = [{"line": {"normal": [0, 1]}}, {"circle": {"radius": radius}}]
    model["contacts"] = {"floor": {"bodies": ["ground", "block"], "shapes": shapes, "friction": 0.0, "compliance": law}}

    def rates(y: np.ndarray, u: np.ndarray, t: float, share: float) -> np.ndarray:
        return np.array([y[1], (u + share * force(radius - y[0], -y[1])) / mass - 9.81])

    return Problem(f"{kind}, {law['law']}", spec, rates)


KINDS: list[Callable[[np.random.Generator], Problem]] = [
    *(lambda random, draw=draw: disturbed(draw, random) for draw in DISTURBANCES),  # type: ignore[misc]
    oscillator, tracking, steep_position, steep_velocity, pendulum, crane, stop, bounce,
]  # fmt: skip


def drawn_problem(number: int) -> Problem:
    """Return a problem; those from 0 to `COUNT` - 1 are the test."""
    return KINDS[number % len(KINDS)](np.random.default_rng([73, number]))


@dataclass(frozen=True)
class Outcome:
    """A prediction beside the optimum of the witness.

    Attributes
    ----------
    word
        ``right`` (good, and within the bar), ``told`` (wrong, and not good), ``told wrongly`` (within the tolerance,
        but not good), ``silent`` (good, but wrong), ``late``, or ``no witness``.
    optimum
        Optimum of the witness; the one near the prediction, if there are several.
    is_lowest
        Whether the continuation finds no lower optimum.
    """

    word: str
    objective: float
    error: float
    optimum: float
    seconds: float
    is_lowest: bool
    verdict: str


def outcome(problem: Problem) -> Outcome:
    """Predict a motion, and judge it."""
    begin = time.perf_counter()
    run = mbdkit.predict(problem.spec)
    seconds = time.perf_counter() - begin
    first = optimum = problem.optimum()
    if not abs(run.objective - first) <= max(run.objective_error, 1e-6 * abs(first)):
        near = problem.optimum_near(run)
        optimum = near if np.isfinite(near) else first
    distance = abs(run.objective - optimum)
    is_good = (run.status, run.verdict) == ("complete", "good")
    tolerance = run.spec.tolerance * abs(optimum) if hasattr(run.spec, "tolerance") else 1e-6 * abs(optimum)
    if seconds > WALL:
        word = "late"
    elif not run.objective_error < np.inf:
        word = "told"  # no optimum, or on one mesh only
    elif not np.isfinite(optimum):
        word = "no witness"
    elif is_good:
        word = "right" if distance <= run.objective_error + ACCURACY * abs(optimum) else "silent"
    else:
        word = "told wrongly" if distance <= tolerance else "told"
    reason = "" if is_good else (run.status_reason or run.verdict_reasons[0])[:100]
    return Outcome(word, run.objective, run.objective_error, optimum, seconds, not first < optimum - tolerance, reason)


def main() -> None:
    """Print the table."""
    numbers, words = [int(x) for x in sys.argv[1:]] or range(COUNT), dict[str, int]()
    print(f"{'':>3} {'problem':<34} {'optimum':>16} {'objective':>16} {'error':>8} {'bar':>8} {'s':>5}")
    for number in numbers:
        problem = drawn_problem(number)
        own = outcome(problem)
        words[own.word] = words.get(own.word, 0) + 1
        print(
            f"{number:>3} {problem.kind:<34} {own.optimum:16.10g} {own.objective:16.10g} "
            f"{abs(own.objective - own.optimum):8.1e} {own.error:8.1e} {own.seconds:5.1f} {own.word}"
            f"{'' if own.is_lowest else ', not the lowest'} {own.verdict}", flush=True,
        )  # fmt: skip
    print(", ".join(f"{word} {count}" for word, count in words.items()))


if __name__ == "__main__":
    main()
