"""The numbers of golden files, read in h5py and JSON alone, as `schemas/archive.md` and `schemas/block.md` describe."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tests.archive.plain_reader import largest_forces, read

Numbers = dict[str, Any]


def numbers(path: Path) -> Numbers:
    """Return what every reader must find in a file or a folder: JSON data, in which unknown numbers are null."""
    return plain(folder(path) if path.is_dir() else file(path))


def plain(value: Any) -> Any:
    """Return JSON data in place of arrays, numbers of NumPy and nan."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def file(path: Path) -> Numbers:
    with h5py.File(path) as opened:
        of_format: dict[str, Callable[[h5py.File], Numbers]] = {
            "mbdkit-run": run, "mbdkit-study": index, "mbdkit-block": block, "mbdkit-identification": identification,
            "mbdkit-members": members,
        }  # fmt: skip
        kind = opened.attrs["format"]
        header = read(path)
        found = {name: header[name] for name in ("title", "status", "verdict") if name in opened.attrs}
        return {"format": kind, **found, **of_format[kind](opened)}


def run(opened: h5py.File) -> Numbers:
    attributes, names = opened.attrs, opened["trajectory/body"].asstr()[:]
    measures, answers = json.loads(attributes.get("measures", "{}")), json.loads(attributes.get("answers", "[]"))
    spec = json.loads(attributes["spec"])
    return {
        "kind": "inverse" if "motion" in spec else "predicted" if "mbdkit_predict" in spec else "forward",
        "status_reason": attributes["status_reason"],
        "rows": len(opened["trajectory/time"]),
        "end": opened["trajectory/time"][-1],
        "measures": {name: measure["value"] for name, measure in measures.items()},
        "answers": {one["id"]: [one[key] for key in ("value", "unit", "lower", "upper")] for one in answers},
        "gradients": {name: one["derivatives"] for name, one in json.loads(attributes.get("gradients", "{}")).items()},
        "forces": largest_forces(opened),
        "positions": dict(zip(names, opened["trajectory/position"][-1], strict=True)),
        "events": list(opened["events/time"]) if "events" in opened else [],
        "spec_sha256": attributes["spec_sha256"],
        "data_sha256": attributes["data_sha256"],
    }


def columns(group: h5py.Group) -> Numbers:
    """Return columns of a table, in which texts may be indices into an array of texts, and hashes rows of bytes."""
    found = {}
    for name, item in group.items():
        texts = group[item.attrs["texts"]].asstr()[:] if "texts" in item.attrs else None
        values = item.asstr()[:] if h5py.check_string_dtype(item.dtype) else item[:]
        values = values if texts is None else texts[values]
        found[name] = [bytes(row).hex() for row in values] if "hash" in item.attrs else values
    return found


def index(opened: h5py.File) -> Numbers:
    group, found = opened["runs"], columns(opened["runs"])
    named = {group[name].attrs["name"]: values for name, values in found.items() if "role" in group[name].attrs}
    return {"columns": {name: values for name, values in named.items() if not name.endswith("_s")}}


def block(opened: h5py.File) -> Numbers:
    runs, rows = columns(opened["runs"]), opened["trajectory/rows"][:]
    kept = ("status", "verdict", "misalignment_max", "run_id", "spec_sha256", "data_sha256")
    return {
        "runs": {name: runs[name] for name in kept},
        "positions": [opened["trajectory/position"][number, last - 1] for number, last in enumerate(rows)],
        "measures": {name: values for name, values in columns(opened["measures"]).items() if name != "run"},
        "values": {item.attrs["key"]: item[:] for item in opened["values"].values() if "key" in item.attrs},
        "forces": largest_forces(opened),
    }


def members(opened: h5py.File) -> Numbers:
    return {item.attrs["key"]: item[:] for item in opened["members"].values() if "key" in item.attrs}


def identification(opened: h5py.File) -> Numbers:
    group = columns(opened["parameters"])
    names = ("parameter", "value", "deviation", "lower", "upper", "unit", "covariance")
    return {
        **{name: opened.attrs[name] for name in ("level", "cost", "log_likelihood")},
        **{name: group[name] for name in names},
        "covered": {item.attrs["quantity"]: item.attrs["covered"] for item in opened["residuals"].values()},
    }


def folder(path: Path) -> Numbers:
    """Return the numbers of a study, a design or a crate."""
    found = {str(one.relative_to(path).as_posix()): file(one) for one in sorted(path.rglob("*.h5"))}
    if (path / "design.json").is_file():
        design = json.loads((path / "design.json").read_text("utf-8"))
        found["design.json"] = {
            "best": design["best"]["variables"], "goals": design["best"]["goals"],
            "measures": design["best"]["measures"], "verdict": design["trust"]["verdict"],
        }  # fmt: skip
    if (path / "ro-crate-metadata.json").is_file():
        entities = json.loads((path / "ro-crate-metadata.json").read_text("utf-8"))["@graph"]
        found["ro-crate-metadata.json"] = {one["@id"]: one["name"] for one in entities if one["@type"] == "File"}
    return found
