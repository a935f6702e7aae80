"""The folder of a study (study.yaml, runs/, index.h5), with locks against concurrent use."""

from __future__ import annotations

import os
import re
from pathlib import Path

from mbdkit.base.errors import SpecError
from mbdkit_studies.folder import member_table
from mbdkit_studies.folder.owned_folder import OwnedFolder, contains
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.spec.study_spec import StudySpec

#: Names of archives of runs (see `RunSpec.run_id`) and blocks, of their unfinished files and checkpoints, and of marks
#: and pieces of blocks.
_ARCHIVE = re.compile(
    r"([0-9a-f]{16}|block-[0-9]{6,})\.h5(\.checkpoint|\.part(\.checkpoint(\.new)?)?)?"
    r"|\.block-[0-9]{6,}\.(at|piece-[0-9]+)"
)

#: Text that every chart of a report contains near its beginning, by suffix; see the metadata in plot/style.py.
_DRAWN = {".png": b"Software\0mbdkit", ".svg": b"<dc:title>mbdkit</dc:title>"}


class StudyFolder(OwnedFolder[StudySpec]):
    """Paths in the folder of a study, and its locks."""

    KIND = "study"

    def __init__(self, path: Path):
        self.index = path / "index.h5"
        super().__init__(path, self.index, path / member_table.FILE)
        self.runs = path / "runs"
        self.figures = path / "figures"

    def archive(self, run_id: str) -> Path:
        """Return the path of the archive of a run, whether it exists or not."""
        return self.runs / f"{run_id}.h5"

    def block(self, number: int) -> Path:
        """Return the path of a block of runs, counted from 0, whether it exists or not."""
        return self.runs / f"block-{number:06d}.h5"

    def check(self, spec: StudySpec, *, overwrite: bool = False) -> None:
        """See `OwnedFolder.check`; also check that no file has the name of the subfolder for runs."""
        super().check(spec, overwrite=overwrite)
        if os.path.lexists(self.runs) and not os.path.isdir(self.runs):
            raise SpecError(
                "this is not a folder, but the study needs a folder of this name for its runs; rename or remove it",
                file=self.runs,
            )

    def is_same(self, spec: StudySpec) -> bool:
        """See `OwnedFolder.is_same`."""
        return load_study_spec(self.spec).sha256() == spec.sha256()

    def plain_spec(self, spec: StudySpec) -> dict[str, object]:
        """See `OwnedFolder.plain_spec`."""
        return spec.model_dump(mode="json", exclude_unset=True)

    def remove_results(self) -> None:
        """Remove the archives of runs, and the charts of the report; other images remain."""
        for path in [*self.runs.iterdir()] if self.runs.is_dir() else ():
            if _ARCHIVE.fullmatch(path.name) and not path.is_dir():
                path.unlink()
        if not self.figures.is_dir() or self.figures.is_symlink():
            return
        for image in list(self.figures.iterdir()):
            if image.suffix in _DRAWN and contains(image, _DRAWN[image.suffix]):
                image.unlink()
        if not any(self.figures.iterdir()):
            self.figures.rmdir()

    def create_more(self, spec: StudySpec) -> None:
        """Create the table of members, if the study has one, and the subfolder for runs."""
        if spec.members is not None and not (self.path / member_table.FILE).exists():
            member_table.write_members(spec, self.path)
        self.runs.mkdir(exist_ok=True)
