"""How a spec says what is done against drift, and what it may not combine."""

from __future__ import annotations

import json
from typing import Any

import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.methods.scipy_solver import SciPySolver
from mbdkit.runs.preparation import caution
from mbdkit.spec import load_spec
from mbdkit.spec.run_spec import spec_type
from mbdkit.spec.schema import run_schema
from tests.integrators.step_methods import RungeKutta, offering

CHOICES: list[tuple[Any, Stabilization]] = [
    ("none", NONE),
    ({"name": "none"}, NONE),
    ("baumgarte", Stabilization("baumgarte", alpha=5.0, beta=5.0)),
    ({"name": "baumgarte", "alpha": 12}, Stabilization("baumgarte", alpha=12.0, beta=12.0)),
    ({"name": "baumgarte", "alpha": 2.0, "beta": 0}, Stabilization("baumgarte", alpha=2.0, beta=0.0)),
    ("projection", Stabilization("projection")),
    ({"name": "projection", "every": 5, "bound": 1e-9}, Stabilization("projection", every=5, bound=1e-9)),
    ({"name": "projection", "symmetric": True}, Stabilization("projection", symmetric=True)),
]


@pytest.mark.parametrize(("given", "chosen"), CHOICES)
def test_the_canonical_spec_holds_all_options_and_reads_back(
    given: Any, chosen: Stabilization, small: dict[str, Any]
) -> None:
    spec = load_spec(small, (), stabilization=given)
    text = spec.canonical_json()
    assert load_spec(json.loads(text)).canonical_json() == text
    assert load_spec(json.loads(text)).stabilized == chosen


def test_a_spec_that_says_nothing_is_the_one_that_says_none(small: dict[str, Any]) -> None:
    silent = load_spec(small)
    told, named = (load_spec(small, (), stabilization=choice) for choice in ("none", {"name": "none"}))
    assert silent.run_id() == told.run_id() == named.run_id()
    assert '"stabilization":"none"' in silent.canonical_json()


def test_the_schema_knows_the_names_and_the_options() -> None:
    schema = run_schema()
    alone, chosen = schema["properties"]["stabilization"]["anyOf"]
    assert alone["enum"] == ["none", "baumgarte", "projection"]
    options = [schema["$defs"][one["$ref"].rpartition("/")[2]] for one in chosen["oneOf"]]
    found = {one["properties"]["name"]["const"]: set(one["properties"]) - {"name"} for one in options}
    wanted = {"baumgarte": {"alpha", "beta"}, "projection": {"every", "bound", "symmetric"}}
    assert found == {"none": set(), **wanted}


def refusal(spec: dict[str, Any]) -> SpecError:
    with pytest.raises(SpecError) as caught:
        load_spec(spec)
    return caught.value


def test_lsoda_cannot_project_and_says_who_can(small: dict[str, Any]) -> None:
    wrong = small | {"integrator": {"name": "scipy-lsoda"}, "stabilization": "projection"}
    error = refusal(wrong)
    assert error.key == "stabilization"
    assert "'scipy-lsoda' does not support the stabilization 'projection', only 'none' and 'baumgarte'" in error.message
    able = error.message.partition("integrators that support it: ")[2]
    assert "gauss" in able
    assert "lsoda" not in able
    assert load_spec(wrong | {"stabilization": "baumgarte"}).stabilized.alpha == 5.0


def test_an_integrator_for_a_stabilization_also_supports_the_formulation() -> None:
    # those of the index-1 formulation project too
    spec = spec_type(offering(RungeKutta(), formulations=("ggl",), stabilizations=("none",)))
    sections: dict[str, Any] = {"model": {"name": "single-pendulum"}, "time": {"end": 0.1, "step": 0.01}}
    sections |= {"mbdkit": 1, "integrator": {"name": "mine"}, "formulation": "ggl"}
    with pytest.raises(SpecError, match="integrators that support it: radau-iia") as caught:
        spec(**sections, stabilization="projection")
    assert "rk4" not in caught.value.message


def test_a_plugin_that_claims_too_much_is_found_out() -> None:
    # a solver of SciPy that claims nothing of stabilization claims, like any method, that its steps can be repeated
    solver = SciPySolver("RK45", 1e-6, 1e-6)
    spec = spec_type(offering(solver))(
        mbdkit=1, model={"name": "single-pendulum"}, integrator={"name": "mine"}, time={"end": 0.1, "step": 0.01},
        stabilization={"name": "projection", "symmetric": True},
    )  # fmt: skip
    with pytest.raises(mbdkit.PluginError, match="should claim"):
        caution(spec)


def test_baumgarte_goes_with_index_one_alone() -> None:
    spec = spec_type(offering(RungeKutta(), formulations=("index-1", "index-3")))
    sections: dict[str, Any] = {"model": {"name": "single-pendulum"}, "time": {"end": 0.1, "step": 0.01}}
    sections |= {"mbdkit": 1, "integrator": {"name": "mine"}, "formulation": "index-3"}
    with pytest.raises(SpecError, match="'index-3' does not have; use index-1") as caught:
        spec(**sections, stabilization="baumgarte")
    assert caught.value.key == "stabilization"
    assert spec(**sections, stabilization="projection").stabilized.kind == "projection"


def test_symmetric_projection_needs_fixed_steps() -> None:
    spec = spec_type(offering(RungeKutta(), adaptive=True))
    with pytest.raises(SpecError, match="needs a fixed step") as caught:
        spec(
            mbdkit=1, model={"name": "single-pendulum"}, integrator={"name": "mine"}, time={"end": 0.1},
            stabilization={"name": "projection", "symmetric": True},
        )  # fmt: skip
    assert caught.value.key == "stabilization.symmetric"


@pytest.mark.parametrize(
    ("integrator", "limit"),
    [
        # expected: where the stability region ends on the negative real axis; Hairer and Wanner 1996, IV.2
        ({"name": "rk4"}, 2.785293563405282),
        ({"name": "rk-gill"}, 2.785293563405282),
        # expected: (alpha h mu)^2 + 2 alpha h mu grows to 1 for both eigenvalues mu = 1/4 +- i sqrt(3)/12 of Gauss-2;
        # with alpha h = x and |mu|^2 = 1/12: |2 x mu + x^2 mu^2| = x |mu| |2 + x mu| = 1
        ({"name": "gauss", "stage_solver": "fixed-point"}, 1.4591007382725592),
    ],
)
def test_a_warning_tells_from_where_on_baumgarte_is_stiff(
    integrator: dict[str, Any], limit: float, small: dict[str, Any]
) -> None:
    def told(alpha: float) -> str:
        chosen = small | {"integrator": integrator, "stabilization": {"name": "baumgarte", "alpha": alpha}}
        return "; ".join(map(str, caution(load_spec(chosen))))

    step = small["time"]["step"]
    assert told(0.999 * limit / step) == ""
    words = told(1.001 * limit / step)
    assert "too large for the step of 0.01 s" in words
    assert f"it should be below {limit:.4g}: " in words


@pytest.mark.parametrize("integrator", [{"name": "gauss"}, {"name": "radau-iia"}, {"name": "scipy-dop853"}])
def test_methods_that_take_any_alpha_are_not_warned_of(integrator: dict[str, Any], small: dict[str, Any]) -> None:
    stabilization = {"name": "baumgarte", "alpha": 1e5}
    assert caution(load_spec(small | {"integrator": integrator, "stabilization": stabilization})) == []
