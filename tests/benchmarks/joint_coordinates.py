"""Joint coordinates beside absolute ones and an independent oracle, on random trees and loops; and the time of a step.

``python -m tests.benchmarks.joint_coordinates --count N`` draws N mechanisms of pins, slots, slides, welds, drivers,
distances, springs and torques, and compares runs in joint coordinates with runs of the same method in absolute ones and
with SciPy's DOP853 on equations written by hand (`tests.engine.by_hand`): motion, every joint force and torque at the
end, and the misalignment of the joints of the tree. It ends with status 1 if anything differs by more than 1e-9 of its
size. ``--method`` chooses the method, ``--loops`` how its cut joints are imposed; the runs in absolute coordinates then
use the same formulation. ``--times`` prints the time of a step in both coordinates instead.
"""

from __future__ import annotations

import argparse
import io
import time
from contextlib import redirect_stderr
from typing import Any, get_args

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit.base.errors import MbdkitError
from mbdkit.engine.assembly import assemble
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.formulation import LoopsName
from mbdkit.engine.spanning_tree import cut_joints
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.start import start_method
from mbdkit.mechanism.joints import Driver
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.methods import INTEGRATORS
from mbdkit.spec import load_spec
from tests.engine.by_hand import ByHand, cross, first_derivative, turned
from tests.engine.random_mechanisms import KINDS, add_rod

END = 0.25
STEP = END / 100
ACCEPTED = 1e-9
ROUNDINGS = 16
"""Misalignment of joints of the tree, in units of the rounding error of the largest position, that is accepted."""
LEAST_CONDITION = 1e-2
_TIGHT = {"adaptive": True, "rtol": 1e-13, "atol": 1e-13}
METHODS: dict[str, dict[str, Any]] = {
    "dop853": {"name": "dop853", **_TIGHT},
    "gauss": {"name": "gauss", "stages": 6, **_TIGHT},
    "radau-iia": {"name": "radau-iia", "stages": 5, **_TIGHT},
}


def any_joints(rng: np.random.Generator) -> Mechanism:
    """Return rods that each hang on a random earlier one by a random joint, some of them in loops, with forces."""
    m, names = Mechanism(), ["ground"]
    for i in range(int(rng.integers(2, 8))):
        start, name = rng.normal(size=2), f"r{i}"
        parent = names[int(rng.integers(0, len(names)))]
        add_rod(m, rng, name, start, rng.uniform(-3, 3))
        ends = (parent, name) if rng.random() < 0.5 else (name, parent)
        kind = rng.choice(["revolute", "revolute", "revolute", "prismatic", "point_on_line", "weld", "none"])
        if kind in ("prismatic", "point_on_line"):
            getattr(m, kind)(f"J{i}", *ends, at=start, axis=tuple(rng.normal(size=2)))
        elif kind != "none":
            getattr(m, kind)(f"J{i}", *ends, at=start)
        if i > 1 and rng.random() < 0.3:
            kind = rng.choice(["revolute", "point_on_line", "driver"])
            other = names[int(rng.integers(0, len(names)))]
            if kind == "driver":
                turn = m.bodies[name].angle - (m.bodies[other].angle if other != "ground" else 0.0)
                motion = f"{turn!r} + 0.3*sin(2*t) + 0.5*t**2"
                m.driver(f"D{i}", other, name, coordinate="angle", motion=motion)
            elif kind == "revolute":
                m.revolute(f"L{i}", other, name, at=rng.normal(size=2))
            else:
                m.point_on_line(f"L{i}", other, name, at=rng.normal(size=2), axis=tuple(rng.normal(size=2)))
        names.append(name)
    a, b = (names[int(x)] for x in rng.choice(len(names), 2, replace=False))
    points = tuple(tuple(x) for x in rng.normal(size=(2, 2)))
    m.spring_damper("spring", a, b, points=points, stiffness=rng.uniform(5, 50), damping=rng.uniform(0, 2))
    m.torque("torque", names[-1], value="cos(3*t)")
    return m


KINDS_DRAWN = {**KINDS, **{f"any {i}": any_joints for i in range(6)}}


class Oracle:
    """The index-1 equations written by hand, solved by SciPy's DOP853 at a relative tolerance of 1e-13."""

    def __init__(self, mechanism: Mechanism):
        self.hand, self.mechanism = ByHand(mechanism), mechanism
        self.n = self.hand.n

    def solve(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return accelerations (n,) and multipliers (m,) at a state."""
        hand, n = self.hand, self.n
        whole_q, whole_v = with_ground(q), with_ground(v)
        jacobian = hand.jacobian(whole_q, t)

        def rate(s: float) -> np.ndarray:
            return hand.jacobian(whole_q + s * whole_v, t + s) @ v + hand.phi_t(whole_q + s * whole_v, t + s)

        gamma = -first_derivative(rate, 3e-3) if len(jacobian) else np.zeros(0)
        matrix = np.block([[np.diag(hand.mass), jacobian.T], [jacobian, np.zeros((len(jacobian),) * 2)]])
        solution = np.linalg.solve(matrix, np.concatenate([hand.forces(whole_q, whole_v, t), gamma]))
        return solution[:n], solution[n:]

    def run(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state at `END`."""
        n = self.n
        found = solve_ivp(
            lambda t, y: np.concatenate([y[n:], self.solve(t, y[:n], y[n:])[0]]),
            (0.0, END), np.concatenate([q, v]), method="DOP853", rtol=1e-13, atol=1e-13,
        )  # fmt: skip
        return found.y[:n, -1], found.y[n:, -1]

    def reactions(self, t: float, q: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """Return force (x, y) and torque of every joint on its second body, at its point; without torque on ground."""
        lam, whole = self.solve(t, q, v)[1], with_ground(q)
        jacobian, row, found = self.hand.jacobian(whole, t), 0, {}
        for name, joint in self.mechanism.joints.items():
            rows = slice(row, row + len(joint.rows))
            row = rows.stop
            force = -jacobian[rows].T @ lam[rows]
            a, b = joint.bodies
            own = joint.point if isinstance(joint, Driver) else joint.attachments()[-1][2]
            body, point = (b, own) if b in self.mechanism.bodies else (a, None)
            i = 3 * self.hand.number[body]
            push = force[i : i + 3]
            if point is None:
                found[name] = np.array([*-push[:2], np.nan])
            else:
                arm = turned(self.hand.angle(whole, body), point)
                found[name] = np.array([*push[:2], push[2] - cross(arm, push[:2])])
        return found


def differences(mechanism: Mechanism, method: str, loops: str) -> dict[str, float]:
    """Return the differences of a run in joint coordinates from others, as shares.

    Raises MbdkitError if a run is not possible.
    """
    state, oracle = assemble(mechanism, 0.0), Oracle(mechanism)
    if len(mechanism.joints) and oracle.hand.conditioning(with_ground(state.q), 0.0) < LEAST_CONDITION:
        raise MbdkitError("the constraints are nearly dependent")
    settings: dict[str, Any] = {"integrator": METHODS[method], "time": {"end": END}, "limits": {"max_steps": 3000}}
    if loops == "index-3":  # the tolerance bounds errors of positions only
        settings |= {"integrator": {"name": "radau-iia", "stages": 5}, "time": {"end": END, "step": STEP}}
    with redirect_stderr(io.StringIO()):  # warnings of large changes by assembly
        ours, theirs = (
            mbdkit.run(mechanism, formulation=one, **settings)
            for one in ({"name": "joint-coordinates", "loops": loops}, loops)
        )
    ours.check()
    theirs.check()
    q, v = oracle.run(state.q.ravel(), state.v.ravel())
    positions, speeds = q.reshape(-1, 3), v.reshape(-1, 3)
    size, speed = (max(1.0, float(np.max(np.abs(x)))) for x in (q, v))
    found = dict.fromkeys(("oracle", "absolute", "reactions of the oracle", "reactions of absolute", "misaligned"), 0.0)

    def note(name: str, difference: Any, scale: float) -> None:
        found[name] = max(found[name], float(np.nanmax(np.abs(difference), initial=0.0)) / scale)

    for i, name in enumerate(mechanism.bodies):
        mine, other = ours.bodies[name], theirs.bodies[name]
        for one, place, rate in (
            ("oracle", positions[i], speeds[i]),
            ("absolute", [*other.position[-1], other.angle[-1]], [*other.velocity[-1], other.angular_velocity[-1]]),
        ):
            note(one, np.array([*mine.position[-1], mine.angle[-1]]) - place, size)
            note(one, np.array([*mine.velocity[-1], mine.angular_velocity[-1]]) - rate, speed)
    forces = {name: np.array([*x.reaction_force[-1], x.reaction_torque[-1]]) for name, x in ours.joints.items()}
    largest = max([1.0, *(float(np.max(np.abs(x))) for x in forces.values())])
    by_hand, cut = oracle.reactions(END, q, v), cut_joints(compile_mechanism(mechanism))
    for name, force in forces.items():
        other = theirs.joints[name]
        note("reactions of the oracle", force - by_hand[name], largest)
        note("reactions of absolute", force - [*other.reaction_force[-1], other.reaction_torque[-1]], largest)
        if name not in cut:
            note("misaligned", ours.joints[name].misalignment[1:], np.finfo(float).eps * size)
    return found


def compare(console: Console, count: int, seed: int, method: str, loops: str) -> bool:
    """Compare `count` mechanisms; return whether all agree."""
    worst: dict[str, tuple[float, str]] = {}
    compared, refused, n = 0, 0, 0
    kinds = list(KINDS_DRAWN)
    while compared < count:
        kind, n = kinds[n % len(kinds)], n + 1
        label = f"{kind} {n}"
        mechanism = KINDS_DRAWN[kind](np.random.default_rng([seed, n]))
        try:
            found = differences(mechanism, method, loops)
        except MbdkitError:  # cannot be assembled, or passes a singular position
            refused += 1
            continue
        compared += 1
        for name, value in found.items():
            worst[name] = max(worst.get(name, (0.0, "")), (value, label))
    title = f"{compared} mechanisms, {method}, loops: {loops}"
    table = Table("largest difference of joint coordinates", "share", "mechanism", title=title)
    agrees = True
    for name, (value, label) in worst.items():
        table.add_row(name, f"{value:.2g}", label)
        agrees = agrees and value <= (ROUNDINGS if name == "misaligned" else ACCEPTED)
    console.print(table)
    console.print(f"{refused} other mechanisms cannot be assembled, or are or become nearly singular")
    return agrees


def times(console: Console, repeats: int = 300) -> None:
    """Print the time of a step in both coordinates, of compiled code alone: the least over short stretches of a run."""
    table = Table("bodies", "method", "index-1 [us]", "joint-coordinates [us]", "ratio")
    for rods in (1, 2, 10, 100, 1000):
        mechanism = load_spec(
            {
                "mbdkit": 1,
                "model": {"name": "n-pendulum", "n": rods, "angle": -0.7},
                "integrator": {"name": "rk4"},
                "time": {"end": 1.0, "step": 0.1},
            }
        ).mechanism()
        for item in (item for item in INTEGRATORS if item.name in {"rk4", *METHODS}):
            steps = max(1, 1000 // rods)
            total = steps * (repeats + 1)
            planned = Timetable(0.0, total * 1e-4, step=1e-4, steps=total, every=total)
            steppers: dict[str, CompiledStepper] = {}
            for name in ("index-1", "joint-coordinates"):
                workspace, _ = workspace_at_start(mechanism, 0.0, formulation=name)
                made = start_method(item.create(item.options()), workspace, planned)
                assert isinstance(made, CompiledStepper)
                steppers[name] = made
            least = dict.fromkeys(steppers, np.inf)
            for _ in range(repeats):
                for name, stepper in steppers.items():
                    stepper.pace.steps = steps
                    begin = time.perf_counter()
                    stepper.advance()
                    least[name] = min(least[name], (time.perf_counter() - begin) / steps)
            absolute, joint = (x * 1e6 for x in least.values())
            table.add_row(str(rods), item.name, f"{absolute:.3g}", f"{joint:.3g}", f"{joint / absolute:.2f}")
    console.print(table)


def main() -> None:
    """Compare random mechanisms, or print times."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.joint_coordinates", description=__doc__)
    parser.add_argument("--count", type=int, default=300, help="number of mechanisms (default 300)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", choices=METHODS, default="dop853")
    parser.add_argument("--loops", choices=get_args(LoopsName), default="index-1")
    parser.add_argument("--times", action="store_true", help="print the time of a step instead")
    asked = parser.parse_args()
    console = Console()
    if asked.times:
        times(console)
    elif not compare(console, asked.count, asked.seed, asked.method, asked.loops):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
