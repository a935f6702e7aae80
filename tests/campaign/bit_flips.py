"""Bits of archives of every kind are changed, one at a time: ``python -m tests.campaign.bit_flips --flips 300``.

Half of the bits are drawn from the whole file, and half from what is no array of numbers: attributes, texts and the
tables of HDF5. A reader returns all that mbdkit reads of a file. Its answer must be an error of mbdkit, or the same as
before the change, where the bit belongs to nothing that is read. Another answer, another exception, or the end of the
process are failures.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import mbdkit
from mbdkit import MbdkitError, Run
from mbdkit.archive.identified_parameters import read_identified
from mbdkit_identify.archive import load_identification, write_identification
from tests.campaign.attack import in_child

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
    """Return the result of an identification."""
    return repr(vars(load_identification(path)))


def of_estimates(path: Path) -> str:
    """Return what other specs take from an identification."""
    return repr(read_identified(path))


def of_study(folder: Path) -> str:
    """Return the table and the stored runs of a study."""
    study = mbdkit.load_study(folder)
    runs = [
        (run.summary(), run.time.tolist(), run["rod1"].angle.tolist()) for _, run in study.runs() if run is not None
    ]
    return repr([study.to_frame().to_csv(), study.status, *runs])


def of_design(folder: Path) -> str:
    """Return the result of a design, and its best run."""
    return repr(mbdkit.load_design(folder).to_dict()) + of_run(folder / "best.h5")


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
    mbdkit.predict(motion).save(folder / "prediction.h5")
    found = {}
    for name in ("run", "inverse", "prediction"):
        found[name] = Kind(folder / f"{name}.h5", partial(of_run, folder / f"{name}.h5"))
    swing = {
        "mbdkit": 1, "model": {"name": "single-pendulum", "length": 1.0}, "integrator": {"name": "rk4"},
        "time": {"end": 2.0, "step": 0.05},
    }  # fmt: skip
    with mbdkit.run(swing) as run:
        noise = np.random.default_rng(1).normal(0.0, 0.01, len(run.time))
        table = np.column_stack([run.time, run["rod1"].angle + noise])
    np.savetxt(folder / "data.csv", table, delimiter=",", header="time,angle", comments="")
    experiment = {"file": str(folder / "data.csv"), "observed": {"rod1.angle": "angle"}}
    fit = {
        "mbdkit_identify": 1, "base": swing, "experiments": {"a": experiment},
        "parameters": {"model.length": {"bounds": [0.5, 2.0]}},
    }  # fmt: skip
    path = write_identification(mbdkit.identify(fit), folder / "fit.h5")
    found["identification"] = Kind(path, partial(of_identification, path))
    found["identification, from"] = Kind(path, partial(of_estimates, path))
    study = {
        "mbdkit_study": 1,
        "base": swing,
        "axes": [{"model.length": [1.0, 1.1]}],
        "measures": ["misalignment_max"],
    }
    for name, store in (("files", "files"), ("blocks", "histories")):
        mbdkit.study(study, out=folder / name, store=store, notify=lambda _: None)
        file = next((folder / name / "runs").glob("*.h5"))
        found[f"study, {name}"] = Kind(file, partial(of_study, folder / name))
        found[f"study, index of {name}"] = Kind(folder / name / "index.h5", partial(of_study, folder / name))
    design = {
        "mbdkit_design": 1, "base": swing, "variables": {"model.length": {"bounds": [1.0, 2.0]}},
        "minimize": "rms(rod1.angle)",
    }  # fmt: skip
    mbdkit.design(design, out=folder / "design")
    for file in ("design.json", "best.h5"):
        found[f"design, {file}"] = Kind(folder / "design" / file, partial(of_design, folder / "design"))
    return found


def places(file: Path, count: int, dice: np.random.Generator) -> list[int]:
    """Return numbers of bits, of which half are not in arrays of numbers."""
    size = file.stat().st_size
    is_number = np.zeros(size, bool)
    if file.suffix == ".h5":
        with h5py.File(file) as opened:

            def mark(_: str, item: object) -> None:
                if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu" and item.id.get_offset() is not None:
                    start = item.id.get_offset()
                    is_number[start : start + item.nbytes] = True

            opened.visititems(mark)
    others = np.flatnonzero(~is_number)
    half = count // 2
    chosen = np.concatenate([dice.integers(size, size=half), dice.choice(others, count - half)])
    return (8 * chosen + dice.integers(8, size=count)).tolist()


def outcome(kind: Kind, before: str) -> str:
    """Return how a reader answers: refused, unchanged, changed, or an exception."""
    try:
        return "unchanged" if kind.read() == before else "changed"
    except MbdkitError as error:
        return "refused" if "\n" not in str(error) else "more than a sentence"
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def flipped(kind: Kind, count: int, seed: int = 1) -> Counter[str]:
    """Return how often a reader answers how to single bits that were changed."""
    content, before = kind.file.read_bytes(), in_child(kind.read).value
    found: Counter[str] = Counter()
    for bit in places(kind.file, count, np.random.default_rng(seed)):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        kind.file.write_bytes(changed)
        ending = in_child(outcome, kind, before)
        found[ending.value if ending.value is not None else f"ended with {ending.exit_status}"] += 1
    kind.file.write_bytes(content)
    return found


def main() -> None:
    """Print the answers for each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flips", type=int, default=300)
    parser.add_argument("--kinds", nargs="*")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name, kind in kinds(Path(folder)).items():
            if not asked.kinds or name in asked.kinds:
                print(f"{name}: {dict(flipped(kind, asked.flips))}", flush=True)


if __name__ == "__main__":
    main()
