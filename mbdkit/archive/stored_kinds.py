"""Kinds of quantities in an archive; those of plugins that are not installed are read from its own axes and units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import h5py

from mbdkit.archive.fingerprint import is_text
from mbdkit.archive.hdf5 import dims
from mbdkit.archive.missing_plugins import missing_plugins
from mbdkit.base.errors import MissingPartError, PluginError
from mbdkit.base.parts import GROUPS_OF_PARTS
from mbdkit.base.text import listed, shown
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array, Kind
from mbdkit.quantities.registered_kinds import added_kinds, kind_of_group, kinds, order_of
from mbdkit.registry.manager import log


def kinds_of_file(file: h5py.File) -> Mapping[str, Kind]:
    """Return the kinds of an archive by group: those of the core, and those of plugins whose groups it has.

    A warning names the plugins that are missing, or that do not provide the kind.
    """
    known = {kind.group: kind for kind in kinds()}
    missing: dict[str, str] = {}
    for group in added_kinds():
        if group in file:
            try:
                known[group] = kind_of_group(group)
            except PluginError as error:
                missing[group] = str(error)
    missing |= reasons_for_missing(file)
    for reason in dict.fromkeys(missing.values()):
        _warn(str(file.filename), tuple(group for group, why in missing.items() if why == reason), reason)
    known |= {group: _stored(file[group]) for group in missing}
    if "accuracy" in file:
        core = known["accuracy"]
        arrays = (
            array for item in file["accuracy"].values() if isinstance(item, h5py.Dataset) and (array := _array(item))
        )
        further = tuple(array for array in arrays if array.path not in core.by_path)
        known["accuracy"] = replace(core, arrays=(*core.arrays, *further))
    return {group: known[group] for group in sorted(known, key=order_of)}


@lru_cache(maxsize=64)
def _warn(path: str, groups: tuple[str, ...], reason: str) -> None:
    """Say, once for each file, which groups are read without the plugin that wrote them."""
    text = "mbdkit: warning: %s: %s as the file describes %s, without the plugin that wrote %s: %s"
    words = ("the groups {} are read", "them") if len(groups) > 1 else ("the group {} is read", "it")
    read = words[0].format(listed([shown(group) for group in groups], "and"))
    log.warning(text, shown(path), read, words[1], words[1], reason)


def reasons_for_missing(file: h5py.File) -> Mapping[str, str]:
    """Return the groups of plugins that are not installed, and for each a clause that says what is missing."""
    present = [group for group, item in file.items() if isinstance(item, h5py.Group) and group not in added_kinds()]
    parts = {
        group: str(MissingPartError("it", GROUPS_OF_PARTS[group])) for group in present if group in GROUPS_OF_PARTS
    }
    if "provenance" not in file:
        return parts
    needed = {plugin.group: plugin.advice for plugin in missing_plugins(dict(file["provenance"].attrs)) if plugin.group}
    return parts | {group: needed[group] for group in present if group in needed}


def _stored(group: h5py.Group) -> Kind:
    name = group.name.lstrip("/")
    every = [array for item in group.values() if isinstance(item, h5py.Dataset) and (array := _array(item))]
    scales = {array.name for array in every if array.is_scale}
    arrays = tuple(array for array in every if scales.issuperset(array.dims))
    axis = next((array.dims[1] for array in arrays if array.dims[0] == "time" and array.dims[1:]), "")
    return Kind(arrays, word=name, one=axis or name, axis=axis, is_optional=True, may_be_unknown=True)


def _array(dataset: h5py.Dataset) -> Array | None:
    """Return an array as the file describes it; None if it is of no type that archives have."""
    dtype = TEXT if is_text(dataset) else dataset.dtype.str
    if dtype not in (TEXT, FLOAT, INTEGER) or not dataset.shape:
        return None
    name, axes = dataset.name.rpartition("/")[2], dims(dataset)
    units, long_name, row_units = (str(dataset.attrs.get(key, "")) for key in ("units", "long_name", "row_units"))
    is_label = dtype == TEXT and axes != (name,)
    label = ("units" if name == "row_units" else name) if is_label else ""
    return Array(dataset.name.lstrip("/"), axes, units, long_name, dtype, row_units, optional=True, label=label)
