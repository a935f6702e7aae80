"""The commands that tell of a mechanism without a run: equilibrium, modes, kinematics."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import pytest

from mbdkit.spec import load_spec
from tests.margins import assert_within
from tests.spec_texts import SMALL


def test_equilibrium_says_where_and_what_the_joints_carry(mbdkit, in_tmp_path):
    # expected: both rods hang, the upper joint carries the two weights of 9.81 N
    Path("two.yaml").write_text(SMALL, encoding="utf-8")
    result = mbdkit("equilibrium", "two.yaml")
    assert result.exit_code == 0
    assert "stable" in result.stdout
    assert "19.62" in result.stdout
    found = json.loads(mbdkit("equilibrium", "two.yaml", "--json").stdout)
    assert found["bodies"]["rod1"] == pytest.approx([0.0, -0.5, -math.pi / 2], abs=1e-12)
    assert found["reactions"]["J1"]["force"] == pytest.approx([0.0, 19.62], abs=1e-11)


def test_equilibrium_writes_a_spec_that_rests(mbdkit, in_tmp_path):
    assert mbdkit("equilibrium", "knee", "--write", "rest.yaml").exit_code == 0
    assert "consistent, unchanged" in mbdkit("validate", "rest.yaml").stdout
    again = json.loads(mbdkit("equilibrium", "rest.yaml", "--json").stdout)
    assert again["iterations"] <= 2
    assert_within(again["imbalance"], 1e-10)
    refused = mbdkit("equilibrium", "knee", "--write", "rest.yaml")
    assert refused.exit_code == 2
    assert "this file exists" in refused.stderr
    assert mbdkit("equilibrium", "rest.yaml", "--write", "rest.yaml", "--overwrite").exit_code == 2
    assert mbdkit("equilibrium", "knee", "--write", "rest.yaml", "--overwrite").exit_code == 0


def test_the_spec_at_rest_has_only_parameters_that_have_an_effect(mbdkit, in_tmp_path):
    model = {"name": "mechanism", "bodies": {"ball": {"mass": "m", "position": [0.0, 0.0]}}}
    spring = {"type": "spring-damper", "bodies": ["ground", "ball"], "points": [[0.0, 1.0], [0.0, 0.0]]}
    model["forces"] = {"spring": spring | {"stiffness": "k", "free_length": 1.0}}
    spec = {"mbdkit": 1, "parameters": {"m": 2.0, "k": 100.0, "low": "down/2", "down": -0.4}, "model": model}
    spec |= {"events": {"low": {"when": "ball.y - low"}}, "gradients": ["m"], "measures": {"y": "final(ball.y)"}}
    spec |= {"integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}
    Path("ball.json").write_text(json.dumps(spec), encoding="utf-8")
    printed = mbdkit("equilibrium", "ball.json", "--write", "rest.yaml").stdout
    assert "rest.yaml has numbers in place of the parameters m and k" in printed
    written = load_spec("rest.yaml")
    assert written.parameters == {"low": "down/2", "down": -0.4}
    assert written.gradients == []


def test_modes_are_listed_and_drawn(mbdkit, in_tmp_path):
    # expected: sqrt(3 g / (2 L)) for the packaged rod of 1 m
    result = mbdkit("modes", "pendulum", "-o", "modes.png")
    assert result.exit_code == 0
    assert "3.83601" in result.stdout
    assert Path("modes.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads(mbdkit("modes", "double-wishbone", "--json").stdout)
    assert found["freedoms"] == len(found["modes"]) == 2
    assert 0 < found["modes"][0]["damping_ratio"] < 1
    assert len(json.loads(mbdkit("modes", "chain", "--count", "3", "--json").stdout)["modes"]) == 3


def test_modes_about_a_start_that_is_no_rest_say_so(mbdkit):
    said = mbdkit("modes", "knee", "--at", "start").stdout
    assert "not at rest" in said
    assert "at this instant only" in said
    assert "at rest" in mbdkit("modes", "knee").stdout


def test_kinematics_writes_a_table(mbdkit, in_tmp_path):
    result = mbdkit("kinematics", "slider-crank", "-o", "crank.csv", "--set", "time.end=0.5")
    assert result.exit_code == 0
    assert "slider" in result.stdout
    rows = list(csv.reader(Path("crank.csv").read_text(encoding="utf-8").splitlines()))
    assert rows[0][:4] == ["time", "crank.x", "crank.y", "crank.angle"]
    assert len(rows) == 502
    assert mbdkit("kinematics", "slider-crank", "-o", "crank.csv").exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("kinematics", "knee"), ":14: model.joints: a kinematic analysis needs a mechanism that is fully driven"),
        (("modes", "slider-crank"), "no degrees of freedom"),
        (("modes", "pendulum", "-o", "modes.doc"), "its name must end in .png, .svg or .pdf"),
        (("equilibrium", "nothing.yaml"), "there is no such file"),
        (("equilibrium", "knee", "--write", "nowhere/rest.yaml"), "does not exist; create it first"),
        (("modes", "pendulum", "--set", "model.length=-1"), "length"),
    ],
)
def test_wrong_input_is_a_sentence_and_exit_status_2(arguments, words, mbdkit, in_tmp_path):
    result = mbdkit(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert result.stdout == ""
    assert not list(in_tmp_path.iterdir())


def test_specs_without_integrator_and_time_are_analysed(mbdkit, in_tmp_path):
    # expected: frequency of a rod of 1 m that hangs from its end
    text = SMALL.partition("integrator:")[0]
    Path("still.yaml").write_text(text, encoding="utf-8")
    for command in ("equilibrium", "modes"):
        assert mbdkit(command, "still.yaml").exit_code == 0
    assert "driver" in mbdkit("kinematics", "still.yaml").stderr


def test_friction_of_a_body_at_rest_is_explained(mbdkit, in_tmp_path):
    text = """\
mbdkit: 1
model:
  name: mechanism
  bodies: {block: {mass: 1 kg, inertia: 0.1}}
  joints:
    slide: {type: prismatic, bodies: [ground, block], at: [0, 0], axis: [1, 0], friction: {coefficient: 0.5, length: 1}}
  forces: {push: {type: force, body: block, point: [0, 0], value: [2, 0]}}
"""
    Path("block.yaml").write_text(text, encoding="utf-8")
    assert "friction holds nothing in an equilibrium" in mbdkit("equilibrium", "block.yaml").stderr
    Path("block.yaml").write_text(text.replace("[2, 0]", "[0, 0]"), encoding="utf-8")
    done = mbdkit("equilibrium", "block.yaml")
    assert done.exit_code == 0
    assert "friction holds nothing in an equilibrium" in done.stdout
