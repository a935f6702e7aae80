"""Many runs of a prepared spec at once: their results are those of single runs, and their derivatives of gradients."""

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit_studies.lanes import run_batch
from tests.margins import assert_within

CRANK = {"model.bodies.crank.mass": [1.0, 2.0, -1.0, 3.0]}
KINETIC = "final(energy.kinetic)"


@pytest.fixture(scope="module")
def prepared() -> Any:
    parameters = {"stiffness": 40.0, "damping": 0.3}
    model = {
        "name": "mechanism",
        "bodies": {"rod": {"mass": 1.5, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {"J": {"type": "revolute", "bodies": ["ground", "rod"], "at": [0, 0]}},
        "forces": {
            "spring": {"type": "torsion-spring", "bodies": ["ground", "rod"], "stiffness": "stiffness",
                       "damping": "damping"},
        },
    }  # fmt: skip
    time, measures = {"end": 0.5, "step": 0.005}, {"swing": "max(abs(bodies.rod.angle))"}
    spec = {"mbdkit": 1, "model": model, "parameters": parameters, "measures": measures, "integrator": {"name": "rk4"}}
    return mbdkit.prepare(spec | {"time": time})


def test_a_whole_number_beyond_double_precision_is_refused_by_formulas_too() -> None:
    prepared = mbdkit.prepare("double-pendulum", time={"end": 0.1, "step": 0.01})
    for mass in (1.1, 1.2, 1.3):
        prepared.run({"model.masses.0": mass})
    for number in (10**400, -(10**400)):
        with pytest.raises(SpecError, match=r"model\.masses\[0\]: is too large"):
            prepared.run({"model.masses.0": number})


def test_results_are_those_of_single_runs_and_a_run_can_be_repeated() -> None:
    prepared = mbdkit.prepare("four-bar", time={"end": 0.2, "step": 0.01})
    runs = prepared.run_many(CRANK, [KINETIC, "reaction_force_max"])
    assert len(runs) == 4
    assert list(runs.statuses) == ["complete", "complete", "failed", "complete"]
    assert runs.verdicts[2] == runs.hashes[2] == ""
    for index in (0, 1, 3):
        single = prepared.run({name: values[index] for name, values in CRANK.items()})
        assert single.data_sha256 == runs.hashes[index]
        assert single.verdict == runs.verdicts[index]
        assert runs.measures[KINETIC][index] == single.energy.kinetic[-1]
        assert runs.remake(index).data_sha256 == runs.hashes[index]
    assert np.isnan(runs.measures[KINETIC][2])
    assert runs.units == {KINETIC: "J", "reaction_force_max": "N"}
    assert "4 runs, 3 complete" in repr(runs)


def test_derivatives_are_those_of_gradients(prepared: Any) -> None:
    names, stiffness = ["stiffness", "model.bodies.rod.mass"], np.array([20.0, 45.0, 80.0])
    runs = prepared.run_many({"stiffness": stiffness}, {"high": "swing", "work": KINETIC}, names)
    assert [*runs.measures] == [*runs.derivatives] == ["high", "work"]
    for index, value in enumerate(stiffness.tolist()):
        spec = prepared.spec_with({"stiffness": value})
        expected = mbdkit.gradient(spec, ["swing", KINETIC], names, check=False)
        found = np.array([runs.derivatives[name][index] for name in ("high", "work")])
        assert_within((found - expected.jacobian) / np.abs(expected.jacobian).max(axis=1, keepdims=True), 1e-12)
        assert_within([runs.measures["high"][index] - expected.value[0]], 1e-3 * abs(expected.value[0]))


def test_two_names_of_one_expression_have_the_same_derivatives(prepared: Any) -> None:
    # expected: the third measure has the derivatives that it has alone
    three = {"a": KINETIC, "b": KINETIC, "c": "swing"}
    runs = prepared.run_many({"stiffness": [20.0, 45.0]}, three, "stiffness")
    alone = prepared.run_many({"stiffness": [20.0, 45.0]}, "swing", "stiffness")
    np.testing.assert_array_equal(runs.derivatives["a"], runs.derivatives["b"])
    np.testing.assert_array_equal(runs.derivatives["c"], alone.derivatives["swing"])
    runs.measures["a"][0] = 0.0
    assert runs.measures["b"][0] != 0.0
    assert runs.remake(0).data_sha256 == runs.hashes[0]


def test_wrong_names_of_derivatives_are_refused_before_the_runs(prepared: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_batch, "ensemble", None)
    with pytest.raises(SpecError, match="mass"):
        prepared.run_many({"stiffness": [20.0]}, KINETIC, "mass")


def test_measures_of_the_spec_are_among_all_and_a_folder_keeps_the_study(prepared: Any, tmp_path: Path) -> None:
    runs = prepared.run_many({"damping": [0.1, 0.2]}, store="summary", out=tmp_path / "runs")
    assert {"swing", "misalignment_max"} <= runs.measures.keys()
    assert runs.measures["swing"][0] > runs.measures["swing"][1]
    assert (tmp_path / "runs" / "study.yaml").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (({"stifness": [1.0]},), "no parameter 'stifness' .did you mean 'stiffness'"),
        (({"stiffness": [1.0], "damping": [1.0, 2.0]},), "stiffness has 1, .*damping has 2"),
        (({"stiffness": 1.0},), r"parameters: parameters.stiffness: needs an array \(N,\)"),
        (({"stiffness": [1.0], "parameters.stiffness": [1.0]},), "two names stand for one key"),
        (({"stiffness": [1.0]}, "max(rod.angel)"), r"measures: .*rod\.angel"),
        (({"stiffness": [1.0]}, [2.0]), "an expression or a name, not 2.0"),
        (({"stiffness": [1.0]}, "misalignment_max", ["stiffness"]), "'misalignment_max' has no derivatives"),
        (({"stiffness": [1.0]}, KINETIC, "mass"), "'mass'"),
    ],
)
def test_wrong_arguments_are_refused_with_their_reason(prepared: Any, arguments: Any, message: str) -> None:
    with pytest.raises(SpecError, match=message):
        prepared.run_many(*arguments)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_prepared_run_says_that_it_cannot_be_copied(prepared: Any, duplicate: Any) -> None:
    with pytest.raises(TypeError, match="a prepared run cannot be copied or pickled"):
        duplicate(prepared)
