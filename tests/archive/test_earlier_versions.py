"""Archives and studies that versions 0.1 and 0.2 wrote open, with the data that they had: `earlier-versions.tar.xz`.

They are of a double pendulum with a spring: a run (of version 0.2; `format-1.0.h5` is one of version 0.1), a study with
an archive per run, and a study in blocks.
"""

from __future__ import annotations

import tarfile
from pathlib import Path

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check

STORED = Path(__file__).with_name("earlier-versions.tar.xz")
VERSIONS = ("0.1", "0.2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder with what each version wrote."""
    folder = tmp_path_factory.mktemp("earlier")
    with tarfile.open(STORED) as stored:
        # the first releases of Python 3.11 have no filters
        stored.extractall(folder, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    return folder


def test_archives_of_version_0_2_are_sound(folder: Path) -> None:
    archives = [folder / "0.2" / "run.h5", *(folder / "0.2" / "study" / "runs").glob("*.h5")]
    assert len(archives) == 3
    for path in archives:
        assert check(path) == []
        with mbdkit.load(path) as run:
            assert run.status == "complete"
            assert run["rod"].position.shape == (len(run.time), 2)
            assert np.all(run.forces["spring"].length > 0.0)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(("kind", "count"), [("study", 2), ("blocks", 3)])
def test_studies_open_with_all_their_runs(version: str, kind: str, count: int, folder: Path) -> None:
    study = mbdkit.load_study(folder / version / kind)
    table = study.to_frame()
    assert table.status.tolist() == ["complete"] * count
    for place in range(count):
        run = study.run(place)
        assert run is not None
        assert run.data_sha256 == table.data_sha256[place]
        assert run.time[-1] == pytest.approx(0.1)
