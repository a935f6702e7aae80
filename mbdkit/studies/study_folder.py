"""The folder of a study: study.yaml, runs/, index.h5; one study a folder, one call at work in it."""

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
    """The names in a study's folder.

    Parameters
    ----------
    path
        The folder.
    """

    def __init__(self, path: Path):
        self.path = path
        self.spec = path / "study.yaml"
        self.runs = path / "runs"
        self.index = path / "index.h5"

    def archive(self, run_id: str) -> Path:
        """Return where the archive of a run lies, or would."""
        return self.runs / f"{run_id}.h5"

    def check(self, spec: StudySpec) -> None:
        """Check, without touching anything, that this study may work here.

        Raises
        ------
        SpecError
            If the folder belongs to another study or holds other things, or cannot be made.
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
            raise SpecError("this is not a folder; a study fills a folder, named with -o", file=path)
        if not os.access(path, os.W_OK | os.X_OK):
            raise SpecError("this folder cannot be written to", file=path)
        if self.spec.is_file():
            if load_study_spec(self.spec).sha256() != spec.sha256():
                raise SpecError(
                    "this folder belongs to another study, or to an earlier state of this one: its study.yaml differs; "
                    "choose another folder with -o",
                    file=path,
                )
        elif any(path.iterdir()):
            raise SpecError("this folder holds other things and no study.yaml; choose another with -o", file=path)

    def prepare(self, spec: StudySpec) -> None:
        """Make what is missing of the folder, its study.yaml included."""
        self.runs.mkdir(parents=True, exist_ok=True)
        if not self.spec.exists():
            part = self.spec.with_name("study.yaml.part")
            part.write_text(write_yaml(spec.model_dump(mode="json", exclude_unset=True)), encoding="utf-8")
            os.replace(part, self.spec)

    @contextlib.contextmanager
    def indexing(self) -> Iterator[None]:
        """Wait until no other part of the study writes the index, and keep them from it."""
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
        """Keep other calls out of the folder while this one works in it.

        Parameters
        ----------
        shared
            Let in others that share it too: those that compute other parts of the same study.

        Raises
        ------
        SpecError
            If another call is at work here.
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
                    "another `mbdkit study` is at work in this folder; wait for it", file=self.path
                ) from None
            yield
