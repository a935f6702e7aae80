"""Discs on springs that bounce from lines and from each other: models of mbdkit, and their motions by SciPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import mbdkit

Array = NDArray[np.floating[Any]]
G = 9.81
LONGEST = 0.01
"""Largest step [s]."""
LEAST = 2 * LONGEST
"""Time between impacts of one contact [s] below which the next one may be within a step, so that the motion is unknown.
"""


@dataclass(frozen=True)
class Discs:
    """Discs of a random system.

    Parameters
    ----------
    radius, mass, inertia
        (B,) in m, kg and kg m^2.
    position, velocity
        (B, 3) at the start.
    anchors, points
        (B, 2) fixed point of the spring of each disc, and the point on the disc.
    stiffness, free_length
        (B,) in N/m and m.
    lines
        (L, 2, 2) point and normal of each line.
    restitution, friction
        Of all contacts.
    """

    radius: Array
    mass: Array
    inertia: Array
    position: Array
    velocity: Array
    anchors: Array
    points: Array
    stiffness: Array
    free_length: Array
    lines: Array
    restitution: float
    friction: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Discs:
        """Return a random system: one or two discs above two lines that form a valley."""
        count = int(rng.integers(1, 3))
        radius = rng.uniform(0.05, 0.15, count)
        mass = rng.uniform(0.5, 2.0, count)
        x = np.linspace(-0.3, 0.3, count) if count > 1 else rng.uniform(-0.3, 0.3, 1)
        position = np.stack([x, rng.uniform(0.5, 1.0, count), rng.uniform(-1, 1, count)], axis=1)
        normals = [np.array([np.sin(a), np.cos(a)]) for a in (rng.uniform(0.05, 0.6), -rng.uniform(0.05, 0.6))]
        return cls(
            radius,
            mass,
            0.5 * mass * radius**2,
            position,
            rng.uniform(-1.0, 1.0, (count, 3)) * [1.0, 1.0, 5.0],
            np.stack([x + rng.uniform(-0.2, 0.2, count), rng.uniform(1.0, 1.5, count)], axis=1),
            rng.uniform(-0.5, 0.5, (count, 2)) * radius[:, None],
            rng.uniform(5.0, 60.0, count),
            rng.uniform(0.2, 0.8, count),
            np.array([[[0.0, 0.0], n] for n in normals]),
            float(rng.uniform(0.3, 1.0)),
            float(rng.choice([0.0, rng.uniform(0.05, 0.8)])),
        )

    @property
    def model(self) -> dict[str, Any]:
        """The `model:` mapping of the spec."""
        names = [f"disc{i}" for i in range(len(self.mass))]
        laws = {"restitution": self.restitution, "friction": self.friction}
        circles = [{"circle": {"radius": float(r)}} for r in self.radius]
        lines = [{"line": {"point": point.tolist(), "normal": normal.tolist()}} for point, normal in self.lines]
        contacts: dict[str, Any] = {
            f"line{k}-{name}": {"bodies": ["ground", name], "shapes": [line, circle], **laws}
            for name, circle in zip(names, circles, strict=True)
            for k, line in enumerate(lines)
        }
        if len(names) > 1:
            contacts["discs"] = {"bodies": names, "shapes": circles, **laws}
        return {
            "name": "mechanism",
            "bodies": {
                name: {
                    "mass": float(self.mass[i]),
                    "inertia": float(self.inertia[i]),
                    "position": self.position[i, :2].tolist(),
                    "angle": float(self.position[i, 2]),
                    "velocity": self.velocity[i, :2].tolist(),
                    "angular_velocity": float(self.velocity[i, 2]),
                }
                for i, name in enumerate(names)
            },
            "forces": {
                f"spring{i}": {
                    "type": "spring-damper",
                    "bodies": ["ground", name],
                    "points": [self.anchors[i].tolist(), self.points[i].tolist()],
                    "stiffness": float(self.stiffness[i]),
                    "free_length": float(self.free_length[i]),
                }
                for i, name in enumerate(names)
            },
            "contacts": contacts,
        }

    def accelerations(self, y: Array) -> Array:
        """Return the accelerations (B, 3) between impacts at states (6 B,)."""
        q = y[: 3 * len(self.mass)].reshape(-1, 3)
        c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
        arm = np.stack(
            [c * self.points[:, 0] - s * self.points[:, 1], s * self.points[:, 0] + c * self.points[:, 1]], 1
        )
        along = self.anchors - q[:, :2] - arm
        length = np.hypot(*along.T)
        force = (self.stiffness * (length - self.free_length) / length)[:, None] * along
        moment = arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
        return np.column_stack([force / self.mass[:, None] - [0.0, G], moment / self.inertia])

    def pairs(self) -> list[tuple[int, int]]:
        """Return the contacts: a disc and a line (-1, -2, ...) or another disc."""
        found = [(i, -1 - k) for i in range(len(self.mass)) for k in range(len(self.lines))]
        return found + [(i, j) for i in range(len(self.mass)) for j in range(i)]

    def normal(self, y: Array, pair: tuple[int, int]) -> tuple[float, Array]:
        """Return gap and the normal that points to the first disc."""
        q, (i, other) = y[: 3 * len(self.mass)].reshape(-1, 3), pair
        if other < 0:
            point, normal = self.lines[-1 - other]
            return float(normal @ (q[i, :2] - point) - self.radius[i]), normal
        between = q[i, :2] - q[other, :2]
        distance = float(np.hypot(*between))
        return distance - self.radius[i] - self.radius[other], between / distance

    def struck(self, y: Array, pair: tuple[int, int]) -> Array:
        """Return the state after an impact by the laws of Newton and Coulomb."""
        count, (i, other) = len(self.mass), pair
        _, n = self.normal(y, pair)
        t = np.array([-n[1], n[0]])
        q, v = y[: 3 * count], y[3 * count :].reshape(-1, 3).copy()
        # velocity of the disc at the contact is v - omega r t, because its arm there is -r n
        parts = [(i, 1.0)] + ([(other, -1.0)] if other >= 0 else [])
        approach = sum(sign * n @ v[k, :2] for k, sign in parts)
        slip = sum(sign * t @ v[k, :2] - self.radius[k] * v[k, 2] for k, sign in parts)
        lightness = sum(1.0 / self.mass[k] for k, _ in parts)
        ease = sum(1.0 / self.mass[k] + self.radius[k] ** 2 / self.inertia[k] for k, _ in parts)
        push = -(1.0 + self.restitution) * approach / lightness
        rub = float(np.clip(-slip / ease, -self.friction * push, self.friction * push))
        for k, sign in parts:
            v[k, :2] += sign * (push * n + rub * t) / self.mass[k]
            v[k, 2] -= self.radius[k] * rub / self.inertia[k]
        return np.concatenate([q, v.ravel()])

    def motion(self, times: Array) -> tuple[Array, Array, list[float]]:
        """Return positions and velocities (T, B, 3), nan once impacts follow closely, and times of impacts."""
        count, pairs = len(self.mass), self.pairs()
        last = dict.fromkeys(pairs, -np.inf)
        y, t, rows, impacts = np.concatenate([self.position.ravel(), self.velocity.ravel()]), float(times[0]), [], []

        def rate(_: float, state: Array) -> Array:
            return np.concatenate([state[3 * count :], self.accelerations(state).ravel()])

        def event(pair: tuple[int, int]) -> Any:
            def gap(_: float, state: Array) -> float:
                return self.normal(state, pair)[0]

            gap.terminal, gap.direction = True, -1.0  # type: ignore[attr-defined]
            return gap

        while len(rows) < len(times):
            found = solve_ivp(
                rate, (t, times[-1]), y, method="DOP853", rtol=3e-14, atol=1e-15, max_step=LONGEST,
                events=[event(pair) for pair in pairs], dense_output=True,
            )  # fmt: skip
            end = float(found.t[-1])
            while len(rows) < len(times) and times[len(rows)] <= end:
                rows.append(found.sol(times[len(rows)]) if times[len(rows)] < end else found.y[:, -1])
            if found.status != 1:
                break
            place = next(k for k, one in enumerate(found.t_events) if len(one))
            if end - last[pairs[place]] < LEAST:
                break
            last[pairs[place]] = end
            impacts.append(end)
            y, t = self.struck(found.y[:, -1], pairs[place]), end
        states = np.full((len(times), 6 * count), np.nan)
        states[: len(rows)] = rows
        return states[:, : 3 * count].reshape(-1, count, 3), states[:, 3 * count :].reshape(-1, count, 3), impacts


METHODS = {"rk4": 0.01, "rk-gill": 0.02, "dop853": 0.05, "moreau-jean": 0.001}
"""Methods and their steps [s]; the last is a time-stepping method."""
FLOOR = 1e-10
"""Accuracy of the motions by SciPy."""
COVERED = 1.12
"""Largest true over estimated error that counts as covered."""


@dataclass(frozen=True)
class Compared:
    """Estimated and true errors of a run.

    Attributes
    ----------
    ratios
        True over estimated errors, where both are known and above the accuracy of the true motion.
    covered
        Share of ratios up to `COVERED`; 1 if there are none.
    known
        Share of the duration in which errors are known.
    impacts
        Number of impacts.
    """

    ratios: Array
    covered: float
    known: float
    impacts: int


def compared(discs: Discs, method: str, end: float) -> Compared:
    """Run discs with a check and compare the estimated errors with the true ones."""
    step = METHODS[method]
    run = mbdkit.run(
        {"mbdkit": 1, "model": discs.model},
        integrator={"name": method},
        time={"end": end, "step": step},
        contact={"treatment": "time-stepping" if method == "moreau-jean" else "event-driven"},
        output={"every": max(1, round(0.02 / step))},
        check=True,
    )
    assert run.accuracy is not None
    *states, impacts = discs.motion(run.time)
    ratios = []
    for name, true in zip(("position", "velocity"), states, strict=True):
        error = np.maximum.accumulate(np.abs(run.array(f"trajectory/{name}") - true), axis=0)
        estimate = getattr(run.accuracy, f"{name}_error")
        compare = np.isfinite(estimate) & np.isfinite(error) & (error > FLOOR)
        ratios.append(error[compare] / estimate[compare])
    both = np.concatenate(ratios)
    known = float(np.nan_to_num(run.accuracy.known_until)) / end
    return Compared(both, float(np.mean(both <= COVERED)) if len(both) else 1.0, known, len(impacts))
