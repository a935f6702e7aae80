"""Mechanisms that archives hold are drawn as those that their models build."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.stored_mechanism import mechanism_json, read_mechanism
from mbdkit.spec import load_spec
from mbdkit.spec.loading import example_names
from mbdkit_biomech.inverse_dynamics.spec.inverse_loading import load_inverse_spec
from mbdkit_report import Drawing, draw_mechanism
from mbdkit_report.figures.drawing_geometry import draw_run
from tests.archive.stored import SHORT, stored, swing


def same(first: Drawing, second: Drawing) -> bool:
    rest = {"owner": None, "local": None}
    return (
        vars(first) | rest == vars(second) | rest
        and np.array_equal(first.owner, second.owner)
        and np.array_equal(first.local, second.local)
    )


@pytest.mark.parametrize("name", [*example_names("run"), *example_names("inverse")])
def test_the_stored_mechanism_of_an_example_is_drawn_as_the_one_that_its_model_builds(name: str) -> None:
    load = load_inverse_spec if name in example_names("inverse") else load_spec
    built = load(name).mechanism()
    read = read_mechanism(mechanism_json(built), list(built.bodies))
    assert read.not_drawn == ""
    assert read.mechanism is not None
    assert read.mechanism.to_spec() == built.to_spec()
    assert same(draw_mechanism(read.mechanism), draw_mechanism(built))


def test_elements_of_unknown_kinds_and_those_that_refer_to_them_are_named_and_the_others_drawn() -> None:
    data = json.loads(mechanism_json(swing()))
    data["joints"]["thread"] = {"type": "screw", "bodies": ["ground", "rod"], "pitch": 0.1}
    cable = {"type": "joint-angles", "angles": {"thread": 0.1}}
    data["forces"]["cable"] = {"type": "law", "law": "linear", "pathway": cable, "stiffness": 1.0}
    data["forces"]["spring"]["later"] = 1.0
    read = stored(data)
    assert read.not_drawn == "not drawn, because not known here: joints.thread, forces.spring, forces.cable"
    assert list(read.mechanism.joints) == ["pin"]
    assert draw_mechanism(read.mechanism).pins


def test_options_of_a_law_of_a_plugin_are_kept_without_the_plugin() -> None:
    data = json.loads(mechanism_json(swing()))
    pathway = {"type": "two-points", "bodies": ["ground", "rod"], "points": [[0.0, 1.0], [0.5, 0.0]]}
    data["forces"]["pull"] = {"type": "law", "law": "acme:spring", "pathway": pathway, "pretension": 5.0}
    read = stored(data)
    assert read.not_drawn == ""
    assert dict(read.mechanism.forces["pull"])["pretension"] == 5.0
    assert len(draw_mechanism(read.mechanism).springs) == 2


def test_a_mechanism_of_more_than_64_kib_is_stored(tmp_path: Path) -> None:
    model = {"name": "n-pendulum", "n": 500}
    with mbdkit.run({"mbdkit": 1, "model": model, **SHORT}, archive=tmp_path / "a.h5") as run:
        assert len(run.file.attrs["mechanism"]) > 1 << 16
        built = mbdkit.RunSpec(mbdkit=1, model=model, **SHORT).mechanism()
        assert same(draw_run(run), draw_mechanism(built))


def test_an_archive_that_lacks_the_mechanism_of_a_plugin_is_drawn_as_points_and_says_so(tmp_path: Path) -> None:
    with mbdkit.run(swing(), archive=tmp_path / "a.h5", **SHORT) as run:
        spec = dict(run.spec)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file.attrs["mechanism"]
        file.attrs["spec"] = json.dumps(spec | {"model": {"name": "acme:crane", "file": str(tmp_path / "secret")}})
    with mbdkit.load(tmp_path / "a.h5") as run:
        assert "the model 'acme:crane' is of a plugin, which may read files" in run.not_drawn
        assert draw_run(run).pins == ()
        with pytest.raises(mbdkit.ArchiveError, match="only points of bodies"):
            assert run.mechanism
