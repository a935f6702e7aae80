"""Fixtures of the reports' tests: synthetic runs, a study folder, a browser with pages, and the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import mbdkit
from mbdkit.cli import app
from mbdkit_report import report
from mbdkit_studies.compute.carry_out import study as run_study
from tests.browser import executable, launched, opened
from tests.registry.conftest import beside_ours as beside_ours
from tests.registry.conftest import entry_point as entry_point
from tests.registry.conftest import installed as installed
from tests.synthetic_runs import make_run as make_run

STUDY = {
    "mbdkit_study": 1,
    "title": "Two methods, three steps",
    "base": "double-pendulum",
    "overrides": {"time": {"end": 2.0, "step": 0.1}, "limits": {"max_steps": 30}},
    "axes": [
        {"integrator": [{"label": "RK4", "value": {"name": "rk4"}}, {"label": "Gauss 2", "value": {"name": "gauss"}}]},
        {"time.step": [0.2, 0.1, 0.05]},  # the last takes 40 steps, ten more than there may be
    ],
    "reference": {"integrator": {"name": "gauss", "stages": 3}, "time.step": 0.08},
}


@pytest.fixture(scope="session")
def study_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of six runs, two of which fail, without a report."""
    folder = tmp_path_factory.mktemp("study") / "two-methods"
    run_study(STUDY, out=folder, notify=lambda text: None)
    return folder


@pytest.fixture
def mbdkit_command() -> Callable[..., Any]:
    """Run a command in this process; the result has exit_code, stdout and stderr."""
    return lambda *arguments: CliRunner().invoke(app, list(arguments), prog_name="mbdkit")


@pytest.fixture(scope="package")
def browser():
    path = executable()
    if path is None:
        pytest.skip("there is no Chromium to open the report in: install chromium, or name one in MBDKIT_TEST_BROWSER")
    with launched(path) as found:
        yield found


@pytest.fixture(scope="package")
def page_path(tmp_path_factory):
    """The report of a double pendulum under a coarse step: its joints come apart by millimetres."""
    folder = tmp_path_factory.mktemp("report")
    archive = folder / "swing.h5"
    mbdkit.run("double-pendulum", integrator={"name": "rk4"}, archive=archive).close()
    return report(archive)


@pytest.fixture
def page(browser, page_path):
    watched = opened(browser, page_path)
    yield watched
    watched.page.context.close()


@pytest.fixture(scope="package", params=["run", "study"])
def any_path(request, page_path, study_folder):
    """The report of a run, and that of a study."""
    if request.param == "run":
        return page_path
    return report(study_folder, page_path.with_name("study.html"), overwrite=True)
