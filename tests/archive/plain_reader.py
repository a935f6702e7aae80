"""A reader of files of results in h5py and NumPy, written from `schemas/archive.md` and `schemas/block.md` alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np


def read(path: Path) -> dict[str, Any]:
    """Return attributes of a file of any kind, axes and units of its arrays, and the largest force of each joint."""
    with h5py.File(path) as file:
        version = file.attrs["format_version"]
        if not version.startswith("1."):
            raise ValueError(f"{path} has version {version} of its format")
        names = ("format", "title", "status", "verdict")
        found: dict[str, Any] = {name: file.attrs.get(name, "-") for name in names}
        arrays: dict[str, Any] = {}
        file.visititems(lambda name, item: add_array(arrays, name, item))
        return found | {"arrays": arrays, "forces": largest_forces(file)}


def add_array(arrays: dict[str, Any], name: str, item: h5py.Group | h5py.Dataset) -> None:
    if isinstance(item, h5py.Dataset):
        units: Any = item.attrs["units"]
        if units == "mixed":
            units = item.parent[item.attrs["row_units"]].asstr()[:].tolist()
        arrays[name] = [scale[0].name if len(scale) else item.name for scale in item.dims], units


def largest_forces(file: h5py.File) -> dict[str, float]:
    """Return the largest force of each joint in all rows, of a block in those of all runs; nan without rows."""
    if "joints/reaction_force" not in file:
        return {}
    names, forces = file["joints/joint"].asstr()[:].tolist(), file["joints/reaction_force"][:]
    sizes = np.linalg.norm(forces, axis=-1).reshape(-1, max(1, len(names)))
    return dict(zip(names, np.fmax.reduce(sizes, axis=0, initial=np.nan).tolist(), strict=False))
