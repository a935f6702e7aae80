"""The README says the truth: its code runs as printed, and its commands exist."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from mbdkit.spec import load_spec

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """Return the fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_python_of_the_readme_runs_as_printed(number: int, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", blocks("python")[number]], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_the_first_spec_runs_through_the_commands_that_follow_it(tmp_path: Path) -> None:
    spec, commands = blocks("yaml")[0], blocks("sh")[2]
    (tmp_path / "swing.yaml").write_text(spec, encoding="utf-8")
    lines = [line.split("#")[0].split() for line in commands.splitlines() if line.strip()]
    assert [line[0] for line in lines] == ["mbdkit"] * len(lines)
    for line in lines:
        done = subprocess.run(
            [sys.executable, "-m", *line], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, f"{' '.join(line)}: {done.stderr}"
    assert {"swing.h5", "fine.h5", "swing-drift.png", "swing.html"} <= {p.name for p in tmp_path.iterdir()}


def test_the_study_runs_through_the_commands_that_follow_it(tmp_path: Path) -> None:
    (tmp_path / "steps.yaml").write_text(blocks("yaml")[1], encoding="utf-8")
    said = []
    for line in blocks("sh")[3].splitlines():
        done = subprocess.run(
            [sys.executable, "-m", *line.split("#")[0].split()],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=300,
            check=True,
        )
        said.append(done.stdout)
    assert "12 complete, and 1 to compare with" in said[0]
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
