"""The spec of a run in a block whose plugins are not installed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbdkit.archive.stored_mechanism import StoredMechanism
from mbdkit.base.errors import ArchiveError
from mbdkit.base.files_read import FileRead
from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import canonical_text
from mbdkit.mechanism.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class PlainSpec:
    """The spec of a run in a block whose plugins are not installed: plain data, with the stored hash and identifier."""

    data: Mapping[str, Any]
    digest: str
    identifier: str
    stored: StoredMechanism
    files_read: tuple[FileRead, ...]

    @property
    def measures(self) -> Mapping[str, Any]:
        """The measures by name."""
        return self.data.get("measures") or {}

    def canonical_json(self) -> str:
        """Return the data as JSON; unlike canonical JSON, it lacks defaults."""
        return canonical_text(self.data)

    def sha256(self) -> str:
        """Return the stored hash."""
        return self.digest

    def run_id(self) -> str:
        """Return the stored identifier."""
        return self.identifier

    def mechanism(self) -> Mechanism:
        """Return the mechanism that was run."""
        if self.stored.mechanism is None:
            raise ArchiveError(self.stored.not_drawn)
        return self.stored.mechanism
