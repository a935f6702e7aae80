"""Layout of a run archive, used by the writer, the checker and `schemas/archive.md`.

The arrays are those of the table of quantities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

from mbdkit.quantities.array import Array, Kind, Recorded
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import groups, kind_of_group, kinds, kinds_of, sizes_of
from mbdkit.quantities.table import KINDS

FORMAT = "mbdkit-run"
FORMAT_VERSION = "1.0"


STATUSES = ("running", "complete", "failed", "interrupted")

ROOT_ATTRIBUTES = (
    "format",
    "format_version",
    "status",
    "status_reason",
    "run_id",
    "created_utc",
    "spec",
    "spec_sha256",
    "data_sha256",
)
#: Root attribute with the values and units of the measures of a run, in JSON; absent without measures.
MEASURES = "measures"
ANSWERS = "answers"  #: Root attribute with the numbers of a checked run and their bars, in JSON.
#: Root attribute with the integrals over time and the extrema that the measures need, by expression, as JSON in SI
#: units.
INTEGRALS = "integrals"
#: Root attribute with the derivatives of the measures with respect to parameters, in JSON; absent without `gradients`.
GRADIENTS = "gradients"
#: Root attribute with a word for what is known of the verification of the method; see `Word` in
#: `mbdkit.runs.method_evidence`.
METHOD_EVIDENCE = "method_evidence"
EVIDENCE = "integrator_evidence"  #: Attribute of the provenance with this word and the reason.
CONVENTIONS = f"{FORMAT}-{FORMAT_VERSION}"  #: Root attribute ``Conventions``.
MECHANISM = "mechanism"  #: Root attribute with the mechanism that was run, in JSON.
#: Root attribute with name, size and SHA-256 of every file that was read for the run, in JSON; absent without files.
FILES = "files"
#: Root attributes with the verdict on a run, its reasons and warnings; archives of crashed runs lack them.
VERDICT_ATTRIBUTES = ("verdict", "verdict_reasons", "warnings")

DATA_HASH = "data_sha256"  #: Root attribute with the hash of all arrays except timings and estimated errors.
#: Root attribute with the hash of all contents that `data_sha256` does not cover; archives of crashed runs lack it.
ATTRIBUTES_HASH = "attributes_sha256"
#: Root attribute with the line of each array that the hashes cover, so that an array can be verified by itself.
ARRAY_HASHES = "array_hashes"

COUNTERS = (
    "steps",
    "accepted",
    "rejected",
    "rhs_evaluations",
    "jacobian_evaluations",
    "factorizations",
    "newton_iterations",
    "projections",
)
#: Counters that only runs of methods in Python have: evaluations by mbdkit itself, for work and integrals over time.
SOME_COUNTERS = ("host_evaluations",)
TIMINGS = ("setup_s", "wall_s", "finish_s", "cpu_s")
#: Times that only some runs have: those with integrals over the continuous motion, and those that are checked.
SOME_TIMINGS = ("integrals_s", "check_s")
STATS = (*COUNTERS, *SOME_COUNTERS, *TIMINGS, *SOME_TIMINGS)

#: Groups that can be selected by `output.quantities`.
QUANTITIES = frozenset(kind.group for kind in KINDS if kind.is_chosen)

#: Arrays that get the attribute `not_unique` if the mechanism is redundant; it lists the joints (or drivers) whose
#: values are not unique.
SHARED = tuple(array.path for kind in KINDS for array in kind.arrays if isinstance(array, Recorded) and array.is_shared)

#: Paths of the arrays of events; all of them are present if the spec has events.
EVENTS = tuple(kind_of_group("events").by_path)

#: Paths of the arrays of settings of inputs; all of them are present if the mechanism has inputs.
SETTINGS = tuple(path for path in kind_of_group("inputs").by_path if path.startswith("inputs/set/"))

#: Paths of the arrays of samples; all of them are present if a function in Python computes outputs of a controller.
SAMPLES = tuple(kind_of_group("samples").by_path)

#: Paths of the arrays of impacts; all of them are present if elements or drivers may have impulses.
IMPACTS = tuple(kind_of_group("impacts").by_path)

#: Paths of the arrays of friction in joints; all of them are present if a joint has friction.
FRICTION = ("joints/value_row_units", "joints/friction")

#: Paths of the arrays of estimated errors that are present after a check of accuracy.
ACCURACY = tuple(kind_of_group("accuracy").by_path)

#: Paths of the arrays of corrections, by the kind of stabilization.
CORRECTIONS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "baumgarte": ("steps/acceleration_correction",),
    "projection": ("steps/projections", "steps/position_correction", "steps/velocity_correction"),
}

#: Paths of arrays in the groups of `QUANTITIES` that are present even if their group is not recorded.
ALWAYS = frozenset(("joints/joint", "joints/first_body", "joints/second_body"))


def is_timing(path: str) -> bool:
    """Whether the array at `path` holds wall time (name ending in ``_s``), which the hashes exclude."""
    return path.endswith("_s")


def is_hashed(path: str) -> bool:
    """Whether the array at `path` is hashed as data.

    Timings, estimated errors, and the hashes and states of files that a study index lists are not.
    """
    is_of_file = path.endswith(("/file_sha256", "/file_state"))
    return not is_timing(path) and not path.lstrip("/").startswith("accuracy/") and not is_of_file


@lru_cache(maxsize=64)
def recorded(
    quantities: frozenset[str], extra: frozenset[str] = frozenset(), known: tuple[Kind, ...] | None = None
) -> tuple[Array, ...]:
    """Return the arrays of an archive that records `quantities`.

    `quantities`: subset of `QUANTITIES`; trajectory, steps and the names of the joints are always recorded. `extra`:
    paths of the optional arrays to include. `known`: the kinds; by default, those of the core and of the plugins that
    have arrays in `extra`.
    """
    return tuple(
        array
        for kind in known or kinds(path.partition("/")[0] for path in extra)
        for array in kind.arrays
        if (array.group not in QUANTITIES or array.group in quantities or array.path in ALWAYS)
        and (not array.optional or array.path in extra)
    )


def recorded_by(
    names: ArchiveNames, quantities: frozenset[str], extra: frozenset[str] = frozenset()
) -> tuple[Array, ...]:
    """Return the arrays of a run as `recorded` does, but without the groups of elements that the mechanism lacks."""
    sizes, optional = sizes_of(names), {kind.group: kind.axis for kind in KINDS if kind.is_optional}
    return recorded(
        frozenset(quantity for quantity in quantities if quantity not in optional or sizes[optional[quantity]]), extra
    )


def of_elements(names: ArchiveNames) -> list[str]:
    """Return the paths of the optional arrays that a run records for its elements, and of names along their axes."""
    sizes, paths = sizes_of(names), []
    for kind in kinds_of(names):
        if kind.is_optional and (not kind.axis or sizes[kind.axis]):
            computed = [array for array in kind.arrays if isinstance(array, Recorded) or array.key == "time"]
            axes = {dim for array in computed for dim in array.dims} - {"time"}
            paths += [
                array.path for array in kind.arrays if array.optional and (array in computed or array.dims[0] in axes)
            ]
    return paths


def name_texts(names: ArchiveNames) -> Mapping[str, Sequence[str]]:
    """Return the values of the arrays that hold names and units, by path."""
    every = (array for kind in kinds_of(names) for array in kind.arrays)
    return {array.path: array.texts(names) for array in every if array.texts is not None}


def every_array() -> tuple[Array, ...]:
    """Return all arrays of the layout; the modules of all plugins with groups are imported."""
    return tuple(array for kind in kinds(groups()) for array in kind.arrays)
