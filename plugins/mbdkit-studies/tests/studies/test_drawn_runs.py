"""Runs drawn from studies in blocks have the bits of single runs; `tests.benchmarks.drawn_runs` draws many more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbdkit_studies.spec import measures
from mbdkit_studies.spec.measures import RunGroup
from tests.benchmarks import drawn_runs
from tests.benchmarks.drawn_runs import compare, remade


@pytest.fixture(autouse=True)
def _short_studies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw from studies of three blocks of at most five runs."""
    monkeypatch.setattr(drawn_runs, "MEMBERS", 14)
    monkeypatch.setattr(drawn_runs, "BLOCK", 5)


@pytest.mark.slow
def test_drawn_runs_have_the_bits_of_single_runs(tmp_path: Path) -> None:
    count, failed, found = compare(["rk4", "dopri5 adaptive"], 2, tmp_path)
    assert found == []
    assert count > 25
    assert failed > 8
    assert remade(tmp_path, 3) == 3


def test_a_difference_in_the_last_bit_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exact = measures.MEASURES["energy_scale"].take

    def rounded(group: RunGroup) -> np.ndarray:
        return np.nextafter(exact(group), np.inf) if len(group) > 1 else exact(group)

    wrong = dict(measures.MEASURES) | {"energy_scale": measures.Measure("J", "largest kinetic energy", rounded)}
    monkeypatch.setattr("mbdkit_studies.compute.compute_block.MEASURES", wrong)
    _, _, found = compare(["rk4"], 1, tmp_path)
    assert found
    assert all("energy_scale" in one for one in found)
