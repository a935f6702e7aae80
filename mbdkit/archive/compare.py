"""Compares two runs: bitwise equality, largest difference of each array, and differences in provenance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.fingerprint import blocks, datasets, is_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.headlines import headlines
from mbdkit.archive.layout import is_hashed
from mbdkit.archive.run import Run
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.plain_data import Path, json_text, path_text
from mbdkit.base.text import shortened, shown

#: Provenance attributes that cannot affect the results.
_NOT_VERSIONS = {"assembly", "command", layout.EVIDENCE}


@dataclass(frozen=True)
class Comparison:
    """Differences between two runs.

    - `same_data`: whether both runs have ended and all compared arrays are bitwise equal.
    - `same_spec`: whether the canonical JSON of both specs is the same.
    - `differences`: largest difference of each array except timings, relative to the largest magnitude of that array in
      either run. Infinite if only one run has the array, or if the shapes, the names or the positions of non-finite
      values differ.
    - `code`: plugins whose code differs.
    - `versions`: provenance attributes that differ, except the command, the evidence of the method and the assembly of
      the start, with the values of the first and the second run.
    - `settings`: keys of the specs whose values differ, with those of the first and the second run as JSON, empty where
      a spec lacks the key.
    - `answers`: labels of the main numbers that differ, with those of the first and the second run as text.
    """

    same_data: bool
    same_spec: bool
    differences: Mapping[str, float]
    versions: Mapping[str, tuple[str, str]]
    code: Sequence[str] = ()
    settings: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    answers: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def largest(self) -> float:
        """Largest value in `differences`; 0 if there are none."""
        return max(self.differences.values(), default=0.0)

    def __str__(self) -> str:
        """Return the comparison as plain text."""
        if self.same_data:
            lines = ["the data are the same to the bit"]
        else:
            lines = [f"the data differ by {self.largest:.2g}, relative to the largest value of the array"]
            for name in sorted(self.code):
                lines.append(f"the cause is probably that the code of {name} has changed since the first run")
            worst = sorted(self.differences.items(), key=lambda item: -item[1])
            lines += [f"  {path:<32} {value:.2g}" for path, value in worst if value > 0]
        if not self.same_spec:
            lines.append("the specs differ")
        for pairs, indent in ((self.settings, "  "), (self.answers, ""), (self.versions, "")):
            for name, both in pairs.items():
                first, second = (shortened(text) or "none" for text in both)
                lines.append(f"{indent}{name}: {first} and {second}")
        return "\n".join(map(shown, lines))  # names and values come from the file


def compare(first: Run, second: Run) -> Comparison:
    """Compare two runs. Raises MbdkitError if a run is closed. Raises SpecError if an archive is damaged."""
    left, right = _arrays(first), _arrays(second)
    # a crashed run has no hash and may lack rows, so its data count as different
    same = bool(first.data_sha256) and first.data_sha256 == second.data_sha256
    differences = {}
    for path in sorted({*left, *right}):
        with reading(path, None):
            differences[path] = 0.0 if same else _difference(left.get(path), right.get(path))
    of_both = (
        {name: str(run.provenance[name]) for name in sorted(run.provenance) if name not in _NOT_VERSIONS}
        for run in (first, second)
    )
    versions = dict(sorted(_pairs(*of_both).items()))
    changed = [name.removesuffix("_digest") for name in versions if name.endswith("_digest")]
    return Comparison(
        same_data=same,
        same_spec=first.spec_json == second.spec_json,
        settings=_pairs(*(dict(_leaves(run.spec)) for run in (first, second))),
        answers={} if same else _pairs(*({one.label: one.text() for one in headlines(run)} for run in (first, second))),
        differences=differences,
        versions=versions,
        code=[str(first.provenance[kind]) for kind in changed if kind in first.provenance],
    )


def _leaves(value: object, path: Path = ()) -> Iterator[tuple[str, str]]:
    """Yield the values of a spec that are no mappings with keys, as JSON, with their own keys."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _leaves(inner, (*path, str(key)))
    else:
        yield path_text(path), json_text(value)


def _pairs(first: Mapping[str, str], second: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return the texts that differ, by name."""
    both = {name: (first.get(name, ""), second.get(name, "")) for name in {**first, **second}}
    return {name: pair for name, pair in both.items() if pair[0] != pair[1]}


def _arrays(run: Run) -> dict[str, h5py.Dataset]:
    with reading("its contents", run.path):
        return {item.name.lstrip("/"): item for item in datasets(run.file) if is_hashed(item.name)}


def _difference(first: h5py.Dataset | None, second: h5py.Dataset | None) -> float:
    if first is None or second is None or first.shape != second.shape or is_text(first) != is_text(second):
        return float("inf")
    largest = difference = 0.0
    for left, right in zip(blocks(first), blocks(second), strict=True):
        if is_text(first):
            if not np.array_equal(left, right):
                return float("inf")
            continue
        if not np.array_equal(np.isfinite(left), np.isfinite(right)):
            return float("inf")
        both = np.isfinite(left)
        for values in (left, right):
            largest = max(largest, float(np.max(np.abs(values), where=both, initial=0.0)))
        with np.errstate(invalid="ignore"):
            difference = max(difference, float(np.max(np.abs(left - right), where=both, initial=0.0)))
    return difference / largest if difference > 0 else 0.0
