"""No rigid contact overlaps without a word: drawn scenes against an own geometry, and impacts that are hard to see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from tests.rigid.scenes import FLOOR, G, run

import mbdkit
from mbdkit_contact.event_step import EventStep


@dataclass(frozen=True)
class Outline:
    """A circle, a convex polygon (counterclockwise), or a polyline with the material below it.

    Attributes
    ----------
    kind
        ``circle``, ``polygon`` or ``polyline``.
    points
        (K, 2) its points in the frame of its body; the center of a circle.
    radius
        Radius of a circle [m].
    """

    kind: str
    points: np.ndarray
    radius: float = 0.0

    def shape(self) -> dict[str, Any]:
        """Return the shape as in specs."""
        if self.kind == "circle":
            return {"circle": {"center": self.points[0].tolist(), "radius": self.radius}}
        return {self.kind: self.points.tolist()}

    def moved(self, place: np.ndarray) -> np.ndarray:
        """Return the points (T, K, 2) at positions (T, 3): x, y and angle."""
        c, s = np.cos(place[:, 2]), np.sin(place[:, 2])
        turn = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
        return np.einsum("tij,kj->tki", turn, self.points) + place[:, None, :2]


def _sides(points: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for k in range(points.shape[1]):
        yield points[:, k], points[:, (k + 1) % points.shape[1]]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _distance(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distances (T,) of points from segments."""
    along = b - a
    share = np.clip(np.sum((p - a) * along, axis=1) / np.sum(along * along, axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - share[:, None] * along, axis=1))


def _in_polygon(p: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of points in polygons (T, K, 2), or minus their distances."""
    heights = [_cross(p - a, b - a) / np.linalg.norm(b - a, axis=1) for a, b in _sides(polygon)]
    apart = np.min([_distance(p, a, b) for a, b in _sides(polygon)], axis=0)
    highest = np.max(heights, axis=0)
    return np.where(highest <= 0.0, -highest, -apart)


def _of_polygons(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of the overlaps of polygons by the theorem of separating axes, or minus a distance."""
    apart = [
        np.min(_cross(other - start[:, None], (end - start)[:, None]), axis=1) / np.linalg.norm(end - start, axis=1)
        for one, other in ((a, b), (b, a))
        for start, end in _sides(one)
    ]
    return -np.max(apart, axis=0)


def _below(p: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of points below a polyline (K, 2) that does not move, or minus their distances."""
    x = np.clip(p[:, 0], line[0, 0], line[-1, 0])
    k = np.clip(np.searchsorted(line[:, 0], x, side="right") - 1, 0, len(line) - 2)
    (ax, ay), (bx, by) = line[k].T, line[k + 1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        height = p[:, 1] - np.where(ax == bx, ay, ay + (by - ay) * (x - ax) / (bx - ax))
    apart = np.min([_distance(p, a[None], b[None]) for a, b in pairwise(line)], axis=0)
    return np.where(height < 0.0, apart, -apart)


def overlap(first: Outline, at: np.ndarray, second: Outline, then: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of the overlaps of two outlines at positions (T, 3) of their bodies; not positive where
    they are apart. A polyline belongs to the ground, and the first outline is no less a polygon than the second.
    """
    a, b = first.moved(at), second.moved(then)
    if first.kind == "circle":
        return first.radius + second.radius - np.asarray(np.linalg.norm(a[:, 0] - b[:, 0], axis=1))
    if second.kind == "circle":
        inside = _below(b[:, 0], first.points) if first.kind == "polyline" else _in_polygon(b[:, 0], a)
        return second.radius + inside
    if first.kind == "polygon":
        return _of_polygons(a, b)
    corners = [_below(b[:, k], first.points) for k in range(b.shape[1])]
    corners += [_in_polygon(np.broadcast_to(p, (len(b), 2)), b) for p in first.points[1:-1]]
    return np.asarray(np.max(corners, axis=0))


EVENT_DRIVEN: tuple[dict[str, Any], ...] = (
    {"name": "rk4"}, {"name": "rk-gill"}, {"name": "dopri5"}, {"name": "gauss", "stages": 2}, {"name": "radau-iia"},
    {"name": "dopri5", "adaptive": True}, {"name": "dop853", "adaptive": True, "rtol": 1e-10},
    {"name": "gauss", "stages": 3, "adaptive": True},
    {"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-8}, {"name": "scipy-dop853", "rtol": 1e-8},
    {"name": "scipy-radau"}, {"name": "scipy-lsoda"},
)  # fmt: skip
TIME_STEPPING: tuple[dict[str, Any], ...] = ({"name": "moreau-jean"}, {"name": "nonsmooth-generalized-alpha"})
STEP = {"event-driven": 0.02, "time-stepping": 0.002}
"""Fixed steps [s]."""
ROWS = 400
"""Number of states in which overlaps of adaptive methods are measured, by dense output; else the ends of steps."""
TOLERANCE, CLOSED = 1e-7, 1e-4
"""Depths of overlaps [m] that count, of bodies that are apart and of those in contact, whose rows are interpolated."""


def outline(kind: str, points: list[list[float]], radius: float = 0.0) -> Outline:
    return Outline(kind, np.array(points), radius)


GROUNDS = (
    outline("polyline", [[-9.0, 0.0], [-0.2, 0.0], [-0.2, -0.08], [9.0, -0.08]]),
    outline("polyline", [[-9.0, 0.1], [-0.5, 0.0], [-0.1, 0.15], [0.1, -0.05], [0.5, 0.05], [9.0, 0.6]]),
    outline("polyline", [[-9.0, 0.0], [9.0, 0.0]]),
    outline("polygon", [[-0.15, -0.3], [0.15, -0.3], [0.15, 0.0], [-0.15, 0.0]]),
    outline("polygon", [[-2.0, -1.0], [2.0, -1.0], [2.0, 0.0], [-2.0, 0.0]]),
    outline("circle", [[0.0, -0.4]], 0.4),
)


def drawn_outline(random: np.random.Generator, size: float) -> Outline:
    """Return a circle, or a convex polygon of three to five corners around the origin or beside it."""
    center = size * random.uniform(-0.3, 0.3, 2)
    if random.uniform() < 0.3:
        return Outline("circle", np.round(center[None], 4), round(float(size * random.uniform(0.4, 0.8)), 4))
    while True:
        angles = np.sort(random.uniform(0.0, 2.0 * np.pi, random.integers(3, 6)))
        apart = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
        if np.max(apart) < 0.9 * np.pi and np.min(apart) > 0.3:
            return Outline("polygon", np.round(center + size * np.column_stack([np.cos(angles), np.sin(angles)]), 4))


@dataclass(frozen=True)
class Scene:
    """Bodies that fall on the ground and on each other.

    Attributes
    ----------
    outlines
        Those of the ground and of the bodies.
    spec
        The spec of the run.
    """

    outlines: list[Outline]
    spec: dict[str, Any]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of outlines in contact, in the order of `overlap`."""
        rank = {"polyline": 0, "polygon": 1, "circle": 2}
        pairs = combinations(range(len(self.outlines)), 2)
        return [(a, b) if rank[self.outlines[a].kind] <= rank[self.outlines[b].kind] else (b, a) for a, b in pairs]

    def deepest(self, run: mbdkit.Run) -> float:
        """Return the deepest overlap in the recorded states that counts [m]."""
        places = [np.zeros((len(run.time), 3))]
        places += [np.column_stack([run[name].position, run[name].angle]) for name in run.bodies]
        deepest = 0.0
        for a, b in self.pairs:
            depth = overlap(self.outlines[a], places[a], self.outlines[b], places[b])
            modes = [run.contacts[name].mode for name in run.contacts if name.split(".")[0] == f"c{a}{b}"]
            is_sound = (np.max(modes, axis=0) > 0.0) & (depth < CLOSED)
            deepest = max(deepest, float(np.max(np.where(is_sound, 0.0, depth))))
        return deepest


def drawn_scene(seed: int) -> Scene:
    """Return a scene of one to four bodies, with a method of either treatment."""
    random = np.random.default_rng([68, seed])
    count = int(random.choice([1, 1, 2, 3, 4]))
    treatment = "time-stepping" if seed % 5 == 4 else "event-driven"
    methods = TIME_STEPPING if treatment == "time-stepping" else EVENT_DRIVEN
    method = methods[seed // 5 % len(methods)] if treatment == "time-stepping" else methods[seed % len(methods)]
    outlines = [GROUNDS[random.integers(len(GROUNDS))], *(drawn_outline(random, 0.2) for _ in range(count))]
    bodies: dict[str, Any] = {}
    for number in range(count):
        bodies[f"b{number}"] = {
            "mass": 1.0, "inertia": 0.01,
            "position": [round(float(random.uniform(-0.25, 0.25)), 4), round(0.6 + 0.7 * number, 4)],
            "angle": round(float(random.uniform(-3.0, 3.0)), 4),
            "velocity": [round(float(random.uniform(-0.5, 0.5)), 4), 0.0],
            "angular_velocity": round(float(random.uniform(-8.0, 8.0)), 4),
        }  # fmt: skip
    laws = {
        "friction": float(random.choice([0.0, 0.3])), "restitution": float(random.choice([0.0, 0.3, 0.6, 0.9])),
    }  # fmt: skip
    names = ["ground", *bodies]
    scene = Scene(outlines, {})
    contacts = {
        f"c{a}{b}": {"bodies": [names[a], names[b]], "shapes": [outlines[a].shape(), outlines[b].shape()]} | laws
        for a, b in scene.pairs
    }
    end = round(float(random.uniform(0.45, 0.8)), 4)
    is_fixed = not method.get("adaptive") and not method["name"].startswith("scipy")
    span: dict[str, Any] = {"end": end} | ({"step": STEP[treatment]} if is_fixed else {})
    spec = {
        "mbdkit": 1, "model": {"name": "mechanism", "bodies": bodies, "contacts": contacts}, "integrator": method,
        "time": span, "contact": {"treatment": treatment},
        "output": {"every": 1} if is_fixed else {"interval": end / ROWS},
    }  # fmt: skip
    return Scene(outlines, spec)


def faults_of(seed: int) -> list[str]:
    """Return what is wrong with the run of a scene: an overlap, or a wait without end. A run may fail for a reason that
    it names, such as numbers that overflow in a method with steps that are too long.
    """
    scene = drawn_scene(seed)
    with mbdkit.run(scene.spec, limits={"wall_time": 60.0}) as run:
        deepest, name = scene.deepest(run), run.spec["integrator"]["name"]
        says_so = any("rigid contact" in reason for reason in run.verdict_reasons)
        faults = [f"{seed} {name}: overlap of {deepest:.3g} m"] if deepest > TOLERANCE and not says_so else []
        if run.status_reason.startswith("wall-time"):
            faults.append(f"{seed} {name}: {run.status_reason}")
    return faults


@pytest.mark.parametrize("count", [20, pytest.param(2000, marks=pytest.mark.slow)])
def test_bodies_of_drawn_scenes_do_not_overlap_without_a_word(count: int) -> None:
    assert [fault for seed in range(count) for fault in faults_of(seed)] == []


@dataclass(frozen=True)
class Fall:
    """A body that falls on a ledge or a post, where its nearest corner or edge changes within a step.

    Attributes
    ----------
    ground, corners
        Number of the ground in `GROUNDS`, and the polygon of the body; a circle of 0.15 m if there is none.
    start
        x, y, angle, velocity along x, and angular velocity.
    friction, restitution, end
        Coefficients, and the duration [s].
    method
        The integrator with which the impact was missed.
    """

    ground: int
    corners: list[list[float]]
    start: tuple[float, float, float, float, float]
    friction: float
    restitution: float
    end: float
    method: dict[str, Any]

    @property
    def outlines(self) -> list[Outline]:
        return [GROUNDS[self.ground], outline("polygon" if self.corners else "circle", self.corners or [[0, 0]], 0.15)]

    def run(self, **more: Any) -> mbdkit.Run:
        x, y, angle, vx, rate = self.start
        body = {"mass": 1.0, "inertia": 0.01, "position": [x, y], "angle": angle, "velocity": [vx, 0.0]}
        contact = {"bodies": ["ground", "b"], "shapes": [one.shape() for one in self.outlines]}
        contact |= {"friction": self.friction, "restitution": self.restitution}
        model = {"bodies": {"b": body | {"angular_velocity": rate}}, "contacts": {"c": contact}}
        return run(model, self.end, method=self.method, **more)


FALLS = {
    "ledge": Fall(
        0, [[0.142, 0.157], [-0.004, 0.231], [-0.237, -0.138], [0.152, -0.163]], (0.013, 0.685, -1.679, -0.041, 7.193),
        0.0, 0.9, 0.587, {"name": "dop853", "adaptive": True, "rtol": 1e-10},
    ),
    "ledge and radau-iia": Fall(
        0, [[0.2466, 0.0776], [-0.1751, 0.1754], [-0.1096, -0.1698], [-0.0009, -0.2041]],
        (0.07015954753794257, 0.5330199155593354, 1.6439603261299158, -0.15172606101236985, -4.076808197091487),
        0.0, 0.6, 0.664192520762682, {"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-8},
    ),
    "post": Fall(
        3, [[0.1198, 0.0605], [-0.0334, 0.1385], [-0.1134, -0.0812], [0.028, -0.1294]],
        (0.07606521858609575, 0.30748091131677435, 2.7971604851579137, -0.14099642174191296, -3.2478029747355297),
        0.0, 0.3, 0.7818045811334358, {"name": "dop853", "adaptive": True, "rtol": 1e-10},
    ),
    "post and triangle": Fall(
        3, [[-0.009, 0.245], [-0.184, -0.105], [0.193, -0.139]], (0.085, 0.68, 1.045, -0.462, -1.097),
        0.3, 0.9, 0.699, {"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-8},
    ),
    "post and disc": Fall(
        3, [], (-0.06741291097723467, 0.5063312730670781, -0.09641609068384271, -0.13388218307350852,
                0.8324017985798137),
        0.3, 0.6, 0.6800786548278164, {"name": "scipy-dop853", "rtol": 1e-8},
    ),
}  # fmt: skip
"""Falls in which samples of the gaps missed impacts."""


@pytest.mark.parametrize("fall", FALLS.values(), ids=FALLS)
def test_an_impact_of_a_corner_that_comes_near_within_a_step_is_located(fall: Fall) -> None:
    found = fall.run(output={"interval": fall.end / ROWS})
    place = np.column_stack([found["b"].position, found["b"].angle])
    assert found.status == "complete"
    assert np.max(overlap(fall.outlines[0], np.zeros_like(place), fall.outlines[1], place)) < TOLERANCE


@pytest.mark.parametrize("check", [False, True])
def test_rigid_bodies_that_overlap_make_a_run_bad(monkeypatch: pytest.MonkeyPatch, check: bool) -> None:
    # a fault of the search is made: no impact is found, and the ball falls 0.21 m into the floor
    monkeypatch.setattr(EventStep, "first_event", lambda self, there: None)
    contacts = {"floor": {"bodies": ["ground", "b"], "shapes": [FLOOR, {"point": [0, 0]}]}}
    model = {"bodies": {"b": {"mass": 1.0, "position": [0.0, 1.0]}}, "contacts": contacts}
    more: dict[str, Any] = {"end": (2.0 * 1.21 / G) ** 0.5, "method": "scipy-dop853", "check": check}
    found = run(model, **more)
    assert found.verdict == "bad"
    reason = found.verdict_reasons[0]
    assert reason.startswith("The shapes of the rigid contact 'floor' overlap by 0.21 m at t = 0.4966")
    assert run(model, **more, accept=["rigid-overlaps"]).verdict != "bad"
