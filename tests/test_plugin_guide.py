"""The guide for authors of plugins says the truth: what it prints is as short as it says, loads and runs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType

import pytest

import mbdkit
from mbdkit.registry.manager import registry
from tests.margins import assert_within

from .installing import install_module, install_project, python

ROOT = Path(__file__).resolve().parent.parent
GUIDE = (ROOT / "mbdkit" / "guide" / "plugins.md").read_text(encoding="utf-8")
PENDULUM = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
ALONG = {"type": "coordinate", "coordinate": "x", "bodies": ["ground", "ball"]}
BALL = {
    "name": "mechanism",
    "bodies": {"ball": {"mass": 1.0, "position": [0.5, 0.0]}},
    "forces": {"spring": {"type": "law", "law": "duffing", "pathway": ALONG}},
}
RK4 = {"name": "rk4"}
PLUGINS = {
    "A tableau in ten lines": (10, PENDULUM, {"name": "heun"}),
    "Adaptive steps for a tableau": (24, PENDULUM, {"name": "bs3", "adaptive": True, "rtol": 1e-8, "atol": 1e-8}),
    "An integrator in thirty lines": (30, PENDULUM, {"name": "verlet"}),
    "A method in twenty lines": (20, PENDULUM, {"name": "bs23"}),
    "The same method with memory, dense output and controlled steps": (
        39,
        PENDULUM,
        {"name": "bs23", "rtol": 1e-8, "atol": 1e-9},
    ),
    "A controller of adaptive steps": (
        9,
        PENDULUM,
        {"name": "dopri5", "adaptive": True, "step_control": {"name": "h211pi"}},
    ),
    "A model in twenty lines": (20, {"name": "swing"}, RK4),
    "A force law in eleven lines": (11, BALL, RK4),
    "A measure in ten lines": (10, PENDULUM, RK4),
}
OTHER_NAMES = {
    "A controller of adaptive steps": "h211pi",
    "A model in twenty lines": "swing",
    "A force law in eleven lines": "duffing",
    "A measure in ten lines": "reach",
}
"""Names of the items that are not the integrator of the run."""
SLOW = [heading for heading in PLUGINS if "integrator in" in heading or "method" in heading]


def block(heading: str, language: str) -> str:
    """Return the first fenced block of a language under a heading."""
    section = GUIDE.split(f"# {heading}\n", 1)[1].split("\n#", 1)[0]
    found = re.search(rf"^```{language}\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1]


@pytest.mark.end_to_end
@pytest.mark.parametrize("heading", PLUGINS)
def test_a_plugin_runs_as_printed_and_is_no_longer_than_it_says(heading: str, tmp_path: Path) -> None:
    lines, model, integrator = PLUGINS[heading]
    code = block(heading, "python")
    assert len([line for line in code.splitlines() if line.strip()]) <= lines
    install_module(tmp_path, "guide-kit", code)
    spec = {"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 0.5, "step": 0.005}}
    spec["accept"] = ["method-evidence"]  # there is none here
    measures = {"far": {"name": "reach"}} if "measure" in heading else {}
    (tmp_path / "spec.json").write_text(json.dumps(spec | {"measures": measures}))
    done = python("-m", "mbdkit", "run", "spec.json", "--json", path=(tmp_path,), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    told = json.loads(done.stdout)
    assert_within(told["misalignment_max"], 1e-3)
    assert told["verdict"] == "unknown", told["verdict_reasons"]  # the best one without a check
    assert list(told.get("measures", ())) == list(measures)
    assert all(0.0 < told["measures"][name] < 2.0 for name in measures)
    if "controlled" in heading or "Adaptive" in heading:
        # expected: the end of a run with smaller errors
        ends = [mbdkit.run(spec | {"integrator": {"name": "dop853"}})["rod2"].position[-1]]
        with mbdkit.load(tmp_path / "spec.h5") as run:
            ends.append(run["rod2"].position[-1])
            assert run.stats["rejected"] > 0
        assert ends[1] == pytest.approx(ends[0], abs=1e-6)


@pytest.mark.end_to_end
@pytest.mark.parametrize(
    "heading", [pytest.param(one, marks=pytest.mark.slow if one in SLOW else ()) for one in PLUGINS]
)
def test_what_a_plugin_claims_is_verified(heading: str, tmp_path: Path) -> None:
    name = OTHER_NAMES.get(heading) or PLUGINS[heading][2]["name"]
    install_module(tmp_path, "guide-kit", block(heading, "python"))
    done = python("-m", "mbdkit", "plugins", "verify", name, "--quick", path=(tmp_path,), cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.end_to_end
def test_a_packaged_study_runs_by_name_as_printed_and_is_reported_with_its_verdict(tmp_path: Path) -> None:
    heading = "A packaged study in twenty lines"
    code = block(heading, "python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 20
    install_module(tmp_path, "guide-kit", code)
    (tmp_path / "steps.yaml").write_text(block(heading, "yaml"))
    listed = python("-m", "mbdkit", "study", "--help", path=(tmp_path,), cwd=tmp_path)
    assert "steps" in listed.stdout.partition("Packaged studies:")[2]
    done = python("-m", "mbdkit", "study", "steps", "--report", "--json", path=(tmp_path,), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["complete"] == 2
    assert "In 2 of 2 runs the joints come apart by" in (tmp_path / "steps" / "report.html").read_text("utf-8")
    assert "verdict: guide-kit:steps" in (tmp_path / "steps" / "study.yaml").read_text("utf-8")
    shown = python("-m", "mbdkit", "plugins", "show", "steps", path=(tmp_path,), cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    verified = python("-m", "mbdkit", "plugins", "verify", "steps", path=(tmp_path,), cwd=tmp_path)
    assert verified.returncode == 0, verified.stdout + verified.stderr


@pytest.mark.slow  # CI types them by itself, with all plugins installed
def test_the_first_steps_work_as_printed(tmp_path: Path) -> None:
    # the installation itself is done in continuous integration, with pip and in an environment of its own
    lines = [line for line in block("A verified integrator from a template", "sh").splitlines() if line.strip()]
    for line in lines:
        if line.startswith("pip install -e "):
            install_project(tmp_path / "site", tmp_path / line.rpartition(" ")[2])
            continue
        path = (tmp_path / "site", tmp_path / "mbdkit-rocket" / "src")
        command = [*line.split(), *(["--quick"] if "verify" in line else [])]
        done = python("-m", *command, path=path, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"
    assert (tmp_path / "rocket" / "report.html").is_file()


def test_every_distribution_stands_in_the_table_beside_it() -> None:
    parts, distributions = set(), set()
    for folder in (ROOT / "plugins").glob("mbdkit-*"):
        (distributions if (folder / "pyproject.toml").is_file() else parts).add(folder.name)
    table = (ROOT / "plugins" / "README.md").read_text(encoding="utf-8")
    assert distributions == set(re.findall(r"^\| \[(mbdkit-.*?)\]", table, flags=re.MULTILINE))
    assert parts == set(re.findall(r"^\| \[.*?\]\((mbdkit-.*?)/README.md\)", table, flags=re.MULTILINE))


def test_the_line_for_tests_makes_a_test_of_each_check() -> None:
    module = ModuleType("guide_tests")
    code = block("Tests", "python").replace('"verlet"', '"gauss"')
    exec(code, vars(module))
    (mark,) = module.test_verlet_conforms.pytestmark
    assert len(mark.args[1]) > 5
    assert registry().get("integrator", "gauss")


def test_a_method_without_a_plugin_runs_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    exec(block("Without a plugin", "python"), {})
    assert "rhs_evaluations=100" in capsys.readouterr().out
