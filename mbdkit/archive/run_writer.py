"""Base class for writing the recorded rows of a run; subclasses write them to a file or store them in memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.fingerprint import line, text_bytes
from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.plain_spec import PlainSpec
from mbdkit.archive.result_table import ResultTable
from mbdkit.archive.stored_mechanism import mechanism_json
from mbdkit.base.files_read import files_json
from mbdkit.base.frozen import dataclass, field
from mbdkit.quantities.array import FLOAT, TEXT, Array, Recorded
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import array_at
from mbdkit.quantities.table import KINDS
from mbdkit.trust.criteria import Judgement

if TYPE_CHECKING:
    from mbdkit.spec.model_spec import ModelSpec


def utc_now() -> str:
    """Return the current time, ISO 8601, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


#: Keys of the core that the `append` methods accept, besides paths of plugins.
_KEYS = frozenset(array.key for kind in KINDS for array in kind.arrays)

#: Array with the numbers of the rows of a group, which is also their axis.
_NUMBERS = {"steps": "interval", "events": "event", "impacts": "impact", "inputs": "set/number", "samples": "sample"}
UNJUDGED = Judgement("unknown")


@dataclass(frozen=True, eq=False)
class Ending:
    """How a run has ended.

    - `status`: ``complete``, ``failed`` or ``interrupted``.
    - `reason`: code and sentence saying why the run is not complete, such as ``newton-failed: the step at t = ...``.
      For a complete run, the event that ended it, or an empty string.
    - `stats`: attributes of ``/stats``: counters (integers) and ``setup_s``, ``wall_s``, ``cpu_s``.
    - `misalignment_max`: (J,) largest misalignment of each joint over all steps [m].
    - `judgement`: the verdict on the run; ``unknown`` by default.
    - `warnings`: warnings about the spec and the run, as sentences.
    - `accuracy`: estimated errors of the rows, if the run was checked.
    - `integrals`: integrals over time and extrema, by expression, in SI units; see
      `mbdkit.archive.measured_values.Integrals`.
    - `cause`: the exception of a plugin that ended the run; None if there was none.
    - `tables`: tables of further results by name.
    """

    status: str
    reason: str
    stats: Mapping[str, int | float]
    misalignment_max: np.ndarray
    judgement: Judgement = UNJUDGED
    warnings: tuple[str, ...] = ()
    accuracy: Accuracy | None = None
    integrals: Integrals = field(default_factory=dict)
    cause: BaseException | None = None
    tables: Mapping[str, ResultTable] = field(default_factory=dict)


@dataclass(frozen=True)
class Origin:
    """The spec of a run, and where and how the run was made.

    - `spec_json`, `spec_sha256`: the canonical JSON of the spec, and the SHA-256 of its UTF-8 bytes.
    - `run_id`: unique name of the run.
    - `provenance`: attributes of ``/provenance``: versions, platform, command.
    - `created_utc`: time at which the run began, ISO 8601; by default now.
    - `bodies`: attributes of ``/trajectory``: ``mass`` (B,) [kg] and ``inertia`` (B,) [kg m^2] of the bodies.
    - `texts`: further root attributes: the mechanism, and the files that were read for the run.
    """

    spec_json: str
    spec_sha256: str
    run_id: str
    provenance: Mapping[str, str | int | float]
    created_utc: str = ""
    bodies: Mapping[str, np.ndarray] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, spec: ModelSpec | PlainSpec, provenance: Mapping[str, str | int | float]) -> Origin:
        """Return the origin of a run of a spec."""
        mechanism = spec.mechanism()
        bodies = mechanism.bodies.values()
        masses = {
            "mass": np.array([body.mass for body in bodies], FLOAT),
            "inertia": np.array([body.inertia or 0.0 for body in bodies], FLOAT),
        }
        texts = {layout.MECHANISM: mechanism_json(mechanism), **catalogue_texts(spec)}
        if spec.files_read:
            texts[layout.FILES] = files_json(spec.files_read)
        if evidence := str(provenance.get(layout.EVIDENCE, "")):
            texts[layout.METHOD_EVIDENCE] = evidence.partition(":")[0]
        return cls(spec.canonical_json(), spec.sha256(), spec.run_id(), provenance, bodies=masses, texts=texts)


def catalogue_texts(spec: ModelSpec | PlainSpec) -> dict[str, str]:
    """Return the root attributes by which catalogues find an archive: what the spec gives, and defaults."""
    if isinstance(spec, PlainSpec):
        given = {"title": spec.data.get("title"), **(spec.data.get("meta") or {})}
        names = [str((spec.data.get(key) or {}).get("name", "")) for key in ("model", "integrator")]
    else:
        given, method = {"title": spec.title, **dict(spec.meta)}, getattr(spec, "integrator_item", None)
        names = [spec.model_item.name, "" if method is None else method.name]
    model, by = (name.rpartition(":")[2] for name in names)
    defaults = {"title": model, "description": f"Planar motion of the model {model}{by and f', computed by {by}'}."}
    texts = {key: given.get(key) or defaults.get(key, "") for key in ("title", "description", "creator", "license")}
    # attributes of HDF5 end at a null character
    known = {key: str(text).replace("\0", " ") for key, text in texts.items() if text}
    return {"Conventions": layout.CONVENTIONS, **known}


@dataclass(frozen=True)
class SharedForces:
    """Attributes of an archive whose mechanism has redundant joints.

    `redundancy`: description, such as ``1 redundant row: joint D``. `joints`: the joints whose reactions are not
    unique. `length`: characteristic length [m]. Of all reactions that produce the same motion, the recorded ones
    minimize the sum over joints of ``|force|^2 + (torque / length)^2``. `drivers`: the drivers among these joints,
    whose powers are not unique.
    """

    redundancy: str
    joints: Sequence[str]
    length: float
    drivers: Sequence[str] = ()


class RunWriter(ABC):
    """Base class of writers, which store the rows of one run as they are recorded.

    `names`: names of bodies, joints and constraint rows. `arrays`: the arrays of the layout that the run records; by
    default, those of all quantities.
    """

    def __init__(self, names: ArchiveNames, arrays: tuple[Array, ...] | None = None):
        self.names = names
        self.arrays = layout.recorded_by(names, layout.QUANTITIES) if arrays is None else arrays

    @cached_property
    def recorded(self) -> Mapping[str, Recorded]:
        """The arrays with a value for each recorded state that can be computed from the state, by their keys."""
        return {array.key: array for array in self.arrays if isinstance(array, Recorded)}

    @property
    @abstractmethod
    def row_keys(self) -> frozenset[str]:
        """Keys that `append` requires; it ignores other keys of the layout."""

    @property
    def path(self) -> Path | None:
        """Final name of the archive; None in memory."""
        return None

    @abstractmethod
    def rows(self, dim: str) -> int:
        """Return the number of rows received along a growing axis of the layout."""

    @abstractmethod
    def take(self, dim: str, rows: Mapping[str, np.ndarray]) -> None:
        """Copy rows of the arrays that grow along `dim`, by key."""

    @abstractmethod
    def flush_if_due(self) -> None:
        """From time to time, write the buffered rows and flush the file, if there is one."""

    @abstractmethod
    def abandon(self) -> None:
        """Discard the run; no effect once it is finished."""

    def use_spec(self, spec: ModelSpec) -> None:  # noqa: B027
        """Store another spec of the same mechanism, which repeats the run, in place of that with which it began."""

    def append(self, rows: Mapping[str, np.ndarray]) -> None:
        """Append recorded rows; the values are copied.

        `rows`: an array with T rows for every key of `row_keys`: paths such as ``trajectory/position`` (T, B, 3), and
        ``time`` (T,) for the times of all groups. Raises ResourceError if the archive cannot be written, as on a full
        disk.
        """
        self._append("time", rows)

    def append_numbered(self, group: str, rows: Mapping[str, np.ndarray]) -> None:
        """Append rows with times of their own, which are numbered from 1; the values are copied.

        `rows`: arrays of the group by name, except the numbers; N is the number of rows.

        - ``steps``: statistics of recorded intervals, ``time``, ``steps``, ``size``, ``iterations``,
          ``iterations_max``, ``rejected``, and the corrections of a stabilized run, each (N,).
        - ``events``: crossings, ``name`` (strings), ``time`` and ``direction``, each (N,), and ``position`` and
          ``velocity`` (N, B, 3).
        - ``impacts``: the arrays of impacts, each (N,), and for the joints the impulses of forces (N, J, 2) and of
          torques (N, J).
        - ``inputs``: settings, ``set/instant`` and ``set/value``, and the strings ``set/name`` and ``set/row_units``,
          each (N,).
        - ``samples``: outputs of controllers in Python, each (N,).
        """
        dim = _NUMBERS[group]
        numbers = np.arange(self.rows(dim) + 1, self.rows(dim) + 1 + len(next(iter(rows.values()))))
        self._append(dim, {f"{group}/{name}": values for name, values in {**rows, dim: numbers}.items()})

    def _append(self, dim: str, rows: Mapping[str, np.ndarray]) -> None:
        if unknown := sorted(key for key in rows.keys() - _KEYS if array_at(key) is None):
            raise ValueError(f"the layout has no {', '.join(unknown)}")
        self.take(dim, rows)


@lru_cache(maxsize=256)
def name_line(path: str, text: tuple[str, ...]) -> str:
    """Return the line of an array of names for `data_sha256`; it is the same for all runs of one mechanism."""
    return line(path, TEXT, (len(text),), sha256(text_bytes(text)).hexdigest())


@lru_cache(maxsize=64)
def name_lines(names: ArchiveNames, arrays: tuple[Array, ...]) -> tuple[str, ...]:
    """Return the lines of the arrays of names for `data_sha256`."""
    texts = layout.name_texts(names)
    return tuple(name_line(array.path, tuple(texts[array.path])) for array in arrays if not array.grows)
