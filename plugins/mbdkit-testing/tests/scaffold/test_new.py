"""`mbdkit plugins new` makes projects that install, lint and pass, and touches nothing that exists."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib

import pytest

from mbdkit.base.errors import SpecError
from mbdkit_testing.scaffold.new_plugin import KINDS, LIKE, new_project
from tests.installing import install_project, python

SORTS = [*((kind, None) for kind in KINDS[1:]), *(("integrator", like) for like in LIKE)]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.end_to_end
@pytest.mark.parametrize(
    "kind", [pytest.param(x, marks=[] if x == "measure" else [pytest.mark.slow]) for x in KINDS[2:5]]
)
def test_a_new_project_passes_its_own_tests_and_runs_its_example(kind, here):
    project = here / new_project(f"mbdkit-new-{kind}", kind)
    install_project(here / "site", project)
    path = (here / "site", project / "src")
    tested = python("-m", "pytest", "-q", "-x", str(project), "-k", "not conforms", path=path, cwd=here)
    assert tested.returncode == 0, tested.stdout
    doctor = python("-m", "mbdkit", "plugins", "doctor", path=path, cwd=here, MBDKIT_STRICT_PLUGINS="1")
    assert f"mbdkit-new-{kind} 0.1.0 (new-{kind} = mbdkit_new_{kind.replace('-', '_')}): 1 of 1 loaded" in doctor.stdout
    if (project / "example.yaml").is_file():
        done = python("-m", "mbdkit", "run", str(project / "example.yaml"), "--json", path=path, cwd=here)
        assert json.loads(done.stdout)["status"] == "complete", done.stderr
    else:
        command = ("-m", "mbdkit", "study", str(project / "study.yaml"), "-o", "out", "--json")
        done = python(*command, path=path, cwd=here)
        assert done.returncode == 0, done.stderr


@pytest.mark.end_to_end
@pytest.mark.parametrize(("kind", "like"), SORTS)
def test_a_new_project_is_formatted_and_free_of_lint(kind, like, here):
    new_project(f"mbdkit-new-{kind}", kind, like=like)
    for command in (("format", "--check"), ("check",)):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--no-cache", "."], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(("kind", "like"), SORTS)
def test_a_new_project_describes_itself(kind, like, here):
    project = new_project(f"mbdkit-new-{kind}", kind, like=like)
    described = tomllib.loads((project / "pyproject.toml").read_text())
    assert described["project"]["name"] == project.name
    assert list(described["project"]["entry-points"]["mbdkit"]) == [f"new-{kind}"]
    assert "{{" not in "".join(path.read_text() for path in project.rglob("*.*") if path.is_file())
    assert sorted(path.name for path in here.iterdir()) == [project.name]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("My-Kit", "small letters"),
        ("3d-kit", "a letter first"),
        ("mbdkit-3d", "a letter first"),
        ("a--b", "single hyphens"),
        ("kit_under", "small letters"),
        ("../kit", "small letters"),
        ("", "small letters"),
        ("json", "Python itself uses it"),
        ("class", "Python itself uses it"),
        ("mbdkit", "is installed already"),
        ("numpy", "is installed already"),
        ("mbdkit-rk4", "'rk4' is taken by the integrator mbdkit:rk4"),
    ],
)
def test_a_name_that_will_not_do_is_refused_and_nothing_is_made(name, words, here):
    with pytest.raises(SpecError, match=words):
        new_project(name, "integrator")
    assert not list(here.iterdir())


def test_what_to_change_of_a_method_of_another_formulation_includes_its_study(here):
    project = new_project("mbdkit-another-dae", "integrator", here, "dae")
    changes = (project / "README.md").read_text(encoding="utf-8").partition("What to\nchange:")[2]
    assert "the formulation in the claims and in `study.yaml`" in changes
    assert "formulation: ggl" in (project / "study.yaml").read_text(encoding="utf-8")


def test_only_integrators_have_sorts(here):
    with pytest.raises(SpecError, match="--like is for --kind integrator, not for --kind model"):
        new_project("mbdkit-rocket", "model", like="dae")


@pytest.mark.parametrize("thing", ["folder", "file", "link"])
def test_what_exists_is_not_touched(thing, here):
    target = here / "mbdkit-rocket"
    if thing == "folder":
        target.mkdir()
    elif thing == "file":
        target.write_text("mine")
    else:
        target.symlink_to("nowhere")
    with pytest.raises(SpecError, match="mbdkit-rocket: this exists already"):
        new_project("mbdkit-rocket", "model")
    assert [path.name for path in here.iterdir()] == ["mbdkit-rocket"]
    assert thing != "file" or target.read_text() == "mine"


def test_the_command_says_what_it_made(here):
    done = python("-m", "mbdkit", "plugins", "new", "kit", "--kind", "model", "--json", path=(), cwd=here)
    made = json.loads(done.stdout)
    assert made["path"] == "kit"
    assert all((here / path).is_file() for path in made["files"])
    again = python("-m", "mbdkit", "plugins", "new", "kit", "--kind", "model", path=(), cwd=here)
    assert (again.returncode, again.stderr) == (2, "error: kit: this exists already; choose another name\n")
