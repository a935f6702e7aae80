"""The packaged notebooks, which are Python scripts with cells that begin with ``# %%``, and their conversion to Jupyter
files.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import cast

from mbdkit.registry.feature_items import Example
from mbdkit.registry.manager import registry

_CELL = re.compile(r"^# %%(.*)\n", flags=re.MULTILINE)


def notebook_names() -> list[str]:
    """Return the names of the packaged notebooks."""
    return sorted(_notebooks())


def notebook_text(name: str) -> str:
    """Return the script of the packaged notebook `name`."""
    return _notebooks()[name].read_text("utf-8")


def notebook_title(name: str) -> str:
    """Return the first heading of a packaged notebook."""
    return next(line[4:] for line in notebook_text(name).splitlines() if line.startswith("# # "))


def jupyter_text(script: str) -> str:
    """Return a script with cells as the text of a Jupyter file (nbformat 4.5) without outputs."""
    _, *parts = _CELL.split(script)
    cells = [_cell(number, *part) for number, part in enumerate(zip(parts[::2], parts[1::2], strict=True), start=1)]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return json.dumps({"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def _cell(number: int, kind: str, text: str) -> dict[str, object]:
    common = {"id": f"cell-{number}", "metadata": {}}
    if "[markdown]" in kind:
        words = re.sub(r"^# ?", "", text.strip("\n"), flags=re.MULTILINE)
        return {"cell_type": "markdown", **common, "source": words.splitlines(keepends=True)}
    source = text.strip("\n").splitlines(keepends=True)
    return {"cell_type": "code", **common, "source": source, "outputs": [], "execution_count": None}


def _notebooks() -> dict[str, Path]:
    files = (cast(Example, item.plugin).file for item in registry().of_kind("example"))
    return {file.stem: file for file in files if file.suffix == ".py"}
