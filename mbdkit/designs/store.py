"""The folder of a design: its result as JSON, and archives of the start and of the best point."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

from mbdkit.designs.design import Design, DesignPoint
from mbdkit.designs.evaluation import ScenarioRuns
from mbdkit.errors import SpecError
from mbdkit.files import check_folder, check_output, replacing
from mbdkit.inverse_dynamics.inverse_run import compute_run
from mbdkit.simulation import simulate
from mbdkit.spec import DesignSpec, RunSpec
from mbdkit.spec.design_spec import variable_path

RESULT = "design.json"
PAGE = "report.html"


def check_folder_of(spec: DesignSpec, folder: Path, *, overwrite: bool, with_report: bool = False) -> None:
    """Raise SpecError or ResourceError unless the results of a design can be written into a folder.

    Parameters
    ----------
    overwrite
        Whether files of an earlier design may be replaced.
    with_report
        Whether a report is written too.
    """
    if not os.path.lexists(folder):
        check_folder(folder.parent, folder)
        return
    if not os.path.isdir(folder):
        raise SpecError("this is not a folder; name another one with -o", file=folder)
    names = [
        RESULT,
        *([PAGE] if with_report else []),
        *(archive_name(which, name) for which in ("start", "best") for name in spec.situations),
    ]
    for name in names:
        check_output(folder / name, overwrite=overwrite)


def write(design: Design, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write a design into its folder, which is created, and return the files.

    ``design.json`` is the result. ``start.h5`` and ``best.h5`` are the runs at the start and at the best point; their
    names contain that of the scenario if the design has scenarios.
    """
    folder.mkdir(exist_ok=True)
    files = [path for which in ("start", "best") for path in _archives(design, which, folder, overwrite)]
    result = folder / RESULT
    with replacing(result, overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(design.to_dict(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return [result, *files]


def _archives(design: Design, which: str, folder: Path, overwrite: bool) -> Iterator[Path]:
    """Write the archives of a point, and yield their names."""
    point: DesignPoint = getattr(design, which)
    settings = [(variable_path(name), value) for name, value in point.variables.items()]
    for name, scenario in design.spec.specs.items():
        spec, path = ScenarioRuns(scenario).at(settings), folder / archive_name(which, name)
        run = (
            simulate(spec, path=path, overwrite=overwrite)
            if isinstance(spec, RunSpec)
            else compute_run(spec, path=path, overwrite=overwrite)
        )
        run.close()
        yield path


def archive_name(which: str, scenario: str) -> str:
    """Return the name of the archive of a point, ``start`` or ``best``, in a scenario."""
    return f"{which}-{scenario}.h5" if scenario else f"{which}.h5"
