"""The recorder of margins: what it refuses, and what it prints."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests import margins
from tests.first_party import ROOT
from tests.margins import assert_within

TESTS = """
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.margins import assert_within

def test_wide(): assert_allclose([1.0, 2.0], [1.0, 2.05], rtol=0.0, atol=0.1)
def test_near(): assert [1.0, 2.09] == pytest.approx([1.0, 2.0], abs=0.1)
def test_near_bar(): assert_within(np.array([0.1, -0.9]), 1.0)
def test_unlike(): assert 1.09 != pytest.approx(1.0, abs=0.01)
def test_digits():
    # margin: digits of a
    # publication
    assert 1.09 == pytest.approx(1.0, abs=0.1)
"""


def test_limits_that_are_nearly_reached_need_a_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "test_some.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.margins", "-c", str(tmp_path / "pytest.ini")]
    done = subprocess.run([*command, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False)
    failed = {line.split()[1].partition("::")[2] for line in done.stdout.splitlines() if line.startswith("FAILED")}
    assert failed == {"test_near", "test_near_bar"}
    assert "more than 0.8 here" in done.stdout
    assert "test_some.py:8: 0.90" in done.stdout
    stored = tmp_path / ".pytest_cache" / "v" / "mbdkit" / "margins"
    rows = {test.partition("::")[2]: (ratio, reason) for ratio, _, test, reason in json.loads(stored.read_text())}
    assert {test: round(ratio, 2) for test, (ratio, _) in rows.items()} == {
        "test_near": 0.9, "test_near_bar": 0.9, "test_digits": 0.9, "test_wide": 0.5,
    }  # fmt: skip
    assert rows["test_digits"][1] == "digits of a publication"
    margins.print_margins(0.6, str(stored), str(stored))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert all(line.startswith("0.900 to 0.900  ") for line in lines)


@pytest.mark.parametrize(
    ("deviation", "limit", "words"),
    [
        ([[0.1, -3.0]], 1.0, r"3\.0 exceeds 1\.0, first at \(0, 1\) of \(1, 2\): name"),
        (np.nan, 1.0, "nan exceeds 1.0: name"),
        ([0.1, 0.2], [1.0, 0.1], "0.2 exceeds 0.1"),
        ([], 1.0, "nothing was compared"),
    ],
)
def test_a_deviation_beyond_its_limit_is_told_with_its_place(deviation: object, limit: object, words: str) -> None:
    with pytest.raises(AssertionError, match=words):
        assert_within(deviation, limit, "name")
