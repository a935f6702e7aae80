"""The run as Python sees it."""

from __future__ import annotations

import inspect
import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive import history, recorded_data
from mbdkit.archive.archive_check import check
from mbdkit.archive.named_columns import Column, NotRecordedError
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import ArchiveContents
from mbdkit.archive.run_writer import Ending
from mbdkit.base.errors import MbdkitError, RunError, SpecError, UnknownNameError
from mbdkit.registry.manager import registry
from mbdkit.trust.criteria import Judgement

from .making import PROVENANCE, SPEC, STATS, fill, largest, make, names, rows, steps, writer


@pytest.fixture(params=["file", "memory", "file larger than memory"])
def run(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    if request.param == "memory":
        return Run(make(None))
    if request.param == "file larger than memory":
        monkeypatch.setattr(recorded_data, "KEEP_BYTES", 0)
    make(tmp_path / "run.h5")
    return load(tmp_path / "run.h5")


def test_body_has_its_motion(run: Run) -> None:
    made = rows(11, names())
    body = run["rod2"]
    for kind, linear, angular in (
        ("position", body.position, body.angle),
        ("velocity", body.velocity, body.angular_velocity),
        ("acceleration", body.acceleration, body.angular_acceleration),
    ):
        np.testing.assert_array_equal(linear, made[f"trajectory/{kind}"][:, 1, :2])
        np.testing.assert_array_equal(angular, made[f"trajectory/{kind}"][:, 1, 2])
    assert list(run.bodies) == ["rod1", "rod2"]


def test_joint_has_its_misalignment_and_reactions(run: Run) -> None:
    made = rows(11, names())
    joint = run.joints["J2"]
    for name in ("misalignment", "velocity_misalignment", "angle_misalignment", "reaction_force", "reaction_torque"):
        np.testing.assert_array_equal(getattr(joint, name), made[f"joints/{name}"][:, 1])
    assert joint.misalignment_max == 1.001
    with pytest.raises(NotRecordedError, match="`check: true` in its spec, or `--check`, estimates errors"):
        joint.reaction_force_error  # noqa: B018
    assert run.misalignment_max == 1.001
    assert run.joint_names == ("J1", "J2")


def test_constraint_has_its_residuals_and_multiplier(run: Run) -> None:
    made = rows(11, names())
    row = run.constraints["J2.x"]
    for name in ("position_residual", "velocity_residual", "multiplier"):
        np.testing.assert_array_equal(getattr(row, name), made[f"constraints/{name}"][:, 2])
    assert row.units == "m"
    with pytest.raises(NotRecordedError):
        row.method_multiplier  # noqa: B018
    with pytest.raises(NotRecordedError):
        run.singularity_distance  # noqa: B018


def test_energy_steps_and_time(run: Run) -> None:
    made = rows(11, names())
    for name in ("kinetic", "potential", "total", "dissipated", "work", "balance"):
        np.testing.assert_array_equal(getattr(run.energy, name), made[f"energy/{name}"])
    for name, values in steps(10).items():
        np.testing.assert_array_equal(getattr(run.steps, name), values)
    np.testing.assert_array_equal(run.time, made["time"])
    np.testing.assert_array_equal(run.elapsed, made["trajectory/elapsed_s"])


def test_attributes_are_plain_values(run: Run) -> None:
    assert run.spec == SPEC
    assert run.provenance == PROVENANCE
    assert type(run.stats["steps"]) is int
    assert type(run.stats["wall_s"]) is float
    assert (run.status, run.status_reason, run.run_id, run.format_version) == ("complete", "", "run-1", "1.0")
    with pytest.raises(TypeError):
        run.stats["steps"] = 3  # type: ignore[index]


def test_arrays_are_read_only(run: Run) -> None:
    for values in (run.time, run["rod1"].position, run.joints["J1"].misalignment, run.array("energy/total")):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0


def test_unknown_names_are_refused_with_the_nearest(run: Run) -> None:
    for ask, words in (
        (lambda: run["rod3"], r"the run has no body 'rod3' \(did you mean 'rod2'\?\)|rod1"),
        (lambda: run.joints["K"], "the run has no joint 'K'; available: J1, J2"),
        (lambda: run.constraints["J1.z"], "no constraint 'J1.z'"),
        (lambda: run.array("energy/totl"), r"no array 'energy/totl' \(did you mean 'energy/total'\?\)"),
    ):
        with pytest.raises(UnknownNameError, match=words):
            ask()
    assert "rod3" not in run.bodies
    assert isinstance(UnknownNameError("body", "x", []), KeyError)


def test_unrecorded_quantities_are_said(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", quantities=frozenset())
    with load(tmp_path / "run.h5") as run:
        for ask in (lambda: run.energy.total, lambda: run.constraints, lambda: run.joints["J1"].misalignment):
            with pytest.raises(NotRecordedError, match=r"did not record .*; `output.quantities`"):
                ask()
        assert run.joints["J1"].misalignment_max == 1.0


@pytest.mark.parametrize(
    ("status", "reason", "words"),
    [
        ("failed", "max-steps: 10 steps were not enough", "the run failed: max-steps: 10 steps were not enough"),
        ("interrupted", "", "^the run was interrupted$"),
        ("interrupted", "interrupted: stopped by the user", "^the run was interrupted: stopped by the user$"),
    ],
)
def test_check_raises_for_a_run_that_is_not_complete(status: str, reason: str, words: str) -> None:
    with Run(make(None, status=status, reason=reason)) as run, pytest.raises(RunError, match=words):
        run.check()


def test_closed_run_keeps_what_was_read_and_says_so(archive: Path) -> None:
    with load(archive) as run:
        time = run.time
    assert run.time is time
    assert run.status == "complete"
    with pytest.raises(MbdkitError, match=r"this run is closed; load .*run\.h5 again"):
        run["rod1"].position  # noqa: B018
    for ask in (run.to_xarray, lambda: run.save("x.h5")):
        with pytest.raises(MbdkitError, match="closed"):
            ask()


def test_pickling_goes_by_the_path(archive: Path) -> None:
    with load(archive) as run, pickle.loads(pickle.dumps(run)) as again:
        np.testing.assert_array_equal(again.time, run.time)


def test_run_in_memory_is_not_pickled() -> None:
    with Run(make(None)) as run, pytest.raises(TypeError, match="save it to a file"):
        pickle.dumps(run)


def test_saved_run_is_the_same_run(run: Run, tmp_path: Path) -> None:
    run.save(tmp_path / "saved.h5")
    with load(tmp_path / "saved.h5") as saved:
        assert saved.data_sha256 == run.data_sha256
        np.testing.assert_array_equal(saved["rod2"].position, run["rod2"].position)
        assert saved.created_utc == run.created_utc
    with pytest.raises(SpecError, match="exists already"):
        run.save(tmp_path / "saved.h5")
    run.save(tmp_path / "saved.h5", overwrite=True)


def test_repr_is_short(run: Run) -> None:
    assert repr(run).startswith("<Run run-1 complete, verdict unknown, 2 bodies, ")
    assert repr(run.joints) == "<2 of joint: J1, J2>"
    assert repr(run["rod1"]) == "<BodyHistory rod1>"


def test_every_column_says_what_it_is() -> None:
    targets = [item.plugin.history for item in registry().of_kind("quantity")]
    columns = [
        value
        for kind in [*vars(history).values(), *(target() for target in targets if target is not None)]
        if inspect.isclass(kind)
        for value in vars(kind).values()
        if isinstance(value, Column)
    ]
    assert len(columns) > 50
    for column in columns:
        assert column.__doc__
        assert "(T" in column.__doc__ or "(N" in column.__doc__
    assert (
        history.JointHistory.reaction_force.__doc__ == "force of the first body on the second, global frame, (T, 2), N"
    )


def test_histories_say_what_they_are() -> None:
    for name in dir(Run):
        member = inspect.getattr_static(Run, name)
        if not name.startswith("_") and (callable(member) or isinstance(member, property)):
            assert inspect.getdoc(member), name


def test_what_the_writer_knows_is_what_its_archive_says(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5")
    fill(into, 11)
    judgement = Judgement("doubtful", ("a reason",))
    into.finish(Ending("failed", "singular: somewhere", STATS, largest(11, names()), judgement, ("a warning",)))
    known = vars(ArchiveContents.just_written(into).header)
    read = vars(ArchiveContents.open(tmp_path / "run.h5").header)
    np.testing.assert_array_equal(known.pop("misalignment_max"), read.pop("misalignment_max"))
    assert known == read


@pytest.mark.parametrize("is_long", [False, True], ids=["written at once", "begun before its end"])
def test_masses_of_bodies_of_a_model_are_in_the_archive(
    is_long: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if is_long:
        monkeypatch.setattr("mbdkit.archive.writer.FLUSH_INTERVAL", 0.0)
    model = {"name": "double-pendulum", "masses": [1.0, 3.0], "lengths": [1.0, 2.0]}
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.05, "step": 0.01}}
    mbdkit.run(spec, archive=tmp_path / "run.h5").close()
    with h5py.File(tmp_path / "run.h5") as file:
        bodies = file["trajectory"]
        assert bodies["body"].asstr()[:].tolist() == ["rod1", "rod2"]
        assert bodies.attrs["mass"].tolist() == [1.0, 3.0]
        assert bodies.attrs["inertia"] == pytest.approx([1.0 / 12.0, 3.0 * 2.0**2 / 12.0])  # uniform rods
    assert check(tmp_path / "run.h5") == []
