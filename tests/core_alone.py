"""The core without its parts, as `.ci/core-alone` installs it: runs, archives, and refusals of what parts offer."""

from __future__ import annotations

import json
import subprocess
import sys

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.fingerprint import seal
from mbdkit.base.errors import MissingPartError
from mbdkit.registry.manager import registry
from mbdkit.spec import load_spec
from tests.margins import assert_within

SECTIONS = {
    "rattle": {"formulation": "index-3"},
    "lobatto-pair": {"formulation": "index-3"},
}
"""What integrators require, by name."""

RUNS = [
    (integrator.name, name)
    for integrator in registry().of_kind("integrator")
    for name in ("pendulum", "double-pendulum", "slider-crank")
]


@pytest.mark.parametrize(("integrator", "name"), RUNS)
def test_example_runs_with_every_integrator_and_is_read_again(integrator, name, tmp_path):
    # expected: conservation of energy, to the error of methods of order 2 at these steps
    sections = {"integrator": {"name": integrator}, "time": {"step": 0.001, "end": 0.3}} | SECTIONS.get(integrator, {})
    run = mbdkit.run(name, archive=tmp_path / "run.h5", **sections).check()
    again = mbdkit.load(tmp_path / "run.h5")
    assert again.data_sha256 == run.data_sha256
    assert again.summary() == run.summary()
    assert_within(again.energy.balance, 1e-3 * np.max(again.energy.kinetic))
    assert again._repr_html_() is None


@pytest.mark.parametrize(
    ("use", "part"),
    [
        (lambda: mbdkit.study, "mbdkit.study needs mbdkit-studies"),
        (lambda: mbdkit.prepare, "mbdkit.prepare needs mbdkit-studies"),
        (lambda: mbdkit.inverse, "mbdkit.inverse needs mbdkit-biomech"),
        (lambda: mbdkit.gradient, "mbdkit.gradient needs mbdkit-gradients"),
        (lambda: mbdkit.equilibrium, "mbdkit.equilibrium needs mbdkit-statics"),
        (lambda: mbdkit.design, "mbdkit.design needs mbdkit-design"),
        (lambda: mbdkit.explore, "mbdkit.explore needs mbdkit-explore"),
        (lambda: mbdkit.identify, "mbdkit.identify needs mbdkit-identify"),
        (lambda: mbdkit.predict, "mbdkit.predict needs mbdkit-predict"),
        (lambda: mbdkit.plot, "mbdkit.plot needs mbdkit-report"),
        (lambda: load_spec("pendulum").mechanism().to_sympy(), "Mechanism.to_sympy needs mbdkit-statics"),
        (lambda: mbdkit.run("pendulum").plot, "Run.plot needs mbdkit-report"),
        (lambda: mbdkit.run("pendulum").animate(), "Run.animate needs mbdkit-report"),
        (lambda: mbdkit.run("pendulum").to_frame("joints"), "Run.to_frame needs mbdkit-report"),
        (lambda: mbdkit.run("pendulum").to_xarray(), "Run.to_xarray needs mbdkit-report"),
    ],
)
def test_what_a_part_offers_is_refused_in_one_sentence(use, part):
    with pytest.raises(MissingPartError) as refused:
        use()
    assert str(refused.value) == f"{part}, a part of mbdkit that is not installed"


def test_the_kit_is_refused_in_one_sentence():
    result = subprocess.run(
        [sys.executable, "-c", "import mbdkit.testing"], capture_output=True, text=True, check=False
    )
    last = result.stderr.splitlines()[-1]
    assert last.endswith("mbdkit.testing needs mbdkit-testing, a part of mbdkit that is not installed")


@pytest.mark.parametrize(
    ("key", "part"),
    [("motion", "mbdkit-biomech"), ("mbdkit_study", "mbdkit-studies"), ("mbdkit_design", "mbdkit-design")],
)
def test_a_spec_of_a_part_is_refused_in_one_sentence(key, part, mbdkit, in_tmp_path):
    (in_tmp_path / "spec.json").write_text(json.dumps({key: 1}), encoding="utf-8")
    for command in ("validate", "run"):
        result = mbdkit(command, "spec.json")
        assert result.exit_code == 2
        assert f"{key}: a spec with this key needs {part}, a part of mbdkit that is not installed" in result.stderr
        assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("key", "part"),
    [("contacts", "mbdkit-contact"), ("muscles", "mbdkit-biomech"), ("cuffs", "mbdkit-wearable")],
)
def test_elements_of_a_part_are_refused_in_one_sentence(key, part, mbdkit, in_tmp_path):
    spec = load_spec("pendulum").model_dump(mode="json")
    spec["model"] = {"name": "mechanism", "bodies": {"ball": {"mass": 1.0}}, key: {}}
    (in_tmp_path / "spec.json").write_text(json.dumps(spec), encoding="utf-8")
    result = mbdkit("run", "spec.json")
    assert result.exit_code == 2
    assert f"model.{key}: a model with this key needs {part}, a part of mbdkit that is not installed" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_the_arrays_of_an_inverse_run_are_read_and_the_rest_is_refused(tmp_path):
    mbdkit.run("pendulum", archive=tmp_path / "run.h5").close()
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        spec = load_spec("pendulum").model_dump(mode="json") | {"motion": {"file": "gait.csv"}}
        file.attrs["spec"] = json.dumps(spec)
        seal(file)
    run = mbdkit.load(tmp_path / "run.h5")
    assert run.time[0] == 0.0
    with pytest.raises(mbdkit.SpecError, match="needs mbdkit-biomech, a part of mbdkit that is not installed"):
        run.summary()
