"""The export to CasADi against the machine code: every element, examples, and random mechanisms.

Expected values are those of `EquationsOfMotion`, whose machine code is tested against closed forms and other programs.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from tests.compliant.pairs_of_bodies import PAIRS, two_bodies

from mbdkit import MbdkitError, Mechanism, SpecError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.events.event_expression import RunExpression
from mbdkit.events.quantities import QuantityEvaluator
from mbdkit.plugin import Target
from mbdkit.spec import load_spec
from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.exported_elements import chosen_equilibria, symbolic_elements
from mbdkit_predict.symbols import BranchError, Symbol, column, every_branch
from tests.engine import random_mechanisms
from tests.engine.strategies import Drawn, mechanisms
from tests.margins import assert_within
from tests.runs.rotor_with_inputs import rotor
from tests.runs.rubbing_joints import pendulum, slide
from tests.witness.eccentric_wheel import wheel

ROUNDING = 1e-12
"""Largest difference, relative to the largest number of a result."""


def assert_same(found: Any, wanted: Any, what: str, least: float = 1e-300) -> None:
    """Compare two results; `least` is the size of the terms of sums that may be zero."""
    wanted = np.asarray(wanted)
    np.testing.assert_allclose(
        np.array(found).reshape(wanted.shape), wanted, rtol=0.0, err_msg=what,
        atol=ROUNDING * np.max(np.abs(wanted), initial=least),
    )  # fmt: skip


def acting(m: Mechanism) -> Mechanism:
    """Return a mechanism whose muscles act, as in runs."""
    m.is_of_run = True
    return m


def check(m: Mechanism, t0: float = 0.0, spread: float = 0.05) -> CasadiSystem:
    """Compare residuals, constraints, Jacobians and rates of a mechanism at its start and at random states."""
    system, rng = m.to_casadi(t0=t0), np.random.default_rng(0)
    wanted = EquationsOfMotion.of(acting(m), t0)
    assert system.constraint_names == wanted.constraint_names
    assert system.bodies == wanted.bodies
    given_symbols = (system.q, system.v, system.a, system.lam, system.z, system.u, system.p, system.t)
    residual = system.residual(*given_symbols)
    rows = system.constraints(*given_symbols)
    derivatives = {
        "stiffness": ca.jacobian(residual, system.q), "damping": ca.jacobian(residual, system.v),
        "jacobian": ca.jacobian(residual, system.lam).T, "mass": ca.jacobian(residual, system.a),
        "phi_q": ca.jacobian(rows[0], system.q), "gamma_v": -ca.jacobian(rows[2], system.v),
        "residual_q": ca.jacobian(rows[2], system.q),
    }  # fmt: skip
    function = system.function("derivatives", derivatives)
    has_friction = any(getattr(joint, "friction", None) is not None for joint in m.joints.values())
    for k in range(3):
        q, v = wanted.q0 + spread * k * rng.normal(size=wanted.n), wanted.v0 + spread * k * rng.normal(size=wanted.n)
        a, lam = rng.normal(size=wanted.n), rng.normal(size=wanted.m)
        t, z = t0 + 0.1 * k, wanted.z0 * (1.0 + 0.1 * k)
        wanted.hold(z)
        state = (q, v, a, lam, z, [], [], t)
        assert_same(system.residual(*state), wanted.residual(t, q, v, a, lam), "residual")
        position, velocity, acceleration = system.constraints(*state)
        jacobian = wanted.constraint_jacobian(t, q).toarray()
        assert_same(position, wanted.constraints(t, q), "position", 1.0)
        assert_same(velocity, wanted.constraint_rates(t, q, v), "velocity", 1.0)
        assert_same(acceleration, jacobian @ a - wanted.gamma(t, q, v), "acceleration", 1.0)
        tangents = wanted.tangents(t, q, v, a, lam)
        found = dict(zip(derivatives, function(*state), strict=True))
        assert_same(found["phi_q"], jacobian, "phi_q")
        assert_same(found["mass"], np.diag(wanted.mass), "mass")
        for name in ("stiffness", "damping", "gamma_v", "residual_q"):
            assert_same(found[name], getattr(tangents, name).toarray(), name)
        if not has_friction:
            assert_same(found["jacobian"], jacobian, "jacobian")
        if len(z):
            a, lam, rates = wanted.derivatives(t, q, v, z)
            assert_same(system.rates(q, v, a, lam, z, [], [], t), rates, "rates")
    return system


@pytest.mark.parametrize("count", [6, pytest.param(100, marks=pytest.mark.slow)])
def test_random_mechanisms_are_those_of_the_machine_code(count: int) -> None:
    @settings(max_examples=count, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
    @given(mechanisms())
    def compare(drawn: Drawn) -> None:
        with contextlib.suppress(SpecError):  # no consistent start
            EquationsOfMotion.of(drawn.mechanism, drawn.start)
            check(drawn.mechanism, drawn.start)

    compare()


GENERATORS: list[Callable[..., Mechanism]] = [
    random_mechanisms.chain, random_mechanisms.tree, random_mechanisms.loop, random_mechanisms.ladder,
    random_mechanisms.driven_frame, random_mechanisms.slides, random_mechanisms.flexible,
]  # fmt: skip


@pytest.mark.parametrize("generator", GENERATORS)
def test_chains_loops_slides_and_beams_are_those_of_the_machine_code(generator: Callable[..., Mechanism]) -> None:
    check(generator(np.random.default_rng(1)))


@pytest.mark.parametrize(
    "name", ["bouncing-ball", "delayed-balance", "limit-stop", "quick-return", "series-elastic-knee", "sit-down"]
)
def test_examples_are_those_of_the_machine_code(name: str) -> None:
    check(load_spec(name).mechanism())


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (i % 2)) for i, name in enumerate(PAIRS)]
)
def test_contacts_are_those_of_the_machine_code(name: str) -> None:
    shapes, at, angle = PAIRS[name]
    check(two_bodies(*shapes, at, angle), spread=0.03)


@pytest.mark.parametrize(
    "law", ["hunt-crossley", "flores", "lankarani-nikravesh", "linear", "smooth-sphere-half-space"]
)
@pytest.mark.parametrize("height", [0.09, 0.12])
def test_every_law_of_contacts_is_that_of_the_machine_code(law: str, height: float) -> None:
    m = Mechanism(gravity=(0.0, -100.0))
    m.body("ball", mass=1.0, inertia=0.1, position=(0, height), velocity=(0.3, -0.4), angular_velocity=1.0)
    speed = {"impact_speed": 1.0} if law in ("flores", "lankarani-nikravesh") else {"dissipation": 0.1}
    shapes = [{"line": {"normal": (0.1, 1)}}, {"circle": {"radius": 0.1}}]
    friction = {"static": 0.6, "kinetic": 0.4}
    compliance = {"law": law, "stiffness": 1e3, **speed}
    m.contact("floor", m.ground, "ball", shapes=shapes, restitution=0.5, friction=friction, compliance=compliance)
    system = check(m, spread=0.003)
    jacobian = system.function(
        "jacobian", {"by_q": ca.jacobian(system.expression("contacts.floor.normal_force"), system.q)}
    )
    away = (
        jacobian([0, 0.0, 0], [0] * 3, [0] * 3, [], [], [], [], 0),
        jacobian([0, 5.0, 0], [0] * 3, [0] * 3, [], [], [], [], 0),
    )
    assert np.all(np.isfinite(away))


@pytest.mark.parametrize("m", [pendulum(1.0), slide(0.2, 3.0), Mechanism.from_spec(wheel())])
def test_friction_and_moving_centers_are_those_of_the_machine_code(m: Mechanism) -> None:
    check(m)


LAWS = [
    {"law": "linear", "stiffness": 20.0, "damping": 2.0, "free_length": 0.3},
    {"law": "exponential", "scale": 3.0, "growth": 2.0, "free_length": 0.05, "acts": "tension"},
    {"law": "gas-spring", "preload": 100.0, "progression": 1.4, "extended_length": 0.9, "stroke": 0.5},
    {"law": "one-sided", "stiffness": 500.0, "damping": 1.0, "free_length": 0.1, "acts": "tension"},
    {"law": "table", "table": [[0.0, 0.4, 0.6, 0.7, 1.0], [0.0, 3.0, 1.0, 2.0, 8.0]], "damping": 0.3},
]


@pytest.mark.parametrize(
    ("options", "along"),
    [*((options, "line") for options in LAWS), *((LAWS[0], along) for along in ("x", "y", "angle"))],
)
def test_every_law_is_that_of_the_machine_code(options: dict[str, Any], along: str) -> None:
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.6), angle=0.7, velocity=(0.1, 0.2), angular_velocity=0.4)
    points = None if along == "angle" else ((0.0, 0.0), (0.1, 0.05))
    m.law("device", m.ground, "rod", along=along, points=points, **options)
    check(m)


def arm(**properties: Any) -> Mechanism:
    """Return an arm with muscles over two joints, around a circle, beside the plane, and with a patella."""
    m = Mechanism()
    m.body("upper", mass=2.0, inertia=0.02, position=(0.0, -0.15), angle=-1.2)
    m.body("lower", mass=1.0, inertia=0.01, position=(0.1, -0.4), angle=-0.4)
    m.revolute("shoulder", m.ground, "upper", points=((0, 0), (-0.15, 0)))
    m.revolute("elbow", "upper", "lower", points=((0.15, 0), (-0.12, 0)))
    own = {"max_force": 400.0, "optimal_length": 0.12, "tendon_length": 0.05, "pennation": 0.2} | properties
    straight = [("ground", (0.02, 0.12)), ("upper", (0.1, 0.03)), ("lower", (-0.05, 0.01))]
    m.muscle("long", [{"body": body, "point": at} for body, at in straight], excitation="0.3 + 0.1*sin(3*t)", **own)
    circle = {"body": "upper", "center": (0.15, 0.0), "radius": 0.03, "side": "left"}
    around = [{"body": "upper", "point": (-0.1, 0.02)}, {"wrap": circle}, {"body": "lower", "point": (0.02, 0.01)}]
    m.muscle("around", around, excitation={"table": [[0, 1, 2], [0.1, 0.5, 0.2]]}, **own)
    beside = [{"body": "ground", "point": (0.02, 0.12, 0.03)}, {"body": "upper", "point": (0.05, -0.03, -0.02)}]
    m.muscle("beside", beside, excitation="0.2 + 0.1*elbow.angle", **own)
    led = [{"body": "upper", "point": (x, -0.03)} for x in (0.0, 0.12)]
    m.muscle("led", led, excitation=0.2, patella={"joint": "elbow", "flexion": "elbow.angle", "deviations": 0.5}, **own)
    return m


@pytest.mark.parametrize("tendon", ["rigid", "elastic"])
@pytest.mark.parametrize("curves", ["de-groote-fregly", "millard"])
def test_muscles_are_those_of_the_machine_code(tendon: str, curves: str) -> None:
    check(arm(tendon=tendon, curves=curves), spread=0.01)


@pytest.mark.parametrize("curves", ["de-groote-fregly", "millard"])
def test_unknowns_of_fibers_are_in_equilibrium_at_the_values_of_the_machine_code(curves: str) -> None:
    m = arm(tendon="elastic", curves=curves)
    m.torque("motor", "lower", value=0.5, reaction_body="upper")  # loads follow springs in the tables of forces
    keys = [f"muscles.{name}.{key}" for name in m.muscles for key in ("fiber_velocity", "tendon_force")]
    system, wanted = m.to_casadi(controls=keys), m.to_casadi()
    assert system.state_names == wanted.state_names
    state = (system.q0 + 1e-4, system.v0 + 0.1, np.ones(6), np.ones(4), system.z0 * 1.0005)
    names = [f"muscles.{name}" for name in m.muscles]
    both = [wanted.expression(f"{name}.{key}") for name in names for key in ("fiber_rate", "force")]
    values = np.array(wanted.function("both", {"both": ca.vertcat(*both)})(*state, [], [], 0.3)).ravel()
    muscle = m.muscles["long"]
    u = values / np.tile([muscle.max_velocity * muscle.optimal_length, muscle.max_force], len(m.muscles))
    assert_within(np.array(system.equilibrium(*state, u, [], 0.3)), 1e-12)
    assert np.abs(np.array(system.equilibrium(*state, 1.1 * u, [], 0.3))).min() > 1e-4
    for found, expected in ((system.residual, wanted.residual), (system.rates, wanted.rates)):
        assert_same(found(*state, u, [], 0.3), expected(*state, [], [], 0.3), "with unknowns")
    faster = m.to_casadi(controls=keys, parameters=["muscles.long.max_velocity"])
    rate = faster.rates(*state, u, 1.3 * muscle.max_velocity, 0.3)[faster.state_names.index("long.fiber_length")]
    assert float(rate) == pytest.approx(1.3 * values[0], rel=1e-12)
    with pytest.raises(SpecError, match=r"needs both muscles\.long\.fiber_velocity and muscles\.long\.tendon_force"):
        m.to_casadi(controls=keys[:1])


def test_cables_states_and_loads_of_the_state_are_those_of_the_machine_code() -> None:
    m = arm()
    m.muscles.clear()
    m.marker("hand", "lower", point=(0.1, 0.0))
    m.cable("cable", {"elbow": 0.03, "shoulder": -0.02}, stiffness=300.0, acts="tension", length=0.3)
    m.state("current", initial=0.3, rate="(2 - states.current - 0.1*elbow.angle + forces.cable.rate)/0.05", unit="A")
    m.torque(
        "motor", "lower", value="0.2*states.current - 0.1*markers.hand.vx*max(markers.hand.y, -0.3)",
        reaction_body="upper",
    )  # fmt: skip
    m.force(
        "wind", "lower", value=["-0.5*markers.hand.vx*abs(markers.hand.vx)", {"table": [[0, 1, 2], [0, 1, 0]]}],
        frame="body",
    )  # fmt: skip
    check(m)


@pytest.mark.parametrize("name", ["knee", "flexible-slider-crank", "sit-down", "elbow-curl"])
def test_quantities_have_the_names_and_values_of_runs(name: str) -> None:
    m = load_spec(name).mechanism()
    system, wanted = m.to_casadi(), EquationsOfMotion.of(acting(m))
    q, v, z, t = wanted.q0, wanted.v0 + 0.1, wanted.z0 + 0.01, 0.05
    a, lam, _ = wanted.derivatives(t, q, v, z)
    found = np.array(system.quantities(q, v, a, lam, z, [], [], t)).ravel()
    quantities = [RunExpression.parse(text, m, crosses=False).quantities[0] for text in system.quantity_names]
    evaluator = QuantityEvaluator(wanted.workspace, quantities)
    q, v = (np.concatenate([x, np.zeros(3)])[None] for x in (q, v))
    _, *columns = evaluator.columns(np.array([t]), q, v, z[None])
    for text, value, column_of_run in zip(system.quantity_names, found, columns, strict=True):
        size = max(abs(column_of_run[0]), *(abs(x[0]) for x in columns if text.split(".")[1] in text))
        assert_within(value - column_of_run[0], 1e-11 * size, text)
    assert all("cannot be exported: " in sentence for sentence in system.refused.values())


@pytest.mark.parametrize("tendon", ["rigid", "elastic"])
def test_muscles_consume_the_power_that_runs_record(tendon: str) -> None:
    m = arm(tendon=tendon, metabolics={"smoothing": 0.02}, pennation=0.3)
    m.muscles["around"] = m.muscles["around"].model_copy(update={"excitation": 0.2})  # tables of time are not exported
    texts = [
        f"muscles.{name}.{key}"
        for name in ("long", "beside")
        for key in ("fiber_length", "fiber_rate", "excitation", "fiber_power", "metabolic_power")
    ]
    system, wanted = m.to_casadi(controls=["muscles.long.excitation"]), EquationsOfMotion.of(acting(m))
    q, v, z, t, u = wanted.q0, wanted.v0 + 0.1, wanted.z0 + 0.01, 0.05, 0.3 + 0.1 * np.sin(3 * 0.05)
    a, lam, _ = wanted.derivatives(t, q, v, z)
    values = ca.vertcat(*map(system.expression, texts))
    found = np.array(system.function("values", {"values": values})(q, v, a, lam, z, u, [], t)).ravel()
    evaluator = QuantityEvaluator(
        wanted.workspace, [RunExpression.parse(text, m, crosses=False).quantities[0] for text in texts]
    )
    q, v = (np.concatenate([x, np.zeros(3)])[None] for x in (q, v))
    _, *columns = evaluator.columns(np.array([t]), q, v, z[None])
    np.testing.assert_allclose(found, np.ravel(columns), rtol=1e-9)


def test_controls_take_the_place_of_loads_and_excitations() -> None:
    m = arm()
    m.torque("motor", "lower", value=0.5, reaction_body="upper")
    m.force("push", "lower", value=[1.0, "sin(t)"])
    keys = ["forces.motor.value", "forces.push.value[1]", "muscles.long.excitation"]
    system = m.to_casadi(controls=keys)
    assert system.control_names == tuple(keys)
    assert system.u0.tolist() == [0.5, 0.0, 0.0]
    m.torque("more", "lower", value=1.5, reaction_body="upper")
    m.forces["motor"] = m.forces.pop("more")
    m.forces["push"] = m.forces["push"].model_copy(update={"value": (1.0, -2.0)})
    m.muscles["long"] = m.muscles["long"].model_copy(update={"excitation": 0.7})
    wanted = m.to_casadi()
    assert system.state_names == wanted.state_names
    state = (system.q0 + 0.01, system.v0 + 0.1, np.ones(6), np.ones(4), system.z0)
    for found, expected in ((system.residual, wanted.residual), (system.rates, wanted.rates)):
        assert_same(found(*state, [1.5, -2.0, 0.7], [], 0.3), expected(*state, [], [], 0.3), "with controls")


def test_parameters_take_the_place_of_numbers() -> None:
    def with_numbers(mass: float, x: float, stiffness: float, force: float) -> Mechanism:
        m = arm(max_force=force)
        m.bodies["lower"] = m.bodies["lower"].model_copy(update={"mass": mass})
        m.joints["elbow"] = m.joints["elbow"].model_copy(update={"points": ((0.15, 0.0), (x, 0.0))})
        m.torsion_spring("spring", "upper", "lower", stiffness=stiffness)
        for name in ("around", "beside", "led"):
            m.muscles[name] = m.muscles[name].model_copy(update={"max_force": 400.0})
        return m

    keys = ["bodies.lower.mass", "joints.elbow.points[1][0]", "forces.spring.stiffness", "muscles.long.max_force"]
    system = with_numbers(1.0, -0.12, 3.0, 400.0).to_casadi(parameters=keys)
    assert system.p0.tolist() == [1.0, -0.12, 3.0, 400.0]
    wanted = with_numbers(1.7, -0.1, 4.0, 500.0).to_casadi()
    state = (system.q0 + 0.01, system.v0 + 0.1, np.ones(6), np.ones(4), system.z0, [])
    for found, expected in ((system.residual, wanted.residual), (system.rates, wanted.rates)):
        assert_same(found(*state, [1.7, -0.1, 4.0, 500.0], 0.3), expected(*state, [], 0.3), "with parameters")
    for found, expected in zip(
        system.constraints(*state, [1.7, -0.1, 4.0, 500.0], 0.3), wanted.constraints(*state, [], 0.3), strict=True
    ):
        assert_same(found, expected, "constraints with parameters")


def test_an_expression_is_that_of_its_quantities() -> None:
    system = load_spec("knee").mechanism().to_casadi()
    value = system.function("value", {"value": system.expression("max(B.force - 10, 2*t)**2 + atan2(shank.x, 2)")})
    forces = [system.expression(f"joints.B.force_{axis}") for axis in "xy"]
    parts = system.function("parts", {"f": ca.norm_2(ca.vertcat(*forces)), "x": system.expression("shank.x")})
    state = (system.q0, system.v0, 0.0 * system.v0, np.full(len(system.constraint_names), 30.0), [], [], [], 1.5)
    force, x = (float(one) for one in parts(*state))
    assert float(value(*state)) == pytest.approx(max(force - 10, 3.0) ** 2 + np.arctan2(x, 2), rel=1e-14)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"controls": ["forces.moter.value"]}, "the mechanism has no 'moter' here (did you mean 'motor'?)"),
        ({"controls": ["bodies.upper.mass"]}, "is no control, because it cannot change with time"),
        ({"parameters": ["bodies.upper"]}, "a parameter should be the key of a number of the mechanism"),
        ({"parameters": ["muscles.long.pennation"]}, "the equations of motion are not linear in it"),
        ({"parameters": ["muscles.long.optimal_length", "muscles.long.max_velocity"]}, "products of these parameters"),
    ],
)
def test_a_wrong_key_is_one_sentence(keys: dict[str, list[str]], text: str) -> None:
    m = arm()
    m.torque("motor", "lower", value=0.5)
    with pytest.raises(SpecError) as caught:
        m.to_casadi(**keys)
    assert text in str(caught.value)


def test_muscles_without_excitation_need_a_control() -> None:
    m = arm()
    m.muscles["long"] = m.muscles["long"].model_copy(update={"excitation": None})
    with pytest.raises(SpecError, match="a muscle needs an excitation"):
        m.to_casadi()
    assert m.to_casadi(controls=["muscles.long.excitation"]).u0.tolist() == [0.0]


def test_rigid_contacts_are_named() -> None:
    with pytest.raises(SpecError, match=r"contact 'sole\.0' is rigid"):
        load_spec("jump").mechanism().to_casadi()


def test_without_casadi_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MbdkitError, match=r"needs the package casadi: install it with `pip install mbdkit\[predict\]`"):
        Mechanism.from_spec({"bodies": {"ball": {"mass": 1.0}}}).to_casadi()


def test_branches_of_a_function_become_selections() -> None:
    def function(x: Any, y: Any) -> list[Any]:
        found = x * 1.0
        if x > 0:
            found = found + 1
        if y > 0.5 or y < -0.5:
            found = found * 3
        return [found - y if found > 2 else found, 5.0 if x > 0 and y > 0 else 0.0]

    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    values = ca.Function("values", [x, y], [column(every_branch(lambda: function(Symbol(x), Symbol(y))))])
    for a, b in np.random.default_rng(0).uniform(-2, 2, (200, 2)):
        np.testing.assert_allclose(np.array(values(a, b)).ravel(), function(a, b), rtol=1e-15)
    with pytest.raises(BranchError, match="more than 1000 outcomes"):
        every_branch(lambda: [sum(1.0 if Symbol(x) > k else 0.0 for k in range(10))])


def test_derivatives_are_finite_where_a_selection_avoids_a_singularity() -> None:
    x = Symbol(ca.SX.sym("x"))
    root, power, quotient = np.sqrt(x), np.power(x, 1.5), 1.0 / x
    result = np.where(x > 0.0, root + power + quotient, x)
    function = ca.Function("derivative", [x.sx], [ca.jacobian(result.sx, x.sx)])
    assert [float(function(at)) for at in (-1.0, 0.0)] == [1.0, 1.0]
    assert float(function(4.0)) == pytest.approx(0.25 + 3.0 - 0.0625, rel=1e-15)


class Wheels:
    """Elements of a stranger that export quantities of their own."""

    searching, kinds, attributes = ("acme.kernels",), ("wheels",), ("slip",)

    def __init__(self, acting: tuple[Any, ...]):
        self.acting = acting


class Wheel:
    symbolic: ClassVar[Target[Any]] = Target(f"{__name__}:Wheels")
    equilibrium: ClassVar[Target[Any]] = Target(f"{__name__}:balanced")


def balanced(wheel: Wheel) -> Any:
    return SimpleNamespace(unknowns=("rate", "force"), wheel=wheel)


def test_elements_of_a_stranger_export_themselves() -> None:
    wheel = Wheel()
    compiled: Any = SimpleNamespace(extensions={"wheels": (wheel,), "others": (1.0,), "none": ()})
    (exported,) = symbolic_elements(compiled)
    assert (type(exported), exported.kinds) == (Wheels, ("wheels",))
    mechanism: Any = SimpleNamespace(elements={"wheels": {"front": wheel}, "joints": {"pin": 1.0}})
    (chosen,) = chosen_equilibria(mechanism, ["x", "wheels.front.force", "wheels.front.rate"])
    assert (chosen.kind, chosen.name, chosen.rate, chosen.force) == ("wheels", "front", 2, 1)
    with pytest.raises(SpecError, match="needs both"):
        chosen_equilibria(mechanism, ["wheels.front.force"])


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_inputs_are_exported_as_states(hold: str) -> None:
    # expected: the rate of a linear input is its slope, and the torque is the input
    system = rotor(hold).to_casadi()
    assert system.state_names == ("inputs.torque", "inputs.torque.slope")[: 1 + (hold == "linear")]
    z = np.array([2.0, 3.0])[: len(system.state_names)]
    q, m = np.zeros(3), np.zeros(2)
    rates = np.array(system.rates(q, q, q, m, z, [], [], 0.0)).ravel()
    assert rates.tolist() == ([3.0, 0.0] if hold == "linear" else [0.0])
    residual = np.array(system.residual(q, q, q, m, z, [], [], 0.0)).ravel()
    assert residual[2] == -2.0
    assert "inputs.torque.value" in system.quantity_names
