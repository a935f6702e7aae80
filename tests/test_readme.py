"""The README says the truth: its code runs as printed, and its commands exist."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from typer.testing import CliRunner

from mbdkit import Mechanism, study
from mbdkit.analysis.verdict import Answer
from mbdkit.cli import app
from mbdkit.engine.jit.law_compiler import bind_law
from mbdkit.registry.manager import load_registry
from mbdkit.spec import load_spec
from mbdkit.spec.law_options import law_element
from mbdkit.spec.study_loading import load_study_spec
from mbdkit.spec.yaml_reader import read_yaml
from mbdkit.studies.judge import judge

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """Return the fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


SCRIPTS = [block for block in blocks("python") if "hookimpl" not in block]
PLUGINS = [block for block in blocks("python") if "hookimpl" in block]


@pytest.mark.parametrize("number", range(len(SCRIPTS)))
@pytest.mark.usefixtures("in_tmp_path")
def test_python_of_the_readme_runs_as_printed(number: int, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(SCRIPTS[number], f"script {number} of the README", "exec"), {"__name__": "readme"})
    assert capsys.readouterr().out


@pytest.mark.parametrize("code", PLUGINS)
def test_a_plugin_of_the_readme_loads_and_its_laws_compile(code: str) -> None:
    module = ModuleType("plugin")
    exec(code, vars(module))
    entry = SimpleNamespace(
        name="plugin", value="plugin", dist=SimpleNamespace(name="mine", version="1"), load=lambda: module
    )
    loaded = load_registry([entry])
    assert not loaded.failures
    for item in loaded.of_kind("force-law"):
        options = law_element(item).model_construct(stiffness=2.0, cubic=3.0, damping=0.5)
        bind_law(item.plugin.law, options, item.id)


def test_the_parameters_that_the_readme_shows_are_those_of_a_mechanism() -> None:
    model = read_yaml(next(block for block in blocks("yaml") if block.startswith("parameters:")))[0]
    spec = load_spec({"mbdkit": 1, **model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}})
    rows = [row for row, _ in spec.mechanism().constraint_rows()]
    assert rows == ["A.x", "A.y", "B.x", "B.y", "C.normal"]
    assert spec.mechanism().joints["C"].points[1] == pytest.approx((0.3, 0.0))


def test_the_forces_that_the_readme_shows_are_those_of_a_mechanism() -> None:
    forces = read_yaml(next(block for block in blocks("yaml") if block.startswith("forces:")))[0]["forces"]
    m = Mechanism()
    m.body("load", mass=1.0, inertia=0.1)
    m.body("frame", mass=1.0, inertia=0.1)
    assert Mechanism.from_spec(m.to_spec() | {"forces": forces}).forces.keys() == {"rope", "bush"}


def output_of(commands: str) -> list[str]:
    """Run the commands in this process, and return what each one prints."""
    lines = [line.split("#")[0].split() for line in commands.splitlines() if line.strip()]
    assert [line[0] for line in lines] == ["mbdkit"] * len(lines)
    printed = []
    for line in lines:
        done = CliRunner().invoke(app, line[1:], prog_name="mbdkit")
        assert done.exit_code == 0, f"{' '.join(line)}: {done.stderr}"
        printed.append(done.stdout)
    return printed


def test_the_first_spec_runs_through_the_commands_that_follow_it(in_tmp_path: Path) -> None:
    (in_tmp_path / "swing.yaml").write_text(blocks("yaml")[0], encoding="utf-8")
    output_of(blocks("sh")[2])
    assert {"swing.h5", "fine.h5", "swing-drift.png", "swing.html"} <= {p.name for p in in_tmp_path.iterdir()}


def test_the_study_runs_through_the_commands_that_follow_it(in_tmp_path: Path) -> None:
    (in_tmp_path / "steps.yaml").write_text(blocks("yaml")[1], encoding="utf-8")
    said = output_of(blocks("sh")[3])
    assert "12 complete; reference runs: 1" in said[0]
    assert "nothing now" in said[1]


def test_run_and_test_sections_begin_with_their_one_command() -> None:
    sections = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", README, flags=re.MULTILINE | re.DOTALL))
    for title in ("Run", "Test"):
        block = re.search(r"^```sh\n(.*?)^```", sections[title], flags=re.MULTILINE | re.DOTALL)
        assert block is not None
        assert len(block[1].splitlines()) == 1


def test_every_packaged_example_that_the_readme_names_is_a_spec() -> None:
    named = re.search(r"every packaged example \((.*?)\)", README, flags=re.DOTALL)
    assert named is not None
    for name in re.findall(r"`(.*?)`", named[1]):
        load_spec(name)


def test_pictures_of_the_readme_exist() -> None:
    for path in re.findall(r"!\[.*?\]\((.*?)\)", README, flags=re.DOTALL):
        assert (ROOT / path).is_file(), path


@pytest.mark.slow
def test_the_verdict_of_the_readme_is_that_of_the_study(tmp_path: Path) -> None:
    # expected: what the packaged study says; times, which are those of a machine, are left out
    spec = json.loads(load_study_spec("paper").canonical_json())
    told = ("published", "one-metre", "joints", "knee", "steps", "precision")
    spec["families"] = {name: family for name, family in spec["families"].items() if name in told}
    verdict = judge(study(spec, out=tmp_path / "paper", workers=2))
    opening = " ".join(README.partition("\n## ")[0].split())
    for misalignment in re.findall(r"[\d.e-]+(?= m \()", verdict.claim("magnitudes").computed):
        assert misalignment in opening
    for name, pattern in (
        ("gill-worst", r"in \d+ of \d+ pairs of model and step"),
        ("knee-both", r"[\d.]+ to [\d.]+ s"),
        ("knee-gauss2", r"[\d.e-]+ mm"),
        ("knee-gauss3", r"[\d.e-]+ mm"),
        ("per-joint", r"[\d.]+ to [\d.]+(?= for the second)"),
        ("per-joint", r"[\d.]+ to [\d.]+(?= for each)"),
    ):
        figures = re.search(pattern, verdict.claim(name).computed)
        assert figures is not None
        assert figures[0] in opening, (name, figures[0])
    assert verdict.claim("magnitudes").answer is verdict.claim("gauss3-better").answer is Answer.YES
