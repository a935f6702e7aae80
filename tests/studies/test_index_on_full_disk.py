"""An index that cannot be written leaves the previous one."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbdkit.errors import MbdkitError
from mbdkit.studies import study_index
from mbdkit.studies.study_index import Index, Row
from tests.tiny_disk import tiny_disk


def test_a_full_disk_leaves_the_previous_index(tmp_path: Path) -> None:
    def index(count: int) -> Index:
        return Index("{}", "hash", "0", tuple(Row(f"run{number}", "missing") for number in range(count)), ())

    with tiny_disk(tmp_path / "disk", 300) as disk:
        path = disk / "index.h5"
        study_index.write(path, index(1))
        with pytest.raises(MbdkitError, match="No space left"):
            study_index.write(path, index(5000))
        assert len(study_index.read(path).runs) == 1
        assert [file.name for file in disk.iterdir()] == ["index.h5"]
