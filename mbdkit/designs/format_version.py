"""Format versions of the files in the folder of a design."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mbdkit.base.errors import SpecError


def read_versioned(text: str | bytes, name: str, path: Path) -> dict[str, Any]:
    """Return data that begin with a format version of this name; none if the text is something else.

    Raises
    ------
    SpecError
        If the version is later than 1.
    """
    try:
        data = json.loads(text)
    except ValueError:
        return {}
    version = data.get(name) if isinstance(data, dict) else None
    if isinstance(version, int) and version > 1:
        message = f"this file has format version {version}, this mbdkit reads 1; install a later version of mbdkit"
        raise SpecError(message, file=path)
    return data if version == 1 else {}
