"""The projects of integrators, all installed beside each other: their tests, studies, and resumption of runs."""

from __future__ import annotations

import json

import h5py
import pytest

from mbdkit_testing.scaffold.new_plugin import LIKE, new_project
from tests.installing import install_project, python

pytestmark = pytest.mark.end_to_end
IN_PYTHON = LIKE[1:]
"""All but the tableau, which has no dense output."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of the projects, and the folders that go on the path."""
    folder = tmp_path_factory.mktemp("site")
    for like in LIKE:
        install_project(folder / "site", new_project(f"mbdkit-new-{like}", "integrator", folder, like))
    return folder, (folder / "site", *(folder / f"mbdkit-new-{like}" / "src" for like in LIKE))


def test_their_own_tests_pass(site):
    folder, path = site
    projects = [str(folder / f"mbdkit-new-{like}") for like in LIKE]
    words = ("-q", "-x", "--import-mode=importlib", "-k", "not conforms")
    done = python("-m", "pytest", *words, *projects, path=path, cwd=folder)
    assert done.returncode == 0, done.stdout


INTERRUPTED = """
import sys, mbdkit
from mbdkit.integrators import interface

def stop(now, end):
    if now > 0.05:
        raise KeyboardInterrupt

interface.STRETCH = 0.0  # progress is shown after every step
for like in sys.argv[1:]:
    name, formulation = f"new-{like}", "ggl" if like == "dae" else "index-1"
    for file, progress in ((f"{like}.h5", None), (f"{like}-part.h5", stop)):
        run = mbdkit.run("series-elastic-knee", archive=file, progress=progress, integrator={"name": name},
                         formulation=formulation, time={"end": 0.1, "step": 0.001}, output={"interval": 0.0031})
        run.close()
    assert run.status == "interrupted"
    mbdkit.resume(file, overwrite=True).close()
"""


def test_their_interrupted_runs_are_resumed_to_the_same_bits(site):
    # the motor has first-order states, and a sampled controller restarts every method
    folder, path = site
    done = python("-c", INTERRUPTED, *IN_PYTHON, path=path, cwd=folder)
    assert done.returncode == 0, done.stderr
    for like in IN_PYTHON:
        with h5py.File(folder / f"{like}.h5") as whole, h5py.File(folder / f"{like}-part.h5") as resumed:
            assert whole.attrs["data_sha256"] == resumed.attrs["data_sha256"], like


@pytest.mark.parametrize("like", [pytest.param(x, marks=[] if x == "dae" else [pytest.mark.slow]) for x in LIKE])
def test_the_study_compares_the_method_with_built_in_ones(like, site):
    folder, path = site
    words = ("study", f"mbdkit-new-{like}/study.yaml", "-o", f"study-{like}", "--json")
    done = python("-m", "mbdkit", *words, path=path, cwd=folder)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["complete"] == told["runs"]
