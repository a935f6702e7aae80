"""Runs of a study that are not to be trusted are visible in its table and its report."""

from __future__ import annotations

import h5py
import pytest

import mbdkit

RUN = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": 2.0, "step": 0.05}}
STUDY = {
    "mbdkit_study": 1, "title": "two methods", "base": {"mbdkit": 1, "model": {"name": "double-pendulum"}, **RUN},
    "axes": [{"integrator": [{"name": "gauss", "stages": 3}, {"name": "rk-gill"}]}],
}  # fmt: skip


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    return mbdkit.study(STUDY, out=tmp_path_factory.mktemp("study") / "two")


def test_the_table_of_a_study_has_the_verdict_of_each_run(study: mbdkit.Study) -> None:
    frame = study.to_frame()
    assert list(frame["status"]) == ["complete", "complete"]
    assert list(frame["verdict"]) == ["unknown", "bad"]
    assert frame["verdict_reasons"][0] == ""
    assert frame["verdict_reasons"][1].startswith("Joint 'J2' is misaligned by up to ")
    assert [point.verdict for point in study.points] == ["unknown", "bad"]
    with h5py.File(study.folder / "index.h5") as file:
        assert list(file["runs/verdict"].asstr()[:]) == ["unknown", "bad"]
