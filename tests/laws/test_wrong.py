"""Laws and law elements that are wrong: who can mend it is told what and where, in one sentence."""

from __future__ import annotations

from typing import Any

import pytest

import mbdkit
from mbdkit import ExpressionLaw, ForceLawPlugin, FunctionLaw, Mechanism, PluginError, SpecError
from mbdkit.engine.force_laws import bind_law
from mbdkit.registry.manager import registry

from .plugin import Nothing, length


def test_a_force_in_the_frame_of_a_point_mass_is_refused() -> None:
    m = Mechanism()
    m.body("ball", mass=1.0)
    m.force("f", "ball", value=[1.0, 0.0], frame="body")
    with pytest.raises(SpecError, match=r"model\.forces\.f\.body: 'ball' is a point mass .* no angle for a force in"):
        m.validate()


def with_law(law: str, **options: Any) -> Mechanism:
    m = Mechanism()
    m.body("ball", mass=1.0, position=(1.0, 0.0))
    m.law("p", m.ground, "ball", law=law, from_=(0, 0), to=(1, 0), **options)
    return m


@pytest.mark.parametrize(
    ("law", "options", "words"),
    [
        ("without-derivatives", {}, "its function returns one value, not the four numbers force, derivative with resp"),
        ("not-compilable", {}, "cannot be compiled: TypingError"),
        ("not-numbers", {}, "its function returns other types, not the four numbers"),
        ("not-smooth", {}, "SymPy cannot differentiate its force f(length)"),
        ("bessel", {}, "'besselj(0, length)' in its force or a derivative cannot be compiled"),
        ("named-length", {}, "its parameter 'length' has the name of an argument of the law"),
        ("not-an-expression", {}, "an object of type str is not a SymPy expression"),
        ("unknown-symbol", {"stiffness": 1.0}, "the symbol 'stifness' of its force is not one of"),
        ("wrong-potential", {"stiffness": 1.0}, ", is not its force at rate zero"),
        ("timed-potential", {"stiffness": 1.0}, "has no potential: remove the potential"),
        ("no-parameters", {}, "failed to compute its parameters: ZeroDivisionError: no parameters today"),
        ("inverse", {"compliance": 0.0}, "failed to check its options: ZeroDivisionError: float division by zero"),
    ],
)
def test_a_law_that_fails_to_be_built_is_the_plugins_fault(law: str, options: Any, words: str) -> None:
    with pytest.raises(PluginError) as caught:
        mbdkit.run(with_law(law, **options), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.1})
    assert str(caught.value).startswith(f"force law acme:{law}")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_that_a_law_refuses_are_the_users_fault() -> None:
    with pytest.raises(SpecError, match=r"compliance.* is too small"):
        mbdkit.run(with_law("inverse", compliance=1e-12), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.1})


@pytest.mark.parametrize("integrator", ["rk4", "gauss", "scipy-dop853", "scipy-radau"])
def test_a_law_that_gives_no_number_ends_the_run_as_not_finite(integrator: str) -> None:
    # expected: the square root of 0.5 - t is none from t = 0.5 s on
    time = {"end": 1.0, "step": 0.01}
    run = mbdkit.run(with_law("not-finite"), integrator={"name": integrator}, time=time)
    assert run.status == "failed"
    assert run.status_reason.startswith("not-finite: ")
    assert 0.4 < run.time[-1] <= 0.5
    assert "the law of force 'p' does not give a finite number" in run.status_reason


@pytest.mark.parametrize("integrator", ["gauss", "scipy-radau"])
def test_a_law_that_gives_no_derivative_ends_the_run_of_a_method_that_asks_for_it(integrator: str) -> None:
    # expected: the derivative is none from t = 0.5 s on; an adaptive method asks for it where it converges badly
    options = {"rtol": 1e-10, "atol": 1e-10} if integrator == "scipy-radau" else {"stages": 2}
    time = {"end": 9.0, "step": 0.01}
    run = mbdkit.run(with_law("no-slope"), integrator={"name": integrator, **options}, time=time)
    assert run.status == "failed"
    assert run.status_reason.startswith("not-finite: the law of force 'p' does not give a finite number")


def test_a_law_without_a_finite_derivative_serves_an_explicit_method() -> None:
    # expected: what it does not ask for cannot stop it
    start = {"start": 0.7, "end": 1.0, "step": 0.01}
    assert mbdkit.run(with_law("no-slope"), integrator={"name": "rk4"}, time=start).status == "complete"


def test_a_law_whose_potential_is_no_number_ends_the_run_by_its_energy() -> None:
    run = mbdkit.run(with_law("no-potential"), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.01})
    assert run.status_reason.startswith("not-finite: the energy is not a finite number at the state")
    assert 0.4 < run.time[-1] <= 0.5


def test_a_potential_that_is_complex_at_negative_lengths_is_checked_at_the_others() -> None:
    # expected: s^(3/2) has the potential 2/5 s^(5/2); the ball starts at s = 1 m and stays at positive lengths
    time = {"end": 0.5, "step": 0.01}
    run = mbdkit.run(with_law("hertz", stiffness=1.0), integrator={"name": "gauss", "stages": 3}, time=time)
    assert run.check().energy.potential[0] == pytest.approx(0.4, rel=1e-14)


def test_a_law_that_gives_no_number_at_the_start_is_refused() -> None:
    with pytest.raises(SpecError, match=r"model\.forces\.p: its law gives no finite number at the start"):
        mbdkit.run(with_law("not-finite"), integrator={"name": "rk4"}, time={"start": 0.7, "end": 1.0, "step": 0.01})


class Points(Nothing):
    points: int = 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"law": length}, "its law is an object of type Symbol, not an ExpressionLaw or a FunctionLaw"),
        ({"options": Points}, "its option 'points' has the name of a key that every element of type law has"),
        ({"name": "a law"}, "is not made of letters, digits"),
    ],
)
def test_an_item_that_is_no_law_is_reported_and_left_out(changes: dict[str, Any], words: str) -> None:
    from types import SimpleNamespace

    from mbdkit import hookimpl
    from mbdkit.registry.manager import load_registry

    made: dict[str, Any] = {"name": "mine", "summary": "Mine", "options": Nothing, "law": ExpressionLaw(length)}

    @hookimpl
    def mbdkit_force_laws() -> Any:
        return [ForceLawPlugin(**made | changes), ForceLawPlugin(**made)]

    entry = SimpleNamespace(
        name="laws",
        value="other",
        dist=SimpleNamespace(name="other", version="1"),
        load=lambda: SimpleNamespace(mbdkit_force_laws=mbdkit_force_laws),
    )
    loaded = load_registry([entry])
    assert [item.id for item in loaded.of_kind("force-law")] == ["other:mine"]
    assert words in str(loaded.failures[0].error)


def test_the_plugin_of_these_tests_is_loaded_whole() -> None:
    assert not registry().failures


def test_a_law_that_changes_its_parameters_is_refused():
    # they belong to the mechanism: the next step would use the changed ones
    def law(length, rate, time, parameters):
        parameters[0] = 2.0 * parameters[0]
        return parameters[0] * length, parameters[0], 0.0, 0.0

    with pytest.raises(PluginError, match=r"force law mine cannot be compiled: .*readonly"):
        bind_law(FunctionLaw(law, parameters=lambda options: [1.0]), None, "mine")


def test_an_option_that_no_spec_can_have_is_not_blamed_on_the_law() -> None:
    m = Mechanism()
    m.body("arm", mass=1.0, inertia=0.1)
    with pytest.raises(SpecError, match="stiffness: a spec cannot contain an object of type object"):
        m.law("p", m.ground, "arm", law="linear", along="angle", stiffness=object())
