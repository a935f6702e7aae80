"""Makes archives of made-up runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.run_writer import Ending, Origin
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import sizes_of

SPEC = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum", "lengths": [1.0, 1.0]},
    "integrator": {"name": "gauss", "stages": 2, "tolerance": None},
    "formulation": "index-1",
    "stabilization": "none",
    "time": {"start": 0.0, "end": 0.1, "step": 0.01},
    "output": {"every": 1, "quantities": "all"},
}
STATS = {
    **{name: 10 * number for number, name in enumerate(layout.COUNTERS, 1)},
    "setup_s": 0.25,
    "wall_s": 0.002,
    "cpu_s": 0.0019,
}
PROVENANCE = {"mbdkit": "0.1.0", "numpy": "2.4.6", "command": "mbdkit run double-pendulum", "platform": "Linux"}


def names(bodies: int = 2, joints: int = 2, constraints: int | None = None, forces: int = 2) -> ArchiveNames:
    """Return the names of a chain; the last constraint row, if there are an odd number, is an angle.

    The last of several force elements is a torsion spring. There are a marker and a beam if there are force elements.
    """
    count = 2 * joints if constraints is None else constraints
    return ArchiveNames(
        [f"rod{number}" for number in range(1, bodies + 1)],
        [f"J{number}" for number in range(1, joints + 1)],
        [f"J{row // 2 + 1}.{'xy'[row % 2]}" for row in range(count)],
        ["rad" if count % 2 and row == count - 1 else "m" for row in range(count)],
        [("ground" if number == 1 else f"rod{number - 1}", f"rod{number}") for number in range(1, joints + 1)],
        forces=[f"s{number}" for number in range(1, forces + 1)],
        force_bodies=[("ground", "rod1")] * forces,
        force_units=["m", "rad", "rad"][:forces],
        markers=["tip"][:forces],
        marker_bodies=["rod1"][:forces],
        elements=["leaf[0]", "leaf[1]", "leaf[2]"] if forces else [],
        element_beams=["leaf"] * 3 if forces else [],
    )


def rows(count: int, named: ArchiveNames, start: int = 0) -> dict[str, np.ndarray]:
    """Return rows `start` to `start + count` of a made-up run: smooth, different in every column."""
    sizes = sizes_of(named)
    time = 0.01 * np.arange(start, start + count)
    made = {"time": time, "trajectory/elapsed_s": 1e-5 * np.arange(start, start + count)}
    growing = [array for array in layout.every_array() if array.dims[0] == "time" and array.key not in made]
    for number, array in enumerate(growing, 1):
        shape = tuple(sizes.get(dim, 0) for dim in array.dims[1:])
        phase = np.arange(np.prod(shape, dtype=int)).reshape(shape) + 10.0 * number
        made[array.path] = np.abs(np.sin(time.reshape(-1, *(1 for _ in shape)) + phase))
    return made


def steps(count: int, start: int = 0) -> dict[str, np.ndarray]:
    """Return the statistics of the intervals that end at rows `start + 1` to `start + count`."""
    return {
        "time": 0.01 * np.arange(start + 1, start + count + 1),
        "steps": np.full(count, 2),
        "size": np.full(count, 0.005),
        "iterations": np.full(count, 7),
        "iterations_max": np.full(count, 4),
        "rejected": np.zeros(count, dtype=int),
    }


def writer(
    path: Path | None,
    named: ArchiveNames | None = None,
    spec: dict[str, Any] | None = None,
    *,
    run_id: str = "run-1",
    provenance: Mapping[str, str | int | float] = PROVENANCE,
    quantities: frozenset[str] = layout.QUANTITIES,
    extra_datasets: Iterable[str] = (),
    **options: Any,
) -> ArchiveWriter:
    """Return a writer for a made-up run."""
    text = json.dumps(SPEC if spec is None else spec, sort_keys=True, separators=(",", ":"))
    origin = Origin(text, hashlib.sha256(text.encode()).hexdigest(), run_id, provenance)
    arrays = layout.recorded_by(named or names(), quantities, frozenset(extra_datasets))
    return ArchiveWriter(path, named or names(), origin, arrays=arrays, **options)


def fill(
    into: ArchiveWriter,
    count: int,
    named: ArchiveNames | None = None,
    piece: int | None = None,
    after: Callable[[], None] | None = None,
) -> None:
    """Append `count` rows and the intervals between them, in pieces, calling `after` each."""
    named = named or names()
    piece = piece or max(1, count)
    for start in range(0, count, piece):
        size = min(piece, count - start)
        into.append(rows(size, named, start))
        first = max(0, start - 1)
        into.append_numbered("steps", steps(start + size - 1 - first, first))
        if after is not None:
            after()


def largest(count: int, named: ArchiveNames) -> np.ndarray:
    """Return a misalignment that no recorded one exceeds."""
    return np.linspace(1.0, 1.0 + 0.001 * (len(named.joints) - 1), len(named.joints))


def make(
    path: Path | None,
    count: int = 11,
    named: ArchiveNames | None = None,
    status: str = "complete",
    reason: str = "",
    piece: int | None = None,
    after: str = "",
    **options: Any,
) -> Any:
    """Write a whole archive; return what `finish` does."""
    named = named or names()
    into = writer(path, named, **options)
    fill(into, count, named, piece, getattr(into, after) if after else None)
    return into.finish(Ending(status, reason, STATS, largest(count, named)))


DOCUMENT = Path(__file__).parents[2] / "schemas" / "archive.md"
