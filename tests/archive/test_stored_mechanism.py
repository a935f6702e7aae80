"""Archives hold the mechanism that was run: they are read and drawn without its model, and without opening a file.

Expected drawings are those of the mechanism that the model itself builds.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.stored_mechanism import mechanism_json, read_mechanism
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec
from mbdkit.spec.loading import example_names
from mbdkit_biomech.inverse_dynamics.spec.inverse_loading import load_inverse_spec
from mbdkit_report.figures.drawing_geometry import Drawing, draw_mechanism, draw_run

SHORT = {"integrator": {"name": "rk4"}, "time": {"end": 0.02, "step": 0.01}}


def same(first: Drawing, second: Drawing) -> bool:
    rest = {"owner": None, "local": None}
    return (
        vars(first) | rest == vars(second) | rest
        and np.array_equal(first.owner, second.owner)
        and np.array_equal(first.local, second.local)
    )


def swing() -> Mechanism:
    m = Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("pin", m.ground, rod, at=(0.0, 0.0))
    m.spring_damper("spring", m.ground, rod, from_=(0.0, 1.0), to=(1.0, 0.0), stiffness=10.0)
    m.marker("tip", rod, at=(1.0, 0.0))
    return m


def stored(data: dict[str, Any], bodies: tuple[str, ...] = ("rod",)) -> Any:
    return read_mechanism(json.dumps(data), bodies)


@pytest.mark.parametrize("name", [*example_names("run"), *example_names("inverse")])
def test_the_stored_mechanism_of_an_example_is_drawn_as_the_one_that_its_model_builds(name: str) -> None:
    load = load_inverse_spec if name in example_names("inverse") else load_spec
    built = load(name).mechanism()
    read = read_mechanism(mechanism_json(built), list(built.bodies))
    assert read.not_drawn == ""
    assert read.mechanism is not None
    assert read.mechanism.to_spec() == built.to_spec()
    assert same(draw_mechanism(read.mechanism), draw_mechanism(built))


def test_bodies_have_the_order_of_the_archive() -> None:
    m = Mechanism()
    m.body("first", mass=1.0)
    m.beam("arm", a=(0, 0), b=(1, 0), elements=2, A=1e-4, I=1e-9, E=1e9, nu=0.3, density=1e3)
    m.body("last", mass=1.0)
    read = read_mechanism(mechanism_json(m), list(m.bodies))
    assert read.mechanism is not None
    assert list(read.mechanism.bodies) == ["first", "arm.0", "arm.1", "arm.2", "last"]


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


def test_unknown_bodies_leave_only_points() -> None:
    data = json.loads(mechanism_json(swing()))
    data["bodies"]["rod"]["color"] = "red"
    read = stored(data)
    assert read.mechanism is None
    assert read.not_drawn == "this version of mbdkit does not know all of its bodies, so only points are drawn"


@pytest.mark.parametrize("text", ["", "[]", "3", "[" * 100_000, '{"bodies": 3}', '{"gravity": "x"}', '{"assembly": 1}'])
def test_a_damaged_mechanism_is_an_error_about_the_archive(tmp_path: Path, text: str) -> None:
    with mbdkit.run(swing(), archive=tmp_path / "a.h5", **SHORT):
        pass
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs["mechanism"] = text
    with mbdkit.load(tmp_path / "a.h5") as run, pytest.raises(mbdkit.ArchiveError, match=r"a\.h5"):
        assert run.mechanism


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


def test_a_run_in_memory_and_its_copy_have_the_mechanism(tmp_path: Path) -> None:
    with mbdkit.run(swing(), **SHORT) as run:
        run.save(tmp_path / "a.h5")
        with mbdkit.load(tmp_path / "a.h5") as copy:
            assert copy.mechanism.to_spec() == run.mechanism.to_spec() == swing().to_spec()
            assert copy.files == ()


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
