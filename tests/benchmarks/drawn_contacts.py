"""Drawn scenes with contacts, compared with oracles that are not mbdkit.

``python -m tests.benchmarks.drawn_contacts --count 1000`` runs two studies with adaptive methods: `compliant`, balls,
points and boxes that are thrown at walls of 1 mm to 20 cm, floors and each other at 0.1 to 20 m/s; and `rigid`, blocks
that rest, slip and lift off under loads that are expressions of time, of states, tables, inputs and sampled
controllers. `--only` chooses one of them, and `--seed` other scenes. It prints each scene that is wrong, and how many
are right, told and silent, and ends with status 1 unless at least 95 % are right and none is wrong without a word.

The oracles are event-exact. A free flight is closed-form, and its end a root of the gap; in contact, SciPy's DOP853
integrates the motion with the published force law, written here again, from event to event. A resting block obeys
Coulomb's law: the times at which it begins and ceases to slip, and at which it lifts off, are roots of the load.
"""

# ruff: noqa: B023 (closures are used before the loop goes on)

from __future__ import annotations

import argparse
import contextlib
import io
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import mbdkit

G = 9.81
METHODS: tuple[dict[str, Any], ...] = (
    {"name": "dop853", "adaptive": True},
    {"name": "dop853", "adaptive": True, "rtol": 1e-9},
    {"name": "dopri5", "adaptive": True},
    {"name": "radau-iia", "stages": 3, "adaptive": True},
    {"name": "radau-iia", "stages": 5, "adaptive": True, "rtol": 1e-8},
    {"name": "gauss", "stages": 3, "adaptive": True},
    {"name": "scipy-dop853"},
    {"name": "scipy-radau"},
    {"name": "scipy-lsoda"},
)
RIGHT = 1e-3
"""Largest error of a position that counts as right, relative to the length of the path (of a rigid block: of slip)."""

MOST = 3
"""Number of contacts, one after another, up to which errors do not grow too much to be compared."""

Force = Callable[[float, float], float]
State = np.ndarray


def told(run: mbdkit.Run) -> bool:
    """Return whether a run says that it may be wrong."""
    return run.status != "complete" or run.verdict in ("doubtful", "bad") or bool(run.warnings)


def simulate(model: dict[str, Any], method: dict[str, Any], end: float, **sections: Any) -> mbdkit.Run:
    """Return a run, without what it prints."""
    spec = {"mbdkit": 1, "model": {"name": "mechanism", **model}, "integrator": method, "time": {"end": end}}
    with contextlib.redirect_stderr(io.StringIO()):
        return mbdkit.run(spec | sections)


# ---- compliant contacts ----------------------------------------------------------------------------------------------


def hertz(stiffness: float, damping: float) -> Force:
    """Return the force of Hunt and Crossley as a function of depth and its rate."""
    return lambda d, rate: max(stiffness * d**1.5 * (1.0 + 1.5 * damping * rate), 0.0) if d > 0.0 else 0.0


def linear(stiffness: float, damping: float) -> Force:
    """Return the force of a spring and damper that cannot pull."""
    return lambda d, rate: max(stiffness * d + damping * rate, 0.0) if d > 0.0 else 0.0


class Thrown:
    """A body that flies freely and touches half planes with points of its outline.

    State: x, y, angle and their rates. `planes`: point, normal. `points`: places in the frame of the body, and radius.
    """

    def __init__(self, planes: list[Any], points: list[Any], force: Force, mass: float, inertia: float, gravity: float):
        self.planes, self.points, self.force = planes, points, force
        self.mass, self.inertia, self.gravity = mass, inertia, gravity

    def gaps(self, y: State) -> np.ndarray:
        """Return the gaps of all points and planes, for states (6, ...)."""
        out = []
        c, s = np.cos(y[2]), np.sin(y[2])
        for (px, py), (nx, ny) in self.planes:
            for ax, ay, r in self.points:
                gx, gy = y[0] + c * ax - s * ay, y[1] + s * ax + c * ay
                out.append((gx - px) * nx + (gy - py) * ny - r)
        return np.array(out)

    def flight(self, y: State, t: Any) -> Any:
        """Return the state after a free flight of duration `t`."""
        t = np.asarray(t, dtype=float)
        vy = y[4] - self.gravity * t
        still = np.zeros_like(t)
        return np.array(
            [y[0] + y[3] * t, y[1] + y[4] * t - 0.5 * self.gravity * t * t, y[2] + y[5] * t, y[3] + still, vy,
             y[5] + still]
        )  # fmt: skip

    def rates(self, _t: float, y: State) -> list[float]:
        """Return the derivative of the state."""
        fx, fy, torque = 0.0, -self.mass * self.gravity, 0.0
        c, s = np.cos(y[2]), np.sin(y[2])
        for (px, py), (nx, ny) in self.planes:
            for ax, ay, r in self.points:
                gx, gy = c * ax - s * ay, s * ax + c * ay
                gap = (y[0] + gx - px) * nx + (y[1] + gy - py) * ny - r
                if gap < 0.0:
                    force = self.force(-gap, -((y[3] - y[5] * gy) * nx + (y[4] + y[5] * gx) * ny))
                    fx, fy = fx + force * nx, fy + force * ny
                    torque += force * (gx * ny - gy * nx)
        return [y[3], y[4], y[5], fx / self.mass, fy / self.mass, torque / self.inertia]

    def end(self, y: State, end: float, shortest: float) -> tuple[State, int, float]:
        """Return the state at the time `end` or before contact number `MOST` + 1, the number of contacts that have
        begun, and that time.

        `shortest`: least time between two events in a flight [s].
        """
        t, contacts = 0.0, 0
        while t < end:
            gaps = self.gaps(y)
            inside = gaps < -1e-15
            if not np.any(inside):
                times = np.linspace(0.0, end - t, max(200, min(400_000, int((end - t) / shortest) + 2)))
                after = np.min(self.gaps(self.flight(y, times)), axis=0)
                below = np.flatnonzero((after[1:] < 0.0) & (np.arange(1, len(times)) > 1))
                first = next((k + 1 for k in below if after[k] >= 0.0), None)
                if first is None:
                    return self.flight(y, end - t), contacts, end
                root = brentq(
                    lambda x, y=y: np.min(self.gaps(self.flight(y, x))), times[first - 1], times[first], xtol=1e-15
                )
                if contacts == MOST:
                    return self.flight(y, 0.5 * root), contacts, t + 0.5 * root
                y, t, contacts = self.flight(y, root), t + root, contacts + 1
                y = self.flight(y, 1e-13)  # just inside
                t += 1e-13
                continue

            def crossing(i: int, sign: float) -> Callable[[float, State], float]:
                def value(_t: float, y: State) -> float:
                    return sign * float(self.gaps(y)[i])

                value.terminal, value.direction = True, 1.0  # type: ignore[attr-defined]
                return value

            events = [crossing(i, 1.0 if inside[i] else -1.0) for i in range(len(gaps))]
            solved = solve_ivp(
                self.rates, (t, end), y, method="DOP853", rtol=1e-11, atol=1e-14, events=events, max_step=shortest
            )
            y, t = solved.y[:, -1], float(solved.t[-1])
            if t < end:
                step = self.rates(t, y)
                y, t = y + 1e-13 * np.array(step), t + 1e-13
        return y, contacts, t


def thrown(rng: np.random.Generator) -> tuple[dict[str, Any], float, State, float, str]:
    """Return a drawn scene: model, end, state of body `b` at the end, length of its path, and a description."""
    kind = rng.choice(["ball-wall", "ball-floor", "balls", "box-floor", "box-wall"])
    speed = float(np.exp(rng.uniform(np.log(0.1), np.log(20.0))))
    thick = float(np.exp(rng.uniform(np.log(1e-3), np.log(0.2))))
    r = float(rng.uniform(0.01, 0.2))
    mass = float(np.exp(rng.uniform(np.log(0.05), np.log(20.0))))
    damping = float(rng.uniform(0.0, 0.3))
    gravity = 0.0 if kind == "balls" else G
    depth = float(rng.uniform(0.05, 0.3)) * min(r, thick if kind == "box-wall" else r)
    law = rng.choice(["hunt-crossley", "linear"])
    fastest = float(np.hypot(speed, np.sqrt(2.0 * G * 4.0 * r))) if kind.endswith("floor") else speed
    if law == "hunt-crossley":
        stiffness = 1.25 * mass * fastest**2 / depth**2.5
        compliance = {"law": "hunt-crossley", "stiffness": stiffness, "dissipation": damping}
        force = hertz(stiffness, damping)
    else:
        stiffness = mass * (fastest / depth) ** 2
        damper = 2.0 * damping * float(np.sqrt(stiffness * mass))
        compliance = {"law": "linear", "stiffness": stiffness, "dissipation": damper}
        force = linear(stiffness, damper)
    far = float(rng.uniform(1.0, 3.0)) * (1.0 if kind != "box-floor" else 0.2) + 2.0 * r
    b, h = r, float(rng.uniform(0.4, 1.0)) * r
    inertia = 0.4 * mass * r * r if kind.startswith("ball") else mass * (b * b + h * h) / 3.0
    box = [[-b, -h], [b, -h], [b, h], [-b, h]]
    y = np.zeros(6)
    if kind.startswith("box"):
        y[2], y[5] = rng.uniform(-1.5, 1.5), rng.uniform(-1.0, 1.0) * speed / r * 0.3
    bodies = {"b": {"mass": mass, "inertia": inertia}}
    if kind in ("ball-wall", "box-wall"):
        y[3], y[4] = speed, 0.5 * G * far / speed
        shapes = [{"polygon": [[far, -400], [far + thick, -400], [far + thick, 400], [far, 400]]}]
        planes, end = [((far, 0.0), (-1.0, 0.0))], 1.5 * far / speed
    elif kind == "balls":
        y[3], y[4] = speed, 0.0
        end, planes = 1.6 * far / speed, []
    else:
        y[1], y[3], y[4] = 3.0 * r, 0.3 * speed, -speed
        shapes, planes, end = [{"line": {"normal": [0.0, 1.0]}}], [((0.0, 0.0), (0.0, 1.0))], 8.0 * r / speed
    body = {"polygon": box} if kind.startswith("box") else {"circle": {"radius": r}}
    bodies["b"] |= {"position": y[:2].tolist(), "angle": float(y[2]), "velocity": y[3:5].tolist(),
                    "angular_velocity": float(y[5])}  # fmt: skip
    model: dict[str, Any] = {"bodies": bodies, "gravity": [0.0, -gravity]}
    contact = {"compliance": compliance, "friction": 0.0}
    shortest = 0.02 * min(depth, r) / fastest
    if kind == "balls":  # two bodies along a line of centres: one body of the reduced mass
        other, own = float(rng.uniform(0.5, 3.0)) * mass, float(rng.uniform(0.5, 2.0)) * r
        bodies["c"] = {"mass": other, "inertia": 0.1, "position": [far, 0.0]}
        shapes = [{"circle": {"radius": own}}]
        model["contacts"] = {"k": {"bodies": ["c", "b"], "shapes": [*shapes, body], **contact}}
        scene = Thrown(
            [((far - own, 0.0), (-1.0, 0.0))], [(0.0, 0.0, r)], force, mass * other / (mass + other), 1.0, 0.0
        )
        relative, contacts, end = scene.end(y, end, shortest)
        centre = (mass * speed * end + other * far) / (mass + other)
        last = np.array([centre + other / (mass + other) * (relative[0] - far), 0.0, 0.0, 0.0, 0.0, 0.0])
    else:
        model["contacts"] = {"k": {"bodies": ["ground", "b"], "shapes": [*shapes, body], **contact}}
        points = [(x, z, 0.0) for x, z in box] if kind.startswith("box") else [(0.0, 0.0, r)]
        scene = Thrown(planes, points, force, mass, inertia, gravity)
        last, contacts, end = scene.end(y, end, shortest)
    return (
        model,
        end,
        last,
        far + speed * end,
        f"{kind} {law} {speed:.3g} m/s r {r:.3g} wall {thick:.3g} contacts {contacts}",
    )


def compliant(rng: np.random.Generator) -> tuple[bool, bool, str]:
    """Run a drawn scene; return whether it is right and told, and a description."""
    model, end, last, path, what = thrown(rng)
    method = METHODS[rng.integers(len(METHODS))]
    run = simulate(model, method, end)
    here = [*run["b"].position[-1], run["b"].angle[-1]]
    error = float(np.max(np.abs(here[:2] - last[:2])) / path)
    return error < RIGHT, told(run), f"{what}, {method}: error {error:.1e} {run.status} {run.verdict} {run.warnings}"


# ---- rigid contacts under loads --------------------------------------------------------------------------------------


def drawn_load(
    rng: np.random.Generator, size: float, end: float
) -> tuple[str, dict[str, Any], dict[str, Any], Any, list[float]]:
    """Return a load of about a size: expression, keys of the model, sections of the spec, function of time, jumps."""
    kind = rng.choice(["time", "state", "table", "input", "controller"])
    f, phase = float(np.exp(rng.uniform(np.log(2.0), np.log(60.0)))), float(rng.uniform(0.0, 6.0))
    if kind == "time":
        forms = {
            f"{size}*sin({f}*t+{phase})": lambda t: size * np.sin(f * t + phase),
            f"{size}*sin({f}*t)*cos({0.37 * f}*t)": lambda t: size * np.sin(f * t) * np.cos(0.37 * f * t),
            f"{size}*exp(-((t-{0.6 * end})/{1.5 / f})**2)": lambda t: (
                size * np.exp(-(((t - 0.6 * end) * f / 1.5) ** 2))
            ),
            f"{size}*t/{end}": lambda t: size * t / end,
        }
        text = list(forms)[rng.integers(len(forms))]
        return text, {}, {}, forms[text], []
    if kind == "state":  # an oscillator that nothing else depends on, or a phase
        if rng.random() < 0.5:
            states = {"p": {"rate": f"{f}*states.w", "initial": float(np.sin(phase))},
                      "w": {"rate": f"-{f}*states.p", "initial": float(np.cos(phase))}}  # fmt: skip
            return f"{size}*states.p", {"states": states}, {}, lambda t: size * np.sin(f * t + phase), []
        states = {"p": {"rate": f"{f}", "initial": phase}}
        return f"{size}*sin(states.p)", {"states": states}, {}, lambda t: size * np.sin(f * t + phase), []
    times = np.unique(np.round(np.linspace(0.0, end, int(rng.integers(5, 12))), 3))
    values = np.round(size * rng.uniform(-1.0, 1.0, len(times)), 3)
    if kind == "table":
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(times, values)
        table = [times.tolist(), values.tolist()]
        return "table", {"table": table}, {}, spline, []
    if kind == "input":
        hold = str(rng.choice(["zero", "linear"]))
        model = {"inputs": {"u": {"unit": "N", "hold": hold, "initial": float(values[0])}}}
        sections = {"inputs": {"u": {"table": [times.tolist(), values.tolist()]}}}
        if hold == "linear":
            return "inputs.u", model, sections, lambda t: np.interp(t, times, values), times.tolist()
        held = lambda t: values[np.clip(np.searchsorted(times, np.asarray(t) + 1e-12, side="right") - 1, 0, None)]  # noqa: E731
        return "inputs.u", model, sections, held, times.tolist()
    period = float(np.round(rng.uniform(0.02, 0.15), 3))
    model = {"controllers": {"c": {"period": period, "outputs": {"u": f"{size}*sin({f}*t+{phase})"}}}}
    sampled = lambda t: size * np.sin(f * period * np.floor((np.asarray(t) + 1e-12) / period) + phase)  # noqa: E731
    return "controllers.c.u", model, {}, sampled, [k * period for k in range(1, int(end / period) + 1)]


def slide(
    load: Any, normal: float, mass: float, static: float, kinetic: float, end: float, jumps: list[float]
) -> tuple[float, float]:
    """Return the displacement at the end, and the path of slip, of a block that a load pushes on a rough floor."""
    x = v = t = path = 0.0
    cuts = [*[j for j in sorted(jumps) if 0.0 < j < end], end]
    for stop in cuts:
        inside = lambda s, a=t, b=stop: load(np.clip(s, a, b - 1e-11))  # noqa: E731
        while t < stop - 1e-12:
            if v == 0.0:
                times = np.linspace(t, stop, 4001)
                excess = np.abs(inside(times)) - static * normal
                if excess[0] <= 1e-9:
                    over = np.flatnonzero(excess > 1e-9)
                    if len(over) == 0:
                        t = stop
                        break
                    k = over[0]
                    if excess[k - 1] < 0.0:
                        t = brentq(
                            lambda s: float(np.abs(inside(s)) - static * normal), times[k - 1], times[k], xtol=1e-14
                        )
                    else:
                        t = float(times[k - 1])
                sign = float(np.sign(inside(t + 1e-9 if t + 1e-9 < stop else t)))
            else:
                sign = float(np.sign(v))
            ends = lambda s, y, sign=sign, a=t: sign * y[1] if s > a + 1e-9 else 1.0  # noqa: E731
            ends.terminal, ends.direction = True, -1.0  # type: ignore[attr-defined]
            solved = solve_ivp(
                lambda s, y, sign=sign: [y[1], (float(inside(s)) - sign * kinetic * normal) / mass], (t, stop), [x, v],
                method="DOP853", rtol=1e-10, atol=1e-13, events=ends, max_step=0.01,
            )  # fmt: skip
            path += abs(solved.y[0, -1] - x)
            t, (x, v) = float(solved.t[-1]), solved.y[:, -1].tolist()
            if t < stop or abs(v) < 1e-12:
                v = 0.0
    return x, path


def lift(load: Any, mass: float, end: float, jumps: list[float]) -> tuple[float, float]:
    """Return height and largest height of a block that a load lifts from a floor without friction or restitution."""
    y = v = t = top = 0.0
    cuts = [*[j for j in sorted(jumps) if 0.0 < j < end], end]
    for stop in cuts:
        inside = lambda s, a=t, b=stop: load(np.clip(s, a, b - 1e-11))  # noqa: E731
        while t < stop - 1e-12:
            if y == 0.0 and v == 0.0:
                times = np.linspace(t, stop, 4001)
                excess = inside(times) - mass * G
                if excess[0] <= 1e-9:
                    over = np.flatnonzero(excess > 1e-9)
                    if len(over) == 0:
                        t = stop
                        break
                    k = over[0]
                    t = (
                        times[k - 1]
                        if excess[k - 1] >= 0.0
                        else brentq(lambda s: float(inside(s) - mass * G), times[k - 1], times[k], xtol=1e-14)
                    )
            lands = lambda s, q, a=t: q[0] if s > a + 1e-7 else 1.0  # noqa: E731
            lands.terminal, lands.direction = True, -1.0  # type: ignore[attr-defined]
            solved = solve_ivp(
                lambda s, q: [q[1], float(inside(s)) / mass - G], (t, stop), [y, v], method="DOP853", rtol=1e-10,
                atol=1e-14, events=lands, max_step=0.01,
            )  # fmt: skip
            t, (y, v) = float(solved.t[-1]), solved.y[:, -1].tolist()
            top = max(top, float(np.max(solved.y[0])))
            if t < stop:
                y = v = 0.0
    return y, top


def rigid(rng: np.random.Generator) -> tuple[bool, bool, str]:
    """Run a drawn block; return whether it is right and told, and a description."""
    mass, end = float(np.round(np.exp(rng.uniform(-2.0, 2.0)), 3)), float(np.round(rng.uniform(0.5, 2.0), 2))
    kinetic = float(np.round(rng.uniform(0.05, 0.5), 3))
    static = kinetic if rng.random() < 0.5 else float(np.round(kinetic * rng.uniform(1.0, 1.5), 3))
    lifts = rng.random() < 0.3
    size = float(np.round(mass * G * (1.0 if lifts else static) * rng.uniform(0.7, 2.0), 3))
    text, more, sections, load, jumps = drawn_load(rng, size, end)
    friction = 0.0 if lifts else {"static": static, "kinetic": kinetic}
    value: Any = {"table": more.pop("table")} if text == "table" else text
    shape = {"polygon": [[-0.5, -0.05], [0.5, -0.05], [0.5, 0.05], [-0.5, 0.05]]}
    if rng.random() < 0.3 and lifts:
        shape = {"circle": {"radius": 0.05}}
    contact = {"bodies": ["ground", "b"], "shapes": [{"line": {"normal": [0.0, 1.0]}}, shape], "friction": friction}
    force = {"type": "force", "body": "b", "value": [0.0, value] if lifts else [value, 0.0]}
    bodies = {"b": {"mass": mass, "inertia": 0.1 * mass, "position": [0.0, 0.05]}}
    method = METHODS[rng.integers(len(METHODS))]
    run = simulate(
        {"bodies": bodies, "contacts": {"k": contact}, "forces": {"F": force}, **more}, method, end,
        contact={"treatment": "event-driven"}, **sections,
    )  # fmt: skip
    if lifts:
        right, path = lift(load, mass, end, jumps)
        here = float(run["b"].position[-1, 1]) - 0.05
    else:
        right, path = slide(load, mass * G, mass, static, kinetic, end, jumps)
        here = float(run["b"].position[-1, 0])
    error = abs(here - right)
    what = f"{'lift' if lifts else 'slip'} {text[:60]}, {method}: {here:.3e} for {right:.3e}, path {path:.1e}"
    return error < RIGHT * path + 1e-7, told(run), f"{what} {run.status} {run.verdict} {run.warnings}"


STUDIES = {"compliant": compliant, "rigid": rigid}


def study(name: str, count: int, seed: int, *, shows: bool = True) -> Counter[str]:
    """Return how many scenes of a study are right, told, or wrong without a word (silent)."""
    counts: Counter[str] = Counter()
    for number in range(count):
        try:
            right, is_told, what = STUDIES[name](np.random.default_rng([seed, number]))
        except mbdkit.MbdkitError as error:
            right, is_told, what = False, True, f"{type(error).__name__}: {error}"
        outcome = "right" if right else "told" if is_told else "silent"
        counts[outcome] += 1
        if shows and not right:
            print(f"{name} {seed} {number} {outcome}: {what}", flush=True)
    return counts


def main() -> int:
    """Run the studies; return 1 if scenes are wrong without a word, or too many are told."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=sorted(STUDIES))
    given = parser.parse_args()
    failed = False
    for name in [given.only] if given.only else STUDIES:
        counts = study(name, given.count, given.seed)
        print(f"{name}: {dict(counts)} of {given.count}", flush=True)
        failed |= counts["silent"] > 0 or counts["right"] < 0.95 * given.count
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
