"""Short runs of mappings that a process runs repeatedly, such as `mbdkit.run` in a loop over a number.

What such runs share is kept by the content of the mapping: all keys, types and values, except for the floats of `model`
and `parameters`, which may vary. It is not shared with runs that differ in anything else, nor after a change of the
registered plugins or of the environment variables of mbdkit.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

from mbdkit.archive.run import Run
from mbdkit.base.plain_data import Path, copied
from mbdkit.engine.consistent_start import Starts
from mbdkit.registry.manager import registry
from mbdkit.registry.policy import ALLOW, DISABLE, STRICT
from mbdkit.runs.lane_group import LaneMember
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.runs.varied_numbers import Variant, VariedNumbers
from mbdkit.runs.varied_runs import VariedRuns
from mbdkit.spec.reading import put
from mbdkit.spec.run_spec import RunSpec

#: Runs with more steps times bodies are computed in the ordinary way, which Ctrl-C can end early.
MANY = 4_000

FIRST = 2  #: Number of runs of a mapping that are computed in the ordinary way before formulas are recorded.

MOST_CONTENTS = 8  #: Largest number of mappings that are remembered.

#: Environment variables of mbdkit that are read at any time; others are read once, when the machine code is loaded.
_VARIABLES = (ALLOW, DISABLE, STRICT)

_LOCK = threading.Lock()
_KNOWN: dict[Hashable, list[VariedRuns | None]] = {}  # `VariedRuns` after as many runs as entries


def repeated_run(data: Mapping[str, Any], load: Callable[[Mapping[str, Any]], RunSpec]) -> Run | None:
    """Return the run of a mapping like which others have been run before; None if it has to be computed.

    The run has no warnings. `load`: validates a mapping and returns the spec.
    """
    numbers: dict[Path, float] = {}
    try:
        content = (_content(data, (), numbers), registry(), *map(os.environ.get, _VARIABLES))
    except TypeError:  # a value of another type
        return None
    if not _LOCK.acquire(blocking=False):
        return None
    try:
        known = _KNOWN.pop(content, [])
        _KNOWN[content] = known  # at the end; the content used least recently is discarded first
        if len(_KNOWN) > MOST_CONTENTS:
            _KNOWN.pop(next(iter(_KNOWN)))
        if len(known) < FIRST:
            known.append(None)
            return None
        if (runs := known[-1]) is None:
            runs = known[-1] = _varied_runs(copied(data), tuple(numbers), load)
        return runs.run([*numbers.values()])
    finally:
        _LOCK.release()


def _varied_runs(
    data: dict[str, Any], paths: tuple[Path, ...], load: Callable[[Mapping[str, Any]], RunSpec]
) -> VariedRuns:
    def spec(numbers: Sequence[float]) -> RunSpec:
        own = copied(data)
        for path, value in zip(paths, numbers, strict=True):
            put(own, path, value)
        return load(own)

    return VariedRuns(LaneRuns(Starts(), ()), VariedNumbers(paths, spec), _accepts)


def _accepts(variant: Variant, run: LaneMember) -> bool:
    """Return whether runs of a variant have no warnings, are short, and read no files."""
    spec, mechanism = run.settings, variant.compiled
    return (
        not (variant.findings or variant.watched or mechanism.states)
        and not (spec.measures or spec.gradients or spec.files_read or spec.estimates)
        and run.method.traits.tolerances is None
        and run.table.interval is None
        and run.table.steps * len(mechanism.bodies) <= MANY
    )


def _content(value: object, path: Path, numbers: dict[Path, float]) -> Hashable:
    """Return plain data as a value that identifies them, without the floats that may vary, which `numbers` receives.

    Raises TypeError for data of other types.
    """
    if (kind := type(value)) is float and path[0] in ("model", "parameters"):
        numbers[path] = value  # type: ignore[assignment]
        return float
    if kind is dict and all(type(key) is str for key in value):  # type: ignore[attr-defined]
        return dict, tuple([(key, _content(item, (*path, key), numbers)) for key, item in value.items()])  # type: ignore[attr-defined]
    if kind is list or kind is tuple:
        return kind, tuple([_content(item, (*path, i), numbers) for i, item in enumerate(value)])  # type: ignore[arg-type, var-annotated]
    if kind in (str, int, bool, type(None)):
        return kind, value
    if kind is float:
        return kind, value.hex()  # type: ignore[attr-defined]
    raise TypeError(f"{kind} is no type of plain data")
