"""Describes the content of an archive as a dictionary or as plain text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py

from mbdkit.archive.archive_check import blaming_damage
from mbdkit.archive.fingerprint import datasets, is_text
from mbdkit.archive.hdf5 import dims
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.layout import STATS
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_summary import corrections
from mbdkit.base.text import shown
from mbdkit.quantities.array import TEXT

#: Largest number of items of a list that are printed.
NAMES_SHOWN = 32


_ATTRIBUTES = ("format_version", "run_id", "created_utc", "status", "status_reason")


def describe(path: str | Path) -> dict[str, Any]:
    """Describe a run archive by JSON-compatible values.

    Returns identity and status of the run; title, model, integrator, formulation and stabilization of its spec; names
    of bodies, joints, force elements, markers and events; number of elements of each beam; statistics, provenance and
    hashes; dimensions, shape, type and units of each array. Raises SpecError if `path` is not an archive that this
    version can read. Raises ResourceError if a run is still writing the file, or the system refuses to read it.
    """
    path = Path(path)
    with blaming_damage(path), load(path) as run, reading("its contents", path):
        time, beams = run.time, _elements(run, "beams/beam")
        return {
            "path": str(path),
            "bytes": path.stat().st_size,
            **{name: getattr(run, name) for name in _ATTRIBUTES},
            "verdict": run.verdict if run.is_judged else "unknown: not judged",
            "verdict_reasons": run.verdict_reasons,
            "warnings": run.warnings,
            "title": run.spec.get("title") or "",
            **{name: run.spec.get(name) for name in ("model", "integrator", "formulation", "stabilization")},
            "corrections": corrections(run),
            "accuracy": run.errors.sentence(),
            "rows": len(time),
            "start": float(time[0]) if len(time) else None,
            "end": float(time[-1]) if len(time) else None,
            "bodies": list(run.bodies),
            "joints": {name: " - ".join(joint.bodies) for name, joint in run.joints.items()},
            "misalignment_max": {
                name: None if math.isnan(joint.misalignment_max) else joint.misalignment_max
                for name, joint in run.joints.items()
            },
            "forces": {name: " - ".join(run.forces[name].bodies) for name in _elements(run, "forces/force")},
            "markers": {name: run.markers[name].body for name in _elements(run, "markers/marker")},
            "beams": {name: beams.count(name) for name in dict.fromkeys(beams)},
            "redundancy": run.redundancy,
            "events": [f"{event.name} at {event.time:.10g} s" for event in run.events],
            "stats": {name: run.stats[name] for name in STATS if name in run.stats},
            "provenance": dict(run.provenance),
            "spec_sha256": run.spec_sha256,
            "data_sha256": run.data_sha256,
            "arrays": {dataset.name.lstrip("/"): _array(dataset) for dataset in datasets(run.file)},
        }


def _elements(run: Run, path: str) -> list[str]:
    return [str(name) for name in run.array(path)] if run.records(path) else []


def _array(dataset: h5py.Dataset) -> dict[str, object]:
    return {
        "dims": list(dims(dataset)),
        "shape": list(dataset.shape),
        "type": TEXT if is_text(dataset) else dataset.dtype.str,
        "units": str(dataset.attrs.get("units", "")),
        "long_name": str(dataset.attrs.get("long_name", "")),
        "not_unique": str(dataset.attrs.get("not_unique", "")),
    }


def text(description: Mapping[str, Any]) -> str:
    """Format a description as plain text, with a table of the arrays."""
    lines = []
    for name, value in description.items():
        if name == "arrays":
            continue
        if isinstance(value, Mapping):
            joined = "{} ({})" if name == "joints" else "{} {}"
            value = _few([joined.format(key, _plain(item)) for key, item in value.items() if item is not None])
        elif isinstance(value, list):
            value = _few(value)
        if value not in ("", None):
            lines.append(f"{name:<17} {_plain(value)}")
    arrays = description["arrays"]
    width = max(map(len, arrays), default=0)
    for path, array in arrays.items():
        axes = ", ".join(f"{dim} {length}" for dim, length in zip(array["dims"], array["shape"], strict=True))
        not_unique = ", not unique" if array["not_unique"] else ""
        lines.append(shown(f"{path:<{width}}  ({axes})  {array['units']}{not_unique}"))
    return "\n".join(lines)


def _few(words: Sequence[str]) -> str:
    more = f", ... ({len(words)} in all)" if len(words) > NAMES_SHOWN else ""
    return ", ".join(words[:NAMES_SHOWN]) + more


def _plain(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else shown(value)
