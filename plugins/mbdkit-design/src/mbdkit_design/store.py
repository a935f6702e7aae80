"""The folder of a design: its spec, the points it has evaluated, its result, and archives of the start and best point.

- ``design.yaml``: the spec, with its bases written out;
- ``points.jsonl``: a line for each evaluated scenario and point, from which the next call continues;
- ``design.json``: the result;
- ``start.h5``, ``best.h5``: archives of the start and of the best point, for each scenario if there are several;
- ``report.html``: the page of ``mbdkit design --report``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

from mbdkit.archive.part_file import remove_checkpoint
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.base.errors import ArchiveError, SpecError
from mbdkit.base.files import replacing
from mbdkit.base.plain_data import canonical_text
from mbdkit.runs.run_seams import computed_run
from mbdkit.spec.loading import read_source
from mbdkit.spec.reading import variable_path
from mbdkit.spec.run_spec import RunSpec
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_design.design import Design
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.evaluation import ScenarioRuns
from mbdkit_design.known_points import NOT_READ, DesignPoint, read_versioned
from mbdkit_design.trust import check_of
from mbdkit_studies import OwnedFolder

VERSION = "mbdkit_result"  #: Name of the format version in the result.
HASH = "sha256"  #: Name of the hash of the spec and of everything else in the result.
WHICH = ("start", "best")  #: Points for which archives are written.


class DesignFolder(OwnedFolder[DesignSpec]):
    """Paths in the folder of a design, and its lock."""

    KIND = "design"

    def __init__(self, path: Path):
        self.points = path / "points.jsonl"
        self.result = path / "design.json"
        super().__init__(path, self.points, self.result)

    def archive(self, which: str, scenario: str) -> Path:
        """Return the path of the archive of a point, ``start`` or ``best``, in a scenario."""
        return self.path / (f"{which}-{scenario}.h5" if scenario else f"{which}.h5")

    def is_same(self, spec: DesignSpec) -> bool:
        """See `OwnedFolder.is_same`."""
        return canonical_text(written_out(load_design_spec(self.spec))) == canonical_text(written_out(spec))

    def plain_spec(self, spec: DesignSpec) -> dict[str, object]:
        """See `OwnedFolder.plain_spec`."""
        return written_out(spec)

    def remove_results(self) -> None:
        """Remove the archives of the start and of the best point."""
        scenarios = read_source(self.spec).data.get("scenarios")
        names = [str(name) for name in scenarios] if isinstance(scenarios, dict) and scenarios else [""]
        for archive in (self.archive(which, name) for which in WHICH for name in names):
            if archive.parent == self.path and not archive.is_dir():
                archive.unlink(missing_ok=True)

    def read(self) -> Design:
        """Return the design and its result.

        Raises
        ------
        SpecError
            If the folder contains no design, or if its result is missing or is not that of the design.
        """
        if not self.spec.is_file():
            raise SpecError("this folder contains no design (no design.yaml)", file=self.path)
        spec = load_design_spec(self.spec)
        if not self.result.is_file():
            message = "this design has no result yet; `mbdkit design` with the same spec and this folder continues it"
            raise SpecError(message, file=self.path)
        data = read_versioned(self.result.read_bytes(), VERSION, self.result)
        if data and data.pop(HASH, "") != _hash_of(spec, data):
            message = "it, or design.yaml beside it, has changed since it was written; remove it and repeat the design"
            raise ArchiveError(message, file=self.result)
        try:
            return Design.from_dict(spec, data)
        except NOT_READ:
            raise SpecError("this is not the result of the design.yaml beside it", file=self.result) from None

    def write(self, design: Design) -> None:
        """Write archives of the start and of the best point and then the result."""
        for which in WHICH:
            self._write_archives(design, which)
        self.write_result(design)

    def write_result(self, design: Design) -> None:
        """Write the result alone."""
        data = json.loads(json.dumps({VERSION: 1, **design.to_dict()}))
        with replacing(self.result) as temporary:
            text = json.dumps({**data, HASH: _hash_of(design.spec, data)}, indent=2) + "\n"
            temporary.write_text(text, encoding="utf-8", newline="\n")

    def _write_archives(self, design: Design, which: str) -> None:
        """Write the archives of a point, with the estimated errors of their runs."""
        point: DesignPoint = getattr(design, which)
        settings = [(variable_path(name), value) for name, value in point.variables.items()]
        for name, scenario in design.spec.specs.items():
            spec = ScenarioRuns(scenario).at([*settings, *check_of(scenario)])
            path = self.archive(which, name)
            with computed_run.of(spec.spec_kind.compute)(spec, path=path, overwrite=True) as run:
                interrupted = run.status == "interrupted"
            if interrupted:
                path.unlink()
                remove_checkpoint(path)
                raise KeyboardInterrupt


@contextmanager
def runs_of(design: Design, folder: Path) -> Iterator[dict[str, dict[str, Run]]]:
    """Open the archives of a design: the runs at the ``start`` and at the ``best`` point by scenario."""
    store = DesignFolder(folder)
    with ExitStack() as stack:
        yield {
            name: {which: stack.enter_context(load(store.archive(which, name))) for which in WHICH}
            for name in design.spec.specs
        }


def _hash_of(spec: DesignSpec, data: Mapping[str, object]) -> str:
    return sha256(json.dumps([written_out(spec), data]).encode()).hexdigest()


def written_out(spec: DesignSpec) -> dict[str, object]:
    """Return a design as plain data that refer to no other spec: each scenario contains its base with all overrides."""
    data: dict[str, Any] = spec.model_dump(mode="json", exclude_unset=True)
    data.pop("overrides", None)
    bases = {name: _base(one) for name, one in spec.specs.items()}
    if not spec.scenarios:
        return data | {"base": bases[""]}
    data.pop("base", None)
    return data | {"scenarios": {n: {"base": bases[n], "weight": one.weight} for n, one in spec.scenarios.items()}}


def _base(spec: RunSpec | InverseSpec) -> dict[str, object]:
    """Return the spec of a scenario as plain data, without the measures, which the design defines."""
    assert spec._document is not None
    data = {key: value for key, value in spec._document.data.items() if key != "measures"}
    if isinstance(spec, InverseSpec):
        data["motion"] = _with_absolute_file(data["motion"], spec.folder)
        if data.get("loads"):
            data["loads"] = {name: _with_absolute_file(load, spec.folder) for name, load in data["loads"].items()}
    return data


def _with_absolute_file(section: dict[str, Any], folder: Path) -> dict[str, object]:
    """Return a section in which the file name does not depend on the folder of the spec."""
    file = section.get("file")
    return section if file is None else section | {"file": os.path.abspath(folder / file)}
