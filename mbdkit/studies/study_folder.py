"""The folder of a study (study.yaml, runs/, index.h5), with locks against concurrent use."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from mbdkit.errors import SpecError
from mbdkit.spec.study_loading import load_study_spec
from mbdkit.spec.study_spec import StudySpec
from mbdkit.spec.yaml_reader import write_yaml


class StudyFolder:
    """Paths in the folder of a study, and its locks."""

    def __init__(self, path: Path):
        self.path = path
        self.spec = path / "study.yaml"
        self.runs = path / "runs"
        self.index = path / "index.h5"

    def archive(self, run_id: str) -> Path:
        """Return the path of the archive of a run, whether it exists or not."""
        return self.runs / f"{run_id}.h5"

    def check(self, spec: StudySpec) -> None:
        """Check that the folder can be used for this study, without changing anything.

        Raises
        ------
        SpecError
            If the folder belongs to another study, contains other files, or cannot be created or written to.
        """
        path = self.path
        if not os.path.lexists(path):
            parent = path.parent
            if not os.path.isdir(parent):
                raise SpecError(f"the folder {parent} does not exist; create it first", file=path)
            if not os.access(parent, os.W_OK | os.X_OK):
                raise SpecError(f"the folder {parent} cannot be written to", file=path)
            return
        if not os.path.isdir(path):
            raise SpecError("this is not a folder; name a folder for the study with -o", file=path)
        if not os.access(path, os.W_OK | os.X_OK):
            raise SpecError("this folder cannot be written to", file=path)
        if self.spec.is_file():
            if load_study_spec(self.spec).sha256() != spec.sha256():
                raise SpecError(
                    "this folder belongs to another study, or to an earlier version of this one: its study.yaml "
                    "differs; choose another folder with -o",
                    file=path,
                )
        elif any(path.iterdir()):
            raise SpecError(
                "this folder contains other files and no study.yaml; choose another folder with -o", file=path
            )

    def prepare(self, spec: StudySpec) -> None:
        """Create the folder, its subfolder for runs, and study.yaml, unless they exist."""
        self.runs.mkdir(parents=True, exist_ok=True)
        if not self.spec.exists():
            part = self.spec.with_name("study.yaml.part")
            part.write_text(write_yaml(spec.model_dump(mode="json", exclude_unset=True)), encoding="utf-8")
            os.replace(part, self.spec)

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
    def locked(self, *, shared: bool = False) -> Iterator[None]:
        """Lock the folder against other calls.

        Parameters
        ----------
        shared
            Share the lock with calls that compute other parts of the same study.

        Raises
        ------
        SpecError
            If another call holds the lock.
        """
        if sys.platform == "win32":
            yield
            return
        import fcntl

        with self.spec.open("rb") as handle:
            try:
                fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            except BlockingIOError:
                raise SpecError(
                    "another `mbdkit study` is running in this folder; wait until it ends", file=self.path
                ) from None
            yield
