"""Archives and studies of a model in a file outlive the file, and read it again only if they may.

Expected drawings and data are those of the run whose file was there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit_report.figures.drawing_geometry import draw_run
from mbdkit_studies.store.blocks import Block

pytest.importorskip("defusedxml")

TEXT = """<mujoco><compiler angle="radian"/><default><joint axis="0 -1 0"/></default><worldbody>
<body name="upper"><joint name="shoulder" frictionloss="0.1"/><geom type="capsule" size="0.02" fromto="0 0 0 0.4 0 0"/>
<body name="lower" pos="0.4 0 0"><joint name="elbow" damping="0.02"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
</body></body></worldbody></mujoco>
"""


@pytest.fixture
def spec(tmp_path: Path) -> dict[str, Any]:
    """Return a spec of a model in a file."""
    (tmp_path / "arm.xml").write_text(TEXT)
    model = {"name": "mjcf", "file": str(tmp_path / "arm.xml")}
    return {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.02, "step": 0.01}}


@pytest.mark.parametrize("store", ["all", "histories", None])
def test_runs_of_a_study_are_drawn_without_the_file(spec: dict[str, Any], tmp_path: Path, store: Any) -> None:
    axes = [{"time.step": [0.01, 0.005, 0.0025]}]
    keys = {} if store is None else {"store": store}
    mbdkit.study({"mbdkit_study": 1, "base": spec, "axes": axes, **keys}, out=tmp_path / "study")
    with mbdkit.run(spec) as run:
        expected = draw_run(run)
    (tmp_path / "arm.xml").write_text("secret")
    study = mbdkit.load_study(tmp_path / "study")
    run = study.run(1)
    assert run is not None
    with run:
        assert run.not_drawn == ""
        assert np.array_equal(draw_run(run).local, expected.local)
        assert draw_run(run).pins == expected.pins
        assert [file.name for file in run.files or ()] == ["arm.xml"]
    with pytest.raises(mbdkit.SpecError, match=r"arm\.xml; files are read only with --files"):
        study.remake(1)
    with pytest.raises(mbdkit.SpecError, match="its SHA-256 differs"):
        study.remake(1, files=True)
    (tmp_path / "arm.xml").write_text(TEXT)
    assert study.remake(1, files=True).data_sha256 == study.points[1].data_sha256


def test_a_block_holds_one_copy_of_an_equal_mechanism(spec: dict[str, Any], tmp_path: Path) -> None:
    axes = [{"time.step": [0.01, 0.005, 0.0025]}]
    mbdkit.study({"mbdkit_study": 1, "base": spec, "axes": axes, "store": "summary"}, out=tmp_path / "study")
    with h5py.File(tmp_path / "study" / "runs" / "block-000000.h5") as file:
        assert file["runs/mechanism_texts"].shape == (1,)
    with Block(tmp_path / "study" / "runs" / "block-000000.h5") as block:
        assert block.is_sound()


def test_a_run_is_resumed_and_repeated_only_if_its_file_may_be_read(spec: dict[str, Any], tmp_path: Path) -> None:
    path, calls = tmp_path / "a.h5", []

    def stop(now: float, end: float) -> None:
        calls.append(now)
        raise KeyboardInterrupt

    long = spec | {"time": {"end": 40.0, "step": 1e-4}, "output": {"every": 10_000}}
    run = mbdkit.run(long, archive=path, progress=stop)
    files = run.files
    run.close()
    assert run.status == "interrupted"
    with pytest.raises(mbdkit.SpecError, match=r"arm\.xml; files are read only with --files"):
        mbdkit.resume(path, overwrite=True)
    (tmp_path / "arm.xml").write_text(TEXT.replace("0.1", "0.2"))
    with pytest.raises(mbdkit.SpecError, match="its SHA-256 differs"):
        mbdkit.resume(path, overwrite=True, files=True)
    (tmp_path / "arm.xml").write_text(TEXT)
    with mbdkit.resume(path, overwrite=True, files=True) as run:
        assert run.check().files == files
