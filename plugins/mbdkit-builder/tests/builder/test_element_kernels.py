"""The generated kernels and methods of elements are what the definitions and the models say."""

from __future__ import annotations

import pytest

from mbdkit_builder import method_stubs
from mbdkit_builder.element_kernels import TARGET, generated
from mbdkit_builder.generated_files import write


@pytest.fixture(scope="module")
def fresh() -> str:
    return generated()


def test_the_checked_in_kernels_are_those_that_the_definitions_generate(fresh: str) -> None:
    assert TARGET.read_text(encoding="utf-8") == fresh, "run `python -m mbdkit_builder elements`"


def test_the_checked_in_signatures_are_those_that_the_models_generate() -> None:
    text = method_stubs.generated()
    assert method_stubs.TARGET.read_text(encoding="utf-8") == text, "run `python -m mbdkit_builder methods`"
    assert "angle: float | None = None" in text
    assert "\n            Initial angular velocity [rad/s].\n" in text


def test_check_tells_fresh_kernels_from_stale_ones(fresh: str, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "element_kernels.py"
    target.write_text(fresh.replace("gx", "gy", 1), encoding="utf-8")
    assert write(target, fresh, check=True) == 1
    assert "element_kernels.py is out of date" in capsys.readouterr().out
    assert write(target, fresh, check=False) == 0
    assert write(target, fresh, check=True) == 0
