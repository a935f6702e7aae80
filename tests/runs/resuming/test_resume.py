"""A run that is killed goes on from its last checkpoint to the bits of the run that nobody disturbed."""

from __future__ import annotations

import fcntl
import math
import os
import random
import shutil
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

import mbdkit
import mbdkit.runs.run_checkpoint
from mbdkit.archive import writer
from mbdkit.archive.archive_check import check
from mbdkit.archive.checkpoint import Checkpoint
from mbdkit.archive.part_file import checkpoint_path, new_checkpoint_path
from mbdkit.base.errors import ArchiveError, ResourceError, SpecError
from mbdkit.cli import app
from mbdkit.integrators import interface
from mbdkit.runs import provenance
from mbdkit.runs.run_checkpoint import Parts
from tests.runs.resuming.checkpoints import NONE, checkpoint_of
from tests.slow_cases import slow, slow_but

from .killed_runs import killed, make_frequent

PENDULUM = {"name": "n-pendulum", "n": 3}
WINDOWS = {"name": "n-four-bar", "n": 2, "speed": 1.0}
"""It passes singular positions."""

BADLY_SCALED = {
    "name": "mechanism",
    "bodies": {
        "rod0": {"mass": 1.0, "inertia": 133.0, "position": [20.0, 0.0], "angular_velocity": 1.5, "velocity": [0, 30]},
        "rod1": {"mass": 1.0, "inertia": 133.0, "position": [60.0, 0.0], "angular_velocity": 1.5, "velocity": [0, 90]},
        "crumb": {"mass": 1e-7},
    },
    "joints": {
        "J0": {"type": "revolute", "bodies": ["ground", "rod0"], "at": [0, 0]},
        "J1": {"type": "revolute", "bodies": ["rod0", "rod1"], "at": [40, 0]},
    },
}
"""The crumb is so light that the run takes the system with pivots, which are chosen anew as the rods turn over."""

TIGHT = {"adaptive": True, "rtol": 1e-10, "atol": 1e-10}
MEASURES = {
    "early": "at(rod2.y, 0.0123)",
    "first": "at(rod2.vx, events.pull.time + 0.0001)",
    "last": "at(rod2.angle, events.pull.last_time)",
    "path": "integral(abs(rod2.vx))",
    "smooth": "integral(rod2.vx**2)",
    "fastest": "max(abs(rod1.angular_velocity))",
}
EVENTS = {"up": {"when": "rod2.y", "direction": "any"}, "pull": {"when": "J1.force - 30", "direction": "any"}}


def spec_of(integrator: dict[str, Any], time: dict[str, Any], model: Any = PENDULUM, **more: Any) -> dict[str, Any]:
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **more}


GAUSS = {"name": "gauss", "stages": 2}

RANGES = {
    "name": "mechanism",
    "bodies": {"rod": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
    "joints": {"A": {"type": "revolute", "bodies": ["ground", "rod"], "at": [0, 0]}},
    "forces": {
        "stop": {
            "type": "law",
            "law": "table",
            "table": [[-3.0, 0.0], [0.0, 0.0]],
            "pathway": {"type": "relative-angle", "bodies": ["ground", "rod"]},
        },
    },
}
"""The angle of a pendulum leaves the range of a law, in which it swings from 0 to -pi, again and again."""

SLIDE: dict[str, Any] = {"type": "prismatic", "bodies": ["ground", "slide"], "points": [[0, 0], [0, 0]], "axis": [1, 0]}
ZIGZAG = {"table": [[0.0, 0.09, 0.18], [0.0, 0.09, 0.0]], "interpolation": "linear", "ends": "periodic"}
DRIVEN: dict[str, Any] = {
    "name": "mechanism",
    "bodies": {"slide": {"mass": 1.0, "inertia": 1.0}},
    "joints": {"S": SLIDE, "D": {"type": "driver", "bodies": ["ground", "slide"], "coordinate": "x", "motion": ZIGZAG}},
}

SPECS = {
    "rk4": spec_of({"name": "rk4"}, {"steps": 20_000, "step": 1e-4}, output={"every": 20}),
    "rk4 through singular positions": spec_of({"name": "rk4"}, {"end": 6.0, "step": 1e-3}, WINDOWS),
    "rk4 with pivots": spec_of({"name": "rk4"}, {"end": 10.0, "step": 1e-3}, BADLY_SCALED),
    "gauss with pivots": spec_of(GAUSS, {"end": 6.0, "step": 2e-3}, BADLY_SCALED),
    "gauss, projection, events": spec_of(
        GAUSS, {"steps": 2400, "step": 2e-3}, stabilization="projection", events=EVENTS, measures=MEASURES
    ),
    "dopri5, adaptive": spec_of({"name": "dopri5", **TIGHT}, {"end": 20.0}, output={"interval": 0.01}),
    "taylor, adaptive": spec_of(
        {"name": "taylor", **TIGHT}, {"end": 60.0}, output={"interval": 0.01}, formulation="joint-coordinates"
    ),
    "radau-iia, adaptive": spec_of({"name": "radau-iia", **TIGHT}, {"end": 10.0}, output={"interval": 0.01}),
    "gauss, adaptive, joint-coordinates": spec_of(
        {"name": "gauss", **TIGHT}, {"end": 5.0}, output={"interval": 0.01}, formulation="joint-coordinates"
    ),
    "radau-iia, ggl in joint-coordinates": spec_of(
        {"name": "radau-iia", **TIGHT},
        {"end": 10.0},
        {"name": "four-bar-knee"},
        output={"interval": 0.01},
        formulation={"name": "joint-coordinates", "loops": "ggl"},
    ),
    "radau-iia, index-3": spec_of(
        {"name": "radau-iia", "stages": 2}, {"steps": 1500, "step": 1e-3}, formulation="index-3"
    ),
    "rk4, laws out of range": spec_of({"name": "rk4"}, {"steps": 20_000, "step": 2e-4}, RANGES, output={"every": 450}),
    "rattle": spec_of({"name": "rattle"}, {"steps": 5000, "step": 1e-4}, formulation="index-3"),
    "rk4, impulses of drivers": spec_of(
        {"name": "rk4"}, {"steps": 20_000, "step": 1e-4}, DRIVEN, output={"every": 20}, impacts="allow"
    ),
}


TURNING = (("a", 0.0), ("b", 0.3))
GEARS = {
    "name": "mechanism",
    "bodies": {
        name: {"mass": 1.0, "inertia": 0.02, "position": [x, 0.05], "angular_velocity": 0.3} for name, x in TURNING
    },
    "joints": {
        name.upper(): {"type": "revolute", "bodies": ["ground", name], "at": [x, 0.0]} for name, x in TURNING
    } | {"teeth": {"type": "gear", "bodies": ["a", "b"], "points": [[0, -0.05], [0, -0.05]], "radii": [0.1, 0.2]}},
}  # fmt: skip
SPECS |= {"gauss, gears with radial forces": spec_of({"name": "gauss"}, {"steps": 5000, "step": 1e-3}, GEARS)}
CONTACTS = {
    "name": "mechanism",
    "bodies": DRIVEN["bodies"] | {
        name: {"mass": 1.0, "inertia": 1.0 / 12.0, "position": [x + 0.5, 0.3], "angular_velocity": 0.3}
        for name, x in (("a", 0.0), ("b", 1.0))
    },
    "joints": DRIVEN["joints"] | {"A": {"type": "revolute", "bodies": ["a", "b"], "at": [1.0, 0.3]}},
    "contacts": {
        name: {
            "bodies": ["ground", name], "shapes": [{"line": {"normal": [0.0, 1.0]}}, {"point": [x, 0.0]}],
            "restitution": e, "friction": {"static": 0.5, "kinetic": 0.3},
        }
        for name, x, e in (("a", -0.5, 0.7), ("b", 0.5, 0.0))
    },
}  # fmt: skip
SPECS |= {
    "rigid contacts, event-driven": spec_of(
        {"name": "rk4"}, {"end": 0.35, "step": 1e-5}, CONTACTS, contact={"treatment": "event-driven"},
        measures={"lowest": "min(a.y)", "peak": "max(contacts.a.normal_force)"}, impacts="allow",
    ),
    "rigid contacts, time-stepping": spec_of(
        {"name": "nonsmooth-generalized-alpha"}, {"end": 0.4, "step": 5e-4}, CONTACTS,
        contact={"treatment": "time-stepping"}, events={"low": {"when": "a.y - 0.2", "direction": "any"}},
        impacts="allow",
    ),
}  # fmt: skip


@pytest.fixture
def frequent(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name in (
        (interface, "STRETCH"),
        (writer, "FLUSH_INTERVAL"),
        (mbdkit.runs.run_checkpoint, "INTERVAL"),
        (mbdkit.runs.run_checkpoint, "SHARE"),
    ):
        monkeypatch.setattr(module, name, getattr(module, name))  # restored after the test
    make_frequent()


FAST = ["rk4 with pivots", "rk4, laws out of range", "gauss, projection, events", "dopri5, adaptive"]


@pytest.mark.parametrize("name", slow_but(SPECS, *FAST, "radau-iia, adaptive", "rigid contacts, time-stepping"))
def test_killed_run_goes_on_to_the_same_bits(name: str, tmp_path: Path) -> None:
    whole = mbdkit.run(SPECS[name])  # compiles as well, so that the forks need not
    delay = 0.3 * float(whole.stats["wall_s"])
    part = tmp_path / "run.h5.part"
    assert killed(SPECS[name], part, checkpoints=random.choice([1, 2, 3]), delay=delay)
    killed(None, part, checkpoints=2, delay=delay)  # its first checkpoint is the one from which it continues
    run = mbdkit.resume(part) if part.exists() else mbdkit.load(part.with_suffix(""))
    assert run.data_sha256 == whole.data_sha256
    assert not check(part.with_suffix(""))
    counters = [name for name in whole.stats if not name.endswith("_s")]
    assert {name: run.stats[name] for name in counters} == {name: whole.stats[name] for name in counters}
    assert dict(run.measures) == dict(whole.measures)
    assert all(map(math.isfinite, whole.measures.values()))
    assert (run.status_reason, run.verdict_reasons) == (whole.status_reason, whole.verdict_reasons)
    assert run.provenance.get("resumed") in (1, 2)
    assert os.listdir(tmp_path) == ["run.h5"]


@pytest.mark.parametrize("name", ["gauss with pivots", "gauss, projection, events", "rigid contacts, time-stepping"])
def test_whole_state_of_a_checkpoint_is_restored(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Crossings and pivots depend on some values only in rare cases, so that equal bits do not show them."""
    part = tmp_path / "run.h5.part"
    assert killed(SPECS[name], part, checkpoints=2, delay=0.0)
    seen: list[bool] = []
    restore = Parts.restore

    def compared(self: Parts, state: Any) -> None:
        restore(self, state)
        without = {key: value for key, value in state.items() if key != "times"}
        wanted, found = (checkpoint_of(one).encoded() for one in (without, self.stored()))
        seen.append(wanted == found)

    monkeypatch.setattr(Parts, "restore", compared)
    mbdkit.resume(part)
    assert seen == [True]


def test_check_of_a_resumed_run_estimates_the_same_errors(tmp_path: Path) -> None:
    spec = spec_of(GAUSS, {"steps": 3000, "step": 2e-3}, check=True)
    whole, part = mbdkit.run(spec), tmp_path / "run.h5.part"
    assert killed(spec, part, delay=0.0)
    run = mbdkit.resume(part)
    assert whole.accuracy is not None
    assert run.accuracy is not None
    assert run.accuracy.position_error_max == whole.accuracy.position_error_max
    assert run.accuracy.known_until == whole.accuracy.known_until


def read(part: Path) -> Checkpoint:
    checkpoint = Checkpoint.of(part)
    assert checkpoint is not None
    return checkpoint


def test_wall_time_of_both_parts_counts(part: Path) -> None:
    taken, rows = read(part).state["times"]["wall_s"], read(part).rows["time"]
    run = mbdkit.resume(part)
    assert run.stats["wall_s"] > taken
    assert np.all(np.diff(run.elapsed) >= 0.0)
    assert run.elapsed[rows] >= run.elapsed[rows - 1]


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ``.part`` of a killed run, with its checkpoint."""
    part = tmp_path_factory.mktemp("killed") / "run.h5.part"
    assert killed(SPECS["rk4"], part, checkpoints=3, delay=0.0)
    return part


@pytest.fixture
def part(left: Path, tmp_path: Path) -> Iterator[Path]:
    """A copy of both, which a refusal must leave as they are."""
    copy = tmp_path / "run.h5.part"
    shutil.copy(left, copy)
    shutil.copy(checkpoint_path(left), checkpoint_path(copy))
    return copy


def refusal(part: Path, error: type[Exception] | tuple[type[Exception], ...] = (SpecError, ArchiveError)) -> str:
    """Return the sentence by which a file is refused; it stays as it is, and nothing is left beside it."""
    before, names = part.read_bytes(), sorted(os.listdir(part.parent))
    with pytest.raises(error) as told:
        mbdkit.resume(part)
    assert part.read_bytes() == before
    assert sorted(os.listdir(part.parent)) == names
    assert "\n" not in str(told.value)
    return str(told.value)


@pytest.mark.parametrize(
    ("entry", "told"), [("mbdkit", "mbdkit 9.9"), ("integrator_version", "mbdkit:rk4 version 9.9")]
)
def test_another_version_is_named_and_refused(entry: str, told: str, part: Path) -> None:
    checkpoint = read(part)
    checkpoint.head["provenance"][entry] = "9.9"
    checkpoint.write(part)
    assert f"it began with {told}, now " in refusal(part)


def test_another_processor_of_the_same_instruction_set_is_named_and_refused(
    part: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")  # linear algebra as on such a processor, with other last bits
    provenance._processor.cache_clear()
    try:
        told = refusal(part)
    finally:
        provenance._processor.cache_clear()
    assert "it began with processor " in told
    assert "OPENBLAS_CORETYPE=Prescott; use such a processor, or run it anew" in told


def test_file_of_a_living_run_is_refused(part: Path) -> None:
    with part.open("rb") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        assert "still writing" in refusal(part, ResourceError)


def test_checkpoint_that_was_not_written_to_its_end_is_not_used(part: Path) -> None:
    whole = mbdkit.run(SPECS["rk4"])
    new_checkpoint_path(part).write_bytes(checkpoint_path(part).read_bytes()[:1000])
    assert mbdkit.resume(part).data_sha256 == whole.data_sha256
    assert os.listdir(part.parent) == ["run.h5"]


def test_run_with_a_damaged_checkpoint_is_refused(part: Path) -> None:
    content = bytearray(checkpoint_path(part).read_bytes())
    content[100] ^= 1
    checkpoint_path(part).write_bytes(content)
    assert "run.h5.part.checkpoint is damaged, so this run cannot be resumed; start it again" in refusal(part)


def test_a_sparse_checkpoint_is_not_read(part: Path) -> None:
    with checkpoint_path(part).open("r+b") as file:
        file.truncate(20 << 30)
    tracemalloc.start()
    try:
        with pytest.raises(SpecError, match=r"checkpoint: this file is larger than 1024 MiB"):
            mbdkit.resume(part)
        assert tracemalloc.get_traced_memory()[1] < 1 << 26
    finally:
        tracemalloc.stop()


def test_run_without_checkpoint_is_refused(part: Path) -> None:
    checkpoint_path(part).unlink()
    told = refusal(part)
    assert "its checkpoint run.h5.part.checkpoint is not in the same folder" in told
    assert "(a run may also end before it has one: the first one is written after 5 s of steps); run it anew" in told


def test_rows_are_read_without_the_structure_of_the_file(part: Path) -> None:
    """A kill may leave the tables of HDF5 half written."""
    content = bytearray(part.read_bytes())
    content[:2048] = bytes(2048)
    part.write_bytes(content)
    with pytest.raises(OSError):
        h5py.File(part)
    with pytest.raises(
        ArchiveError, match=r"`mbdkit run --resume run\.h5\.part` completes the run from its checkpoint"
    ):
        mbdkit.load(part)
    assert mbdkit.resume(part).data_sha256 == mbdkit.run(SPECS["rk4"]).data_sha256
    assert os.listdir(part.parent) == ["run.h5"]


def test_resumed_run_that_was_killed_between_two_renamings_is_resumed(part: Path, frequent: None) -> None:
    """The checkpoint is already that of the new file, whose rows are at other places than those of the ``.part``."""
    old, kept = part.read_bytes(), part.with_name("kept")

    def stop(reached: float, end: float) -> None:
        shutil.copy(checkpoint_path(part), kept)
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        mbdkit.resume(part, progress=stop)
    kept.replace(checkpoint_path(part))
    part.rename(part.with_name("run.h5.resumed.part"))
    part.write_bytes(old)
    assert mbdkit.resume(part).data_sha256 == mbdkit.run(SPECS["rk4"]).data_sha256
    assert os.listdir(part.parent) == ["run.h5"]


def test_changed_row_is_noticed(part: Path) -> None:
    with h5py.File(part, "r+") as file:
        file["trajectory/velocity"][3, 0, 0] += 1e-12
    assert "it is damaged: its rows do not match its checkpoint" in refusal(part)


def test_new_run_removes_the_checkpoint_of_a_killed_one(part: Path) -> None:
    mbdkit.run("pendulum", archive=part.with_suffix("")).close()
    assert os.listdir(part.parent) == ["run.h5"]


@pytest.mark.parametrize("name", ["run.h5.part", "run.h5.part.checkpoint"])
def test_damage_anywhere_is_refused_or_harmless(name: str, left: Path, tmp_path: Path) -> None:
    whole = mbdkit.run(SPECS["rk4"]).data_sha256
    generator = np.random.default_rng(20261121)
    for case in range(6):
        folder = tmp_path / str(case)
        shutil.copytree(left.parent, folder)
        content = (left.parent / name).read_bytes()
        damaged = bytearray(content)
        if case % 4:
            damaged[int(generator.integers(len(content)))] ^= 1 << int(generator.integers(8))
        else:
            del damaged[int(generator.integers(len(content))) :]
        (folder / name).write_bytes(damaged)
        try:
            assert mbdkit.resume(folder / "run.h5.part").data_sha256 == whole
        except (SpecError, ArchiveError, ResourceError):
            assert (folder / name).read_bytes() == damaged


def test_made_up_state_is_refused(part: Path, frequent: None) -> None:
    """A stranger can compute hashes, too; indices that kernels follow are checked."""
    checkpoint = read(part)
    checkpoint.state["stepper"]["run"]["progress.passed"][0] = 10**9
    checkpoint.write(part)
    assert "the state of its checkpoint does not fit its spec (ValueError: it has passed more" in refusal(part)


@pytest.mark.parametrize(
    "changes",
    [
        {"chunk_rows": 10**12},
        {"chunk_rows": 0},
        {"row_shape": (10**9, 3)},
        {"offsets": np.array([-8])},
        {"offsets": NONE},
    ],
)
def test_made_up_places_of_rows_are_refused(changes: dict[str, Any], part: Path, frequent: None) -> None:
    checkpoint = read(part)
    checkpoint.arrays["trajectory/position"].__dict__.update(changes)
    checkpoint.write(part)
    assert "damaged" in refusal(part)


def test_state_survives_encoding() -> None:
    state = {"a": np.array([np.nan, -0.0, 5e-324]), "b": [None, 1, "x", 0.1 + 0.2, np.inf], "c": np.zeros((0, 2), int)}
    before = checkpoint_of(state)
    again = Checkpoint.decoded(before.encoded())
    assert again is not None
    assert (again.head, again.file, again.rows, again.lines) == (before.head, before.file, before.rows, before.lines)
    assert again.arrays["events/name"].texts == ("up",)
    assert again.arrays["energy/total"].offsets.tolist() == [8, 99]
    assert again.state["a"].tobytes() == state["a"].tobytes()  # type: ignore[attr-defined]
    assert again.state["b"] == state["b"]
    assert again.state["c"].shape == (0, 2)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"integrator": {"name": "scipy-dop853"}, "time": {"end": 3.0}}, "SciPy"),
        ({"integrator": {"name": "gauss"}, "time": {"end": 1.0}, "accuracy": 1e-6}, "pilot runs"),
    ],
)
def test_methods_without_checkpoints_say_why(changes: dict[str, Any], why: str, part: Path) -> None:
    spec = mbdkit.RunSpec(**{"mbdkit": 1, "model": PENDULUM, **changes})
    checkpoint_path(part).unlink()
    with h5py.File(part, "r+") as file:
        file.attrs.modify("spec", spec.canonical_json())
        file.attrs.modify("spec_sha256", spec.sha256())
        file.attrs.modify("run_id", spec.run_id())
        file["provenance"].attrs.modify("integrator", spec.integrator_item.id)
    assert why in refusal(part)


def test_ended_run_that_was_not_renamed_is_renamed(tmp_path: Path) -> None:
    path, part = tmp_path / "run.h5", tmp_path / "run.h5.part"
    mbdkit.run("pendulum", archive=path).close()
    whole = path.read_bytes()
    path.rename(part)
    with mbdkit.resume(part) as run:
        assert run.status == "complete"
    assert path.read_bytes() == whole
    path.rename(part)
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 1
    part.write_bytes(damaged)
    assert "damaged" in refusal(part)


@pytest.mark.parametrize("name", ["rk4", *slow("radau-iia, adaptive")])
def test_an_interrupted_run_goes_on_to_the_same_bits(name: str, tmp_path: Path, frequent: None) -> None:
    spec, path, calls = SPECS[name], tmp_path / "run.h5", 0

    def stop(reached: float, end: float) -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise KeyboardInterrupt

    with mbdkit.run(spec, archive=path, progress=stop) as run:
        assert run.status == "interrupted"
    left = path.read_bytes()
    assert "allow this with --overwrite" in refusal(path)
    with pytest.raises(RuntimeError, match="no"):
        mbdkit.resume(path, overwrite=True, progress=fail)
    assert path.read_bytes() == left
    calls = 0
    with mbdkit.resume(path, overwrite=True, progress=stop) as run:
        assert run.status == "interrupted"  # again
    done = CliRunner().invoke(app, ["run", "--resume", str(path), "--overwrite"])
    assert done.exit_code == 0, done.output
    with mbdkit.load(path) as run:
        assert run.data_sha256 == mbdkit.run(spec).data_sha256
    assert [one.name for one in tmp_path.iterdir()] == ["run.h5"]


def test_a_rejected_step_of_a_taylor_series_is_repeated_with_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rods are so long that the errors of positions, not those of angles, decide on the steps."""
    monkeypatch.setattr(interface, "STRETCH", 0.0)  # one attempt at a time
    integrator = {"name": "taylor", "adaptive": True, "rtol": 1e-12, "atol": 1e-6}
    model, formulation = {**PENDULUM, "length": 30.0}, "joint-coordinates"
    spec = spec_of(integrator, {"end": 300.0}, model, output={"interval": 1.0}, formulation=formulation)
    path, last, interrupted = tmp_path / "run.h5", 0.0, 0

    def stop(reached: float, end: float) -> None:
        nonlocal last
        is_rejected, last = reached == last, reached
        if is_rejected:
            raise KeyboardInterrupt

    run = mbdkit.run(spec, archive=path, progress=stop)
    while run.status == "interrupted":
        interrupted += 1
        run.close()
        run = mbdkit.resume(path, overwrite=True, progress=stop)
    whole = mbdkit.run(spec)
    assert interrupted >= 2
    assert run.data_sha256 == whole.data_sha256
    assert run.stats["rhs_evaluations"] == whole.stats["rhs_evaluations"]


def fail(reached: float, end: float) -> None:
    raise RuntimeError("no")


def test_archives_that_are_not_resumed_say_why(part: Path, frequent: None) -> None:
    path, kept = part.with_suffix(""), part.with_name("kept")
    part.rename(kept)
    checkpoint_path(part).rename(checkpoint_path(path))
    mbdkit.run("pendulum", archive=path).close()
    assert "this run is complete, so there is nothing to resume; to simulate a longer time" in refusal(path)
    for spec in (SPECS["rk4"], spec_of({"name": "scipy-dop853"}, {"end": 20.0})):
        mbdkit.run(spec, archive=path, overwrite=True, progress=interrupt).close()
        if spec is SPECS["rk4"]:
            checkpoint = checkpoint_path(path)
            content = checkpoint.read_bytes()
            checkpoint.write_bytes(content[:-1])
            assert "run.h5.checkpoint is damaged" in refusal(path)
            foreign = Checkpoint.decoded(content)
            assert foreign is not None
            foreign.head["run_id"] = "0" * 16  # type: ignore[index]
            foreign.write(path)
            assert "run.h5.checkpoint belongs to another run; run it anew" in refusal(path)
            checkpoint.rename(checkpoint_path(part))
            kept.rename(part)
            assert "has left run.h5.part; resume that file, or remove it" in refusal(path)
            part.unlink()
            checkpoint_path(part).unlink()
            assert "its checkpoint run.h5.checkpoint is not in the same folder" in refusal(path)
    assert "SciPy" in refusal(path)


def interrupt(reached: float, end: float) -> None:
    raise KeyboardInterrupt


def test_names_that_cannot_be_resumed(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"there is no such file$"):
        mbdkit.resume(tmp_path / "run.h5.part")
    (tmp_path / "run.h5").touch()
    with pytest.raises(SpecError, match=r"the run has ended, and run.h5 is its archive"):
        mbdkit.resume(tmp_path / "run.h5.part")
    (tmp_path / "run.h5").rename(tmp_path / "run.h5.part")
    with pytest.raises(SpecError, match=r"the run was killed and has left run.h5.part"):
        mbdkit.resume(tmp_path / "run.h5")
    with pytest.raises(SpecError, match=r"only an archive can be resumed: FILE.h5.part of a killed run"):
        mbdkit.resume(tmp_path / "run")
    for make in (os.mkdir, os.mkfifo):
        make(tmp_path / "other.h5.part")
        with pytest.raises(SpecError, match=r"this is not a regular file|this is a folder"):
            mbdkit.resume(tmp_path / "other.h5.part")
        shutil.rmtree(tmp_path / "other.h5.part") if make is os.mkdir else None


def test_short_runs_write_no_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer.ArchiveWriter, "keep_checkpoint", lambda *_: pytest.fail("a checkpoint was written"))
    mbdkit.run("pendulum", archive=tmp_path / "run.h5").close()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--resume", "run.h5.part", "pendulum", "--check"], "omit SPEC, --check"),
        (["--resume", "run.h5", "--set", "time.end=9"], "omit --set; other settings, such as a later time.end, need"),
        (["--resume", "run.yaml"], "only an archive can be resumed"),
        ([], "give a SPEC, or --resume FILE"),
    ],
)
def test_wrong_arguments_of_the_command(arguments: list[str], told: str) -> None:
    refused = CliRunner().invoke(app, ["run", *arguments])
    assert refused.exit_code == 2
    assert told in refused.output
