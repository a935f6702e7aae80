"""Bits of archives of every kind are changed, one at a time: ``python -m tests.archive.bit_flips --flips 300``.

Half of the bits are drawn from the whole file, and half from what is no array of numbers: attributes, texts and the
tables of HDF5. A reader returns all that mbdkit reads of a file. Its answer must be an error of mbdkit, or the same as
before the change, where the bit belongs to nothing that is read. Another answer, another exception, or the end of the
process are failures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import mbdkit
from mbdkit import Run

SHORT = {"end": 0.2, "step": 0.02}


@dataclass(frozen=True)
class Kind:
    """An archive, and a function that reads it."""

    file: Path
    read: Callable[[], str]


def contents(run: Run) -> str:
    """Return all arrays and attributes of a run but the addresses of dimension scales, as text."""
    items: list[tuple[str, Any]] = [("", run.file)]
    run.file.visititems(lambda path, item: items.append((path, item)))
    found: list[object] = [run.summary(), run.verdict]
    for path, item in items:
        found += [(path, name, str(item.attrs[name])) for name in item.attrs if not name.endswith("_LIST")]
        if isinstance(item, h5py.Dataset):
            values = (item.asstr() if h5py.check_string_dtype(item.dtype) else item)[()]
            found.append((path, str(item.dtype), item.shape, values.tolist()))
            found.append([scale.name for dim in item.dims for scale in dim.values()])
    return repr(found)


def of_run(path: Path) -> str:
    """Return the contents of the archive of a run."""
    with mbdkit.load(path) as run:
        return contents(run)


def of_identification(path: Path) -> str:
    """Return the result of an identification, and what another spec takes from it."""
    body = {"mass": "1 + 0*friction", "inertia": "inertia"}
    spec = mbdkit.RunSpec(
        mbdkit=1, parameters={"from": str(path)}, time=SHORT, integrator={"name": "rk4"},
        model={"name": "mechanism", "bodies": {"b": body}},
    ) if False else None  # fmt: skip
    found = mbdkit.load_identification(path)
    return repr([vars(found), spec])


def of_study(folder: Path) -> str:
    """Return the table and the stored runs of a study."""
    study = mbdkit.load_study(folder)
    runs = [(run.summary(), run.time.tolist(), run["rod"].angle.tolist()) for _, run in study.runs() if run is not None]
    return repr([study.to_frame().to_csv(), study.status, *runs])


def of_design(folder: Path) -> str:
    """Return the result of a design."""
    return mbdkit.load_design(folder).summary()


def kinds(folder: Path) -> dict[str, Kind]:
    """Write an archive of each kind, and return them by name."""
    measures = {"pull": "max(abs(joints.J1.force))"}
    mbdkit.run("double-pendulum", time=SHORT, check=True, measures=measures).save(folder / "run.h5")
    mbdkit.run("squat").save(folder / "inverse.h5")
    model = {
        "name": "mechanism", "gravity": [0, 0],
        "bodies": {"block": {"mass": 1.0, "inertia": 1.0, "position": [0.0, 0.0]}},
        "joints": {"rail": {"type": "prismatic", "bodies": ["ground", "block"], "at": [0, 0], "axis": [1, 0]}},
        "forces": {"push": {"type": "force", "body": "block", "value": [0.0, 0.0]}},
    }  # fmt: skip
    motion = {
        "mbdkit_predict": 1, "base": {"mbdkit": 1, "model": model}, "duration": 1.0,
        "controls": {"forces.push.value[0]": {"bounds": [-200, 200]}}, "initial": {"block.x": 0, "block.vx": 0},
        "final": {"block.x": 1, "block.vx": 0}, "minimize": "integral(forces.push.value**2)",
    }  # fmt: skip
    mbdkit.predict(motion).run.save(folder / "prediction.h5")
    found = {}
    for name in ("run", "inverse", "prediction"):
        found[name] = Kind(folder / f"{name}.h5", partial(of_run, folder / f"{name}.h5"))
    times, random = np.linspace(0.0, 2.0, 41), np.random.default_rng(1)
    angle = mbdkit.run("pendulum", time={"end": 2.0, "step": 0.05})["rod"].angle
    np.savetxt(
        folder / "data.csv",
        np.c_[times, angle + random.normal(0, 0.01, 41)],
        delimiter=",",
        header="time,a",
        comments="",
    )
    fit = mbdkit.identify(
        {
            "mbdkit_identify": 1,
            "base": {
                "mbdkit": 1,
                "model": {"name": "pendulum", "length": 1.0},
                "time": {"end": 2.0, "step": 0.05},
                "integrator": {"name": "rk4"},
            },
            "experiments": {"a": {"file": str(folder / "data.csv"), "observed": {"rod.angle": "a"}}},
            "parameters": {"model.length": {"bounds": [0.5, 2.0]}},
        }
    )
    fit.save(folder / "fit.h5")
    found["identification"] = Kind(folder / "fit.h5", partial(of_identification, folder / "fit.h5"))
    return found
