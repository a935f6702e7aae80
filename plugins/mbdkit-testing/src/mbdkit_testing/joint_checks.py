"""Checks of a kind of joints: its class, its functions, its rows on each pair of bodies of its example, and runs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.archive.reader import load
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.text import listed
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.joint_base import FunctionJoint
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.simulation import simulate
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed
from mbdkit_testing.example_checks import balance, checkpoint, tangents, without_plugin
from mbdkit_testing.example_under_test import completed, with_units
from mbdkit_testing.item_checks import relative_difference
from mbdkit_testing.joint_under_test import SMOOTH, JointUnderTest, Pair, recorded, slope

#: Largest errors of derivatives and of equal values, in parts of the size of the joint.
DERIVATIVE, SAME = 1e-8, 1e-9
MOVED = 0.01  #: Largest displacement by which assembly may close a joint of the example, as a part of its size.
#: Displacements from the start at which all rows are finite, as a part of the size of the joint, and their number.
NEXT_TO_START, TRIES = 1e-3, 200
#: Lines through the start on which curvatures are compared, points on each, its intervals with the largest changes that
#: are halved and how often, and the change that remains only of a jump, relative to the curvature. At the ends of
#: tables, 0.007 remain.
LINES, POINTS, LARGEST, HALVINGS, JUMP = 8, 201, 3, 30, 0.02
WORTH = 20.0  #: Factor by which the change of a row may differ from the displacement that causes it.
#: Largest difference of motions by several methods, in parts of the motion, and number of the steps of these runs.
MOTION, SHORT = 1e-7, 12
#: Methods and formulations that are compared with Gauss collocation of order 8 on index 1.
METHODS: tuple[dict[str, Any], ...] = (
    {"integrator": {"name": "dop853", "adaptive": True, "rtol": 1e-11}, "formulation": "index-1"},
    {"integrator": {"name": "radau-iia", "stages": 5}, "formulation": "index-2"},
    {"integrator": {"name": "radau-iia", "stages": 5}, "formulation": "index-3"},
    {"integrator": {"name": "radau-iia", "stages": 5}, "formulation": "ggl"},
    {"integrator": {"name": "gauss", "stages": 4}, "formulation": "joint-coordinates"},
)


@check("joint.class")
def own_class(kind: JointUnderTest) -> Result:
    """The class is derived from `FunctionJoint`, its `type` is the name of the kind, and units of rows are m or rad."""
    field = kind.model.model_fields.get("type")
    default = None if field is None else field.default
    if default != kind.plugin.name:
        return failed(
            f"the `type` of its class is {default!r} by default, not the name of the kind, '{kind.plugin.name}'"
        )
    for joint in kind.elements.values() if kind.plugin.example or "spec" in vars(kind) else ():
        if cause := _wrong_rows(joint.rows, joint.units):
            return failed(cause)
    return passed()


def _wrong_rows(rows: Sequence[str], units: Sequence[str]) -> str:
    """Return what is wrong with the names and units of rows."""
    if not rows or len(set(rows)) != len(rows):
        return f"its `rows` are {listed(rows) or 'empty'}; each row needs a name of its own"
    if len(units) != len(rows):
        return f"it has {len(rows)} `rows`, but {len(units)} `units`"
    if wrong := [unit for unit in units if unit not in ("m", "rad")]:
        return f"the unit of a row is {wrong[0]}, not m or rad"
    return ""


@check("joint.functions")
def functions(kind: JointUnderTest) -> Result:
    """There is one function for each row; it can be differentiated, has no memory, and equal ones are one object.

    A function of a place does not depend on where the pair lies.
    """
    number, mechanism = 0, kind.spec.mechanism()
    for name, joint in kind.elements.items():
        start = mechanism.relative_pose(joint)
        first, second = list(joint.functions(start)), list(joint.functions(start))
        if len(first) != len(joint.rows):
            return failed(f"'{name}' has {len(joint.rows)} rows, {listed(joint.rows)}, but {len(first)} functions")
        before = [recorded(one) for one in first]
        turned = complex(start.x, start.y) * 1j
        with suppress(SpecError):  # bodies that cannot be joined
            joint.functions(start._replace(x=turned.real, y=turned.imag, angle=start.angle + np.pi / 2))
        for row, one, terms in zip(joint.rows, first, before, strict=True):
            if recorded(one) != terms:
                return failed(
                    f"the function of row '{row}' is another one when it is called again; it may depend on `pose` and "
                    "`p` only, not on counters, clocks, random numbers or variables that change"
                )
            if "first" in terms.variables and terms.variables & {"x", "y"}:
                return failed(
                    f"row '{row}' of '{name}' is a function of a place and of `pose.first`, so that its curve lies in "
                    "the global frame, and its reaction has a torque on the pair that no body exerts; `x` and `y` are "
                    "those of a's frame already, and `first` is for couplings of angles alone"
                )
        try:
            mine, others = ([(x.function, hash(x.function), x.parameters) for x in some] for some in (first, second))
            are_equal = mine == others
        except TypeError:  # a function cannot be hashed
            are_equal = False
        if not are_equal:
            return failed(
                "equal joints have different functions, which cannot share a program: use a function of a module, or "
                "an object of a frozen dataclass"
            )
        number += len(first)
    kind.workspace  # noqa: B018 - derivatives are recorded; what cannot be differentiated is refused by its name
    return passed(functions=number)


@check("joint.start")
def start(kind: JointUnderTest) -> Result:
    """Joints of the example are closed at the start, and stay finite next to it; assembly closes what is displaced."""
    mechanism = kind.spec.mechanism()
    given = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
    size = kind.workspace.mechanism.length
    bodies = [kind.workspace.mechanism.bodies.index(name) for name in mechanism.bodies]
    moved = np.abs(kind.workspace.q0.reshape(-1, 3)[bodies] - given) / [size, size, 1.0]
    if not (most := float(np.max(moved, initial=0.0))) <= MOVED:
        return failed(
            "assembly moves the bodies of its example, because rows are not zero where these begin: compare signs and "
            "offsets of the functions with `start`",
            displacement=most,
        )
    for name, pair in kind.pairs.items():
        rows = np.abs(pair.rows_at(pair.q)) / pair.units
        if not np.max(rows) <= SAME:
            return failed(f"after assembly, '{name}' is not closed", row=float(np.max(rows)))
        random = np.random.default_rng(2)
        for _ in range(TRIES):
            near = pair.q + NEXT_TO_START * pair.scales * random.uniform(-1.0, 1.0, len(pair.q))
            if not np.all(np.isfinite(pair.rows_at(near))):
                return failed(f"a row of '{name}' is not a finite number next to the start, where steps may try it")
    return passed(displacement=most)


@check("joint.turns")
def turns(kind: JointUnderTest) -> Result:
    """Rows do not jump as the second body turns, or moves around the first one, by more than a turn."""
    most = 0.0
    for name, pair in kind.pairs.items():
        for around in (False, True):
            for turned, rows, _ in pair.walk(around=around):
                most = max(most, turned)
                for row, value in zip(pair.joint.rows, np.abs(rows) / pair.units, strict=True):
                    if value > SMOOTH:
                        return failed(
                            f"row '{row}' of '{name}' jumps after {turned:.2g} turns; count the turns of angles from "
                            "`arctan2`"
                        )
    return passed(turns=most)


@check("joint.points")
def points(kind: JointUnderTest) -> Result:
    """The pose refers to the points that the joint has on its bodies, wherever the origins of their frames are."""
    for name, pair in kind.pairs.items():
        for which, word in enumerate(("first", "second")):
            by, body = (0.3 * pair.size, -0.2 * pair.size), pair.joint.bodies[which]
            at = _points(pair.joint)[which]
            other = pair.with_points_moved(which, by) if body != GROUND and at == pair.joint.points[which] else pair
            for joint in (pair.joint, other.joint):
                at, listed_there = _points(joint)[which], [point for _, on, point in joint.attachments() if on == body]
                if at not in map(tuple, listed_there):
                    return failed(
                        f"the pose of '{name}' refers to the point {list(at)} of the {word} body, which is not among "
                        "the `attachments` of the joint; `flat_points` has to return the points that it has"
                    )
            for q in () if other is pair else pair.states():
                k = 3 * pair.equations.bodies.index(body)
                c, s = np.cos(q[k + 2]), np.sin(q[k + 2])
                same = q.copy()
                same[k : k + 2] += c * by[0] - s * by[1], s * by[0] + c * by[1]
                off = np.max(np.abs(other.rows_at(same) - pair.rows_at(q)) / pair.units)
                if not off <= SAME:
                    return failed(
                        f"the rows of '{name}' change with the frame of the {word} body, although its point in "
                        "`points` is the same one",
                        off=float(off),
                    )
    return passed(joints=len(kind.pairs))


def _points(joint: FunctionJoint) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the points to which the pose refers, on both bodies."""
    xa, ya, xb, yb = joint.flat_points
    return (xa, ya), (xb, yb)


@check("joint.units")
def units(kind: JointUnderTest) -> Result:
    """A row in m doubles if all lengths do, and one in rad stays; rows change about as much as the bodies move."""
    worth, scaled = [], 0
    for name, pair in kind.pairs.items():
        twice = pair.enlarged(2.0)
        for q in pair.states():
            jac = np.abs(pair.equations.constraint_jacobian(pair.time, q).toarray() * pair.scales) / pair.units[:, None]
            worth += np.max(jac, axis=1).tolist()
            if twice is None:
                continue
            scaled += 1
            rows, double = pair.rows_at(q), twice.rows_at((q.reshape(-1, 3) * [2.0, 2.0, 1.0]).ravel())
            for row, unit, one, other in zip(pair.joint.rows, pair.joint.units, rows, double, strict=True):
                factor, size = (2.0, pair.size) if unit == "m" else (1.0, 1.0)
                if not abs(other - factor * one) <= SAME * size:
                    what = "double" if unit == "m" else "stay the same"
                    return failed(
                        f"row '{row}' of '{name}' is in {unit}, but does not {what} if all lengths double: a length is "
                        "missing in it, or a key has no unit [m]",
                        factor=float(other / one),
                    )
    least, largest = min(worth), max(worth)
    if not 1.0 / WORTH <= least <= largest <= WORTH:
        return failed(
            "a row changes by much more or less than the bodies move, so that it is no measure of misalignment",
            least=least,
            largest=largest,
        )
    return passed(least=least, largest=largest, scaled=scaled).within({"largest": WORTH})


@check("derivatives.rows")
def rows(kind: JointUnderTest) -> Result:
    """Jacobian, gamma and weighted derivatives of rows agree with differences, near the start and on a way from it."""
    worst: dict[str, float] = {}
    for name, pair in kind.pairs.items():
        way = [q for around in (False, True) for _, _, q in pair.walk(around=around)]
        for q in [*pair.states(), *way[:: max(1, len(way) // 6)]]:
            for what, off in _errors_of_derivatives(pair, q).items():
                worst[what] = max(worst.get(what, 0.0), off)
                if not off <= DERIVATIVE:
                    return failed(
                        f"the {what} of the rows of '{name}' differs from differences: a function is not smooth, or "
                        "contains `.plain`",
                        off=off,
                    )
    return passed(**worst).within(dict.fromkeys(worst, DERIVATIVE))


@check("derivatives.curvature")
def curvature(kind: JointUnderTest) -> Result:
    """The curvature of rows does not jump, also far from the motion of the example."""
    random, at = np.random.default_rng(5), np.linspace(-1.0, 1.0, POINTS)
    for name, pair in kind.pairs.items():
        for _ in range(LINES):
            d = pair.scales * random.uniform(-1.0, 1.0, len(pair.q)) * np.tile([1.0, 1.0, np.pi], len(pair.places))
            values = [pair.curvature_at(pair.q + s * d, d) for s in at]
            changes, size = np.abs(np.diff(values, axis=0)).max(axis=1), max(1.0, float(np.nanmedian(np.abs(values))))
            for k in np.argsort(-np.nan_to_num(changes))[:LARGEST]:
                (low, high), (first, last) = at[k : k + 2], values[k : k + 2]
                for _ in range(HALVINGS):
                    middle = (low + high) / 2
                    value = pair.curvature_at(pair.q + middle * d, d)
                    is_below = np.max(np.abs(value - first)) > np.max(np.abs(last - value))
                    low, high, first, last = (low, middle, first, value) if is_below else (middle, high, value, last)
                if (jump := float(np.max(np.abs(last - first)))) > JUMP * size:
                    return failed(f"the curvature of the rows of '{name}' jumps away from the example", jump=jump)
    return passed(joints=len(kind.pairs))


def _errors_of_derivatives(pair: Pair, q: np.ndarray) -> dict[str, float]:
    """Return the relative error of each derivative at a position, with drawn velocities and multipliers."""
    equations, scales, rows, t = pair.equations, pair.scales, pair.units, pair.time
    random = np.random.default_rng(3)
    v, a = (scales * random.uniform(-1.0, 1.0, len(q)) for _ in range(2))
    lam = random.uniform(-1.0, 1.0, len(rows)) / rows

    exact = equations.tangents(t, q, v, a, lam)
    jacobian = equations.constraint_jacobian(t, q).toarray()

    def force(x: np.ndarray) -> np.ndarray:
        return equations.residual(t, x, v, a, lam)

    def acceleration(x: np.ndarray) -> np.ndarray:
        return np.asarray(equations.constraint_jacobian(t, x) @ a - equations.gamma(t, x, v))

    compared = {
        "Jacobian": (jacobian * scales / rows[:, None], pair.differences(pair.rows_at, q) / rows[:, None]),
        "gamma": (
            equations.gamma(t, q, v) / rows,
            -slope(lambda s: equations.constraint_rates(t + s, q + s * v, v)) / rows,
        ),
        "stiffness": (
            exact.stiffness.toarray() * scales * scales[:, None],
            pair.differences(force, q) * scales[:, None],
        ),
        "derivative of gamma": (
            exact.residual_q.toarray() * scales / rows[:, None],
            pair.differences(acceleration, q) / rows[:, None],
        ),
    }
    return {what: relative_difference(*values) for what, values in compared.items()}


@check("joint.reaction")
def reaction(kind: JointUnderTest) -> Result:
    """Reactions do no work along displacements that the rows allow, and those on both bodies are in balance."""
    for name, pair in kind.pairs.items():
        equations = pair.equations
        lam = np.random.default_rng(4).uniform(0.5, 1.0, equations.m) / pair.units
        for q in pair.states():
            force = equations.constraint_forces(pair.time, q, lam)
            allowed = np.linalg.svd(pair.differences(pair.rows_at, q))[2][equations.m :]
            work = np.abs(allowed @ (force * pair.scales)) / np.linalg.norm(force * pair.scales)
            if not np.max(work, initial=0.0) <= DERIVATIVE:
                return failed(f"the reaction of '{name}' does work along a displacement that its rows allow")
            if _is_out_of_balance(pair, q, force, equations.reactions(pair.time, q, lam)[0]):
                return failed(
                    f"the reactions of '{name}' on its two bodies, at the second body's point, are not in balance"
                )
    return passed(joints=len(kind.pairs))


def _is_out_of_balance(pair: Pair, q: np.ndarray, force: np.ndarray, values: np.ndarray) -> bool:
    """Return whether the forces ``Phi_q^T lam``, the negative ones on the bodies, are not those of a reaction.

    It is a force (x, y) and a torque on the second body, at its point, and the opposite ones on the first.
    """
    at, bodies = pair.point(q, 1), pair.equations.bodies
    own = np.zeros(len(q))
    for body, sign in zip(pair.joint.bodies, (1.0, -1.0), strict=True):
        if body in bodies:
            k = 3 * bodies.index(body)
            x, y = at - q[k : k + 2]
            own[k : k + 3] = sign * values[0], sign * values[1], sign * (values[2] + x * values[1] - y * values[0])
    off = (force - own) / pair.scales
    if pair.of_first and pair.joint.bodies[0] in bodies:  # the ground bears a torque if an absolute angle matters
        off[3 * bodies.index(pair.joint.bodies[0]) + 2] = 0.0
    return not np.max(np.abs(off * pair.scales**2)) <= SAME * np.linalg.norm(force * pair.scales)


@check("joint.spec")
def spec(kind: JointUnderTest) -> Result:
    """Joints round-trip through a spec, an archive and Python, and take numbers with the units of their keys."""
    data = kind.spec.mechanism().to_spec()
    if Mechanism.from_spec(data).to_spec() != data:
        return failed("its joints change in a round trip through a spec")
    others = {name: joint for name, joint in data["joints"].items() if name not in kind.elements}
    again, stated = Mechanism.from_spec({**data, "joints": others}), dict(data["joints"])
    for name in kind.elements:
        one = data["joints"][name]
        options = {key: value for key, value in one.items() if key not in ("type", "bodies")}
        getattr(again, kind.plugin.builder)(name, *one["bodies"], **options)
        stated[name] = one | with_units(kind.model, options)
    added = again.to_spec()["joints"]
    if any(added[name] != data["joints"][name] for name in kind.elements):
        return failed(f"joints that are added by `Mechanism.{kind.plugin.builder}` differ from those of a spec")
    if kind.changed(data | {"joints": stated}).mechanism().to_spec() != data:
        return failed("its numbers change if they are written with units")
    with tempfile.TemporaryDirectory(prefix="mbdkit-joint-") as folder:
        path = Path(folder) / "run.h5"
        simulate(_short(kind), path=path).close()
        with load(path) as run:
            if run.mechanism.to_spec()["joints"] != data["joints"]:
                return failed("its joints change in a round trip through an archive")
    return passed(joints=len(kind.elements))


def _short(kind: JointUnderTest, factor: float = 1.0, **sections: Any) -> Any:
    """Return the spec of the first steps of the example."""
    times = kind.times(factor)
    end = min(times["end"], times["start"] + SHORT * kind.times()["step"])
    return kind.changed(time={**times, "end": end}, output={}, events={}, measures={}, parameters={}, **sections)


@check("energy.methods")
def methods(kind: JointUnderTest) -> Result:
    """Several methods and formulations, also in joint coordinates, give the same motion, and joints stay closed."""
    gauss = {"integrator": {"name": "gauss", "stages": 4}, "formulation": "index-1", "stabilization": "none"}

    def end_of(found: Any) -> np.ndarray:
        with completed(found) as run:
            position = run.array("trajectory/position")
            return np.concatenate([position[-1], np.abs(position[-1] - position[0])])

    reference, agreed, refused, worst = end_of(_short(kind, 0.5, **gauss)), 0, [], 0.0
    half = len(reference) // 2
    size = np.array([kind.workspace.mechanism.length, kind.workspace.mechanism.length, 1.0])
    if not (motion := float(np.max(reference[half:] / size))) > 1e-9:
        raise Skip("the bodies of its example rest")
    for method in METHODS:
        try:
            result = end_of(_short(kind, 0.5, **method, stabilization="none"))
        except MbdkitError as error:
            refused.append(f"{method['formulation']}: {error}".rstrip("."))
            continue
        off = float(np.max(np.abs(result - reference)[:half] / size)) / motion
        worst, agreed = max(worst, off), agreed + 1
        if not off <= MOTION:
            name = method["integrator"]["name"]
            return failed(f"the motion by {name} on {method['formulation']} is another one", off=off)
    if agreed < 2:
        return failed(f"too few methods can integrate its example: {refused[0]}")
    return passed(methods=agreed, refused=len(refused), off=worst).within({"off": MOTION})


@check("drawing.lines")
def drawing(kind: JointUnderTest) -> Result:
    """Lines with which joints are drawn have finite points, each on the first or the second body."""
    lines, mechanism = 0, kind.spec.mechanism()
    for name, joint in kind.elements.items():
        for line in joint.lines(mechanism.relative_pose(joint)):
            lines += 1
            for body, point in line:
                if body not in (0, 1):
                    return failed(f"'{name}' is drawn on the body {body!r}; 0 is the first and 1 the second one")
                if len(point) != 2 or not np.all(np.isfinite(point)):
                    return failed(f"'{name}' is drawn at {point!r}")
    if not lines:
        raise Skip("its joints are not drawn as lines")
    return passed(lines=lines)


CHECKS = (
    own_class, functions, start, turns, points, units, rows, curvature, reaction, spec, balance, methods, tangents,
    checkpoint, drawing, without_plugin,
)  # fmt: skip
