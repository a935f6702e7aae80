"""Files of tides, in JSON: `mbdkit archive check FILE.tides` examines them."""

import json
from pathlib import Path

from mbdkit.plugin import FileFormat, Target, hookimpl
from mbdkit.plugin.seams import file_problems


@file_problems
def problems(path: Path) -> list[str] | None:
    if path.suffix != ".tides":
        return None
    levels = json.loads(path.read_text(encoding="utf-8"))["level"]
    return [f"level {number} is not finite" for number, level in enumerate(levels) if not abs(level) < 100.0]


@hookimpl
def mbdkit_items():
    return [
        FileFormat(name="tides", summary="Levels of tides.", suffix=".tides", problems=Target("tide_table:problems"))
    ]
