"""Canonical hashes of golden specs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbdkit.spec.reading import read_file
from mbdkit.spec.spec_kinds import kind_of, spec_loader


def load(path: Path) -> Any:
    """Return a spec of any kind, validated."""
    return spec_loader.of(kind_of(read_file(path).data).load)(path, ())


def spec_hash(path: Path) -> str:
    """Return the SHA-256 of the canonical JSON of a spec."""
    return str(load(path).sha256())
