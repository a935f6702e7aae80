"""`mbdkit run` and what is done with its archive."""

from __future__ import annotations

import json
import os

import h5py
import numpy as np
import pytest

from mbdkit import load
from mbdkit import run as from_python
from mbdkit.archive.fingerprint import seal


def test_a_run_leaves_one_complete_archive_and_a_summary(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    result = mbdkit("run", "spec.yaml")
    assert result.exit_code == 0, result.stderr
    assert sorted(os.listdir()) == ["spec.h5", "spec.yaml"]
    with load("spec.h5") as run:
        assert run.status == "complete"
        assert len(run.time) == 101
        assert run.summary() in result.stdout


def test_the_archive_tells_the_command_without_what_nobody_else_should_read(mbdkit, small, in_tmp_path, monkeypatch):
    (in_tmp_path / "home").mkdir()
    (in_tmp_path / "home" / "my spec.yaml").write_text(small)
    monkeypatch.setattr("sys.argv", ["train.py", "--token", "secret-token"])  # of the program that calls mbdkit
    out = ["-o", f"{in_tmp_path}/home/out.h5", "--set", "title=secret-title", "--json"]
    assert mbdkit("run", "home/my spec.yaml", *out).exit_code == 0
    with load("home/out.h5") as run:
        assert run.provenance["command"] == "mbdkit run 'my spec.yaml' --output out.h5"
    with from_python("home/my spec.yaml", archive="python.h5") as run:
        assert run.provenance["command"] == ""
    assert b"secret-token" not in (in_tmp_path / "python.h5").read_bytes()


def test_json_prints_one_object_with_the_keys_of_the_contract(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    result = mbdkit("run", "spec.yaml", "--json", "-o", "out.h5")
    answer = json.loads(result.stdout)
    told = {"path", "status", "status_reason", "run_id", "stats", "misalignment_max", "events"}
    assert set(answer) == told | {"verdict", "verdict_reasons", "warnings", "answers"}
    assert (answer["verdict"], answer["verdict_reasons"], answer["warnings"]) == ("unknown", [], [])
    assert (answer["path"], answer["status"]) == ("out.h5", "complete")
    assert answer["stats"]["steps"] == 100
    with h5py.File("out.h5") as file:
        assert file.attrs["run_id"] == answer["run_id"]


def test_accuracy_chooses_the_step_and_reports_it(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    result = mbdkit("run", "spec.yaml", "--accuracy", "1e-6", "--json", "-o", "out.h5")
    assert result.exit_code == 0, result.stderr
    told = json.loads(result.stdout)["accuracy"]
    assert told["asked"] == 1e-6
    assert 0 < told["reached"] <= 1e-6
    assert told["chosen"].startswith("gauss stages 2 with step ")
    assert told["why"]
    again = mbdkit("rerun", "out.h5")
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize("asked", ["0", "-1", "nan", "inf", "1e-20"])
def test_an_accuracy_that_no_run_can_have_is_refused_in_one_sentence(asked, refusal, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    told = refusal("run", "spec.yaml", f"--accuracy={asked}")
    assert "--accuracy should be a share of the mechanism's size from 1e-12 to 0.1, not " in told
    assert ("rounding errors" in told) == (asked in ("0", "-1", "1e-20"))
    (in_tmp_path / "spec.yaml").write_text(f"{small}\naccuracy: 1e-20\n")
    assert refusal("run", "spec.yaml").startswith("spec.yaml:10: accuracy: should be at least 1e-12, not 1e-20")


def test_quiet_prints_nothing(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    result = mbdkit("run", "spec.yaml", "--quiet")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "", "")


def test_a_spec_from_stdin_goes_to_stdin_h5(mbdkit, small, in_tmp_path):
    result = mbdkit("run", "-", stdin=small)
    assert result.exit_code == 0, result.stderr
    assert os.listdir() == ["stdin.h5"]


def test_an_existing_archive_is_kept_unless_it_may_be_replaced(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    (in_tmp_path / "spec.h5").write_bytes(b"precious")
    assert mbdkit("run", "spec.yaml").exit_code == 2
    assert (in_tmp_path / "spec.h5").read_bytes() == b"precious"
    assert mbdkit("run", "spec.yaml", "--overwrite").exit_code == 0
    with load("spec.h5") as run:
        assert run.status == "complete"


def test_a_run_that_stops_early_keeps_its_archive_and_says_why(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small + "limits: {max_steps: 10}\n")
    result = mbdkit("run", "spec.yaml", "--json")
    assert result.exit_code == 3
    answer = json.loads(result.stdout)
    assert answer["status"] == "failed"
    assert answer["status_reason"].startswith("max-steps")
    assert "max-steps" in result.stderr
    with load("spec.h5") as run:
        assert run.status == "failed"


EVENTS = """events:
  bent: {when: J2.angle + 0.1}
  enough: {when: t - 0.7, action: stop}
"""


def test_a_run_that_an_event_stops_is_done(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small + EVENTS)
    result = mbdkit("run", "spec.yaml", "--json")
    assert result.exit_code == 0, result.stderr
    answer = json.loads(result.stdout)
    assert (answer["status"], answer["stats"]["steps"]) == ("complete", 70)
    assert answer["status_reason"] == "event: 'enough' crossed zero upwards at t = 0.7 s."
    assert [event["name"] for event in answer["events"]] == ["bent", "enough"]
    assert answer["events"][1] == {"name": "enough", "time": pytest.approx(0.7, abs=1e-12), "direction": 1}
    assert mbdkit("archive", "check", "spec.h5").exit_code == 0
    assert mbdkit("rerun", "spec.h5").exit_code == 0
    assert "event: 'enough' crossed zero upwards" in mbdkit("archive", "info", "spec.h5").stdout


def test_validate_shows_the_events_with_their_values_at_the_start(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small + EVENTS)
    result = mbdkit("validate", "spec.yaml")
    assert result.exit_code == 0, result.stderr
    assert "  bent    any        note    0.1       J2.angle + 0.1\n" in result.stdout
    assert "  enough  any        stop    -0.7      t - 0.7\n" in result.stdout


def test_validate_shows_directions_and_travels_of_slides(mbdkit, in_tmp_path):
    """The rail turns its y axis by 90 degrees to -x; the slider is 0.4 m along -x of the point (1, 1) of the rail."""
    (in_tmp_path / "spec.yaml").write_text("""\
mbdkit: 1
model:
  name: mechanism
  bodies:
    rail: {mass: 1, inertia: 1, position: [1, 0], angle: 90 deg}
    slider: {mass: 1, inertia: 1, position: [0.6, 1.2], angle: 90 deg}
  joints:
    fixed: {type: weld, bodies: [ground, rail], at: [1, 0]}
    guide: {type: prismatic, bodies: [rail, slider], points: [[1, 0], [-0.2, 0]], axis: [0, 3]}
time: {end: 0.1, step: 0.01}
integrator: {name: rk4}
""")
    result = mbdkit("validate", "spec.yaml")
    assert result.exit_code == 0, result.stderr
    assert "  JOINT  BODY    ON    DIRECTION  TRAVEL\n  guide  slider  rail  (-1, 0)    0.4 m\n" in result.stdout
    assert mbdkit("run", "spec.yaml").exit_code == 0
    with load("spec.h5") as run:
        assert run.joints["guide"].angle[0] == pytest.approx(0.4, abs=1e-12)


def test_validate_says_what_the_mechanism_is_and_that_its_start_is_consistent(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    result = mbdkit("validate", "spec.yaml")
    assert result.exit_code == 0, result.stderr
    assert "freedom      2 degrees of freedom, 2 joints\n" in result.stdout
    assert "consistent, unchanged" in result.stdout
    assert os.listdir() == ["spec.yaml"]


def test_a_table_that_overshoots_is_warned_of_but_runs(mbdkit, in_tmp_path):
    table = "{table: [[0.0, 0.5, 0.51, 1.0], [0.0, 0.0, 1.0, 1.0]]}"
    (in_tmp_path / "spec.yaml").write_text(
        "mbdkit: 1\nintegrator: {name: rk4}\ntime: {end: 1.0, step: 0.1}\nmodel:\n  name: mechanism\n"
        "  bodies: {a: {mass: 1.0, inertia: 1.0}}\n"
        f"  forces: {{m: {{type: torque, body: a, value: {table}}}}}\n"
    )
    for command in ("validate", "run"):
        result = mbdkit(command, "spec.yaml")
        assert result.exit_code == 0
        told = "the cubic spline of the table at model.forces.m.value leaves the range"
        assert (result.stdout + result.stderr).count(told) == 1


def test_validate_and_run_refuse_a_controller_with_a_method_without_states(mbdkit, in_tmp_path):
    rattle = ["--set", "integrator={name: rattle}", "--set", "formulation=index-3"]
    told = [mbdkit(name, "delayed-balance", *rattle) for name in ("validate", "run")]
    assert [result.exit_code for result in told] == [2, 2]
    assert "a Lobatto pair does not include first-order states (nerves.torque)" in told[0].stderr
    assert told[0].stderr == told[1].stderr


def test_validate_names_the_stabilization_and_warns_where_it_is_stiff(mbdkit, small, in_tmp_path):
    stiff = small.replace("{name: gauss, stages: 2}", "{name: rk4}")
    (in_tmp_path / "spec.yaml").write_text(stiff + "stabilization: {name: baumgarte, alpha: 300}\n")
    result = mbdkit("validate", "spec.yaml")
    assert result.exit_code == 0
    assert "stabilized   Baumgarte, alpha 300 1/s, beta 300 1/s\n" in result.stdout
    assert "warning: Baumgarte's alpha = 300 and beta = 300 1/s are too large" in result.stderr
    assert "it should be below 2.785: take a smaller step or a smaller alpha" in result.stderr
    gentle = mbdkit("validate", "spec.yaml", "--set", "stabilization.alpha=200")
    assert (gentle.exit_code, gentle.stderr) == (0, "")


SPARE = """\
mbdkit: 1
integrator: {name: gauss}
time: {end: 0.1, step: 0.01}
model:
  name: mechanism
  bodies:
    left: {mass: 1, inertia: 0.1, position: [0.3, -0.4], angle: -0.9272952180016122}
    right: {mass: 1, inertia: 0.1, position: [2.3, -0.4], angle: -0.9272952180016122}
    spare: {mass: 1, inertia: 0.1, position: [1.3, -0.4], angle: -0.9272952180016122}
    coupler: {mass: 1, inertia: 1, position: [1.6, -0.8]}
  joints:
    A: {type: revolute, bodies: [ground, left], points: [[0, 0], [-0.5, 0]]}
    B: {type: revolute, bodies: [left, coupler], points: [[0.5, 0], [-1, 0]]}
    C: {type: revolute, bodies: [ground, right], points: [[2, 0], [-0.5, 0]]}
    E: {type: revolute, bodies: [right, coupler], points: [[0.5, 0], [1, 0]]}
    F: {type: revolute, bodies: [ground, spare], points: [[1, 0], [-0.5, 0]]}
    D: {type: revolute, bodies: [spare, coupler], points: [[0.5, 0], [0, 0]]}
"""


def test_redundant_joints_are_named_by_validate_run_and_info(mbdkit, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(SPARE)
    result = mbdkit("validate", "spec.yaml")
    assert result.exit_code == 0, result.stderr
    assert "freedom      1 degree of freedom, 6 joints, 1 redundant row: joints A, B, C, E, F and D\n" in result.stdout
    result = mbdkit("run", "spec.yaml")
    assert result.exit_code == 0, result.stderr
    assert "redundancy    1 redundant row: joints A, B, C, E, F and D; reactions are not unique" in result.stdout
    result = mbdkit("archive", "info", "spec.h5")
    assert "redundancy        1 redundant row: joints A, B, C, E, F and D\n" in result.stdout
    assert result.stdout.count(", not unique\n") == 5
    assert mbdkit("archive", "check", "spec.h5").exit_code == 0
    with load("spec.h5") as run:
        assert run.redundancy == "1 redundant row: joints A, B, C, E, F and D"
        for path in ("joints/reaction_force", "joints/reaction_torque", "constraints/multiplier"):
            assert run.file[path].attrs["not_unique"] == "A, B, C, E, F, D"


@pytest.mark.parametrize("command", ["run", "validate"])
def test_joints_that_contradict_each_other_are_refused_with_their_line(mbdkit, in_tmp_path, command):
    driver = '{{type: driver, bodies: [ground, left], coordinate: angle, motion: "-0.9272952180016122{}"}}'
    twice = f"    M: {driver.format('')}\n    N: {driver.format(' + t**2')}\n"
    (in_tmp_path / "spec.yaml").write_text(SPARE + twice)
    result = mbdkit(command, "spec.yaml")
    assert result.exit_code == 2
    assert "spec.yaml:11: model.joints: joints M and N constrain the same motion" in result.stderr
    assert os.listdir() == ["spec.yaml"]


@pytest.fixture
def archive(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small)
    assert mbdkit("run", "spec.yaml").exit_code == 0
    return "spec.h5"


def test_rerun_reproduces_an_archive_to_the_bit(mbdkit, archive):
    result = mbdkit("rerun", archive)
    assert result.exit_code == 0, result.stderr
    assert "the same to the bit" in result.stdout
    assert sorted(os.listdir()) == ["spec.h5", "spec.yaml"]


def test_rerun_can_keep_what_it_made(mbdkit, archive):
    assert mbdkit("rerun", archive, "-o", "again.h5").exit_code == 0
    with load(archive) as one, load("again.h5") as two:
        assert one.data_sha256 == two.data_sha256
    assert mbdkit("rerun", archive, "-o", archive, "--overwrite").exit_code == 2


def test_rerun_tells_how_far_the_data_differ(mbdkit, archive):
    with h5py.File(archive, "r+") as file:
        file["trajectory/position"][5, 0, 0] += 1e-6
        seal(file)
    result = mbdkit("rerun", archive)
    assert result.exit_code == 1
    assert "trajectory/position" in result.stdout


def test_rerun_tells_why_the_new_run_stopped_early(mbdkit, archive):
    with h5py.File(archive, "r+") as file:
        file.attrs["spec"] = json.dumps(json.loads(file.attrs["spec"]) | {"limits": {"max_steps": 3}})
        seal(file)
    result = mbdkit("rerun", archive)
    assert result.exit_code == 1
    assert "the new run stopped early: failed: max-steps: " in result.stderr


def test_archive_info_and_check(mbdkit, archive):
    info = mbdkit("archive", "info", archive)
    assert info.exit_code == 0
    assert "double-pendulum" in info.stdout
    described = json.loads(mbdkit("archive", "info", "--json", archive).stdout)["archives"]
    assert len(described) == 1
    check = mbdkit("archive", "check", archive)
    assert (check.exit_code, check.stdout) == (0, "spec.h5: sound\n")


def test_a_picture_never_replaces_an_archive(mbdkit, archive):
    with open(archive, "rb") as file:
        before = file.read()
    for command in ("plot", "animate"):
        result = mbdkit(command, archive, "-o", archive)
        assert result.exit_code == 2
    with open(archive, "rb") as file:
        assert file.read() == before


@pytest.mark.parametrize("command", [("plot",), ("animate",), ("rerun",), ("archive", "info")])
@pytest.mark.parametrize("name", ["missing.h5", "text.h5", "folder", "."])
def test_what_is_no_archive_is_refused(command, name, mbdkit, in_tmp_path):
    (in_tmp_path / "text.h5").write_text("not HDF5")
    (in_tmp_path / "folder").mkdir()
    result = mbdkit(*command, name)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"error: {name}: ")
    assert len(result.stderr.splitlines()) == 1


def test_a_parameter_is_set_from_the_command_line(mbdkit, tmp_path):
    short = ["--set", "time.end=0.02", "--quiet"]
    result = mbdkit("run", "quick-return", "--set", "parameters.crank=0.12", *short, "-o", tmp_path / "a.h5")
    assert result.exit_code == 0
    assert result.stderr == ""
    with load(tmp_path / "a.h5") as run:
        assert np.hypot(*run["crank"].position[0]) == pytest.approx(0.06, abs=1e-12)
        assert run.spec["parameters"]["crank"] == 0.12


def test_a_misspelled_parameter_is_told(mbdkit, tmp_path):
    assignments = ["--set", "parameters.cranck=0.12", "--set", "time.end=0.02"]
    result = mbdkit("run", "quick-return", *assignments, "-o", tmp_path / "a.h5")
    told = "the parameter at parameters.cranck is not used (did you mean 'crank'?)"
    assert (result.stdout.count(told), result.stderr.count(told)) == (1, 0)
