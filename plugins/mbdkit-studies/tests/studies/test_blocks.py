"""Studies that are stored in blocks: the same runs, to the bit, as from single files, whatever happens to the study."""

from __future__ import annotations

import copy
import dataclasses
import fcntl
import os
from pathlib import Path
from typing import Any

import h5py
import netCDF4
import numpy as np
import pytest
from tests.studies.stored_studies import BASE, GRID, index_hash

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import data_sha256, datasets, seal
from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.base.errors import ArchiveError, MbdkitError, SpecError
from mbdkit.runs.varied_numbers import Stacks, VariedNumbers
from mbdkit.spec import RunSpec, load_spec
from mbdkit_studies.compute import batch, pool, run_blocks, unfinished_block
from mbdkit_studies.compute import compute_block as compute_block_module
from mbdkit_studies.compute.compute_block import compute_block
from mbdkit_studies.compute.tasks import mark_of, run_at_work
from mbdkit_studies.compute.unfinished_block import UnfinishedBlock, pieces_of
from mbdkit_studies.compute.varied_runs import EnsembleRuns
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.report.runs_table import export_runs
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.store.blocks import Block
from mbdkit_studies.store.storage import StudyBlocks
from tests.runs.rotor_with_inputs import OFF_GRID, given, rotor


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """The study of `GRID`, run by one process; not to be changed."""
    return mbdkit.study(GRID, out=tmp_path_factory.mktemp("blocks") / "grid")


def pendulums(count: int = 12, **options: Any) -> mbdkit.Study:
    """Return an ensemble of double pendulums."""
    angles = np.linspace(-1.0, 1.0, count)
    return mbdkit.ensemble(BASE, {"model.angles.0": angles, "time.step": [0.01, 0.02] * (count // 2)}, **options)


@pytest.mark.parametrize(
    ("runs", "size"), [(10, 64), (100, 64), (600, 75), (1000, 125), (10_000, 1000), (100_000, 5000), (200_000, 5000)]
)
def test_studies_have_several_blocks_for_several_processes(runs: int, size: int) -> None:
    first, second = (np.linspace(-1.0, 1.0, count).tolist() for count in (min(runs, 1000), max(1, runs // 1000)))
    axes = [{"model.angles.0": first}, {"model.angles.1": second}]
    spec = load_study_spec({"mbdkit_study": 1, "base": BASE, "store": "summary", "axes": axes})
    blocks = StudyBlocks.of(spec, PlannedPoints(spec))
    assert (blocks.size, blocks.count) == (size, -(-runs // size))


def test_runs_of_all_methods_have_the_bits_of_single_runs(grid: mbdkit.Study) -> None:
    assert [point.status for point in grid.points[:6]] == ["complete", "failed", "failed"] * 2
    assert len(list((grid.folder / "runs").iterdir())) == 4  # 15 runs
    for point in grid.points:
        with mbdkit.run(point.spec) as single, grid.run(point) as stored:
            assert stored.data_sha256 == point.data_sha256 == single.data_sha256
            assert stored.spec_json == single.spec_json
            assert point.status == stored.status == single.status
            assert (stored.run_id, stored.status_reason) == (single.run_id, single.status_reason)
            assert (stored.verdict, stored.verdict_reasons) == (single.verdict, single.verdict_reasons)
            assert data_sha256(stored.file) == single.data_sha256  # of the arrays that were read from the block
            assert stored.joints["J2"].misalignment_max == single.joints["J2"].misalignment_max
            counters = {name: value for name, value in single.stats.items() if name in COUNTERS}
            assert counters == {name: stored.stats[name] for name in counters}


def test_a_stored_run_can_be_saved_as_an_archive(grid: mbdkit.Study, tmp_path: Path) -> None:
    with grid.run(0) as run:
        run.save(tmp_path / "run.h5")
        assert run.to_xarray()["energy"]["total"].shape == (31,)
    assert check(tmp_path / "run.h5") == []


def test_other_programs_read_blocks(grid: mbdkit.Study) -> None:
    with netCDF4.Dataset(grid.folder / "runs" / "block-000000.h5") as file:
        array = file["trajectory/position"]
        assert array.dimensions == ("run", "row", "body", "coordinate")
        rows = file["trajectory/rows"][:]
        with grid.run(0) as run:
            assert rows[0] == len(run.time)
            both = np.stack([run["rod1"].position, run["rod2"].position], axis=1)
            np.testing.assert_array_equal(array[0, : rows[0], :, :2], both)


@pytest.mark.parametrize("store", ["hashes", "summary", "histories", "all"])
def test_every_store_keeps_results_and_makes_runs_again(store: Any, tmp_path: Path) -> None:
    study = pendulums(store=store, out=tmp_path / "s", block=5)
    frame = study.to_frame()
    assert frame["number"].tolist() == list(range(1, 13))
    assert frame["model.angles.0"].tolist() == np.linspace(-1.0, 1.0, 12).tolist()
    assert set(frame["status"]) == {"complete"}
    for name in ("verdict", "misalignment_max", "energy_balance_max", "data_sha256"):
        assert name in frame
    assert ("steps" in frame) == (store != "hashes")
    again = study.remake(7)
    assert again.data_sha256 == frame["data_sha256"][7]
    assert again.misalignment_max == frame["misalignment_max"][7]
    kept = study.run(7)
    assert kept is not None
    assert kept.records("joints/reaction_force") == (store in ("histories", "all"))
    assert kept.records("energy/total") == (store == "all")
    assert kept.spec == again.spec
    if store in ("histories", "all"):
        np.testing.assert_array_equal(kept["rod2"].position, again["rod2"].position)
    else:
        with pytest.raises(MbdkitError, match=f"store: {store}"):
            kept.energy.total  # noqa: B018
    if store != "all":
        with pytest.raises(MbdkitError, match="complete archive"):
            kept.save(tmp_path / "run.h5")


def test_files_stand_beside_the_blocks_of_a_table(tmp_path: Path) -> None:
    given: Any = {"store": "files", "out": tmp_path / "s", "block": 5}
    given |= {"measures": ["misalignment_max", {"last": "final(rod1.x)"}]}
    study = pendulums(**given)
    archives = {point.path for point in study.points}
    assert {path for path in (tmp_path / "s" / "runs").iterdir() if "block" not in path.name} == archives
    assert len(archives) == 12
    for point in study.points:
        assert check(point.path) == []
        with mbdkit.run(point.spec) as single, mbdkit.load(point.path) as stored, study.run(point) as opened:
            assert opened.data_sha256 == point.data_sha256 == stored.data_sha256 == single.data_sha256
            assert opened.measures["last"] == stored["rod1"].position[-1, 0]
    lost, damaged, kept = (study.points[place].path for place in (0, 1, 7))
    lost.unlink()
    damaged.write_bytes(damaged.read_bytes()[:-1000])
    before = kept.stat().st_mtime_ns
    assert pendulums(**given).computed == 5  # those of the block in which one was lost
    assert [check(path) for path in archives] == [[]] * 12
    assert kept.stat().st_mtime_ns == before


def test_files_beside_blocks_need_runs_that_can_be_made_again(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"store: .*`limits.wall_time`"):
        mbdkit.ensemble(
            BASE | {"limits": {"wall_time": 1.0}}, {"model.angles.0": [0.0, 1.0]}, store="files", out=tmp_path / "s"
        )
    assert not (tmp_path / "s").exists()


def test_a_run_that_cannot_be_made_again_is_told_from_the_one_that_was_stored(tmp_path: Path) -> None:
    study = pendulums(4, store="hashes", out=tmp_path / "s")
    other = study.points[1]
    object.__setattr__(other, "data_sha256", study.points[2].data_sha256)
    (tmp_path / "s" / "runs" / "block-000000.h5").unlink()  # the index alone tells what was computed
    with pytest.raises(MbdkitError, match="run 2, computed again, has other data"):
        study.remake(other)


def test_compressed_blocks_are_smaller_and_have_the_same_runs(tmp_path: Path) -> None:
    plain, packed = (pendulums(store="all", out=tmp_path / str(on), compress=on) for on in (False, True))
    sizes = [(one.folder / "runs" / "block-000000.h5").stat().st_size for one in (plain, packed)]
    assert sizes[1] < sizes[0]
    assert packed.to_frame()["data_sha256"].tolist() == plain.to_frame()["data_sha256"].tolist()
    with packed.run(3) as run:
        assert data_sha256(run.file) == plain.points[3].data_sha256


def test_only_missing_and_damaged_blocks_are_computed(tmp_path: Path) -> None:
    out = tmp_path / "s"
    study = pendulums(store="summary", out=out, block=3)
    before = index_hash(out)
    assert (study.computed, pendulums(store="summary", out=out, block=3).computed) == (12, 0)
    damaged, missing = out / "runs" / "block-000001.h5", out / "runs" / "block-000002.h5"
    content = bytearray(damaged.read_bytes())
    with h5py.File(damaged) as file:
        place = file["runs/misalignment_max"].id.get_offset()
    content[place + 3] ^= 1
    damaged.write_bytes(content)
    missing.unlink()
    assert pendulums(store="summary", out=out, block=3).computed == 6
    assert index_hash(out) == before


@pytest.mark.parametrize("path", ["runs/status", "stats/steps", "trajectory/position"])
def test_an_axis_without_its_scale_is_found(grid: mbdkit.Study, tmp_path: Path, path: str) -> None:
    block = tmp_path / "block.h5"
    block.write_bytes((grid.folder / "runs" / "block-000000.h5").read_bytes())
    assert check(block) == []
    with h5py.File(block, "r+") as file:
        dim = file[path].dims[0]
        dim.detach_scale(dim[0])
    assert check(block) == ["its arrays, attributes or dimension scales have changed since they were written"]


def test_unchanged_blocks_are_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options: dict[str, Any] = {"store": "histories", "out": tmp_path / "s", "block": 3}
    monkeypatch.setattr(run_blocks, "SETTLED", 0.0)
    pendulums(**options)
    before, opened = index_hash(tmp_path / "s"), []
    is_sound = Block.is_sound

    def noted(block: Block) -> bool:
        opened.append(block.path.name)
        return is_sound(block)

    monkeypatch.setattr(Block, "is_sound", noted)
    assert (pendulums(**options).computed, opened) == (0, [])
    assert index_hash(tmp_path / "s") == before
    # one bit of an array of results, in the same file, with its modification time set back
    path = tmp_path / "s" / "runs" / "block-000002.h5"
    with h5py.File(path) as file:
        place = next(item for item in datasets(file) if item.name.endswith("trajectory/position")).id.get_offset()
    times = path.stat()
    with path.open("r+b") as changed:
        changed.seek(place)
        byte = changed.read(1)[0]
        changed.seek(place)
        changed.write(bytes([byte ^ 1]))
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert (pendulums(**options).computed, opened) == (3, ["block-000002.h5"])
    assert index_hash(tmp_path / "s") == before


def test_a_file_that_has_just_changed_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # its time may be that of the next change, too: file systems count time in steps
    monkeypatch.setattr(run_blocks, "SETTLED", 60.0)
    pendulums(store="summary", out=tmp_path / "s", block=3)
    with h5py.File(tmp_path / "s" / "index.h5") as file:
        assert not file["blocks/file_state"][:].any()


def test_a_block_of_another_study_is_not_replaced(tmp_path: Path) -> None:
    pendulums(4, store="summary", out=tmp_path / "a")
    pendulums(6, store="summary", out=tmp_path / "b")
    moved = tmp_path / "b" / "runs" / "block-000000.h5"
    moved.write_bytes((tmp_path / "a" / "runs" / "block-000000.h5").read_bytes())
    with pytest.raises(SpecError, match="a block of another study"):
        pendulums(6, store="summary", out=tmp_path / "b")


def test_a_run_of_another_study_is_not_returned(tmp_path: Path) -> None:
    # the blocks have the same number of runs, and are sound: only the hash of their study tells them apart
    pendulums(4, store="histories", out=tmp_path / "a")
    angles = {"model.angles.0": np.linspace(0.5, 1.5, 4)}
    study = mbdkit.ensemble(BASE, angles, store="histories", out=tmp_path / "b")
    moved = tmp_path / "b" / "runs" / "block-000000.h5"
    moved.write_bytes((tmp_path / "a" / "runs" / "block-000000.h5").read_bytes())
    for read in (study.run, study.remake, lambda _: study.quantiles("rod1.angle")):
        with pytest.raises(SpecError, match="a block of another study") as refused:
            read(1)
        assert refused.value.file == str(moved)


def test_a_block_whose_runs_have_other_data_than_the_index_is_not_read(tmp_path: Path) -> None:
    study = pendulums(4, store="histories", out=tmp_path / "s")
    path = tmp_path / "s" / "runs" / "block-000000.h5"
    with h5py.File(path, "r+") as file:
        file["runs/data_sha256"][1] = file["runs/data_sha256"][0]
        seal(file)
    assert study.run(0) is not None
    for read in (study.run, study.remake):
        with pytest.raises(SpecError, match="the data of run 2 are not those that the study has indexed"):
            read(1)


def test_a_falsified_index_is_found_when_a_run_is_computed_again(tmp_path: Path) -> None:
    pendulums(4, store="summary", out=tmp_path / "s")
    path = tmp_path / "s" / "index.h5"
    with h5py.File(path, "r+") as file:
        file["runs/energy_balance_max"][...] = 123.0
        file["runs/rhs_evaluations"][...] = 7
        seal(file)
    study = mbdkit.load_study(tmp_path / "s")
    assert study.points[1].values["energy_balance_max"] == 123.0  # the hashes are not a signature
    with pytest.raises(MbdkitError, match="the index has other values of energy_balance_max, rhs_evaluations"):
        study.remake(1)
    with pytest.raises(MbdkitError, match="the index has other values of verdict"):
        study.remake(dataclasses.replace(study.points[2], verdict="bad", values={}))


def test_a_block_is_a_function_of_its_folder(grid: mbdkit.Study, tmp_path: Path) -> None:
    out = tmp_path / "s"
    mbdkit.study(GRID, out=out, shard=Shard(100, 100))  # computes nothing: there are four blocks
    for block in range(4):
        compute_block(out, block)
    assert mbdkit.study(GRID, out=out).computed == 0
    assert index_hash(out) == index_hash(grid.folder)


def test_a_block_that_another_process_computes_is_left_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pendulums(store="summary", out=tmp_path / "s", block=3)
    folder = StudyFolder(tmp_path / "s")
    folder.block(1).unlink()
    monkeypatch.setattr(compute_block_module, "PATIENCE", 0.1)
    with mark_of(folder.block(1)).open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        study = pendulums(store="summary", out=tmp_path / "s", block=3)
    assert study.statuses().count("missing") == 3
    assert "another process is computing this block" in study.unfinished[0]
    assert pendulums(store="summary", out=tmp_path / "s", block=3).status == "complete"


def test_a_process_that_dies_in_a_run_is_known_to_have_died_in_that_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # several runs are prepared at once, but the file that names the run at work must name the one that is computed
    alone, at_work = batch.simulate_arrays, []

    def noting(spec: RunSpec, **rest: Any) -> Any:
        at_work.append((run_at_work(StudyFolder(tmp_path / "s").block(0)), spec.run_id()))
        return alone(spec, **rest)

    monkeypatch.setattr(batch, "simulate_arrays", noting)
    study = mbdkit.study(GRID | {"block": 15}, out=tmp_path / "s")
    assert len(at_work) >= 5
    assert all(study.points[number - 1].run_id == run_id for number, run_id in at_work)


@pytest.mark.usefixtures("processes")
def test_a_run_that_kills_its_process_twice_fails_without_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer_of = pool._Process.answer
    deaths: list[int] = []

    def deadly(worker: Any, message: Any, notify: Any) -> Any:
        if message["block"] == 1 and "5" not in message["skip"]:
            mark_of(Path(message["path"])).write_text(f"{5:8d}")
            deaths.append(1)
            worker.process.kill()
            worker.process.wait()
        return answer_of(worker, message, notify)

    monkeypatch.setattr(pool._Process, "answer", deadly)
    study = pendulums(store="summary", out=tmp_path / "s", block=3)
    assert len(deaths) == 2
    assert [point.number for point in study.failures] == [5]
    assert study.failures[0].reason.startswith("worker-died: two processes that computed it died")
    assert study.unfinished == (study.failures[0].reason,)
    assert set(study.to_frame()["status"]) == {"complete", "failed"}
    monkeypatch.undo()
    again = pendulums(store="summary", out=tmp_path / "s", block=3)  # tried again, as runs in files are
    assert (again.computed, len(again.failures)) == (3, 0)
    assert not list((tmp_path / "s" / "runs").glob(".block*"))


def test_a_large_study_becomes_blocks_unless_it_asks_for_files(tmp_path: Path) -> None:
    many = {"mbdkit_study": 1, "base": BASE, "axes": [{"model.angles.0": {"linspace": [0.0, 1.0, 501]}}]}
    last = Shard(1000, 1000)
    blocks = mbdkit.study(copy.deepcopy(many), out=tmp_path / "blocks", shard=last)
    assert blocks.spec.store == "all"
    files = mbdkit.study(copy.deepcopy(many), out=tmp_path / "files", shard=last, store="files")
    assert files.spec.store == "files"
    again = mbdkit.study(copy.deepcopy(many), out=tmp_path / "blocks", shard=last)  # without `store` again
    assert again.spec.store == "all"


def test_what_needs_files_is_refused_in_blocks() -> None:
    with pytest.raises(SpecError, match=r"blocks cannot be combined with `reference`"):
        mbdkit.study(GRID | {"reference": {"time.step": 0.001}})
    with pytest.raises(SpecError, match=r"blocks cannot be combined with `repeats`"):
        mbdkit.study(GRID | {"repeats": 3})


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({}, "there are none"),
        ({"model.angles.0": [1.0, 2.0], "time.step": [0.1]}, "model.angles.0 has 2, time.step has 1"),
        ({"model.angles.0": [[1.0]]}, "needs an array"),
        ({"model.angles.0": [True]}, "numbers or of texts"),
        ({"model.angles.7": [1.0]}, "model.angles has 2 items"),
        ({"model.mass": [1.0]}, "'mass' belongs to"),
        ({"model.angles.0": [np.nan]}, "finite"),
    ],
)
def test_wrong_variables_of_an_ensemble_are_refused(variables: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=message):
        mbdkit.ensemble(BASE, variables, out=tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_a_study_begins_only_if_the_checked_specs_are_valid(tmp_path: Path) -> None:
    def study(*steps: float) -> dict[str, Any]:
        return {"mbdkit_study": 1, "base": BASE, "store": "hashes", "axes": [{"time.step": list(steps)}]}

    right = [0.01 + 0.001 * place for place in range(14)]  # the first and every second of 15 specs are checked
    for wrong in (study(-1.0, *right), study(*right[:4], -1.0, *right[4:])):
        with pytest.raises(SpecError, match="greater than 0, not -1"):
            mbdkit.study(wrong, out=tmp_path / "s")
    assert not (tmp_path / "s").exists()
    done = mbdkit.study(study(*right[:3], -1.0, *right[3:]), out=tmp_path / "s")
    assert [point.number for point in done.failures] == [4]
    assert done.failures[0].reason.startswith("wrong-input: ")
    assert done.run(done.failures[0]) is None


def test_an_ensemble_goes_on_from_its_folder_alone(tmp_path: Path) -> None:
    out = tmp_path / "s"
    before = pendulums(store="hashes", out=out, block=4)
    (out / "runs" / "block-000002.h5").unlink()
    again = mbdkit.study(out / "study.yaml", out=out)
    assert again.computed == 4
    assert again.to_frame()["data_sha256"].tolist() == before.to_frame()["data_sha256"].tolist()
    copied = mbdkit.study(out / "study.yaml", out=tmp_path / "other", shard=Shard(9, 9))
    assert copied.status == "partial"
    (tmp_path / "other" / "members.h5").write_bytes(b"")
    with pytest.raises(ArchiveError, match=r"members\.h5"):
        mbdkit.load_study(tmp_path / "other")


def test_specs_in_a_block_do_not_need_the_study(grid: mbdkit.Study) -> None:
    with Block(grid.folder / "runs" / "block-000001.h5") as block:
        for number in block.numbers.tolist():
            if (run := block.run(number)) is not None:
                assert run.run_spec.sha256() == grid.points[number - 1].spec.sha256()


def test_rows_are_selected_by_conditions(grid: mbdkit.Study) -> None:
    frame = grid.to_frame()
    for condition, expected in (
        ("status == 'complete'", frame["status"] == "complete"),
        ("time.step < 0.005 and time.step > 0.0035", frame["time.step"] == 0.004),
        ("integrator in ['rk4', 'scipy-dop853'] and not status != 'complete'", frame["number"].isin([1, 13, 14, 15])),
        ("abs(-number) ** 2 >= 4 * 4 or number == 1", frame["number"].isin([1, *range(4, 16)])),
        ("isnan(misalignment_max)", frame["misalignment_max"].isna()),
        ("1 < number <= 3", frame["number"].isin([2, 3])),
        ("verdict == 3", frame["number"] < 0),
    ):
        assert grid.select(condition)["number"].tolist() == frame["number"][expected].tolist(), condition
    assert grid.select("number > 2").attrs["units"]["misalignment_max"] == "m"


@pytest.mark.parametrize(
    "condition",
    [
        "__import__('os').system('true')",
        "status.__class__ == 1",
        "(lambda: True)()",
        "[x for x in number]",
        "f'{number}' == 'a'",
        "number if number else 1",
        "number := 1",
        "@number",
        "number & 1",
        "number",
        "status < 3",
        "'a' * 1000000000 == 'b'",
        "number in range(10)",
        "number == " + "-" * 200 + "1",
        "number == 1 " + "or number == 1 " * 2000,
        "misalignment < 1",
        "",
        "number == 'a\\x41'",
    ],
)
def test_conditions_of_strangers_are_refused(grid: mbdkit.Study, condition: str) -> None:
    with pytest.raises(SpecError):
        grid.select(condition)


def test_the_table_of_runs_is_exported(grid: mbdkit.Study, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    for form in ("csv", "parquet"):
        export_runs(grid, tmp_path / form, form)
    frame = grid.to_frame()
    table = pandas.read_parquet(tmp_path / "parquet" / "runs.parquet")
    assert table["misalignment_max"].equals(frame["misalignment_max"])
    assert table["data_sha256"].tolist() == frame["data_sha256"].tolist()
    assert len((tmp_path / "csv" / "runs.csv").read_text().splitlines()) == 16


ONE_BLOCK = GRID | {"block": 15, "measures": ["misalignment_max", {"low": "min(rod2.y)"}]}
ONE_BLOCK["base"] = BASE | {"time": {"end": 0.1, "step": 0.01}, "limits": {"max_steps": 20}}
COMPUTED = 15
"""Runs of the grid. Some fail, because their steps are so small that `max_steps` ends them."""


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list of the numbers of runs that each later call computes; all of them save each vector of runs."""
    monkeypatch.setattr(unfinished_block, "INTERVAL", 0.0)
    monkeypatch.setattr(unfinished_block, "LARGEST_RATE", np.inf)
    simulate, counts = compute_block_module.simulate_in_any_order, []

    def counted(specs: Any, **options: Any) -> Any:
        counts.append(len(specs))
        return simulate(specs, **options)

    monkeypatch.setattr(compute_block_module, "simulate_in_any_order", counted)
    return counts


def begun(folder: Path, spec: Any = ONE_BLOCK) -> StudyFolder:
    """Return the folder of a study of one block of which nothing has been computed."""
    mbdkit.study(spec, out=folder, shard=Shard(2, 2))
    return StudyFolder(folder)


def interrupt(folder: StudyFolder, monkeypatch: pytest.MonkeyPatch, saves: int) -> None:
    """Compute the block until it has saved runs several times."""
    add = UnfinishedBlock.add

    def interrupted(self: UnfinishedBlock, runs: Any) -> None:
        add(self, runs)
        if len(pieces_of(folder.block(0))) >= saves:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(UnfinishedBlock, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            compute_block(folder.path, 0)


def contents(block: Path) -> dict[str, Any]:
    """Return the arrays of a block except for times, as bytes."""
    with h5py.File(block) as file:
        return {
            item.name: item[()].tobytes() if item.dtype.kind != "O" else [str(one) for one in np.ravel(item[()])]
            for item in datasets(file)
            if item.name.rpartition("/")[2] not in (*TIMINGS, "elapsed_s")
        }


@pytest.mark.parametrize("store", ["hashes", pytest.param("all", marks=pytest.mark.slow)])
def test_an_interrupted_block_is_completed_to_the_same_bits(
    store: str, tmp_path: Path, computed: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, whole = (begun(tmp_path / name, ONE_BLOCK | {"store": store}) for name in ("interrupted", "whole"))
    compute_block(whole.path, 0)
    interrupt(folder, monkeypatch, 3)
    interrupt(folder, monkeypatch, 4)
    compute_block(folder.path, 0)
    assert computed[0] == computed[1] == COMPUTED > computed[2] > computed[3] > 0
    assert contents(folder.block(0)) == contents(whole.block(0))
    assert [path.name for path in folder.runs.iterdir()] == ["block-000000.h5"]


def test_runs_of_other_versions_and_truncated_files_are_computed_again(
    tmp_path: Path, computed: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = begun(tmp_path / "s")
    interrupt(folder, monkeypatch, 2)
    (first, second) = sorted(pieces_of(folder.block(0)))
    saved = [len(UnfinishedBlock(folder.block(0), heading(mbdkit_version)).saved()) for mbdkit_version in ("", "0.0.7")]
    assert saved[0] > saved[1] == 0
    for path in (first, second):
        path.write_bytes(path.read_bytes()[:-200])
    compute_block(folder.path, 0)
    assert computed == [COMPUTED, COMPUTED]


def heading(version: str) -> Any:
    study = load_study_spec(ONE_BLOCK)
    now = compute_block_module.surroundings()
    return compute_block_module.BlockHeading(study.sha256(), "all", now | ({"mbdkit": version} if version else {}), {})


def test_saved_runs_are_removed_with_the_study_and_when_their_block_is_complete(
    tmp_path: Path, computed: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = begun(tmp_path / "s")
    interrupt(folder, monkeypatch, 1)
    folder.clear()
    assert not list(folder.runs.iterdir())
    folder = begun(tmp_path / "t")
    compute_block(folder.path, 0)
    (folder.runs / ".block-000000.piece-7").touch()  # the process was killed before it could remove this file
    assert mbdkit.study(ONE_BLOCK, out=folder.path).computed == 0
    assert [path.name for path in folder.runs.iterdir()] == ["block-000000.h5"]


def test_runs_with_inputs_are_stored_with_what_was_set(tmp_path: Path) -> None:
    spec = load_spec(
        rotor("linear", 9.81), inputs=given(OFF_GRID), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.05}
    )
    ends = [0.5, 1.0]
    study = mbdkit.ensemble(spec, {"time.end": ends}, out=tmp_path / "study", store="all")
    for number, end in enumerate(ends):
        with study.run(number) as stored, mbdkit.run(spec, time={"end": end, "step": 0.05}) as single:
            assert stored.data_sha256 == single.data_sha256 == data_sha256(stored.file)
            np.testing.assert_array_equal(stored.inputs["torque"].set.time, single.inputs["torque"].set.time)
    for path in (study.folder / "runs").glob("*.h5"):
        with Block(path) as block:
            assert block.is_sound()


ENSEMBLES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "angles": ({"name": "double-pendulum"}, {"model.angles.0": [0.3, -0.4, 0.0, 1.0], "model.angles.1": [1, 2, 3, -1]}),
    "lengths": ({"name": "single-pendulum"}, {"model.length": [0.5, 1.5, -1, 1], "model.mass": [0.7, 2, 3, 0.1]}),
    "springs": (
        {"name": "four-bar-knee", "springs": {"a": {"points": [[0.05, 0.1], [0.05, -0.1]], "stiffness": 1.0}}},
        {"model.springs.a.stiffness": [1000.0, 2e3, 0.0, 4e3], "model.springs.a.damping": [20.0, 3, 1, -0.0]},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ENSEMBLES)
def test_runs_computed_from_arrays_are_those_with_specs_of_their_own(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # expected: each run, prepared from its own spec; among the values are defaults, zeros and refused ones
    model, variables = ENSEMBLES[name]
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.2, "step": 0.01}}
    done, finished = [], EnsembleRuns.finished

    def noted(*arguments: Any) -> Any:
        for places, runs in finished(*arguments):
            done.extend(places)
            yield places, runs

    monkeypatch.setattr(EnsembleRuns, "finished", noted)
    mbdkit.ensemble(spec, variables, store="all", out=tmp_path / "s", notify=lambda _: None)
    folder = StudyFolder(tmp_path / "s")
    arrays = contents(folder.block(0))
    assert len(done) >= 2
    compute_block(folder.path, 0, one_by_one=True, notify=lambda _: None)
    own = contents(folder.block(0))
    assert own.keys() == arrays.keys()
    assert [key for key, values in own.items() if values != arrays[key]] == []


def test_a_study_ends_with_both_hashes_if_a_run_computed_twice_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stacks = VariedNumbers.stacks

    def shifted(self: VariedNumbers, values: np.ndarray) -> Stacks | None:
        made = stacks(self, values)
        return made and dataclasses.replace(made, v=made.v + 1e-300)

    monkeypatch.setattr(VariedNumbers, "stacks", shifted)
    monkeypatch.setattr(compute_block_module, "drawn", lambda places, _: frozenset(places))
    variables = {"model.angles.0": [0.1, 0.2]}
    with pytest.raises(MbdkitError, match=r"data_sha256 [0-9a-f]{64} .* but [0-9a-f]{64} .* defect of mbdkit"):
        mbdkit.ensemble(BASE, variables, out=tmp_path / "s")
    for number in (1, 2):  # computed by the ordinary way after all
        mbdkit.load_study(tmp_path / "s").remake(number=number).close()
