"""Readers in plain h5py and in C, written from `schemas/archive.md` alone, read files of all kinds as mbdkit does."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdkit

from .plain_reader import read

SPEC = {"mbdkit": 1, "title": "A swing", "model": {"name": "double-pendulum"}, "integrator": {"name": "rk4"}}
SPEC |= {"time": {"end": 0.2, "step": 0.01}}


def swing_record(folder: Path) -> dict[str, object]:
    """Return the motion of a pendulum, measured for inverse dynamics."""
    time = np.arange(0.0, 1.0, 0.01)
    table = np.column_stack([time, 0.1 * np.cos(3.0 * time)])
    np.savetxt(folder / "swing.csv", table, delimiter=",", header="time,pivot", comments="")
    return {"file": str(folder / "swing.csv"), "columns": {"pivot.angle": "pivot"}, "smooth": {"name": "none"}}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return files of all kinds but identifications, which take too long."""
    folder = tmp_path_factory.mktemp("kinds")
    files = {name: folder / f"{name}.h5" for name in ("run", "failed", "ball", "inverse")}
    mbdkit.run(SPEC, archive=files["run"]).close()
    mbdkit.run(SPEC, limits={"max_steps": 5}, archive=files["failed"]).close()
    ball, bob = mbdkit.Mechanism(name="Without joints"), mbdkit.Mechanism(name="Measured")
    ball.body("ball", mass=1.0)
    mbdkit.run(ball, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01}, archive=files["ball"]).close()
    bob.body("bob", mass=1.0, inertia=0.1, position=(0.0, -1.0))
    bob.revolute("pivot", "ground", "bob", at=(0.0, 0.0))
    mbdkit.inverse(bob, motion=swing_record(folder), archive=files["inverse"]).close()
    study = {"mbdkit_study": 1, "base": SPEC, "store": "all", "axes": [{"time.step": [0.01, 0.02]}]}
    mbdkit.study(study, out=folder / "study")
    return files | {"index": folder / "study" / "index.h5", "block": folder / "study" / "runs" / "block-000000.h5"}


@pytest.mark.parametrize("name", ["run", "failed", "ball", "inverse"])
def test_plain_h5py_reads_what_mbdkit_reads(name: str, files: dict[str, Path]) -> None:
    found = read(files[name])
    with mbdkit.load(files[name]) as run:
        assert (found["status"], found["verdict"]) == (run.status, run.verdict)
        assert found["title"] == (run.spec.get("title") or run.spec["model"]["name"])
        forces = {name: np.hypot(*joint.reaction_force.T).max() for name, joint in run.joints.items()}
        assert found["forces"] == pytest.approx(forces)
        axes, units = found["arrays"]["trajectory/position"]
        assert axes == ["/trajectory/time", "/trajectory/body", "/trajectory/coordinate"]
        assert units == ["m", "m", "rad"]


@pytest.mark.parametrize("name", ["run", "failed", "ball", "inverse"])
def test_names_are_names_of_variables_in_matlab(name: str, files: dict[str, Path]) -> None:
    with h5py.File(files[name]) as file:
        names = {*file.attrs}
        file.visititems(lambda path, item: names.update({path.rpartition("/")[2], *item.attrs}))
    assert [one for one in names if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", one)] == []


def test_a_block_has_the_largest_forces_of_its_runs(files: dict[str, Path]) -> None:
    largest: dict[str, float] = {}
    for step in (0.01, 0.02):
        run = mbdkit.run(SPEC, time={"end": 0.2, "step": step})
        for name, joint in run.joints.items():
            largest[name] = max(largest.get(name, 0.0), np.hypot(*joint.reaction_force.T).max())
    assert read(files["block"])["forces"] == pytest.approx(largest)
    axes, _ = read(files["index"])["arrays"]["runs/misalignment_max"]
    assert axes == ["/runs/run"]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the reader in C; skip without a compiler or the headers of HDF5."""
    if shutil.which("gcc") is None or shutil.which("pkg-config") is None:
        pytest.skip("no gcc or no pkg-config")
    flags = subprocess.run(["pkg-config", "--cflags", "--libs", "hdf5"], capture_output=True, text=True, check=False)
    if flags.returncode:
        pytest.skip("no headers of HDF5")
    program, source = tmp_path_factory.mktemp("c") / "reader", Path(__file__).with_name("plain_reader.c")
    strict = ("-std=c11", "-Wall", "-Wextra", "-Werror")
    subprocess.run(["gcc", *strict, str(source), "-o", str(program), *flags.stdout.split(), "-lm"], check=True)
    return program


def test_c_reads_the_same(program: Path, files: dict[str, Path]) -> None:
    for path in files.values():
        done = subprocess.run([str(program), str(path)], capture_output=True, text=True, check=True)
        lines, found = [line.split("\t") for line in done.stdout.splitlines()], read(path)
        assert {words[0]: words[1] for words in lines[:4]} == {key: found[key] for key, _ in lines[:4]}
        units = {words[1]: words[2] for words in lines if words[0] == "array"}
        assert units == {key: "mixed" if isinstance(one, list) else one for key, (_, one) in found["arrays"].items()}
        forces = {words[1]: float(words[2]) for words in lines if words[0] == "force"}
        assert forces == pytest.approx(found["forces"], rel=1e-12)
