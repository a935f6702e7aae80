"""Muscles in runs, against equations written here from the papers and integrated by SciPy, and closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from tests.muscles.arm import DAMPING, FIBER, FORCE, PENNATION, SPEED, WIDTH, active, arm, by_velocity, passive

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.matrix_terms import RATE
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from mbdkit_biomech.muscles.muscle_path import MusclePath
from mbdkit_studies.compute.batch import simulate_batch
from tests.margins import assert_within
from tests.runs.resuming.killed_runs import killed

IMPLICIT = {"name": "radau-iia", "stages": 3}
PRECISE = {"name": "dop853", "adaptive": True, "rtol": 1e-12, "atol": 1e-12}


def tendon(x: float) -> float:
    return 0.2 * np.exp(np.log(6) / 0.049 * (x - 1)) - 0.2


def activation_rate(excitation: float, a: float, rise: float = 0.01, fall: float = 0.04) -> float:
    f = 0.5 * np.tanh(10 * (excitation - a))
    return ((f + 0.5) / (rise * (0.5 + 1.5 * a)) + (0.5 - f) * (0.5 + 1.5 * a) / fall) * (excitation - a)


def length_of(angle: float) -> tuple[float, float]:
    """Length of the path and its derivative with respect to the angle of the forearm."""
    x, y = 0.04 * np.cos(angle) - 0.04, 0.04 * np.sin(angle) - 0.3
    length = float(np.hypot(x, y))
    return length, float((-0.04 * np.sin(angle) * x + 0.04 * np.cos(angle) * y) / length)


def rates(t: float, y: np.ndarray) -> list[float]:
    """Derivatives of angle, rate, activation and, with an elastic tendon, the fibre length."""
    angle, rate, a = y[:3]
    length, slope = length_of(angle)
    more = []
    if len(y) == 4:
        cosine = np.sqrt(1 - (WIDTH / y[3]) ** 2)
        force = FORCE * tendon((length - y[3] * cosine) / 0.18)
        isometric, at_rest = a * active(y[3] / FIBER), passive(y[3] / FIBER)
        v = brentq(
            lambda v: FORCE * (isometric * by_velocity(v) + at_rest + DAMPING * v) * cosine - force, -20, 20,
            xtol=1e-15, rtol=1e-15,
        )  # fmt: skip
        more = [v * SPEED * FIBER]
    else:
        fiber = np.hypot(length - 0.18, WIDTH)
        cosine = (length - 0.18) / fiber
        v = slope * rate * cosine / (SPEED * FIBER)
        force = FORCE * (a * active(fiber / FIBER) * by_velocity(v) + passive(fiber / FIBER) + DAMPING * v) * cosine
    torque = -force * slope - 1.5 * 9.81 * 0.15 * np.cos(angle)
    return [rate, torque / (0.02 + 1.5 * 0.15**2), activation_rate(0.3 + 0.2 * np.sin(5 * t), a), *more]


@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_runs_agree_with_an_independent_integration(kind: str) -> None:
    end, start = 0.1, [0.0, 0.0, 0.05]
    if kind == "elastic":
        path = length_of(0.0)[0]
        start.append(
            brentq(
                lambda x: (0.05 * active(x / FIBER) + passive(x / FIBER)) * np.sqrt(1 - (WIDTH / x) ** 2)
                - tendon((path - np.sqrt(x * x - WIDTH**2)) / 0.18), 0.05, 0.1211, xtol=1e-15, rtol=1e-15,
            )
        )  # fmt: skip
    wanted = solve_ivp(rates, (0, end), start, method="Radau", rtol=1e-12, atol=1e-13).y[:, -1]
    run = mbdkit.run(arm(kind), integrator=PRECISE, time={"end": end}).check()
    muscle, arm_ = run.muscles["biceps"], run["forearm"]
    got = [arm_.angle[-1], arm_.angular_velocity[-1], muscle.activation[-1], muscle.fiber_length[-1]]
    np.testing.assert_allclose(got[: len(wanted)], wanted, rtol=0, atol=1e-10)
    assert_within(run.energy.balance, 1e-11)


@pytest.mark.parametrize("kind", ["rigid", "elastic"])
@pytest.mark.parametrize(
    ("integrator", "order"),
    [({"name": "rk4"}, 4), ({"name": "gauss", "stages": 2}, 4), ({"name": "radau-iia", "stages": 2}, 3)],
    ids=str,
)
def test_methods_keep_their_order(integrator: dict[str, Any], order: int, kind: str) -> None:
    model = arm(kind, excitation="0.1 + 0.2*sin(5*t)", activation={"initial": 0.1})
    exact = mbdkit.run(model, integrator=PRECISE, time={"end": 0.1}).muscles["biceps"].fiber_length[-1]
    runs = [mbdkit.run(model, integrator=integrator, time={"end": 0.1, "step": step}) for step in (0.001, 0.0005)]
    coarse, fine = (abs(run.muscles["biceps"].fiber_length[-1] - exact) for run in runs)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.3)  # margin: order, from errors of mbdkit alone


STRAIGHT = [{"body": "ground", "point": (0.0, 0.0)}, {"body": "slider", "point": (0.0, 0.0)}]


def slide(motion: str, kind: str = "rigid", path: Any = STRAIGHT, **more: Any) -> Mechanism:
    """A muscle along a slide with a prescribed motion."""
    m = Mechanism(gravity=(0, 0))
    m.body("slider", mass=1.0, inertia=1.0, position=(0.3, 0.0))
    m.weld("turn", m.ground, "slider", at=(0, 0)) if motion == "0" else m.prismatic(
        "rail", m.ground, "slider", at=(0.3, 0), axis=(1, 0)
    )
    if motion != "0":
        m.driver("drive", m.ground, "slider", coordinate="x", motion=f"0.3 + {motion}")
    values = {"max_force": FORCE, "optimal_length": FIBER, "tendon_length": 0.18, "pennation": PENNATION}
    m.muscle("m", path, tendon=kind, **(values | more))
    return m


# Activation, length of the path, and length of the fibres and tension after `equilibrateMuscles` of OpenSim 4.6, for
# the muscle of `arm` with an elastic tendon (DeGrooteFregly2016Muscle, strain of 0.049 at one norm force) on a slide
OPENSIM = [
    (0.05, 0.25, 0.07069636320036596, 8.218266899348237), (0.05, 0.30, 0.11918127187938013, 40.203023454523645),
    (0.05, 0.35, 0.16633371351434179, 155.90169026108924), (0.50, 0.28, 0.09521890057513880, 249.61763048486318),
    (0.50, 0.32, 0.13434532373357003, 301.9772954721702), (1.00, 0.25, 0.06801643763455668, 102.84246054652613),
    (1.00, 0.30, 0.11193899888631438, 583.2191537629114), (1.00, 0.35, 0.16328408065507038, 393.4808787162183),
]  # fmt: skip


@pytest.mark.parametrize(("activation", "length", "fiber", "tension"), OPENSIM)
def test_fibres_start_in_the_equilibrium_of_opensim(
    activation: float, length: float, fiber: float, tension: float
) -> None:
    path = [{"body": "ground", "point": (0.3 - length, 0.0)}, {"body": "slider", "point": (0.0, 0.0)}]
    model = slide("0", "elastic", path, excitation=activation, activation={"initial": activation})
    run = mbdkit.run(model, integrator={"name": "rk4"}, time={"end": 1e-6, "step": 1e-6})
    muscle = run.muscles["m"]
    assert muscle.fiber_length[0] == pytest.approx(fiber, abs=3e-12)
    assert muscle.force[0] == pytest.approx(tension, rel=1e-8)
    assert_within(muscle.fiber_rate[0], 1e-11)


def test_an_isokinetic_contraction_has_the_closed_form_of_the_curves() -> None:
    spec = {"excitation": 0.5, "activation": {"initial": 0.5}}
    run = mbdkit.run(slide("-0.4*t", **spec), integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01}).check()
    along = 0.12 - 0.4 * run.time
    fiber = np.hypot(along, WIDTH)
    v = -0.4 * along / fiber / (SPEED * FIBER)
    force = (
        FORCE * (0.5 * active(fiber / FIBER) * by_velocity(v) + passive(fiber / FIBER) + DAMPING * v) * along / fiber
    )
    muscle = run.muscles["m"]
    np.testing.assert_allclose(muscle.force, force, rtol=1e-11)
    np.testing.assert_allclose(muscle.fiber_length, fiber, rtol=1e-12)
    np.testing.assert_allclose(muscle.fiber_rate, v * SPEED * FIBER, rtol=1e-11)
    np.testing.assert_allclose(muscle.power, -force * -0.4, rtol=1e-11)
    np.testing.assert_allclose(run.joints["drive"].driver_power, -muscle.power, rtol=1e-9)


def test_a_passive_muscle_makes_no_energy() -> None:
    """Over a cycle, fibres without activation give back what they take, less what their damping dissipates."""
    rest = {"excitation": 0.0, "activation": {"initial": 0.0}}
    time = {"end": 1.0, "step": 0.002}
    cycle = "0.05*sin(2*pi*t)"
    elastic = mbdkit.run(slide(cycle, **rest, damping=0.0), integrator=IMPLICIT, time=time).check()
    assert np.ptp(elastic.muscles["m"].force) > 10.0
    assert_within(elastic.energy.work[-1], 1e-9)
    for kind in ("rigid", "elastic"):
        lossy = mbdkit.run(slide(cycle, kind, **rest), integrator=IMPLICIT, time=time).check()
        supplied = -np.trapezoid(lossy.muscles["m"].power, lossy.time)
        assert 0.01 < supplied < 5.0


@pytest.mark.parametrize("slack", [0.01, 0.003])
def test_stiff_fibres_run_with_implicit_methods_at_steps_of_a_millisecond(slack: float) -> None:
    stiff = arm("elastic", fiber=0.29 - slack, slack=slack)
    exact = mbdkit.run(stiff, integrator=PRECISE | {"rtol": 1e-10, "atol": 1e-10}, time={"end": 0.2}).check()
    for integrator in (IMPLICIT, {"name": "gauss", "stages": 2}):
        run = mbdkit.run(stiff, integrator=integrator, time={"end": 0.2, "step": 0.001}).check()
        assert run["forearm"].angle[-1] == pytest.approx(exact["forearm"].angle[-1], abs=1e-7)
        assert run.muscles["biceps"].force[-1] == pytest.approx(exact.muscles["biceps"].force[-1], rel=1e-3)
    run = mbdkit.run(stiff, integrator={"name": "rk4"}, time={"end": 0.2, "step": 0.001})
    assert run.status == "failed"
    assert "fibres of muscle 'biceps' are stiff" in run.status_reason


def bent() -> Mechanism:
    """An arm of two segments with a muscle over four points of three bodies."""
    m = Mechanism()
    m.body("upper", mass=2.0, inertia=0.02, position=(0.0, -0.15), angle=0.1)
    m.body("forearm", mass=1.5, inertia=0.02, position=(0.12, -0.32), angle=0.3)
    m.revolute("shoulder", m.ground, "upper", points=((0, 0), (0, 0.15)))
    m.revolute("elbow", "upper", "forearm", points=((0, -0.15), (-0.12, 0)))
    path = [
        {"body": "ground", "point": (0.03, 0.02, 0.03)}, {"body": "upper", "point": (0.03, 0.05, -0.02)},
        {"body": "upper", "point": (0.035, -0.08)}, {"body": "forearm", "point": (-0.07, 0.01)},
    ]  # fmt: skip
    m.muscle(
        "biceps", path, max_force=800, optimal_length=0.13, tendon_length=0.15, tendon="elastic",
        excitation="0.5 - 0.3*cos(8*t)",
    )  # fmt: skip
    return m


def wrapped(side: str, kind: str = "rigid") -> Mechanism:
    """An arm of two segments with a muscle that wraps around the elbow, and has points off the plane."""
    m = bent()
    del m.muscles["biceps"]
    path = [
        {"body": "ground", "point": (-0.03, 0.02, 0.03)},
        {"body": "upper", "point": (-0.025, 0.05, -0.01)},
        {"wrap": {"body": "upper", "center": (0, -0.15), "radius": 0.02, "side": side}},
        {"body": "forearm", "point": (-0.06, -0.015, -0.01)},
    ]
    m.muscle("biceps", path, max_force=100, optimal_length=0.2, tendon_length=0.15, tendon=kind, excitation=0.3)
    return m


@pytest.mark.parametrize(
    "model", [bent(), wrapped("left"), wrapped("left", "elastic"), wrapped("right", "elastic")],
    ids=["points", "rigid", "left", "right"],
)  # fmt: skip
def test_a_path_over_several_bodies_pulls_on_all_of_them(model: Mechanism) -> None:
    run = mbdkit.run(model, integrator=IMPLICIT, time={"end": 0.3, "step": 0.002}).check()
    q = run.array("trajectory/position").reshape(len(run.time), -1)
    path = MusclePath("biceps", model.muscles["biceps"], QuantityNames(model)).at(run.time, q)
    muscle = run.muscles["biceps"]
    np.testing.assert_allclose(muscle.length, path.length, rtol=1e-13)
    v = run.array("trajectory/velocity").reshape(len(run.time), -1)
    np.testing.assert_allclose(muscle.rate, path.rate(v), atol=1e-12)
    # Newton's law of the forearm: the reaction of the elbow is what weight and muscle leave over
    pull = -muscle.force[:, None] * path.gradient[:, 3:5]
    wanted = 1.5 * run["forearm"].acceleration[:, :2] - pull - [0, -1.5 * 9.81]
    np.testing.assert_allclose(run.joints["elbow"].reaction_force, wanted, atol=1e-9)
    assert_within(run.energy.balance, 1e-7)


def rigid_millard() -> Mechanism:
    """The muscle of `bent` with other curves."""
    m = bent()
    m.muscles["biceps"] = m.muscles["biceps"].model_copy(update={"curves": "millard", "tendon": "rigid"})
    return m


@pytest.mark.parametrize(
    "model", [bent(), rigid_millard(), wrapped("left"), wrapped("right")], ids=["points", "millard", "left", "right"]
)
def test_the_tangents_of_muscles_are_those_of_differences(model: Mechanism) -> None:
    workspace, _ = build(load_spec(model, time={"end": 1, "step": 0.1}, integrator={"name": "rk4"}))
    n = workspace.mechanism.size - 3
    q, v = workspace.q0.copy(), workspace.v0.copy()
    v[:n] += np.random.default_rng(0).normal(size=n)
    top, w = workspace.mechanism.topology, workspace.scratch

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tangents_at(workspace.engine, 0.0, q, v, np.zeros_like(q), np.zeros((len(top.pairs), 2)))
        return w.force[:n].copy()

    step = 1e-6 * np.eye(n + 3)[:n]
    wanted = [
        np.array([force(q - one, v) - force(q + one, v) for one in step]).T / 2e-6,
        np.array([force(q, v - one) - force(q, v + one) for one in step]).T / 2e-6,
    ]
    force(q, v)
    terms, tangents, first = workspace.terms, np.zeros((2, n, n)), workspace._offsets
    of_forces = (terms.source >= first["spring_stiff"]) & (terms.row < n) & (terms.column < n)
    every = np.column_stack([terms.source, terms.row, terms.column, terms.factor])[of_forces]
    for source, row, column, factor in every:
        tangents[int(factor == RATE), row, column] += w.source[source]
    for given, exact in zip(tangents, wanted, strict=True):
        np.testing.assert_allclose(given, exact, atol=1e-7 * np.abs(exact).max())


def test_a_path_that_would_change_the_side_of_a_circle_stops_the_run() -> None:
    model = wrapped("left", "elastic")
    model.muscles["biceps"] = model.muscles["biceps"].model_copy(update={"max_force": 2000.0})
    run = mbdkit.run(model, integrator=IMPLICIT, time={"end": 1.0, "step": 0.001})
    assert run.status == "failed"
    assert "muscle 'biceps' would pass a circle on its other side" in run.status_reason


TIMES = [0.01 * k for k in range(21)]


@pytest.mark.parametrize(
    "excitation",
    [
        {"table": [TIMES, [0.3 + 0.2 * float(np.sin(5 * t)) for t in TIMES]], "interpolation": "quintic"},
        {
            "table": [[0.02 * np.pi * k for k in range(21)], [0.3 + 0.2 * np.sin(0.1 * np.pi * k) for k in range(21)]],
            "interpolation": "quintic",
            "ends": "periodic",
        },
        "states.e",
        "0.3 + 0.2*sin(5*t) + 0*forearm.angle",
    ],
    ids=["table", "periodic", "state", "expression"],
)
def test_excitations_of_all_kinds_act_alike(excitation: Any) -> None:
    integrator, time = IMPLICIT, {"end": 0.2, "step": 0.002}
    wanted = mbdkit.run(arm("elastic"), integrator=integrator, time=time).check()
    model = arm("elastic", excitation=0.0)
    model.state("e", rate="cos(5*t)", initial=0.3)
    spec = model.to_spec()
    spec["muscles"]["biceps"]["excitation"] = excitation
    run = mbdkit.run({"mbdkit": 1, "model": spec, "integrator": integrator, "time": time}).check()
    for name in ("excitation", "activation", "fiber_length"):
        given, exact = (getattr(one.muscles["biceps"], name) for one in (run, wanted))
        np.testing.assert_allclose(given, exact, rtol=0, atol=3e-8)


def test_a_reflex_sees_length_and_rate_of_its_muscle() -> None:
    reflex = "min(1, max(0.01, 0.05 + 20*(muscles.biceps.length - 0.29) + 0.5*muscles.biceps.rate))"
    run = mbdkit.run(arm("elastic", excitation=reflex), integrator=IMPLICIT, time={"end": 0.3, "step": 0.002}).check()
    muscle = run.muscles["biceps"]
    wanted = np.clip(0.05 + 20 * (muscle.length - 0.29) + 0.5 * muscle.rate, 0.01, 1)
    np.testing.assert_allclose(muscle.excitation, wanted, atol=1e-13)
    assert np.ptp(wanted) > 0.1


def test_events_measures_and_archives_know_muscles(tmp_path: Path) -> None:
    spec = {"mbdkit": 1, "model": bent().to_spec(), "integrator": IMPLICIT, "time": {"end": 0.3, "step": 0.002}}
    spec["events"] = {"strong": {"when": "muscles.biceps.force - 120"}}
    spec["measures"] = {"most": "max(muscles.biceps.force)"}
    run = mbdkit.run(spec, archive=tmp_path / "run.h5").check()
    muscle = mbdkit.load(tmp_path / "run.h5").muscles["biceps"]
    before, top, after = muscle.force[muscle.force.argmax() + np.array([-1, 0, 1])]
    vertex = top - (after - before) ** 2 / (8 * (after - 2 * top + before))  # the largest force is between two rows
    assert run.measures["most"] == pytest.approx(vertex, rel=4e-5)
    (event,) = run.events[:1]
    assert np.interp(event.time, run.time, muscle.force) == pytest.approx(120, abs=0.1)
    assert list(run.states) == ["biceps.activation", "biceps.fiber_length"]
    assert not run.forces


def test_runs_of_a_batch_and_resumed_runs_have_the_same_bits(tmp_path: Path) -> None:
    def spec(integrator: dict[str, Any], step: float, kind: str = "elastic", number: int = 0) -> Any:
        more = {"slack": 0.18 - 0.001 * number, "excitation": 0.3 + 0.01 * number}
        model = arm(kind, fiber=0.12 + 0.001 * number, **more).to_spec()
        return load_spec({"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 0.2, "step": step}})

    specs = [spec({"name": "rk4"}, 0.002, kind, k) for kind in ("rigid", "elastic") for k in range(9)]
    for one, run in zip(specs, simulate_batch(specs), strict=True):
        assert run.data_sha256 == mbdkit.run(one).data_sha256
    slow = spec(IMPLICIT, 2e-5)
    part = tmp_path / "run.h5.part"
    assert killed(slow, part, delay=0.0)
    assert mbdkit.resume(part).data_sha256 == mbdkit.run(slow).data_sha256


@pytest.mark.parametrize(
    ("change", "key", "sentence"),
    [
        ({"slack": 0.31}, "tendon_length", "tendon is longer than the path at the start"),
        ({"kind": "elastic", "slack": 0.31}, "tendon_length", "no length of the fibres is in equilibrium"),
        ({"kind": "elastic", "slack": 0.0}, "tendon_length", "should be greater than 0"),
        ({"excitation": None}, "excitation", "needs an excitation"),
        ({"kind": "elastic", "curves": "millard", "damping": 0.0}, "damping", "should be greater than 0: with the"),
        ({"excitation": "sin(x)"}, "excitation", "unknown name 'x'"),
        ({"excitation": 1.5}, "excitation", "should be between 0 and 1, not 1.5"),
        ({"excitation": {"table": [[0, 0.01], [0.1, 0.2]]}}, "excitation.table[0]", "the table covers 0.0 s to 0.01 s"),
    ],
)
def test_errors_name_the_muscle_and_its_key(change: dict[str, Any], key: str, sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence) as caught:
        mbdkit.run(arm(**({"kind": "rigid"} | change)), integrator=IMPLICIT, time={"end": 0.1, "step": 0.01})
    assert str(caught.value.key) == f"model.muscles.biceps.{key}"


def test_an_excitation_that_leaves_0_to_1_makes_the_run_doubtful() -> None:
    model = arm("rigid", excitation="0.9 + t")
    run = mbdkit.run(model, integrator={"name": "rk4"}, time={"end": 0.3, "step": 0.001})
    assert run.verdict == "doubtful"
    assert run.warnings == ["the excitation of muscle 'biceps' is 1.2 at t = 0.3 s; it should stay between 0 and 1"]


def test_a_path_that_becomes_shorter_than_its_tendon_makes_the_run_doubtful() -> None:
    short = slide("-1.5*t", excitation=0.2)
    run = mbdkit.run(short, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.005})
    assert run.verdict == "doubtful"
    assert "the length of muscle 'm' leaves the range" in " ".join(run.warnings)


def test_moment_arms_of_a_forward_run_are_derivatives_of_the_length_of_the_path() -> None:
    run = mbdkit.run("elbow-curl", time={"end": 0.3, "step": 0.001}, output={"every": 1})
    angle = run.joints["elbow"].angle
    rates = np.gradient(run.muscles["biceps"].length, run.time), np.gradient(angle, run.time)
    moving = np.abs(rates[1]) > 0.3
    assert np.count_nonzero(moving) > 50
    arms = run.moment_arms("biceps", "elbow.angle")
    assert_within((arms + rates[0] / rates[1])[moving][1:-1], 1e-5)  # differences of the recorded rows
