"""The command `identify`, and what other commands say of its specs and results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.identify.hand_made import result
from typer.testing import CliRunner, Result

import mbdkit
import mbdkit_identify.identify
from mbdkit.base.units import read_unit
from mbdkit.cli import app
from mbdkit.spec import example_names
from mbdkit_identify.identification import Identification
from mbdkit_identify.identify_spec import IdentifySpec
from mbdkit_identify.loading import load_identify_spec
from mbdkit_identify.measured_data import read_experiment
from mbdkit_identify.segments import segments_of
from tests.margins import assert_within

RIG = """
mbdkit: 1
parameters: {inertia: 0.03, damping: 0.01, start: 1.0}
model:
  name: mechanism
  bodies: {arm: {mass: 1.2, inertia: inertia, position: [0.25*sin(start), -0.25*cos(start)], angle: start}}
  joints: {pin: {type: revolute, bodies: [ground, arm], points: [[0, 0], [0, 0.25]]}}
  forces: {oil: {type: torsion-spring, bodies: [ground, arm], damping: damping}}
integrator: {name: gauss, stages: 2}
time: {end: 1.0, step: 0.02}
"""
SPEC = """
mbdkit_identify: 1
title: A pendulum
base: rig.yaml
experiments:
  high: {file: high.csv, observed: {arm.angle: {column: encoder, unit: deg}}, initial: rest}
  late: {file: high.csv, observed: {arm.angle: {column: encoder, unit: deg}}, window: [0.5, 1.0], role: hold-out,
    initial: estimated}
parameters: {inertia: {bounds: [0.005, 0.1]}, damping: {bounds: [0, 0.2]}}
intervals: {method: linear, of: {ratio: damping/inertia}}
"""
TRUE = {"inertia": 0.042, "damping": 0.02}
NOISE = 0.2
"""Deviation of the noise of the encoder [deg]."""


def command(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments), prog_name="mbdkit")


@pytest.fixture
def spec(in_tmp_path: Path) -> Path:
    """Write the base, the data and the spec to the working folder."""
    (in_tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    path = in_tmp_path / "pendulum.yaml"
    path.write_text(SPEC, encoding="utf-8")
    run = mbdkit.run("rig.yaml", parameters=TRUE | {"start": 1.4})
    encoder = np.degrees(run.bodies["arm"].angle) + np.random.default_rng(2).normal(0.0, NOISE, len(run.time))
    table = np.column_stack([run.time, encoder])
    np.savetxt("high.csv", table, delimiter=",", header="time,encoder", comments="")
    return path


@pytest.fixture
def hand_made(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Replace the computation by the result with these changes, which are empty at first."""
    changes: dict[str, Any] = {}

    def identify(source: IdentifySpec, **options: Any) -> Identification:
        assert isinstance(source, IdentifySpec)
        options["notify"]("a stage")
        return result(**changes)

    monkeypatch.setattr(mbdkit_identify.identify, "identify", identify)
    return changes


def test_the_command_prints_writes_and_reports(spec: Path, hand_made: dict[str, Any]) -> None:
    done = command("identify", "pendulum.yaml", "--report")
    assert done.exit_code == 0, done.stderr
    assert done.stdout.startswith(result().summary())
    assert done.stdout.endswith("result: pendulum.h5, report: pendulum-report.html\n")
    assert done.stderr == "a stage\n"
    assert mbdkit.load_identification("pendulum.h5")["stiffness"] == result()["stiffness"]
    again = command("identify", "pendulum.yaml")
    assert (again.exit_code, again.stdout) == (2, "")
    assert "pendulum.h5: this file exists already" in again.stderr
    hand_made["verdict"] = "bad"
    quiet = command("identify", "pendulum.yaml", "--overwrite", "--quiet")
    assert (quiet.exit_code, quiet.stdout, quiet.stderr) == (3, "", "")
    assert mbdkit.load_identification("pendulum.h5").verdict == "bad"


def test_json_has_estimates_without_infinite_numbers(spec: Path, hand_made: dict[str, Any]) -> None:
    done = command("identify", "pendulum.yaml", "-o", "fit.h5", "--json")
    values = json.loads(done.stdout)
    assert (values["path"], values["verdict"], done.stderr) == ("fit.h5", "doubtful", "")
    assert values["estimates"]["mass"] == {
        "name": "mass", "unit": "kg", "value": 2.0, "lower": None, "upper": None, "deviation": None,
        "identifiable": False, "at_bound": "", "why": "", "mean": None,
    }  # fmt: skip
    assert values["covariance"][0] == [0.04, -0.001, None]
    assert values["doubts"][0]["place"] == "friction in the joint 'hip'"
    assert [one["is_hold_out"] for one in values["signals"]] == [False, True]


def test_validate_says_what_would_be_estimated(spec: Path) -> None:
    done = command("validate", "pendulum.yaml")
    assert done.stdout.splitlines() == [
        "pendulum.yaml: this identification is valid",
        "experiment   high: arm.angle, 51 samples from 0 to 1 s",
        "experiment   late, held out: arm.angle, 26 samples from 0.5 to 1 s",
        "parameters   inertia, damping",
        "expressions  ratio = damping/inertia",
        "intervals    95 %, linear",
    ]


@pytest.mark.parametrize("name", example_names("identify"))
def test_packaged_identifications_are_valid_in_every_folder(name: str, in_tmp_path: Path) -> None:
    done = command("validate", name)
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.startswith(f"{name}: this identification is valid\nexperiment ")


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [
        ("experiments.high.file=missing.csv", "missing.csv"),
        (
            "experiments.high.observed={arm.angle: {column: encodr}}",
            "column: high.csv has no column 'encodr' (did you mean 'encoder'?)",
        ),
        ("experiments.high.observed={arm.angle: {column: encoder, unit: N}}", 'experiments.high.observed."arm.angle"'),
        ("experiments.high.observed={arm.angl: encoder}", "body 'arm' has no 'angl' (did you mean 'angle'?)"),
        ("parameters.dampin={}", "parameters.dampin: neither the base nor a sensor has the parameter 'dampin'"),
        ("base=missing.yaml", "base: there is no file 'missing.yaml'"),
        ("mbdkit_identify=2", "mbdkit_identify: should be 1"),
    ],
)
def test_wrong_input_is_refused_in_one_sentence(spec: Path, assignment: str, sentence: str) -> None:
    done = command("identify", "pendulum.yaml", "--set", assignment)
    assert (done.exit_code, done.stdout) == (2, "")
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not Path("pendulum.h5").exists()


def test_other_commands_name_the_command(spec: Path, hand_made: dict[str, Any]) -> None:
    assert "`mbdkit identify` solves" in command("run", "pendulum.yaml").stderr
    command("identify", "pendulum.yaml")
    assert command("archive", "check", "pendulum.h5").stdout == "pendulum.h5: sound\n"
    for words in (("archive", "info"), ("plot",), ("rerun",)):
        refused = command(*words, "pendulum.h5")
        assert refused.exit_code == 2
        sentence = "not a run archive but the result of an identification; `mbdkit report` writes a page about it"
        assert refused.stderr == f"error: pendulum.h5: this is {sentence}\n"
    assert command("report", "pendulum.h5").stdout == "pendulum-report.html\n"


def test_a_pendulum_is_identified_and_its_estimates_are_used(spec: Path) -> None:
    done = command("identify", "pendulum.yaml", "-o", "fit.h5", "--report")
    assert done.exit_code == 0, done.stderr
    fit = mbdkit.load_identification("fit.h5")
    for name, true in TRUE.items():
        assert_within(fit[name].value - true, 4 * fit[name].deviation)
        assert fit[name].lower < fit[name].value < fit[name].upper
    assert fit.residuals[0].deviation == pytest.approx(np.radians(NOISE), rel=0.3)
    assert [one.experiment for one in fit.hold_out] == ["late"]
    run = mbdkit.run("rig.yaml", parameters={"from": "fit.h5", "start": 1.4})
    assert run.spec["parameters"]["inertia"] == fit["inertia"].value


def test_estimates_have_the_units_of_their_parameters_and_sensors() -> None:
    # expected: the units in the comments of the base, with radians as pure numbers; offsets are those of angles
    spec = load_identify_spec("double-pendulum-swing")
    unknowns, _, _ = segments_of(spec, [read_experiment(spec, one) for one in spec.experiments])
    units = {one.name: read_unit(one.unit) for one in unknowns if one.unit}
    expected = {"center": "m", "inertia": "kg m^2", "damping": "N m s/rad", "friction": "N m", "zero": "rad"}
    expected["drag"] = "N m s^2/rad^2"
    assert all(units[name].is_like(read_unit(expected[name.partition("_")[2]])) for name in spec.parameters)
