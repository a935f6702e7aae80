"""The projects of kinds without hooks of their own, all installed beside each other, outside the tree."""

from __future__ import annotations

import json
import re

import h5py
import pytest

from mbdkit_testing.scaffold.new_plugin import KINDS, new_project
from tests.installing import install_project, python

ITEMS = KINDS[5:]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of the projects, and the folders that go on the path."""
    folder = tmp_path_factory.mktemp("site")
    for kind in ITEMS:
        install_project(folder / "site", new_project(f"mbdkit-new-{kind}", kind, folder))
    return folder, (folder / "site", *(folder / f"mbdkit-new-{kind}" / "src" for kind in ITEMS))


@pytest.fixture(scope="module")
def mbdkit(site):
    folder, path = site

    def call(*words):
        done = python("-m", "mbdkit", *words, path=path, cwd=folder)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return call


@pytest.fixture(scope="module")
def archive(site, mbdkit):
    mbdkit("new-spec-kind", "mbdkit-new-spec-kind/example.yaml", "-o", "run.h5")
    return site[0] / "run.h5"


@pytest.mark.end_to_end
def test_their_own_tests_pass(site):
    folder, path = site
    projects = [str(folder / f"mbdkit-new-{kind}") for kind in ITEMS]
    done = python("-m", "pytest", "-q", "-x", "--import-mode=importlib", *projects, path=path, cwd=folder)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("kind", ITEMS)
def test_an_item_takes_at_most_60_lines_a_kind_of_elements_150_and_one_of_joints_100(kind, site):
    folder, _ = site
    files = sorted((folder / f"mbdkit-new-{kind}" / "src").rglob("*.py"))
    assert [file.name for file in files] == ["__init__.py", "code.py"]
    assert sum(len(file.read_text().splitlines()) for file in files) <= (
        150 if kind == "element" else 100 if kind == "joint" else 60
    )


@pytest.mark.end_to_end
def test_a_kind_of_specs_is_checked_documented_and_computed_again(archive, mbdkit):
    spec = "mbdkit-new-spec-kind/example.yaml"
    assert "valid as a spec of new-spec-kind" in mbdkit("validate", spec)
    assert "new_spec_kind" in json.loads(mbdkit("schema", "new-spec-kind"))["required"]
    with h5py.File(archive) as file:
        assert "new_spec_kind" in file.attrs["spec"]
    assert "the same to the bit" in mbdkit("rerun", "run.h5")


@pytest.mark.end_to_end
def test_an_archive_whose_kind_of_specs_was_removed_names_it(archive, site):
    done = python("-m", "mbdkit", "rerun", "run.h5", path=(), cwd=site[0])
    assert done.returncode == 2
    assert "'mbdkit-new-spec-kind:new-spec-kind' is not installed here" in done.stderr
    assert python("-m", "mbdkit", "archive", "info", "run.h5", path=(), cwd=site[0]).returncode == 0


@pytest.mark.end_to_end
def test_a_run_is_plotted_reported_and_exported_by_the_items(archive, mbdkit):
    folder = archive.parent
    assert "new_plot_kind" in mbdkit("plot", "--help")
    mbdkit("plot", "run.h5", "--kind", "new_plot_kind", "-o", "plot.png")
    assert (folder / "plot.png").read_bytes().startswith(b"\x89PNG")
    mbdkit("report", "run.h5", "-o", "page.html")
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert "Largest speeds" in page
    assert "Speeds of the bodies." in page
    assert "trajectory.tsv" in mbdkit("archive", "export", "run.h5", "--to", "new-table-format", "-o", "tables")


@pytest.mark.end_to_end
def test_the_doctor_checks_them_all(mbdkit):
    lines = mbdkit("plugins", "doctor").splitlines()
    loaded = [line for line in lines if line.startswith("mbdkit-new-")]
    assert len(loaded) == len(ITEMS)
    assert all(re.search(r": ([124]) of \1 loaded", line) for line in loaded)
