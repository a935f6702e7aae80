"""The packaged examples: listed, run by name, and copied to start one's own from."""

from __future__ import annotations

import pytest

from mbdkit.spec import example_names, example_text, load_spec
from mbdkit.spec.loading import example_files, read_source


def test_examples_are_listed_with_their_titles(mbdkit):
    result = mbdkit("examples")
    assert result.exit_code == 0
    for name in example_names():
        assert f"{name} " in result.stdout
        assert read_source(name).data["title"] in result.stdout


def test_examples_are_listed_by_purpose_with_the_command_that_runs_them(mbdkit):
    blocks = [block.splitlines() for block in mbdkit("examples").stdout.split("\n\n")]
    group_of = {line.split()[0]: head for head, *lines in blocks for line in lines}
    assert group_of["four-bar"] == "Linkages (mbdkit run)"
    assert group_of["walking"] == "Inverse dynamics (mbdkit inverse)"
    assert not [name for name in example_names("run") if group_of[name].startswith("Runs")]


def test_an_unknown_example_is_answered_with_near_names_and_not_with_all(mbdkit):
    said = mbdkit("run", "pendulm").stderr
    assert "did you mean 'pendulum', " in said
    assert "`mbdkit examples` lists all" in said
    assert "watt-six-bar" not in said


@pytest.mark.parametrize("name", example_names("run"))
def test_a_copy_is_the_example_with_its_comments(name, mbdkit, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert mbdkit("examples", "copy", name).stdout == f"{name}.yaml\n"
    written = (tmp_path / f"{name}.yaml").read_text("utf-8")
    assert written == example_text(name)
    assert written.startswith("# yaml-language-server: $schema=")
    assert load_spec(str(tmp_path / f"{name}.yaml")).sha256() == load_spec(name).sha256()


def test_a_copy_of_inverse_dynamics_comes_with_its_table(mbdkit, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert mbdkit("examples", "copy", "walking", "-o", "mine/step.yaml").exit_code == 2
    (tmp_path / "mine").mkdir()
    result = mbdkit("examples", "copy", "walking", "-o", "mine/step.yaml")
    assert result.stdout == "mine/step.yaml\nmine/walking.csv\n"
    assert (tmp_path / "mine" / "step.yaml").read_text("utf-8") == example_text("walking")
    assert (tmp_path / "mine" / "walking.csv").read_text("utf-8") == example_files("walking")["walking.csv"]
    assert "261 rows from 0 to" in mbdkit("validate", "mine/step.yaml").stdout
    again = mbdkit("examples", "copy", "walking", "-o", "mine/other.yaml")
    assert again.exit_code == 2
    assert "mine/walking.csv: this file exists already; choose another name or folder with -o" in again.stderr
    assert not (tmp_path / "mine" / "other.yaml").exists()


def test_an_example_of_the_other_kind_is_refused_with_its_command(mbdkit):
    assert "this is a run spec: run it with `mbdkit run`" in mbdkit("inverse", "knee").stderr
    assert "compute it with `mbdkit inverse`" in mbdkit("run", "walking").stderr
    assert "this spec of inverse dynamics is valid" in mbdkit("validate", "walking").stdout


def test_a_copy_never_replaces_a_file(mbdkit, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text("mine", encoding="utf-8")
    result = mbdkit("examples", "copy", "knee", "-o", mine)
    assert result.exit_code == 2
    assert "exists already" in result.stderr
    assert mine.read_text("utf-8") == "mine"


def test_an_example_that_is_not_there_is_refused_with_the_nearest_name(mbdkit, tmp_path):
    result = mbdkit("examples", "copy", "kne", "-o", tmp_path / "x.yaml")
    assert result.exit_code == 2
    assert "did you mean 'knee'?" in result.stderr
    assert not (tmp_path / "x.yaml").exists()
