"""Gradients of measures: published values, derivatives that are known, and what is refused."""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.gradients.checks import assert_passed
from tests.gradients.slider_crank import SLIDER_CRANK

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.spec import load_spec
from mbdkit_gradients import gradient_check
from mbdkit_gradients.gradient_parameters import resolved

PENDULUM: dict[str, Any] = {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 0.5, "step": 0.02}}


@pytest.mark.parametrize(
    ("integrator", "step"),
    [({"name": "gauss", "stages": 3}, 0.01), ({"name": "radau-iia", "stages": 3}, 0.01), ({"name": "rk4"}, 0.004)],
)
def test_gradient_of_the_slider_crank_of_sundials(integrator: dict[str, Any], step: float) -> None:
    # expected: the integral of the kinetic energy over 10 s and its derivatives with respect to stiffness and damping,
    # computed from the equations of the example in one coordinate to 13 digits
    found = mbdkit.gradient(
        SLIDER_CRANK, "integral(energy.kinetic)", ["k", "c"], check=False, integrator=integrator,
        time={"end": 10.0, "step": step},
    )  # fmt: skip
    assert found.value == pytest.approx([3.3366067994828], rel=0, abs=1e-10)
    np.testing.assert_allclose(found.jacobian, [[0.333448106128, -0.363754033971]], rtol=0, atol=1e-10)


def test_values_of_parameters_may_be_given_with_their_names() -> None:
    spec, measure, values = load_spec(SLIDER_CRANK, (), **PENDULUM), "final(energy.kinetic)", {"k": 2.0, "c": 1.0}
    expected = mbdkit.gradient(
        SLIDER_CRANK | {"parameters": values}, measure, parameters=["k"], check=False, **PENDULUM
    )
    for found in (
        mbdkit.gradient(spec, measure, {"k": 2.0}, check=False),
        mbdkit.gradient(spec, measure, {"k": 2.0}, parameters={"k": 9.0, "c": 1.0}, check=False),
        mbdkit.gradient(spec, measure, "k", parameters=values, check=False),
    ):
        assert found.parameters == ("k",)
        assert found.jacobian == expected.jacobian
    assert spec.parameters["k"] == 1.0


def test_a_parameter_that_only_a_measure_contains_is_used() -> None:
    # expected: the angle of a free rotor grows at its rate, so that d angle(tau)/d tau is this rate
    rotor = {"name": "mechanism", "bodies": {"rotor": {"mass": 2.0, "inertia": 0.3, "angular_velocity": 0.7}}}
    spec = {"mbdkit": 1, "parameters": {"tau": 0.3, "idle": 1.0}, "model": rotor, **PENDULUM}
    found = mbdkit.gradient(spec, ["at(rotor.angle, tau)"], ["tau"])
    assert found.jacobian[0, 0] == pytest.approx(0.7, rel=1e-9)
    unused = [remark for remark in found.remarks if "is not used" in remark]
    assert unused == ["the parameter at parameters.idle is not used"]


def test_gradient_by_an_initial_angle_is_that_of_a_free_rotation() -> None:
    # expected: a balanced rotor turns by its initial rate, so that d(angle)/d(angle) = 1 and d(angle)/d(rate) = T
    rotor = {
        "mbdkit": 1,
        "model": {
            "name": "mechanism",
            "bodies": {"rotor": {"mass": 2.0, "inertia": 0.3, "angle": 0.4, "angular_velocity": 0.7}},
            "joints": {"hub": {"type": "revolute", "bodies": ["ground", "rotor"], "points": [[0, 0], [0, 0]]}},
        },
    }
    wanted = ["model.bodies.rotor.angle", "model.bodies.rotor.angular_velocity", "model.bodies.rotor.mass"]
    found = mbdkit.gradient(
        rotor, ["final(bodies.rotor.angle)", "max(abs(joints.hub.force))"], wanted, check=False, **PENDULUM
    )
    np.testing.assert_allclose(found.jacobian, [[1.0, 0.5, 0.0], [0.0, 0.0, 9.81]], rtol=0, atol=1e-12)
    assert found.parameters == tuple(wanted)
    assert found["final(bodies.rotor.angle)", "model.bodies.rotor.angular_velocity"] == pytest.approx(0.5)


@pytest.mark.parametrize("integrator", [{"name": "rk4"}, {"name": "gauss", "stages": 2}])
def test_gradient_by_youngs_modulus_is_that_of_time(integrator: dict[str, Any]) -> None:
    # expected: with all forces proportional to E, and a start at rest, q depends on t sqrt(E), so dq/dE = v t / (2 E)
    places = [[0.1 * i, 0.002 * i**2, 0.04 * i] for i in range(5)]
    material = {"E": "E", "nu": 0.3, "A": 1e-2, "I": 1e-4, "density": 1e3}
    spec = {
        "mbdkit": 1, "parameters": {"E": 2e5},
        "model": {
            "name": "mechanism", "gravity": [0.0, 0.0],
            "beams": {"strip": {"a": [0, 0], "b": [0.4, 0], "elements": 2, "nodes": 3, **material, "start": places}},
        },
    }  # fmt: skip
    tip = [f"bodies['strip.4'].{coordinate}" for coordinate in ("x", "y", "angle")]
    sections: dict[str, Any] = {"integrator": integrator, "time": {"end": 0.1, "step": 2e-4}}
    found = mbdkit.gradient(spec, [f"final({one})" for one in tip], "E", check=False, **sections)
    rates = mbdkit.run(spec, **sections)["strip.4"]
    expected = [*rates.velocity[-1], rates.angular_velocity[-1]]
    np.testing.assert_allclose(found.jacobian[:, 0], np.array(expected) * 0.1 / (2 * 2e5), rtol=2e-6)


def test_ends_of_a_beam_move_all_its_nodes() -> None:
    # expected: a straight beam of rods as stiff as steel, hanging still from a pin: the node at the end is the end
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiff = {"axial": 1e6, "shear": 1e6, "bending": 1e3}
    m.beam("strip", a=(0, 0), b=(1, 0), elements=2, stiffness=stiff, mass_per_length=1.0)
    spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 1e-3, "step": 1e-4}}
    names = ["model.beams.strip.a.0", "model.beams.strip.b.0"]
    found = mbdkit.gradient(spec, [f"final(bodies['strip.{k}'].x)" for k in range(3)], names)
    np.testing.assert_allclose(found.jacobian, [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]], atol=1e-9)


def test_the_largest_of_several_elements_has_the_gradient_of_that_element() -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiff = {"axial": 1e3, "shear": 1e3, "bending": 1.0}
    nodes = m.beam("strip", a=(0, 0), b=(1, 0), elements=4, stiffness=stiff, mass_per_length=1.0, damping=0.02)
    m.weld("clamp", m.ground, nodes[0], at=(0, 0))
    m.force("push", nodes[-1], value=(0, -1))
    sections: dict[str, Any] = {"integrator": {"name": "radau-iia", "stages": 3}, "time": {"end": 2.0, "step": 0.02}}
    spec = {"mbdkit": 1, "model": m.to_spec(), **sections}
    texts = [f"max({text})" for text in ("abs(beams.strip.moment)", "abs(beams.strip.moment[0])", "beams.strip.moment")]
    found = mbdkit.gradient(spec, texts, "model.beams.strip.stiffness.bending", check=False)
    np.testing.assert_allclose(found.jacobian[0], found.jacobian[1], rtol=1e-9)  # the one at the clamp
    wanted = [mbdkit.run(spec | {"model": _bent(spec["model"], x)}, measures={"x": texts[0]}) for x in (0.999, 1.001)]
    assert found.jacobian[0, 0] == pytest.approx((wanted[1].measures["x"] - wanted[0].measures["x"]) / 0.002, rel=1e-4)


def _bent(model: dict[str, Any], stiffness: float) -> dict[str, Any]:
    beam = model["beams"]["strip"]
    return model | {"beams": {"strip": beam | {"stiffness": beam["stiffness"] | {"bending": stiffness}}}}


def test_more_parameters_than_one_pass_takes_give_the_same_gradient() -> None:
    every = [
        f"model.bodies.{body}.{key}"
        for body in ("crank", "rod")
        for key in ("mass", "inertia", "position.0", "position.1", "angle", "velocity.0", "angular_velocity")
    ]
    measures = ["final(energy.kinetic)", "mean(bodies.rod.x)"]
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 0.2, "step": 0.02}}
    both = mbdkit.gradient(SLIDER_CRANK, measures, every, mode="forward", **sections)
    last = mbdkit.gradient(SLIDER_CRANK, measures, every[-2:], check=False, mode="forward", **sections)
    np.testing.assert_array_equal(both.jacobian[:, -2:], last.jacobian)
    assert both.check is not None
    assert both.check.is_passed, str(both)


def test_check_reports_a_wrong_gradient_with_numbers() -> None:
    spec = mbdkit.RunSpec(**SLIDER_CRANK, **PENDULUM)
    for change, is_one_sided in ((-1.0, False), (1.0, True)):
        found = gradient_check.check_gradient(
            gradient_check.Direction(resolved(spec, ["k"]), np.array([change]), is_one_sided),
            lambda settings: [settings[0][1] ** 2], {"square": 1.0}, np.array([1.0]), np.array([[2.1]]),
        )  # fmt: skip
        assert not found.is_passed
        assert found.extrapolated[0] == pytest.approx(2.0 * change)
        assert "square: the derivative in a random direction" in str(found)
        assert "DISAGREES" in str(found)
        (doubt,) = gradient_check.check_doubts(found)
        assert "fails its check" in doubt
        assert "4.8 % of its scale away" in doubt  # 0.1 of 2.1


@pytest.mark.parametrize(
    ("derivative", "reference", "passes"),
    [(2.0001, 2.00002, True), (2.0001, 2.0, False), (2.002, 2.00002, False), (2.002, 2.002, False)],
    ids=["discretization", "no-discretization", "wrong", "wrong-like-reference"],
)
def test_a_derivative_may_deviate_by_the_discretization_error(
    derivative: float, reference: float, passes: bool
) -> None:
    # the derivative of k^2 at 1 is 2
    spec = mbdkit.RunSpec(**SLIDER_CRANK, **PENDULUM)
    found = gradient_check.check_gradient(
        gradient_check.Direction(resolved(spec, ["k"]), np.array([1.0]), False), lambda settings: [settings[0][1] ** 2],
        {"square": 1.0}, np.array([1.0]), np.array([[derivative]]), lambda settings: [settings[0][1] ** reference],
    )  # fmt: skip
    assert found.is_passed == passes
    assert ("DISAGREES with differences" in str(found)) != passes


def test_differences_of_another_method_that_scatter_are_no_error() -> None:
    # the derivative of k^2 at 1 is 2; the first function has an error whose differences depend on the distance, as runs
    # across discontinuities have, and those of the second one do not
    spec = mbdkit.RunSpec(**SLIDER_CRANK, **PENDULUM)
    direction = gradient_check.Direction(resolved(spec, ["k"]), np.array([1.0]), False)
    given = (lambda settings: [settings[0][1] ** 2]), {"square": 1.0}, np.array([1.0]), np.array([[2.0]])
    for error, expected in ((lambda k: 1e-8 * np.sign(k - 1.0), 0.0), (lambda k: 2e-5 * (k - 1.0), 2e-5)):
        found = gradient_check.check_gradient(direction, *given, lambda s, e=error: [s[0][1] ** 2 + e(s[0][1])])
        assert found.is_passed
        assert found.reference[0] == pytest.approx(2.00002, rel=1e-9)
        assert found.entry_error[0, 0] == pytest.approx(expected, rel=1e-3, abs=1e-12)


@pytest.mark.parametrize(
    ("measure", "end", "remark"),
    [
        pytest.param("max(abs(joints.J1.torque))", 0.5, "joints.J1.torque in 'x' is always zero", id="zero reaction"),
        pytest.param("max(abs(joints.J1.force))", 0.2, "x: max at the end of the run", id="before the lowest point"),
        pytest.param("max(abs(joints.J1.force))", 0.5, "", id="after it"),
        pytest.param("max(rod1.y)", 0.5, "", id="largest at the start"),
        pytest.param("max(rod1.x - rod1.x)", 0.5, "", id="constant"),
    ],
)
def test_notes_of_the_run_are_remarks_of_its_gradient(measure: str, end: float, remark: str) -> None:
    rod = {"model": {"name": "single-pendulum", "length": 1.0, "angle": -0.5}}
    method = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": end, "step": 0.01}}
    found = mbdkit.gradient({"mbdkit": 1, **rod, **method}, {"x": measure}, "model.mass", check=False)
    assert not found.doubts
    assert [one[: len(remark)] for one in found.remarks] == [remark] * bool(remark)
    assert remark in str(found)


def test_warnings_of_the_run_are_doubts_of_its_gradient() -> None:
    rod = {"mbdkit": 1, "model": {"name": "single-pendulum", "angle": -17.0}}
    method = {"integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}
    (doubt,) = mbdkit.gradient(rod | method, "final(rod1.x)", "model.length", check=False).doubts
    assert "-17 rad at model.angle is more than a full rotation" in doubt


def test_numbers_that_are_zero_but_for_rounding_errors_pass_the_check() -> None:
    # a pendulum that hangs at rest: positions across, kinetic energies and the moment of its joint are zero
    measures = ["final(rod1.x)", "integral(energy.kinetic)", "rms(joints.J1.torque)", "integral(abs(rod1.vx))"]
    rest = {"mbdkit": 1, "model": {"name": "single-pendulum", "angle": "-pi/2"}}
    method = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}}
    found = mbdkit.gradient(rest | method, measures, ["model.length", "model.mass"])
    assert_passed(found)
    np.testing.assert_allclose(found.jacobian, 0.0, rtol=0, atol=1e-14)
    checked = mbdkit.run(rest | method | {"check": True, "measures": {"across": measures[0]}})
    assert checked.measure_errors["across"] < 1e-12


def test_a_peak_at_two_times_is_said_to_have_no_derivative() -> None:
    # an undamped oscillator reaches the same height again after a period
    oscillator = {
        "mbdkit": 1,
        "model": {
            "name": "mechanism", "gravity": [0.0, 0.0], "bodies": {"weight": {"mass": 1.0, "position": [1.0, 0.0]}},
            "forces": {
                "spring": {
                    "type": "spring-damper", "bodies": ["ground", "weight"], "points": [[-3.0, 0.0], [0.0, 0.0]],
                    "stiffness": 4 * pi**2, "free_length": 3.0,
                },
            },
        },
        "integrator": {"name": "gauss", "stages": 3}, "time": {"end": 2.0, "step": 0.02},
    }  # fmt: skip
    found = mbdkit.gradient(oscillator, "max(bodies.weight.x)", "model.forces.spring.stiffness", check=False)
    assert "is attained at several times" in "".join(found.doubts)


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("kk", "there is no parameter 'kk' (did you mean 'k'?)"),
        ("model.bodies.rodd.mass", "no key 'model.bodies.rodd.mass': there is no 'rodd' in model.bodies"),
        ("model.forces.s.stiffness", "is the text or expression 'k'"),
        ("model.bodies.rod", "should be the key of a number"),
        ("time.step", "is no parameter of the mechanism"),
        (["k", "parameters.k"], "the parameter 'k' is named twice"),
        ([3], "needs names of parameters, such as 'stiffness' or 'model.bodies.rod.mass', not 3"),
        (None, "needs names of parameters"),
        ({"kk": 1.0}, "there is no parameter 'kk' (did you mean 'k'?)"),
    ],
)
def test_wrong_parameters_are_refused(parameter: Any, message: str) -> None:
    with pytest.raises(SpecError) as error:
        mbdkit.gradient(SLIDER_CRANK, "final(energy.kinetic)", parameter, **PENDULUM)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"output": {"interval": 0.1}}, "gradients are not available with `interval`"),
        (
            {"integrator": {"name": "taylor"}, "formulation": "joint-coordinates"},
            "only steps of explicit Runge-Kutta methods and of collocation methods",
        ),
    ],
)
def test_runs_without_derivatives_are_refused(sections: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError) as error:
        mbdkit.gradient(SLIDER_CRANK, "final(energy.kinetic)", "k", **{**PENDULUM, **sections})
    assert message in str(error.value)


TABLE = [[-0.1, 0.0, 0.1, 0.2, 0.3], [0.2, 0.0, 1.0, 0.5, 0.7]]
"""Knots before, at the start of, in, at the end of and after a run of 0.2 s."""


@pytest.mark.parametrize("knot", [1, 2, 3])
def test_knots_of_tables_are_refused_at_the_start_and_end_too(knot: int) -> None:
    load = {"type": "torque", "body": "disc", "value": {"table": TABLE}}
    spec = {
        "mbdkit": 1,
        "model": {
            "name": "mechanism",
            "bodies": {"disc": {"mass": 1.0, "inertia": 0.5, "position": [0.0, 0.0], "angle": 0.0}},
            "joints": {"pin": {"type": "revolute", "bodies": ["ground", "disc"], "at": [0.0, 0.0]}},
            "forces": {"load": load},
        },
        "integrator": {"name": "rk4"},
        "time": {"end": 0.2, "step": 0.02},
    }
    by_value = mbdkit.gradient(spec, "final(energy.kinetic)", "model.forces.load.value.table.1.1")
    assert by_value.check.is_passed
    with pytest.raises(SpecError, match="the time at which a motion, or its derivative, is discontinuous depends on"):
        mbdkit.gradient(spec, "final(energy.kinetic)", f"model.forces.load.value.table.0.{knot}")


def test_a_measure_without_derivative_is_refused() -> None:
    with pytest.raises(SpecError, match=r"joints\.B\.misalignment has no derivative"):
        mbdkit.gradient(SLIDER_CRANK, "max(joints.B.misalignment)", "k", **PENDULUM)
    for text, message in (("max(joints.B.misalignment)", "has no derivative"), ("max(joints.B.force)", "is a vector")):
        with pytest.raises(SpecError, match=rf"^measures\.gap: .*{message}"):
            mbdkit.gradient(SLIDER_CRANK, {"gap": text}, "k", **PENDULUM)


@pytest.mark.parametrize(
    ("integrator", "order"),
    [({"name": "gauss", "stages": 1}, 2), ({"name": "radau-iia", "stages": 2}, 3), ({"name": "rk4"}, 4)],
)
def test_gradient_converges_with_the_order_of_the_method(integrator: dict[str, Any], order: int) -> None:
    # expected: the exact derivatives of the slider-crank over 10 s
    def error(step: float) -> float:
        sections = {"integrator": integrator, "time": {"end": 10.0, "step": step}}
        found = mbdkit.gradient(SLIDER_CRANK, "integral(energy.kinetic)", ["k", "c"], check=False, **sections)
        return float(np.max(np.abs(found.jacobian - [[0.333448106128, -0.363754033971]])))

    # margin: order, from errors of mbdkit alone
    assert np.log2(error(0.1) / error(0.05)) == pytest.approx(order, abs=0.35)


def test_gradients_of_a_spec_are_stored_in_the_archive_and_printed(tmp_path: Path) -> None:
    # expected: what `mbdkit.gradient` returns
    measures = {"speed": "final(abs(bodies.rod.angular_velocity))", "energy": "final(energy.kinetic)"}
    spec = {**SLIDER_CRANK, **PENDULUM, "measures": measures, "gradients": ["k", "model.bodies.rod.mass"]}
    mbdkit.run(spec, archive=tmp_path / "run.h5")
    run = mbdkit.load(tmp_path / "run.h5")
    found = mbdkit.gradient(SLIDER_CRANK, measures, ["k", "model.bodies.rod.mass"], **PENDULUM)
    for name in measures:
        stored = run.gradients[name]["derivatives"]
        assert stored == {one: found[name, one] for one in ("k", "model.bodies.rod.mass")}
        assert run.gradients[name]["check"]["agrees"]
    assert f"speed by k: {found['speed', 'k']:.12f} +- " in run.summary()


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"gradients": ["k"]}, "the spec has no `measures`"),
        ({"gradients": ["kk"], "measures": {"a": "final(energy.kinetic)"}}, "[0]: there is no parameter 'kk'"),
    ],
)
def test_gradients_of_a_spec_are_checked_before_the_run(sections: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError) as error:
        mbdkit.run({**SLIDER_CRANK, **PENDULUM, **sections})
    assert message in str(error.value)
    assert error.value.key.startswith("gradients")


def test_parameters_in_the_expression_of_a_measure_are_differentiated_too() -> None:
    # expected: the product rule, since the stiffness also changes the run
    spec = {**SLIDER_CRANK, "parameters": {"k": 1.0, "c": 1.0, "twice": "2*k"}, **PENDULUM}
    measures = {
        "energy": "final(energy.kinetic)", "product": {"value": "twice*final(energy.kinetic)", "unit": "J"},
        "angle": "final(bodies.rod.angle)", "power": {"value": "final(-bodies.rod.angle)**(k + 0.5)", "unit": "rad"},
    }  # fmt: skip
    found = mbdkit.gradient(spec, measures, "k")
    energy, _, angle, power = found.value
    by_k = found["energy", "k"]
    assert found["product", "k"] == pytest.approx(2.0 * energy + 2.0 * by_k, rel=1e-12)
    assert found["power", "k"] == pytest.approx(power * (np.log(-angle) + 1.5 * found["angle", "k"] / angle), rel=1e-12)
    assert_passed(found)


def test_a_parameter_that_changes_the_form_of_an_expression_is_refused() -> None:
    spec = {**SLIDER_CRANK, "parameters": {"k": 1.0, "c": 1.0, "n": 2.0}, **PENDULUM}
    with pytest.raises(SpecError, match="the form of an expression depends on 'n'"):
        mbdkit.gradient(spec, {"a": {"value": "final(bodies.rod.angle)**n", "unit": "rad"}}, "n")


def test_a_parameter_at_the_limit_of_its_range_is_checked_on_the_valid_side() -> None:
    spec = {**SLIDER_CRANK, "parameters": {"k": 1.0, "c": 0.0}, **PENDULUM}
    found = mbdkit.gradient(spec, "final(energy.kinetic)", ["k", "c"])
    assert_passed(found)
    assert found.check.direction[1] > 0.0
    assert found.check.error[0] < 1e-8


def test_parameters_that_are_almost_zero_have_exact_derivatives() -> None:
    # expected: the same as for the parameter zero; changes in proportion to its value would be lost in rounding errors
    def by_turn(turn: float) -> float:
        arm = {"mass": 1.0, "position": ["cos(0.5 + turn)", "sin(0.5 + turn)"]}
        spec = {
            "mbdkit": 1, "parameters": {"turn": turn},
            "model": {
                "name": "mechanism", "bodies": {"ball": arm},
                "forces": {
                    "s": {
                        "type": "spring-damper", "from": [0.0, 0.0], "to": arm["position"],
                        "bodies": ["ground", "ball"], "stiffness": 1.0,
                    },
                },
            },
        }  # fmt: skip
        return float(mbdkit.gradient(spec, "final(bodies.ball.x)", "turn", check=False, **PENDULUM).jacobian[0, 0])

    assert by_turn(1e-9) == pytest.approx(by_turn(0.0), rel=1e-8)


@pytest.mark.parametrize(("velocity", "told"), [([0.0, 0.0], True), ([0.0, "0.5*rate"], False)])
def test_a_rate_that_assembly_reduces_is_a_doubtful_parameter(velocity: list[Any], told: bool) -> None:
    # expected: a rod on a pin at its end keeps the share I / (I + m a^2) = 1/4 of a rate given without its velocity
    rod = {"mass": 1.0, "inertia": 1.0 / 12.0, "position": [0.5, 0.0], "velocity": velocity, "angular_velocity": "rate"}
    pin = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0.0, 0.0]}
    model = {"name": "mechanism", "gravity": [0.0, 0.0], "bodies": {"rod": rod}, "joints": {"pin": pin}}
    spec = {"mbdkit": 1, "parameters": {"rate": 2.0}, "model": model, **PENDULUM}
    found = mbdkit.gradient(spec, "final(rod.angular_velocity)", "rate", check=False)
    np.testing.assert_allclose(found.jacobian, [[0.25 if told else 1.0]], rtol=1e-12)
    assert len(found.doubts) == 2 * told
    if told:
        assert "assembly changes the angular velocity of rod" in found.doubts[0]
        assert "changes by 0.25 of a change of model.bodies.rod.angular_velocity" in found.doubts[1]
        assert "doubts" in found.described(found.measures[0])
