"""Files that are read for a run: archives store their hashes, and they are read again only with `--files`.

Hashes are compared with those that hashlib computes from the file.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from typer.testing import CliRunner

import mbdkit
from mbdkit.base.files_read import FileRead, check_readable, note_read, only_known
from mbdkit.cli import app

MOTION = "time,tilt\n" + "".join(f"{0.05 * k},{0.1 * (0.05 * k) ** 2}\n" for k in range(21))
INVERSE = {
    "mbdkit": 1,
    "model": {"name": "single-pendulum"},
    "motion": {"file": "motion.csv", "columns": {"J1.angle": "tilt"}},
}


@pytest.fixture
def measured(in_tmp_path: Path) -> Path:
    """Return an archive of inverse dynamics beside the table from which it was made."""
    (in_tmp_path / "motion.csv").write_text(MOTION)
    mbdkit.inverse(INVERSE, archive="a.h5").close()
    return in_tmp_path / "a.h5"


def command(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(word) for word in words])
    return done.exit_code, done.output


def test_an_archive_lists_name_size_and_hash_of_a_table(measured: Path) -> None:
    digest = hashlib.sha256(MOTION.encode()).hexdigest()
    with mbdkit.load(measured) as run:
        assert run.files == (FileRead("motion.csv", len(MOTION), digest),)


def test_a_rerun_reads_files_only_if_it_may_and_only_those_that_the_run_has_read(measured: Path) -> None:
    code, text = command("rerun", measured)
    assert code == 2
    assert "motion.csv; files are read only with --files (files=True in Python), and only those that" in " ".join(
        text.split()
    )
    assert command("rerun", measured, "--files")[0] == 0
    measured.with_name("motion.csv").write_text(MOTION + "1.05,0.2\n")
    code, text = command("rerun", measured, "--files")
    assert code == 2
    assert "not the one with which the run was made: its SHA-256 differs" in " ".join(text.split())


def test_files_without_resume_are_refused(in_tmp_path: Path) -> None:
    code, text = command("run", "pendulum", "--files")
    assert code == 2
    assert "takes effect only with --resume" in " ".join(text.split())


def test_an_archive_that_lists_no_file_opens_none_with_files_either(tmp_path: Path) -> None:
    with only_known((), allowed=True), pytest.raises(mbdkit.SpecError, match="only those that the archive lists"):
        check_readable(tmp_path / "secret")


def test_without_the_archive_permission_alone_is_needed(tmp_path: Path) -> None:
    with only_known(None, allowed=True):
        check_readable(tmp_path / "table")
        note_read(tmp_path / "table", b"1")
    with only_known(None, allowed=False), pytest.raises(mbdkit.SpecError, match="only with --files"):
        check_readable(tmp_path / "table")
