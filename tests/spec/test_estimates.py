"""Parameters that a spec takes from an identification: `parameters: {from: FILE.h5}`, and the section `estimates`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mbdkit import ArchiveError, MbdkitError, RunSpec, SpecError
from mbdkit.archive.fingerprint import seal
from mbdkit.spec import load_spec
from mbdkit.spec.estimates import Estimates, cholesky_factor
from mbdkit.spec.yaml_reader import write_yaml
from tests.identified import COVARIANCE, MASS, STIFFNESS, sliding, write_fit, write_identified


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    """The spec of the spring in a folder with the file that it names."""
    write_fit(tmp_path)
    path = tmp_path / "spring.yaml"
    path.write_text(write_yaml(sliding()), "utf-8")
    return path


def test_values_and_covariance_of_the_parameters_in_use_are_taken(spec: Path) -> None:
    loaded = load_spec(spec)  # the file name is relative to the folder of the spec
    assert loaded.parameters == {"stiffness": STIFFNESS, "mass": MASS}
    assert loaded.mechanism().bodies["block"].mass == MASS
    assert loaded.estimated is not None
    assert loaded.estimated.names == ("stiffness", "mass")
    np.testing.assert_allclose(loaded.estimated.factor @ loaded.estimated.factor.T, COVARIANCE, rtol=1e-14)
    assert [file.name for file in loaded.files_read] == ["fit.h5"]


def test_the_loaded_spec_does_not_need_the_file(spec: Path) -> None:
    loaded = load_spec(spec)
    (spec.parent / "fit.h5").unlink()
    again = load_spec(json.loads(loaded.canonical_json()))
    assert again.sha256() == loaded.sha256()
    assert again.estimates == loaded.estimates


def test_numbers_beside_the_file_take_precedence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_fit(tmp_path)
    given = load_spec(sliding(parameters={"from": Path("fit.h5"), "stiffness": "0.03 N/mm", "twice": "2*mass"}))
    assert given.numbers == {"stiffness": pytest.approx(30.0), "mass": MASS, "twice": 2 * MASS}
    assert given.estimated is not None
    assert given.estimated.names == ("mass",)
    assert given.estimated.factor == pytest.approx(0.01)
    assert load_spec(sliding(), ["parameters.stiffness=3", "parameters.mass=1"]).estimates is None


def test_a_parameter_with_another_value_is_no_estimate(spec: Path) -> None:
    changed = load_spec(load_spec(spec), ["parameters.mass=3"])
    assert changed.estimated is not None
    assert changed.estimated.names == ("stiffness",)
    assert changed.estimated.factor == pytest.approx(0.2)
    assert load_spec(changed, ["parameters.stiffness=3"]).estimated is None


@pytest.mark.parametrize(
    ("changes", "key", "message"),
    [
        (["parameters.from=3"], "parameters.from", "should be the file of an identification, not 3"),
        (["parameters.from=no.h5"], "", "No such file"),
        (["parameters.from=spring.yaml"], "", "this is not an HDF5 file, so not a result of an identification"),
        (["parameters.from=other.h5"], "", "this is an HDF5 file, but not the result of an identification"),
        (["parameters.from=later.h5"], "", "has the format version 2; this mbdkit reads 1"),
        (["parameters.from=damaged.h5"], "", "arrays were added or removed, such as parameters/value"),
        (["parameters.from=strange.h5"], "parameters.from", "no expression contains a parameter of strange.h5"),
        (["model.bodies.block.mass=lost"], "parameters.from", "of 'lost' (the data do not determine it)"),
        (["model.bodies.block.mass=2*absent"], "model.bodies.block.mass", "there is no parameter 'absent'"),
        (["estimates={values: {a: 1}, covariance: [[1, 2]]}", "parameters={mass: 1, stiffness: 1}"],
         "estimates.covariance", "1 rows of 1"),
    ],
)  # fmt: skip
def test_wrong_files_and_names_are_refused(spec: Path, changes: list[str], key: str, message: str) -> None:
    folder = spec.parent
    with h5py.File(folder / "other.h5", "w") as file:
        file["x"] = 1.0
    for name, attribute, value in (("later", "format_version", 2), ("damaged", "", 0)):
        with h5py.File(write_identified(folder / f"{name}.h5", {"mass": 1.0}, [[1.0]]), "a") as file:
            if attribute:
                file.attrs[attribute] = value
            else:
                del file["parameters/value"]
    write_identified(folder / "strange.h5", {"drag": 1.0}, [[1.0]])
    with pytest.raises(MbdkitError) as caught:
        load_spec(spec, changes)
    assert message in str(caught.value)
    assert getattr(caught.value, "key", "") == key


def test_a_spec_that_is_not_loaded_refuses_the_file(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="which is read when a spec or a base is loaded") as caught:
        RunSpec(**sliding())
    assert caught.value.key == "parameters.from"


def test_singular_covariances_have_a_factor_and_others_are_refused() -> None:
    # expected: two equal parameters, and one without variance
    singular = np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    factor = cholesky_factor(singular)
    np.testing.assert_allclose(factor @ factor.T, singular, atol=1e-15)
    for wrong in ([[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.4, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]):
        with pytest.raises(ValueError, match="should be symmetric and have no negative eigenvalue"):
            Estimates(values={"a": 1.0, "b": 2.0}, covariance=wrong)


def test_random_covariances_of_any_units_have_their_factor() -> None:
    generator = np.random.default_rng(1)
    for _ in range(50):
        root = generator.normal(size=(5, 4)) * 10.0 ** generator.uniform(-9, 9, size=(5, 1))  # of rank 4
        covariance: Any = root @ root.T
        factor = cholesky_factor(covariance)
        sizes = np.sqrt(np.outer(np.diagonal(covariance), np.diagonal(covariance)))
        np.testing.assert_allclose(factor @ factor.T / sizes, covariance / sizes, atol=3e-6)
        assert np.array_equal(factor, np.tril(factor))


def test_an_estimate_that_no_covariance_describes_is_refused_with_the_reason(tmp_path: Path) -> None:
    path = write_identified(tmp_path / "fit.h5", {"stiffness": 40.0, "mass": 2.0}, [[0.04, np.nan], [np.nan, np.nan]])
    with h5py.File(path, "r+") as file:
        file["parameters/identifiable"][1] = 1
        file["parameters/why"][1] = "the interval of mass reaches a bound"
        seal(file)
    spec = sliding(parameters={"from": str(path)})
    because = r"'mass' \(no covariance describes it, because the interval of mass reaches a bound\); give a number"
    with pytest.raises(SpecError, match=because):
        load_spec(spec)
    assert load_spec(sliding(parameters={"from": str(path), "mass": 2.0})).estimated is not None


@pytest.mark.parametrize("place", ["value", "verdict"])
def test_estimates_of_a_changed_file_are_refused(spec: Path, place: str) -> None:
    with h5py.File(spec.parent / "fit.h5", "r+") as file:
        if place == "value":
            file["parameters/value"][0] = 2 * STIFFNESS  # one bit
        else:
            file.attrs["verdict"] = "good"
    with pytest.raises(ArchiveError, match=r"fit\.h5.* changed since"):
        load_spec(spec)
