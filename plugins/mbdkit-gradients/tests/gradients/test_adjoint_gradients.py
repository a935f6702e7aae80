"""Gradients by the adjoint: against dual numbers, against complex steps of a code of its own, and refusals."""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from tests.gradients.checks import assert_passed

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.engine.kernels.table_rows import LAW_ROW, SPRING
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit.laws.tabulated import LAW as TABLE
from mbdkit.runs.preparation import RunSetup, make_method
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.loading import _examples
from mbdkit.spec.sections import GradientMode
from mbdkit_gradients import adjoint_gradient
from mbdkit_gradients.adjoint_gradient import AdjointRun, why_forward
from mbdkit_gradients.adjoint_measures import NotByAdjointError
from mbdkit_gradients.backward_sweep import ARRAYS
from mbdkit_gradients.differentiated_expressions import expressions_of
from mbdkit_gradients.differentiated_run import Needs, differentiated_run
from mbdkit_gradients.measured_derivatives import derived_measures, needs_of
from mbdkit_gradients.table_derivatives import TableValues
from tests.engine.strategies import Drawn, mechanisms
from tests.margins import assert_within
from tests.witness.absolute import AbsoluteRods, rk4

MODES: tuple[GradientMode, GradientMode] = ("forward", "adjoint")
QUICK = ("pendulum", "double-pendulum", "four-bar", "slider-crank", "knee", "gravity-balanced-arm")
METHODS: tuple[dict[str, Any], ...] = (
    {"name": "rk4"},
    {"name": "gauss", "stages": 2},
    {"name": "dopri5", "adaptive": True, "rtol": 1e-7},
)


def random_seeds(spec: RunSpec, draw: np.random.Generator) -> Seeds:
    """Return a direction in which all numbers of the mechanism and of its start change."""
    workspace = RunSetup.of(spec).workspace
    top = workspace.mechanism.topology
    arrays: dict[str, np.ndarray] = {name: draw.normal(size=(*getattr(top, name).shape, 1)) for name in ARRAYS}
    arrays["mass"] *= top.mass[..., None]
    arrays["mass"][-1] = 0.0
    arrays["linear"] *= np.abs(top.linear)[..., None]
    arrays["spring_points"][top.springs[:, SPRING.segments] != 1] = 0.0
    of_laws = np.zeros(len(top.law_parameters))
    for law in top.springs[top.springs[:, SPRING.law] >= 0, SPRING.law]:
        begin = int(top.laws[law, LAW_ROW.parameters])
        of_laws[begin + 1 : begin + 1 + int(top.law_parameters[begin])] = 1.0
        if workspace.mechanism.laws[law][1].law is TABLE:
            of_laws[begin + 2 : begin + 4 + int(top.law_parameters[begin + 2])] = 0.0
    arrays["law_parameters"] *= (of_laws * np.abs(top.law_parameters))[:, None]
    arrays["weight"] = -(top.weight**2)[..., None] * arrays["mass"]
    for name, x in (("q", workspace.q0), ("v", workspace.v0)):
        arrays[name] = 0.1 * draw.normal(size=(len(x), 1))
        arrays[name][-3:] = 0.0
    return Seeds({name: x for name, x in arrays.items() if x.size}, np.ones(1))


def measures_of(spec: RunSpec) -> dict[str, str]:
    """Return measures of all kinds that the adjoint gives, of the last body, the first joint and the first spring."""
    mechanism = spec.mechanism()
    body, middle = f"bodies.{[*mechanism.bodies][-1]}", 0.5 * (spec.time.start + spec.time.final)
    wanted = [f"final({body}.x)", f"at({body}.angle, {middle!r})", "mean(energy.kinetic)", "final(energy.total)"]
    if mechanism.joints:
        joint = f"joints.{next(iter(mechanism.joints))}"
        wanted += [f"max(abs({joint}.force))", f"rms({joint}.force_x)"]
    springs = [name for name, force in mechanism.forces.items() if hasattr(force, "pathway")]
    if springs:
        wanted += [f"integral(forces.{springs[0]}.value)", f"final(forces.{springs[0]}.power)"]
    return {text: text for text in wanted}


def compare(spec: RunSpec, draw: np.random.Generator) -> str:
    """Compare both ways to differentiate in a random direction; return why the adjoint does not take the run, if so."""
    seeds = random_seeds(spec, draw)
    if why := why_forward(spec, make_method(spec), seeds):
        return why
    count = 0
    for text in measures_of(spec):
        try:
            expressions = expressions_of(spec, {text: (text, "")})
        except SpecError:
            continue
        need = needs_of(expressions[text])
        needs = Needs(need.nodes, need.ends)
        try:
            run = AdjointRun(spec, seeds, needs)
            found = run.measures(expressions)[text]
        except NotByAdjointError as error:
            if str(error).startswith(("an extremum", "the operand of 'rms'")):  # not smooth in this motion
                continue
            return str(error)
        known = derived_measures(differentiated_run(spec, seeds, needs, sizes=run.sizes), expressions, seeds)[text]
        size = max(abs(known.value), known.size, abs(float(known.slope[0])), 1e-3)
        assert_within(found.value - known.value, 1e-11 * size, text)
        assert_within(found.slope - known.slope, 3e-11 * max(abs(float(known.slope[0])), known.size, 1e-3), text)
        count += 1
    assert count
    return ""


def example(name: str, method: dict[str, Any], share: float = 1.0) -> RunSpec:
    """Return 40 steps of an example with another method, in a share of its steps."""
    path = _examples()[name]
    spec = load_spec(str(path), ())
    step = share * (spec.time.step or (spec.time.final - spec.time.start) / 1000)
    time = {"start": spec.time.start, "end": spec.time.start + 40 * step, "step": step}
    if "rtol" in method:
        time.pop("step")
    sections: dict[str, Any] = {"integrator": method, "time": time, "check": False, "measures": {}, "gradients": []}
    return load_spec(str(path), (), output={"every": 1}, **sections)


def is_run(name: str) -> bool:
    """Return whether a packaged example is a run of which there are gradients."""
    text = Path(_examples()[name]).read_text("utf-8")
    return "mbdkit: 1" in text.splitlines() and not re.search("^motion:", text, re.MULTILINE)


REFUSED = {
    "sit-down": "states",
    "delayed-balance": "states", "pd-leg": "states", "series-elastic-knee": "states",
    "flexible-slider-crank": "beams", "flying-spaghetti": "beams", "roll-up": "beams", "spin-up-beam": "beams",
    "knee-orthosis": "does not converge", "light-cart-pole": "projected",
}  # fmt: skip
"""Examples that the adjoint does not take, and a word of the reason."""
NO_GRADIENTS = ("belt", "elbow-curl", "jump", "leaf-spring", "slider-crank-guide", "walker")
"""Examples that have no gradients with these methods, or none at all: muscles, index 2, rigid contacts."""
RUNS = [name for name in sorted(_examples()) if name not in NO_GRADIENTS and is_run(name)]
EXAMPLES = [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in RUNS]


@pytest.mark.parametrize("name", EXAMPLES)
def test_adjoint_agrees_with_a_dual_direction_on_packaged_examples(name: str) -> None:
    # expected: the derivative in a random direction by dual numbers, from the kernels of the run itself
    is_stiff = name == "hinged-beam"  # whose stages a fixed-point iteration does not find
    spec = example(name, METHODS[0 if is_stiff else len(name) % 2], share=0.01 if is_stiff else 1.0)
    assert REFUSED.get(name, "") in (why := compare(spec, np.random.default_rng(len(name))))
    assert bool(why) == (name in REFUSED)


def test_a_run_whose_stages_a_fixed_point_iteration_does_not_find_is_refused_with_the_reason() -> None:
    # expected: gauss on a chain of stiff links, whose stages need Newton's method
    why = compare(example("hinged-beam", METHODS[1]), np.random.default_rng(11))
    assert why.endswith("the iteration for the stages diverges")


def test_adjoint_agrees_with_a_dual_direction_for_adaptive_steps() -> None:
    # expected: dual numbers with the same step sizes, which are constants
    compare(example("double-pendulum", METHODS[2]), np.random.default_rng(1))


def test_adjoint_agrees_with_a_dual_direction_with_baumgarte_terms() -> None:
    # expected: dual numbers
    base = {"name": "baumgarte", "alpha": 5.0, "beta": 7.0}
    spec = load_spec("four-bar", (), integrator={"name": "rk4"}, stabilization=base, time={"end": 0.2, "step": 0.005})
    compare(spec, np.random.default_rng(2))


@pytest.mark.parametrize("method", METHODS[:2])
def test_baumgarte_terms_of_steps_are_not_in_recorded_forces(method: dict[str, Any]) -> None:
    # expected: dual numbers; several measures, because the steps of one leave these terms behind
    arm = {"mass": 1.0, "inertia": 0.05, "position": [0.5, 0.0], "velocity": [0.0, -0.5], "angular_velocity": -1.0}
    pin = {"type": "revolute", "bodies": ["ground", "arm"], "points": [[0, 0], [-0.5, 0]]}
    spec = {
        "mbdkit": 1,
        "model": {"name": "mechanism", "bodies": {"arm": arm}, "joints": {"pin": pin}},
        "integrator": method,
        "stabilization": {"name": "baumgarte", "alpha": 20.0, "beta": 20.0},
        "time": {"end": 0.2, "step": 0.01},
    }
    force = "joints.pin.force_y"
    texts = [f"final({force})", "max(abs(joints.pin.force))", f"at({force}, 0.1)", f"mean({force})", "final(arm.ay)"]
    names = ["model.joints.pin.points.1.0", "model.bodies.arm.mass"]
    one, other = (mbdkit.gradient(spec, texts, names, mode=mode, check=False) for mode in MODES)
    assert_within(other.jacobian - one.jacobian, 1e-10 * np.abs(one.jacobian).max())


@pytest.mark.parametrize("method", METHODS[:2])
def test_steps_with_equal_derivatives_are_all_counted(method: dict[str, Any]) -> None:
    # expected: dual numbers; a constant force on a slider adds the same derivative by the angle in every step
    body = {"mass": 2.0, "inertia": 0.4, "position": [0.0, 0.0]}
    slide = {"type": "prismatic", "bodies": ["ground", "b"], "points": [[0, 0], [0, 0]], "axis": [0.8, -0.6]}
    push = {"type": "force", "body": "b", "point": [0.1, -0.5], "value": [5.0, 1.2], "frame": "body"}
    model = {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"b": body},
        "joints": {"s": slide},
        "forces": {"f": push},
    }
    spec = load_spec({"mbdkit": 1, "model": model, "integrator": method, "time": {"end": 0.15, "step": 0.025}})
    assert compare(spec, np.random.default_rng(3)) == ""


def friction_of(kind: str, draw: np.random.Generator) -> dict[str, dict[str, float]]:
    """Return friction for a joint of a drawn mechanism; empty if joints of this type have none."""
    found = {"static": 0.3, "kinetic": draw.uniform(0.1, 0.25), "transition_speed": draw.uniform(0.1, 0.6)}
    if kind == "revolute":
        found["radius"] = draw.uniform(0.05, 0.2)
    elif draw.random() < 0.5:
        found["length"] = draw.uniform(0.3, 2.0)
    return {"friction": found} if kind in ("revolute", "prismatic") else {}


def compare_drawn(drawn: Drawn, compared: list[int], *, friction: bool) -> None:
    """Compare both ways for a drawn mechanism, until 25 have been compared."""
    index, time = len(compared), {"start": drawn.start, "end": drawn.start + 0.15, "step": 0.025}
    if index < 25:
        model, draw = drawn.mechanism.to_spec(), np.random.default_rng(index)
        points = [name for name, body in model["bodies"].items() if "inertia" not in body]  # pins need angles
        rough = [joint for joint in model.get("joints", {}).values() if not {*points} & {*joint.get("bodies", ())}]
        for joint in rough if friction else ():
            joint |= friction_of(joint["type"], draw)
        if friction and not any("friction" in joint for joint in rough):
            return
        try:
            spec = load_spec({"mbdkit": 1, "model": model}, (), integrator=METHODS[index % 2], time=time)
            why = compare(spec, np.random.default_rng(index))
        except SpecError as error:  # reactions must be unique, and friction must not lock a joint
            if not re.search("is not unique|locks itself", str(error)):
                raise
            return
        assert why in (
            "",
            "the mechanism has beams",
            "force laws have, or may have, discontinuities",
            "a fixed-point iteration for the stages of a step does not converge",
        )
        compared += [] if why else [index]


@pytest.mark.slow
@pytest.mark.parametrize(("batch", "friction"), [*((k, False) for k in range(8)), *((k, True) for k in range(8, 12))])
def test_adjoint_agrees_with_a_dual_direction_on_drawn_mechanisms(batch: int, *, friction: bool) -> None:
    # expected: dual numbers
    compared = list[int]()
    chosen = settings(
        max_examples=160, database=None, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
    )
    seed(batch)(chosen(given(mechanisms())(lambda drawn: compare_drawn(drawn, compared, friction=friction))))()
    assert len(compared) == 25


def pendulum_by_complex_steps(measure: Callable[[np.ndarray], Any], values: list[float]) -> list[float]:
    """Return derivatives of a function of the last state of a pendulum with a spring: own equations, rk4, 100 steps."""

    def final(mass: Any, length: Any, stiffness: Any, angle: Any) -> Any:
        def rate(y: np.ndarray) -> np.ndarray:
            moment = -mass * 9.81 * 0.5 * length * np.cos(y[0]) - stiffness * y[0]
            return np.array([y[1], moment / (mass * length**2 / 3.0)])

        y, h = np.array([angle, 0.0j]), 0.01
        for _ in range(100):
            a = rate(y)
            b = rate(y + 0.5 * h * a)
            c = rate(y + 0.5 * h * b)
            y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(y + h * c))
        return measure(y)

    steps = 1e-30j * np.eye(len(values))
    return [float(final(*(np.array(values) + step)).imag) / 1e-30 for step in steps]


def pendulum(mode: str, **sections: Any) -> mbdkit.Gradient:
    mass, length, stiffness, angle = 2.0, 0.7, 3.0, 0.4
    position = ["l/2*cos(a)", "l/2*sin(a)"]
    model = {
        "name": "mechanism",
        "bodies": {"rod": {"mass": "m", "inertia": "m*l**2/12", "position": position, "angle": "a"}},
        "joints": {"J": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], ["-l/2", 0]]}},
        "forces": {"k": {"type": "torsion-spring", "bodies": ["ground", "rod"], "stiffness": "k"}},
    }  # fmt: skip
    numbers = {"m": mass, "l": length, "k": stiffness, "a": angle}
    spec = {"mbdkit": 1, "model": model, "parameters": numbers, "integrator": {"name": "rk4"}, **sections}
    spec.setdefault("time", {"end": 1.0, "step": 0.01})
    return mbdkit.gradient(spec, ["final(bodies.rod.angle)"], [*numbers], check=False, mode=mode)  # type: ignore[arg-type]


def test_adjoint_of_a_pendulum_agrees_with_complex_steps_of_its_equation_in_the_angle() -> None:
    # expected: complex steps of an independent code in one coordinate; its steps differ by a discretization error
    found = pendulum("adjoint", time={"end": 1.0, "step": 0.0005})
    expected = pendulum_by_complex_steps(lambda y: y[0], [2.0, 0.7, 3.0, 0.4])
    assert_within(found.jacobian[0] - expected, 1e-6 * np.max(np.abs(expected)))


def hinged_rods(count: int) -> dict[str, Any]:
    """Return a chain of rods with springs in its hinges; each number is a named parameter ``QUANTITY_ROD``."""
    x, y, vx, vy = "0", "0", "0", "0"
    bodies, joints, forces = {}, {}, {}
    for k in range(count):
        along, up = f"l_{k}*cos(a_{k})", f"l_{k}*sin(a_{k})"
        bodies[f"rod{k}"] = {
            "mass": f"m_{k}", "inertia": f"m_{k}*l_{k}**2/12", "angle": f"a_{k}", "angular_velocity": f"w_{k}",
            "position": [f"{x} + {along}/2", f"{y} + {up}/2"],
            "velocity": [f"{vx} - w_{k}*{up}/2", f"{vy} + w_{k}*{along}/2"],
        }  # fmt: skip
        pair = [f"rod{k - 1}" if k else "ground", f"rod{k}"]
        inner = [f"l_{k - 1}/2", 0] if k else [0, 0]
        joints[f"J{k}"] = {"type": "revolute", "bodies": pair, "points": [inner, [f"-l_{k}/2", 0]]}
        forces[f"s{k}"] = {"type": "torsion-spring", "bodies": pair, "stiffness": f"k_{k}"}
        x, y, vx, vy = f"{x} + {along}", f"{y} + {up}", f"{vx} - w_{k}*{up}", f"{vy} + w_{k}*{along}"
    return {"name": "mechanism", "gravity": [0, "-g"], "bodies": bodies, "joints": joints, "forces": forces}


@pytest.mark.parametrize("number", range(10))
def test_adjoint_agrees_with_complex_steps_of_a_code_of_its_own(number: int) -> None:
    # expected: own equations of motion in absolute coordinates and own rk4, with complex numbers
    draw = np.random.default_rng(7300 + number)
    count, h, steps = 1 + number // 2, 0.01, 30
    drawn = {"l": draw.uniform(0.4, 1.2, count), "m": draw.uniform(0.5, 3.0, count), "a": draw.normal(size=count),
             "w": 3.0 * draw.normal(size=count), "k": draw.uniform(1.0, 20.0, count)}  # fmt: skip
    parameters = {f"{name}_{k}": float(x) for name, values in drawn.items() for k, x in enumerate(values)} | {"g": 9.81}

    def final(numbers: np.ndarray) -> np.ndarray:
        l, m, a, w, k = numbers[:-1].reshape(5, count)  # noqa: E741

        def load(_time: float, q: np.ndarray, _v: np.ndarray) -> np.ndarray:
            moments = k * np.diff(q[2::3], prepend=0.0)
            loads = np.zeros_like(q)
            loads[2::3] = np.append(moments[1:], 0.0) - moments
            return loads

        rods = AbsoluteRods(tuple(l), tuple(m), load, gravity=numbers[-1])
        q, v = np.split(rk4(rods.right_side, rods.state(a, w), h, steps)[-1], 2)
        masses = np.array([[mass, mass, mass * length**2 / 12] for mass, length in zip(m, l, strict=True)]).ravel()
        forces = rods.solve(h * steps, q, v)[1]
        return np.array([q[-2], 0.5 * masses @ v**2, np.sqrt(forces[0] ** 2 + forces[1] ** 2)])

    values = np.array([*parameters.values()])
    expected = np.stack([final(values + 1e-30j * one).imag / 1e-30 for one in np.eye(len(values))], axis=-1)
    spec = {"mbdkit": 1, "model": hinged_rods(count), "parameters": parameters, "integrator": {"name": "rk4"},
            "time": {"end": h * steps, "step": h}}  # fmt: skip
    measures = [f"final(bodies.rod{count - 1}.y)", "final(energy.kinetic)", "abs(final(joints.J0.force))"]
    found = mbdkit.gradient(spec, measures, [*parameters], check=False, mode="adjoint")
    size = np.max(np.abs(expected), axis=1, keepdims=True)
    assert_within((found.jacobian - expected) / size, 1e-11)
    assert_within((found.value - final(values)) / np.abs(final(values)), 1e-12)


@pytest.mark.parametrize(
    ("sections", "reason"),
    [
        ({"formulation": "index-3", "integrator": {"name": "radau-iia"}}, "the formulation is index-3"),
        ({"stabilization": "projection"}, "projected"),
    ],
)
def test_what_the_adjoint_does_not_take_is_refused_with_its_reason(sections: dict[str, Any], reason: str) -> None:
    with pytest.raises(SpecError, match=reason):
        pendulum("adjoint", **sections)
    assert np.all(np.isfinite(pendulum("auto", **sections).jacobian))


def compared_ways(spec: RunSpec | dict[str, Any], texts: Sequence[str], names: Sequence[str]) -> mbdkit.Gradient:
    """Compare the derivatives of both ways, none of which is zero for all parameters; return those of the adjoint."""
    one, other = (mbdkit.gradient(spec, texts, names, mode=mode, check=False) for mode in MODES)
    size = np.max(np.abs(one.jacobian), axis=1, keepdims=True)
    assert np.all(size > 0.0)
    assert_within((other.jacobian - one.jacobian) / size, 3e-11)
    assert_within((other.value - one.value) / np.maximum(np.abs(one.value), 1.0), 1e-11)
    assert other.doubts == one.doubts
    return other


EVENTS = {"low": {"when": "rod1.angle + 1.2", "action": "stop"}, "passed": {"when": "rod2.angle + 0.5*t"}}
OF_EVENTS = (
    "events.passed.time", "final(rod2.x)", "final(abs(joints.J1.force))", "mean(t*rod1.x)", "max(abs(joints.J1.force))",
    "at(rod2.y, events.passed.time)", "at(rod1.x, events.low.time)", "at(rod1.x, 0.8*events.low.time)",
)  # fmt: skip
"""Measures whose derivatives depend on those of the times of events."""


@pytest.mark.parametrize("method", METHODS, ids=lambda one: str(one["name"]))
def test_adjoint_agrees_with_dual_numbers_through_events(method: dict[str, Any]) -> None:
    # expected: the forward way, which differentiates the steps that end at events
    time = {"end": 1.5} if "rtol" in method else {"end": 1.5, "step": 0.01}
    model = {"name": "double-pendulum", "angles": [0.3, 0.1]}
    spec = RunSpec(mbdkit=1, model=model, integrator=method, time=time, events=EVENTS)
    names = ["model.masses.0", "model.lengths.0", "model.lengths.1", "model.angles.1"]
    compared_ways(spec, OF_EVENTS, names)


@pytest.mark.parametrize("mode", MODES)
def test_a_driver_acts_on_a_state_whose_time_an_event_determines(mode: GradientMode) -> None:
    # expected: central differences of runs; the torque of a motor at a time that depends on the length of its crank
    def spec(length: float) -> dict[str, Any]:
        m = mbdkit.Mechanism()
        crank = m.body("crank", mass=1.0, inertia=length**2 / 12, position=(length / 2, 0))
        rod = m.body("rod", mass=1.0, inertia=0.1, position=(length + 0.3, 0))
        m.revolute("A", m.ground, crank, at=(0, 0))
        m.revolute("B", crank, rod, at=(length, 0))
        m.driver("motor", m.ground, crank, coordinate="angle", motion="0.7*sin(9*t)")
        stop = {"when": "rod.angle + 0.8", "action": "stop"}
        sections = {"integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.002}, "events": {"stop": stop}}
        return {"mbdkit": 1, "model": m.to_spec(), **sections}

    text, width = "final(joints.motor.torque)", 1e-4
    same = "at(joints.motor.torque, events.stop.time)"
    given = spec(0.2) | {"parameters": {"L": 0.2}}
    ends = ["-L/2", 0], ["L/2", 0]
    bodies, joints = given["model"]["bodies"], given["model"]["joints"]
    bodies["crank"] |= {"inertia": "L**2/12", "position": ["L/2", 0]}
    bodies["rod"]["position"] = ["L + 0.3", 0]
    joints["A"]["points"], joints["B"]["points"] = [[0, 0], ends[0]], [ends[1], [-0.3, 0]]
    found = mbdkit.gradient(given, [text, same], "L", mode=mode)
    runs = [mbdkit.run(spec(0.2 + x), measures={"torque": text}).measures["torque"] for x in (width, -width)]
    np.testing.assert_allclose(found.jacobian[:, 0], (runs[0] - runs[1]) / (2 * width), rtol=1e-5)
    assert found.check is not None
    assert found.check.is_passed


def test_reductions_within_reductions_have_derivatives() -> None:
    # expected: the forward way
    texts = ["integral((rod1.y - 2*mean(rod1.y))**2)", "rms(rod1.x - max(rod2.x))"]
    spec = load_spec("double-pendulum", (), time={"end": 1.0, "step": 0.01}, measures={}, gradients=[])
    one, other = (mbdkit.gradient(spec, texts, "model.lengths.0", mode=mode, check=False) for mode in MODES)
    np.testing.assert_allclose(other.jacobian, one.jacobian, rtol=1e-11)


@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize("method", METHODS[:2], ids=lambda one: str(one["name"]))
def test_adjoint_agrees_with_dual_numbers_where_a_rod_strikes_a_stop(method: dict[str, Any], *, stops: bool) -> None:
    # expected: the forward way; the force of the stop begins suddenly, because it has a damper
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("A", m.ground, rod, at=(0, 0))
    spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": method, "time": {"end": 1.2, "step": 0.01}}
    path = {"type": "two-points", "bodies": ["ground", "rod"], "points": [[0.5, 0.2], [0.5, 0.0]]}
    law = {"type": "law", "law": "one-sided", "acts": "tension", "stiffness": 300, "damping": 1, "free_length": 0.6}
    spec["model"]["forces"] = {"stop": {**law, "pathway": path}}
    stop = "model.forces.stop"
    names = [f"{stop}.stiffness", f"{stop}.free_length", f"{stop}.pathway.points.0.0", "model.bodies.rod.mass"]
    texts = ["final(rod.y)", "mean(abs(joints.A.force))", "integral(forces.stop.value)", "final(energy.total)"]
    if stops:
        spec["events"] = {"back": {"when": "rod.angular_velocity*(t - 0.5) + 0.03", "action": "stop"}}
        texts.append("events.back.time")
    compared_ways(spec, texts, names)


def test_a_named_length_of_a_slider_crank_may_be_a_parameter() -> None:
    # expected: the forward way; the line of the slide follows from the length, too
    m = mbdkit.Mechanism()
    crank = m.body("crank", mass=1.0, inertia=0.01, position=(0.1, 0.0))
    rod = m.body("rod", mass=2.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("A", m.ground, crank, at=(0, 0))
    m.revolute("B", crank, rod, at=(0.2, 0))
    m.point_on_line("C", m.ground, rod, at=(0.8, 0), axis=(1, 0))
    spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 0.2, "step": 0.005}}
    spec |= {"parameters": {"rod": 0.6}}
    spec["model"]["joints"]["C"]["points"] = [["0.2 + rod", 0.0], ["rod/2", 0.0]]
    spec["model"]["joints"]["B"]["points"] = [[0.1, 0.0], ["-rod/2", 0.0]]
    spec["model"]["bodies"]["rod"]["position"] = ["0.2 + rod/2", 0.0]
    texts = ["final(rod.x)", "mean(abs(joints.C.force))"]
    one, other = (mbdkit.gradient(spec, texts, "rod", mode=mode, check=False) for mode in MODES)
    np.testing.assert_allclose(other.jacobian, one.jacobian, rtol=1e-10)


@pytest.mark.parametrize("method", METHODS[:2], ids=lambda one: str(one["name"]))
def test_adjoint_agrees_with_dual_numbers_where_a_slide_stops_slipping_and_is_pressed_on_its_other_side(
    method: dict[str, Any],
) -> None:
    # expected: the forward way; both changes of the friction depend on parameters, the second one by the reaction
    model: dict[str, Any] = {
        "name": "mechanism",
        "gravity": [0.0, -9.81],
        "bodies": {
            "rod": {"mass": 1.0, "inertia": 0.1, "angular_velocity": 3.0},
            "bead": {"mass": 0.5, "inertia": 0.01, "position": [0.3, 0.0], "velocity": [0.2, 0.9],
                     "angular_velocity": 3.0},
        },
        "joints": {
            "pin": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [0, 0]],
                    "friction": {"coefficient": 0.3, "radius": 0.05, "transition_speed": 0.2}},
            "slide": {"type": "prismatic", "bodies": ["rod", "bead"], "points": [[0, 0], [0, 0]], "axis": [1, 0],
                      "friction": {"static": 0.3, "kinetic": 0.2, "transition_speed": 0.1, "length": 0.2}},
        },
    }  # fmt: skip
    spec = {"mbdkit": 1, "model": model, "integrator": method, "time": {"end": 1.0, "step": 0.01}}
    texts = [
        "final(bead.x)", "mean(joints.slide.friction)", "integral(joints.pin.friction**2)", "final(energy.total)",
        "mean(joints.slide.force_x**2)",
    ]  # fmt: skip
    friction = "model.joints.slide.friction"
    names = [f"{friction}.static", f"{friction}.transition_speed", f"{friction}.length", "model.bodies.bead.mass"]
    compared_ways(spec, texts, [*names, "model.joints.pin.friction.radius", "model.joints.slide.points.1.1"])


def two_balls(draw: np.random.Generator, law: str) -> dict[str, Any]:
    """Return a ball at a pendulum that falls on a floor, and a ball that falls on this one, with friction."""
    stiffness = {"hunt-crossley": 2e4, "linear": 2e3, "smooth-sphere-half-space": 1e5}[law]
    dissipation = {"linear": 5.0}.get(law, 0.1)
    compliance = {"law": law, "stiffness": stiffness, "dissipation": dissipation, "transition_speed": 0.2}
    low, high = draw.uniform(0.12, 0.2), draw.uniform(0.5, 0.7)
    bodies = {
        "arm": {"mass": draw.uniform(0.5, 2.0), "inertia": 0.05, "position": [0.5, low], "angular_velocity": -1.0},
        "ball": {"mass": draw.uniform(0.2, 1.0), "inertia": 0.002, "position": [draw.uniform(0.9, 1.1), high]},
    }
    bodies["arm"]["velocity"] = [0.0, -0.5]
    circle, upper = {"circle": {"center": [0.5, 0.0], "radius": 0.1}}, {"circle": {"radius": 0.08}}
    floor = {"line": {"normal": [draw.uniform(-0.2, 0.2), 1.0]}}
    more = {"compliance": compliance, "friction": draw.uniform(0.1, 0.5)}
    contacts = {"floor": {"bodies": ["ground", "arm"], "shapes": [floor, circle], **more}}
    if law != "smooth-sphere-half-space":
        contacts["both"] = {"bodies": ["arm", "ball"], "shapes": [circle, upper], **more}
    joints = {"pin": {"type": "revolute", "bodies": ["ground", "arm"], "points": [[0, low], [-0.5, 0]]}}
    return {"name": "mechanism", "bodies": bodies, "joints": joints, "contacts": contacts}


@pytest.mark.parametrize("law", ["hunt-crossley", "linear", "smooth-sphere-half-space"])
@pytest.mark.parametrize("number", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 8))])
def test_adjoint_agrees_with_dual_numbers_through_compliant_contacts(law: str, number: int) -> None:
    # expected: the forward way; steps end where the linear law acts first and last
    model = two_balls(np.random.default_rng(number), law)
    spec = {"mbdkit": 1, "model": model, "integrator": METHODS[number % 2], "time": {"end": 0.5, "step": 0.001}}
    floor = "model.contacts.floor"
    names = ["model.bodies.arm.mass", f"{floor}.compliance.stiffness", f"{floor}.compliance.dissipation"]
    names += [f"{floor}.friction", f"{floor}.shapes.1.circle.radius", f"{floor}.shapes.1.circle.center.0"]
    texts = ["final(arm.angle)", "mean(abs(joints.pin.force))", "final(energy.kinetic)", "at(arm.vy, 0.4)"]
    if law != "smooth-sphere-half-space":
        names += ["model.contacts.both.shapes.1.circle.radius", "model.bodies.ball.position.1"]
        texts += ["final(ball.x)"]
    compared_ways(spec, texts, names)


def test_adaptive_steps_end_at_discontinuities() -> None:
    # expected: the forward way, before the balls touch and behind the jump of the force
    model = two_balls(np.random.default_rng(3), "linear")
    model["contacts"]["floor"]["shapes"][0] = {"line": {"normal": [0.0, 1.0]}}  # the ball begins 27 mm above it
    names = ["model.bodies.arm.mass", "model.joints.pin.points.1.0"]
    for end in (0.01, 0.3):
        spec = {"mbdkit": 1, "model": model, "integrator": METHODS[2], "time": {"end": end}}
        compared_ways(spec, ["final(arm.angle)", "mean(joints.pin.force_y)"], names)
    spec |= {"integrator": METHODS[0], "time": {"end": 0.3, "step": 0.001}}
    assert_passed(mbdkit.gradient(spec, "final(arm.angle)", names, mode="adjoint"))


@pytest.mark.parametrize("kind", ["driver", "weld"])
def test_joints_that_are_no_pins_need_no_forces(kind: str) -> None:
    # expected: the forward way
    bodies = {name: {"mass": 1.0, "inertia": 0.1, "position": [x, 0.0]} for name, x in (("a", 0.5), ("b", 1.3))}
    outer = {"type": "revolute", "bodies": ["a", "b"], "points": [[0.5, 0.0], [-0.3, 0.0]]}
    pin = {"type": "revolute", "bodies": ["ground", "a"], "points": [[0.0, 0.0], [-0.5, 0.0]]}
    driver = {"type": "driver", "bodies": ["ground", "a"], "coordinate": "angle", "motion": "-0.5*t**2"}
    inner = {"pin": pin, "driver": driver} if kind == "driver" else {"weld": pin | {"type": "weld"}}
    model = {"name": "mechanism", "bodies": bodies, "joints": inner | {"outer": outer}}
    names = ["model.bodies.b.inertia", "model.bodies.b.mass", "model.joints.outer.points.1.0"]
    for method, time in ((METHODS[0], {"end": 0.5, "step": 0.01}), (METHODS[2], {"end": 0.5})):
        spec = {"mbdkit": 1, "model": model, "integrator": method, "time": time}
        compared_ways(spec, ["final(b.angle)", "max(joints.outer.force_y)"], names)


def test_pins_whose_system_is_solved_with_pivots_have_the_derivatives_of_the_forward_way() -> None:
    # expected: the forward way; the second rod is a million times lighter, and the Schur complement is not used
    bodies = {
        f"b{k}": {"mass": mass, "inertia": 0.02 * mass, "position": [0.25 + 0.5 * k, 0.0]}
        for k, mass in enumerate((1.0, 1e-6))
    }
    points = [[0.0, 0.0], [-0.25, 0.0]], [[0.25, 0.0], [-0.25, 0.0]]
    pairs = zip((["ground", "b0"], ["b0", "b1"]), points, strict=True)
    joints = {f"j{k}": {"type": "revolute", "bodies": of, "points": at} for k, (of, at) in enumerate(pairs)}
    model = {"name": "mechanism", "bodies": bodies, "joints": joints}
    spec = {"mbdkit": 1, "model": model, "integrator": METHODS[0], "time": {"end": 0.3, "step": 0.005}}
    compared_ways(spec, ["final(b0.angle)"], ["model.bodies.b0.mass", "model.joints.j0.points.1.0"])


def test_two_stops_that_act_at_one_time_have_the_derivatives_of_the_forward_way() -> None:
    # expected: the forward way; a ball meets two equal stops, which also act at the start of a second run
    for height in (0.5, 0.3):
        path = {"type": "two-points", "bodies": ["ground", "ball"], "points": [[0, 0], [0, 0]]}
        law = {"type": "law", "law": "one-sided", "acts": "compression", "damping": 2.0, "pathway": path}
        stops = {name: {**law, "stiffness": k, "free_length": 0.3} for name, k in (("one", 100.0), ("two", 200.0))}
        bodies = {"ball": {"mass": 1.0, "position": [0.0, height], "velocity": [0.0, -1.0]}}
        model = {"name": "mechanism", "bodies": bodies, "forces": stops}
        spec = {"mbdkit": 1, "model": model, "integrator": METHODS[0], "time": {"end": 0.4, "step": 0.01}}
        names = [f"model.forces.{one}.{key}" for one in stops for key in ("stiffness", "damping")]
        compared_ways(spec, ["final(ball.y)", "integral(forces.one.value)"], [*names, "model.bodies.ball.mass"])


@pytest.mark.parametrize("method", METHODS[:2], ids=lambda one: str(one["name"]))
def test_gradients_whose_states_are_in_files_are_bitwise_equal(
    method: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # expected: the same gradient with all states in memory
    events = {"passed": {"when": "rod2.angle + 0.5*t"}, "low": {"when": "rod1.angle + 1.2", "action": "stop"}}
    model = {"name": "double-pendulum", "angles": [0.3, 0.1]}
    spec = RunSpec(mbdkit=1, model=model, integrator=method, time={"end": 1.5, "step": 0.001}, events=events)
    texts = ["final(rod2.x)", "mean(joints.J1.force_x*t)", "at(rod2.y, 0.9)", "at(rod1.x, events.passed.time)"]
    found = []
    for most in (adjoint_gradient.MOST_BYTES, 1000):
        monkeypatch.setattr(adjoint_gradient, "MOST_BYTES", most)
        found.append(mbdkit.gradient(spec, texts, ["model.masses.0", "model.lengths.1"], mode="adjoint", check=False))
    assert found[0].jacobian.tobytes() == found[1].jacobian.tobytes()
    assert found[0].value.tobytes() == found[1].value.tobytes()


@pytest.mark.slow
def test_storage_is_bounded_however_many_steps_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    # expected: four times the steps need little more storage, a few numbers for each stage; states are 2 kB each
    model = {"name": "n-pendulum", "n": 20, "mass": 0.05, "length": 0.05}
    monkeypatch.setattr(adjoint_gradient, "MOST_BYTES", 1_000_000)
    peaks = []
    for end in (0.5, 2.0):
        time = {"end": end, "step": 0.0005}
        spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": time}
        tracemalloc.start()
        mbdkit.gradient(spec, ["final(rod1.x)", "mean(energy.kinetic)"], ["model.mass"], mode="adjoint", check=False)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 3000 * 1000


def test_values_of_tables_have_the_derivatives_of_recorded_operations() -> None:
    # expected: the derivatives of a spline through unit vectors, for uneven lengths
    draw = np.random.default_rng(4)
    for points in (2, 3, 4, 5, 9, 60):
        lengths, places = np.cumsum(draw.uniform(0.1, 2.0, points)), draw.permutation(points)[: 1 + points // 2]
        table = TableValues(7, lengths, np.arange(len(places)), places)
        bars = draw.normal(size=5 * (points - 1))
        expected = bars @ table.slopes()
        assert_within(table.contract(bars) - expected, 1e-13 * np.max(np.abs(bars)) * np.max(np.abs(table.slopes())))


def test_a_table_and_other_parameters_have_the_derivatives_of_the_forward_way() -> None:
    # expected: the forward way, which takes the whole matrix
    lengths = np.linspace(-2.0, 2.0, 9)
    model: dict[str, Any] = {
        "name": "mechanism",
        "bodies": {"rod": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {"hip": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]}},
        "forces": {"support": {"type": "law", "law": "table", "table": [lengths.tolist(), np.sin(lengths).tolist()],
                               "damping": 0.1, "pathway": {"type": "relative-angle", "bodies": ["ground", "rod"]}}},
    }  # fmt: skip
    spec = {"mbdkit": 1, "model": model, "integrator": METHODS[0], "time": {"end": 1.0, "step": 0.01}}
    names = [f"model.forces.support.table.1.{k}" for k in (2, 0, 5, 4, 3)]
    names = ["model.forces.support.damping", *names, "model.bodies.rod.mass"]
    compared_ways(spec, ["final(rod.angle)", "integral(forces.support.potential)"], names)
