"""The projects of integrators, all installed beside each other: their tests, examples, and resumption of runs."""

from __future__ import annotations

import pytest

from mbdkit_testing.scaffold.new_plugin import LIKE, new_project
from tests.installing import install_project, python

pytestmark = pytest.mark.end_to_end


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
