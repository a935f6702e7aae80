"""Type checkers see an installed mbdkit as its users do."""

from __future__ import annotations

import subprocess
import sys
import typing
from pathlib import Path

import pytest

from mbdkit.registry.element_items import ElementKind
from mbdkit.registry.manager import registry
from mbdkit.spec import RunSpec
from mbdkit.spec.loading import Sections

SCRIPT = Path(__file__).with_name("users_script.py")


def mypy(script: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Check a script from a folder in which no configuration lies."""
    return subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", folder / "cache", script],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow  # mypy reads all of mbdkit, and CI runs it anyway
def test_mypy_accepts_a_script_and_finds_its_mistakes(tmp_path: Path) -> None:
    accepted = mypy(SCRIPT, tmp_path)
    assert accepted.returncode == 0, accepted.stdout
    wrong = tmp_path / "wrong.py"
    wrong.write_text('import mbdkit\nmbdkit.run("knee", integratr={"name": "rk4"})\nmbdkit.integrate\nmbdkit.run(3)\n')
    found = mypy(wrong, tmp_path).stdout
    assert 'Unexpected keyword argument "integratr"' in found
    assert 'has no attribute "integrate"' in found
    assert 'incompatible type "int"' in found


def test_the_keyword_arguments_of_a_run_are_the_keys_of_its_spec() -> None:
    kinds = [typing.cast(ElementKind, item.plugin) for item in registry().of_kind("element-kind")]
    sections = {kind.section for kind in kinds if kind.section}
    assert set(typing.get_type_hints(Sections)) == set(RunSpec.model_fields) | sections
