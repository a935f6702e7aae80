"""Checks a run archive against the layout and its stored hashes; each problem is reported as one sentence."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import cast

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.fingerprint import StoredHashes, blocks, datasets, is_text, spec_sha256
from mbdkit.archive.hdf5_errors import DAMAGE, cause
from mbdkit.archive.layout import FORMAT_VERSION
from mbdkit.archive.result_seams import file_problems
from mbdkit.archive.result_table import ResultTable, is_table
from mbdkit.archive.run import Run
from mbdkit.archive.run_header import open_archive
from mbdkit.archive.stored_kinds import kinds_of_file
from mbdkit.base.errors import ArchiveError, MbdkitError, SpecError
from mbdkit.base.plain_data import json_data
from mbdkit.base.text import listed, one_line, shown
from mbdkit.quantities.array import FLOAT, TEXT, Array
from mbdkit.quantities.names import AXES, COORDINATES
from mbdkit.registry.feature_items import FileFormat
from mbdkit.registry.manager import registry
from mbdkit.spec.spec_kinds import kind_of
from mbdkit.trust.criteria import LEVELS


def check(path: str | Path) -> list[str]:
    """Check the structure, units, dimension scales, times, values and hashes of a run archive or a block of runs.

    Returns one sentence per problem; empty if the archive is valid. Raises ResourceError if a run is still writing the
    file, or the system refuses to read it.
    """
    path = Path(path)
    try:
        file = open_archive(path)
    except (SpecError, ArchiveError) as error:
        for item in registry().of_kind("file-format"):
            of_kind = cast(FileFormat, item.plugin).problems
            if of_kind is not None and (problems := file_problems.of(of_kind)(path)) is not None:
                return problems
        return [shown(error.message)]
    with contextlib.closing(file):
        problems = _Checker(file).problems()
    return problems or _unreadable(path)


@contextlib.contextmanager
def blaming_damage(*paths: Path) -> Iterator[None]:
    """Replace an unforeseen error in the body of a `with` statement if one of the archives `paths` is damaged.

    Raises ArchiveError in place of an error that is not an MbdkitError, with the first problem found by `check`.
    """
    try:
        yield
    except (MbdkitError, MemoryError):
        raise
    except Exception as error:
        for path in paths:
            if problems := check(path):
                message = f"this archive is damaged: {problems[0]}; `mbdkit archive check` says more"
                raise ArchiveError(message, file=path) from error
        raise


def _unreadable(path: Path) -> list[str]:
    """Return a list with the reason why `Run` cannot read an archive without other problems; empty if it can."""
    try:
        with Run.open(path) as run:
            run.summary()
    except MbdkitError as error:
        return [shown(error.message if isinstance(error, SpecError | ArchiveError) else str(error))]
    except MemoryError:
        raise
    except Exception as error:
        return [f"it cannot be summarized: {one_line(error)}"]
    return []


class _Checker:
    def __init__(self, file: h5py.File):
        self.file = file
        self.found: list[str] = []
        self.status = ""
        self.version = str(file.attrs.get("format_version"))
        self.spec: dict[str, object] = {}

    def problems(self) -> list[str]:
        with self.reading("the attributes of the arrays"):
            self.kinds = kinds_of_file(self.file)
        if self.found:
            return self.found
        with self.reading("the attributes of the file"):
            self.root()
        with self.reading("the groups"):
            arrays = self.expected()
            for array in arrays:
                with self.reading(array.path):
                    self.array(array)
            self.others(arrays)
        with self.reading("the tables"):
            ResultTable.of_file(self.file)
        with self.reading("time"):
            self.times()
        with self.reading("the events"):
            self.events()
            self.settings()
        with self.reading("the estimated errors"):
            self.accuracy()
        with self.reading("the names of axes"):
            self.names()
        with self.reading("misalignment_max"):
            self.misalignment()
        with self.reading("the statistics"):
            self.stats()
        if self.status != "running":
            with self.reading("the contents"):
                StoredHashes(self.file).verify()
        return self.found

    @property
    def is_integrated(self) -> bool:
        """Whether the run was integrated, so that its errors are envelopes, which do not decrease with time."""
        try:
            return kind_of(self.spec).is_integrated
        except SpecError:  # the part with the kind is not installed
            return False

    def say(self, sentence: str) -> None:
        self.found.append(shown(sentence))  # names and values come from the file

    @contextlib.contextmanager
    def reading(self, what: str) -> Iterator[None]:
        """Report a read error in the body of a `with` statement as a problem instead of raising it."""
        try:
            yield
        except DAMAGE as error:
            self.say(f"{what} cannot be read: {cause(error)}")

    def root(self) -> None:
        attributes = self.file.attrs
        values = {}
        for name in layout.ROOT_ATTRIBUTES:
            value = attributes.get(name)
            if not isinstance(value, str):
                self.say(f"the attribute {name} {'is missing' if value is None else 'is not a string'}")
            values[name] = value if isinstance(value, str) else ""
        self.verdict()
        self.status = values["status"]
        if self.status not in layout.STATUSES:
            self.say(f"status is {self.status!r}, not one of {', '.join(layout.STATUSES)}")
        if self.status == "running":
            self.say("the run did not end: it crashed or is still running, so there is no hash to check")
        code, _, sentence = values["status_reason"].partition(": ")
        if self.status == "complete" and code and (code != "event" or not sentence):
            self.say(f"a complete run has the status_reason {code!r}")
        if self.status == "failed" and not (re.fullmatch("[a-z]+(-[a-z]+)*", code) and sentence):
            self.say("status_reason of a failed run should be a code, a colon and a sentence")
        try:
            if not values["created_utc"].endswith("Z"):
                raise ValueError
            datetime.fromisoformat(values["created_utc"])
        except ValueError:
            self.say(f"created_utc is {values['created_utc']!r}, not a time such as 2025-01-31T12:00:00.000Z")
        if spec_sha256(values["spec"]) != values["spec_sha256"]:
            self.say("the spec has changed since it was written: spec_sha256 does not match")
        spec = None
        with contextlib.suppress(ValueError):
            spec = json_data(values["spec"])
        if isinstance(spec, dict):
            self.spec = spec
        else:
            self.say("the attribute spec does not contain a spec in JSON")

    def verdict(self) -> None:
        """Check the verdict, which archives of crashed runs lack."""
        attributes = self.file.attrs
        if not (present := [name for name in layout.VERDICT_ATTRIBUTES if name in attributes]):
            return
        if missing := [name for name in layout.VERDICT_ATTRIBUTES if name not in present]:
            self.say(f"the verdict is incomplete: there is no attribute {listed(missing, 'or')}")
        if "verdict" in present and attributes["verdict"] not in LEVELS:
            self.say(f"verdict is {attributes['verdict']!r}, not one of {', '.join(LEVELS)}")
        for name in layout.VERDICT_ATTRIBUTES[1:]:
            values = np.atleast_1d(attributes.get(name, ()))
            if not all(isinstance(value, str) for value in values):
                self.say(f"the attribute {name} does not hold strings")

    def expected(self) -> tuple[Array, ...]:
        """Return the arrays that the file should contain, according to its spec and the groups that it has."""
        output = self.spec.get("output")
        asked = output.get("quantities", "all") if isinstance(output, dict) else "all"
        wanted = layout.QUANTITIES if asked == "all" or not isinstance(asked, list) else frozenset(map(str, asked))
        present = {name for name in layout.QUANTITIES if name in self.file and name != "joints"}
        if "joints" in self.file and any(f"joints/{name}" not in layout.ALWAYS for name in self.file["joints"]):
            present.add("joints")
        known = tuple(self.kinds.values())
        every = (array for kind in known for array in kind.arrays)
        extra = frozenset(array.path for array in every if array.optional and array.path in self.file)
        if self.spec.get("events") or "events" in self.file:
            extra |= frozenset(layout.EVENTS)
        if "accuracy" in self.file:
            extra |= frozenset(layout.ACCURACY)
        always = frozenset(kind.group for kind in known if not kind.is_optional)
        return layout.recorded((wanted & layout.QUANTITIES & always) | present, extra, known)

    def array(self, array: Array) -> None:
        path, dataset = array.path, self.file.get(array.path)
        if dataset is None and self.status == "running" and array.grows:
            return  # the run crashed before its first flush
        if not isinstance(dataset, h5py.Dataset):
            self.say(f"{path} is missing")
            return
        dtype = TEXT if is_text(dataset) else dataset.dtype.str
        if dtype != array.dtype:
            self.say(f"{path} has the type {dtype}, not {array.dtype}")
        for name, value in (("units", array.units), ("long_name", array.long_name), ("row_units", array.row_units)):
            there = dataset.attrs.get(name, "")
            reworded = name == "long_name" and self.version != FORMAT_VERSION
            if there != value and not reworded:
                self.say(f"{name} of {path} is {there!r}, not {value!r}")
        if dataset.ndim != len(array.dims):
            self.say(f"{path} has {dataset.ndim} axes, not {len(array.dims)}")
            return
        if array.is_scale:
            if not dataset.is_scale:
                self.say(f"{path} is not a dimension scale")
        else:
            self.scales(array, dataset)
        unknown_is_nan = self.kinds[array.group].may_be_unknown
        must_be_finite = self.status != "running" and dtype == FLOAT and not unknown_is_nan
        if must_be_finite and (bad := sum(int(np.count_nonzero(~np.isfinite(block))) for block in blocks(dataset))):
            self.say(f"{path} has {bad} values that are not finite")

    def scales(self, array: Array, dataset: h5py.Dataset) -> None:
        for axis, dim in enumerate(array.dims):
            scale = self.file.get(f"{array.group}/{dim}")
            if not isinstance(scale, h5py.Dataset):
                continue  # reported as missing already
            attached = dataset.dims[axis].values()
            if len(attached) != 1 or attached[0] != scale:
                self.say(f"axis {axis} of {array.path} is not attached to its scale {array.group}/{dim}")
            if scale.shape[:1] != dataset.shape[axis : axis + 1]:
                self.say(
                    f"axis {axis} of {array.path} has the length {dataset.shape[axis]}, its scale {array.group}/{dim} "
                    f"{scale.shape[0] if scale.ndim else 'none'}"
                )

    def others(self, arrays: tuple[Array, ...]) -> None:
        if self.version != FORMAT_VERSION:
            return  # later 1.x versions may add arrays
        known = {array.path for array in arrays}
        for dataset in datasets(self.file):
            if dataset.name.lstrip("/") not in known and not is_table(dataset.parent):
                self.say(f"{dataset.name.lstrip('/')} is not part of the layout")

    def times(self) -> None:
        if "trajectory/time" not in self.file:
            return
        time = self.file["trajectory/time"][:]
        if np.any(np.diff(time) <= 0):
            self.say("trajectory/time does not increase from row to row")
        for group, kind in sorted(self.kinds.items()):
            timed = any(array.key == "time" for array in kind.arrays)
            if timed and f"{group}/time" in self.file and not np.array_equal(self.file[f"{group}/time"][:], time):
                self.say(f"{group}/time differs from trajectory/time")
        for path in ("trajectory/elapsed_s", "events/time", "inputs/set/instant"):
            if path in self.file and np.any(np.diff(self.file[path][:]) < 0):
                self.say(f"{path} decreases")
        for path in ("steps/interval", "events/event", "inputs/set/number"):
            if path in self.file and not np.array_equal(self.file[path][:], np.arange(1, len(self.file[path]) + 1)):
                self.say(f"{path} does not count from 1")
        if "steps/time" in self.file and not np.array_equal(self.file["steps/time"][:], time[1:]):
            self.say("steps/time differs from trajectory/time after the start")

    def events(self) -> None:
        if any(f"events/{name}" not in self.file for name in ("name", "direction")):
            return
        group = self.file["events"]
        if not np.all(np.abs(group["direction"][:]) == 1):
            self.say("events/direction has values other than 1 and -1")
        known = self.spec.get("events")
        if isinstance(known, dict) and (strange := set(group["name"].asstr()[:]) - set(known)):
            self.say(f"events/name has {', '.join(sorted(strange))}, which the spec does not have")

    def settings(self) -> None:
        if any(path not in self.file for path in ("inputs/input", *layout.SETTINGS)):
            return
        if strange := {*self.file["inputs/set/name"].asstr()[:]} - {*self.file["inputs/input"].asstr()[:]}:
            self.say(f"inputs/set/name has {', '.join(sorted(strange))}, which is no input")

    def accuracy(self) -> None:
        group = self.file.get("accuracy")
        if group is None or any(path not in self.file for path in layout.ACCURACY):
            return
        for name, kind in (("known_until", np.floating), ("order_observed", np.floating), ("method", str)):
            if not isinstance(group.attrs.get(name), kind):
                self.say(f"the attribute {name} of accuracy is missing or has the wrong type")
                return
        known = group.attrs["known_until"]
        count = 0 if np.isnan(known) else int(np.searchsorted(group["time"][:], known, side="right"))
        for path in layout.ACCURACY:
            if path.endswith("_error"):
                values = self.file[path][:]
                if not np.all(np.isfinite(values[:count])):
                    self.say(f"{path} has unknown values before known_until")
                if np.any(values < 0) or (self.is_integrated and np.any(np.diff(values, axis=0) < 0)):
                    self.say(f"{path} is negative or decreases")

    def names(self) -> None:
        homes = {kind.axis: f"{kind.group}/{kind.axis}" for kind in self.kinds.values()}
        for path, array in ((described.path, described) for kind in self.kinds.values() for described in kind.arrays):
            if path not in self.file or not array.is_scale or array.dtype != TEXT:
                continue
            names = list(self.file[path].asstr()[:])
            wanted = {"coordinate": COORDINATES, "axis": AXES}.get(array.name)
            if wanted is not None and tuple(names) != wanted:
                self.say(f"{path} is not {', '.join(wanted)}")
            if wanted is None and len(set(names)) < len(names):
                self.say(f"{path} has a name twice")
            home = homes.get(array.name, path)
            if home in self.file and names != list(self.file[home].asstr()[:]):
                self.say(f"{path} differs from {home}")

    def misalignment(self) -> None:
        if self.status == "running" or "joints/joint" not in self.file:
            return
        largest = self.file["joints"].attrs.get("misalignment_max")
        count = len(self.file["joints/joint"])
        if largest is None or largest.shape != (count,):
            self.say(f"the attribute misalignment_max of joints does not hold a number for each of {count} joints")
            return
        if (recorded := self.file.get("joints/misalignment")) is None:
            return
        if not np.array_equal(recorded.attrs.get("misalignment_max"), largest, equal_nan=True):
            self.say("misalignment_max of joints and of joints/misalignment differ")
        for block in blocks(recorded):
            if np.any(block.max(axis=0, initial=0.0) > largest):
                self.say("misalignment_max of joints is less than the maximum of joints/misalignment")
                return

    def stats(self) -> None:
        for group in ("stats", "provenance"):
            if not isinstance(self.file.get(group), h5py.Group):
                self.say(f"the group {group} is missing")
        if self.status == "running" or "stats" not in self.file:
            return
        attributes = self.file["stats"].attrs
        for names, kind, words in (
            (layout.COUNTERS, np.integer, "an integer"),
            (layout.TIMINGS, np.floating, "a time in s"),
        ):
            for name in names:
                value = attributes.get(name)
                if not isinstance(value, kind):
                    self.say(f"{name} of stats {'is missing' if value is None else f'is not {words}'}")
