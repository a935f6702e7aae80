"""What a plugin made outlives it: archives open and report without it, and say what to install to run them again."""

from __future__ import annotations

import json
import shutil

import pytest

from mbdkit.archive.reader import load
from tests.installing import install_module, python

pytestmark = pytest.mark.end_to_end

METHOD = """
import mbdkit
from pydantic import BaseModel

class Euler(mbdkit.StepMethod):
    def step(self, equations, t, state, h):
        a, _ = equations.accelerations(t, state.q, state.v)
        return state.moved(h * (state.v + h * a), h * a)

@mbdkit.hookimpl
def mbdkit_integrators():
    return [mbdkit.IntegratorPlugin("euler", "Euler", BaseModel, lambda options: Euler(),
                                    lambda options: mbdkit.Claims(order=1))]
"""
MODEL = {"name": "single-pendulum"}
SPEC = {"mbdkit": 1, "model": MODEL, "integrator": {"name": "euler"}, "time": {"end": 0.2, "step": 0.01}}
STUDY = {"mbdkit_study": 1, "base": SPEC, "axes": [{"time.step": [0.01, 0.02]}]}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a folder with a run and a study of a plugin that is installed no longer."""
    here = tmp_path_factory.mktemp("made")
    install_module(here / "site", "euler-kit", METHOD, version="2.3")
    (here / "spec.json").write_text(json.dumps(SPEC))
    (here / "study.json").write_text(json.dumps(STUDY))
    for command in (("run", "spec.json"), ("study", "study.json", "-o", "study")):
        done = python("-m", "mbdkit", *command, path=(here / "site",), cwd=here)
        assert done.returncode == 0, done.stderr
    shutil.rmtree(here / "site")
    return here


def mbdkit(here, *arguments):
    return python("-m", "mbdkit", *arguments, path=(), cwd=here)


def test_an_archive_names_what_made_it(made):
    with load(made / "spec.h5") as run:
        assert run.provenance["integrator"] == "euler-kit:euler"
        assert run.provenance["integrator_distribution"] == "euler-kit"
        assert run.provenance["integrator_version"] == "2.3"
        assert run.provenance["integrator_entry_point"] == "main = euler_kit"


READERS = [("archive", "info", "spec.h5"), ("archive", "check", "spec.h5"), ("plot", "spec.h5", "--kind", "drift")]
READERS += [("animate", "spec.h5", "-o", "spec.html"), ("report", "spec.h5"), ("report", "study")]


def test_what_is_there_is_read_without_the_plugin(made):
    called = f"""
from typer.testing import CliRunner
from mbdkit.cli import app
for command in {READERS!r}:
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, (command, done.output)
"""
    done = python("-c", called, path=(), cwd=made)
    assert done.returncode == 0, done.stderr


def test_running_it_again_says_what_to_install(made):
    done = mbdkit(made, "rerun", "spec.h5")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: spec.h5: the integrator 'euler-kit:euler' is not installed here")
    assert done.stderr.endswith("the archive names, euler-kit 2.3, if you trust both\n")


def test_a_study_that_goes_on_says_what_to_install(made):
    (made / "study" / "runs").mkdir(exist_ok=True)
    done = mbdkit(made, "study", "study.json", "-o", "study")
    assert done.returncode == 2
    assert "there is no integrator 'euler'" in done.stderr
    assert "was made with it: install the distribution that the archive names, euler-kit 2.3, if" in done.stderr
