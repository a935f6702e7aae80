"""The folder of a study (study.yaml, runs/, index.h5), with locks against concurrent use."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from mbdkit.errors import SpecError, file_error
from mbdkit.files import check_folder, check_writable, rename_new
from mbdkit.spec.reading import read_file
from mbdkit.spec.study_loading import load_study_spec
from mbdkit.spec.study_spec import StudySpec
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit.studies import folder_lock, member_table
from mbdkit.studies.folder_lock import LOCK
from mbdkit.studies.shard import WHOLE, Shard

#: Beginning of the name of study.yaml while it is written.
_BEGUN = ".study.yaml-"

#: Beginning of the name of the folder for the files of submitted jobs.
JOBS = ".jobs-"

#: Names of archives of runs, see `RunSpec.run_id`, of blocks, also of unfinished ones, and their marks.
_ARCHIVE = re.compile(r"([0-9a-f]{16}|block-[0-9]{6,})\.h5(\.part)?|\.block-[0-9]{6,}\.at")

#: What every page of mbdkit contains near its beginning.
_GENERATOR = b'<meta name="generator" content="mbdkit '

#: What every chart of a report contains near its beginning, by suffix; see the metadata in plot/style.py.
_DRAWN = {".png": b"Software\0mbdkit", ".svg": b"<dc:title>mbdkit</dc:title>"}


class StudyFolder:
    """Paths in the folder of a study, and its locks."""

    def __init__(self, path: Path):
        self.path = path
        self.spec = path / "study.yaml"
        self.runs = path / "runs"
        self.index = path / "index.h5"
        self.report = path / "report.html"
        self.figures = path / "figures"

    def archive(self, run_id: str) -> Path:
        """Return the path of the archive of a run, whether it exists or not."""
        return self.runs / f"{run_id}.h5"

    def block(self, number: int) -> Path:
        """Return the path of a block of runs, counted from 0, whether it exists or not."""
        return self.runs / f"block-{number:06d}.h5"

    def mark(self, number: int) -> Path:
        """Return the path of the file that names the run at work in a block."""
        return self.runs / f".block-{number:06d}.at"

    def run_at_work(self, number: int) -> int | None:
        """Return the number of the run that a process was computing when it died in a block; None if there is none."""
        try:
            return int(self.mark(number).read_bytes()[:8])
        except (OSError, ValueError):
            return None

    def forget_run_at_work(self, number: int) -> None:
        """Empty the file that names the run at work in a block; it is kept, as a process may hold a lock on it."""
        with contextlib.suppress(OSError):
            os.truncate(self.mark(number), 0)

    def check(self, spec: StudySpec, *, overwrite: bool = False) -> None:
        """Check that the folder can be used for this study, without changing anything.

        Parameters
        ----------
        overwrite
            Whether the folder may contain another study, which `clear` then removes.

        Raises
        ------
        SpecError
            If the folder belongs to another study, contains other files but no study, or cannot be created.
        ResourceError
            If writing into it is not permitted.
        """
        path = self.path
        if not os.path.lexists(path):
            check_folder(path.parent, path)
            check_writable(path.parent, path)
            return
        if not os.path.isdir(path):
            raise SpecError("this is not a folder; name a folder for the study with -o", file=path)
        check_writable(path, path)
        has_others = not all(entry.name.startswith((_BEGUN, LOCK)) for entry in path.iterdir())
        if self.spec.is_file():  # asked last: another call may be creating it, before any other file
            if overwrite:
                self._check_study()
            else:
                self._check_same(spec)
        elif has_others:
            raise SpecError(
                "this folder contains other files and no study.yaml; choose another folder with -o", file=path
            )
        self._check_kinds()

    def _check_kinds(self) -> None:
        """Check that no file has the name of the subfolder for runs, and no folder that of the index."""
        if os.path.lexists(self.runs) and not os.path.isdir(self.runs):
            raise SpecError("this is not a folder, as the runs of the study need; rename or remove it", file=self.runs)
        if os.path.isdir(self.index):
            raise SpecError("this is a folder, where the study writes a file; rename or remove it", file=self.index)

    def _check_same(self, spec: StudySpec) -> None:
        if load_study_spec(self.spec).sha256() != spec.sha256():
            raise SpecError(
                "this folder belongs to another study, or to an earlier version of this one: its study.yaml "
                "differs; choose another folder with -o, or start it anew with --overwrite",
                file=self.path,
            )

    def _check_study(self) -> None:
        """Raise SpecError if study.yaml is not that of a study, so that nothing in the folder may be removed."""
        if "mbdkit_study" not in read_file(self.spec).data:
            raise SpecError("this is not the spec of a study, so its folder is not overwritten", file=self.spec)

    def clear(self) -> None:
        """Remove what studies write into the folder: study.yaml, the index, the archives of runs, and the report.

        All other files are kept, and so are a report.html and images in figures/ that mbdkit has not written.

        Raises
        ------
        ResourceError
            If another call uses the folder, or the system refuses to remove a file.
        """
        if not self.spec.is_file():
            return
        self._check_study()
        with self.locked():
            try:
                self.index.unlink(missing_ok=True)
                (self.path / member_table.FILE).unlink(missing_ok=True)
                for path in [*self.runs.iterdir()] if self.runs.is_dir() else ():
                    if _ARCHIVE.fullmatch(path.name) and not path.is_dir():
                        path.unlink()
                self._clear_report()
                self.spec.unlink()
            except OSError as error:
                raise file_error(
                    error.errno, f"cannot be removed: {error.strerror or error}", file=self.path
                ) from error

    def _clear_report(self) -> None:
        """Remove report.html and its charts, and the folder of the charts if nothing is left in it."""
        if _contains(self.report, _GENERATOR):
            self.report.unlink()
        if not self.figures.is_dir() or self.figures.is_symlink():
            return
        for image in list(self.figures.iterdir()):
            if image.suffix in _DRAWN and _contains(image, _DRAWN[image.suffix]):
                image.unlink()
        if not any(self.figures.iterdir()):
            self.figures.rmdir()

    def prepare(self, spec: StudySpec) -> None:
        """Create the folder, study.yaml, and the subfolder for runs, unless they exist.

        Calls that compute parts of the same study may do this at the same time: study.yaml appears with its whole
        content, and before any other file.

        Raises
        ------
        SpecError
            If another call has just begun another study in this folder.
        ResourceError
            If the system refuses a file or folder.
        """
        try:
            self.path.mkdir(exist_ok=True)
            if not self.spec.exists():
                begun = self.path / f"{_BEGUN}{secrets.token_hex(4)}"
                try:
                    text = write_yaml(spec.model_dump(mode="json", exclude_unset=True))
                    begun.write_text(text, encoding="utf-8")
                    with contextlib.suppress(FileExistsError, FileNotFoundError):  # another call was faster
                        rename_new(begun, self.spec)
                finally:
                    begun.unlink(missing_ok=True)
            self._check_same(spec)  # it may have appeared since `check`
            if spec.members is not None and not (self.path / member_table.FILE).exists():
                member_table.write_members(spec, self.path)
            self.runs.mkdir(exist_ok=True)
        except OSError as error:
            raise file_error(error.errno, f"cannot be created: {error.strerror or error}", file=self.path) from error

    @contextlib.contextmanager
    def indexing(self) -> Iterator[None]:
        """Hold an exclusive lock on the index, after waiting for other calls that write it."""
        if sys.platform == "win32":
            yield
            return
        import fcntl

        handle = os.open(self.runs, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield
        finally:
            os.close(handle)

    @contextlib.contextmanager
    def locked(self, shard: Shard | None = None) -> Iterator[None]:
        """Lock the folder against other calls.

        Parameters
        ----------
        shard
            The part that is computed; calls for parts without runs in common may work at the same time.

        Raises
        ------
        ResourceError
            If another call holds the lock.
        """
        if sys.platform == "win32":
            yield
            return
        with folder_lock.locked(self.path, self.spec, shard or WHOLE):
            if shard is None:
                for begun in self.path.glob(f"{_BEGUN}*"):  # of a call that was killed
                    begun.unlink(missing_ok=True)
                for jobs in self.path.glob(f"{JOBS}*"):
                    shutil.rmtree(jobs, ignore_errors=True)
            yield


def _contains(path: Path, mark: bytes) -> bool:
    """Return whether a regular file has a mark of mbdkit near its beginning."""
    if not path.is_file() or path.is_symlink():
        return False
    with path.open("rb") as file:
        return mark in file.read(4096)
