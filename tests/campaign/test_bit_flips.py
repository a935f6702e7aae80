"""A changed bit of an archive of any kind is found by whatever reads it, unless it belongs to nothing that is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from .bit_flips import flipped, kinds


@pytest.mark.slow
def test_every_changed_bit_is_found_by_whatever_reads_the_file(tmp_path: Path) -> None:
    for name, kind in kinds(tmp_path).items():
        found = flipped(kind, 25)
        assert {*found} <= {"refused", "unchanged"}, (name, found)
        assert found["refused"] >= 12, (name, found)
