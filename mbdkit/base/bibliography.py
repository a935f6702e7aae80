"""BibTeX entries of sources, which lie in a file ``references.bib`` beside the modules that name them."""

from __future__ import annotations

from functools import cache
from pathlib import Path


def entry(module_file: str, key: str) -> str:
    """Return the entry with a key, such as ``kutta1901``, from the file beside a module.

    `module_file`: the ``__file__`` of the module.
    """
    return _entries(Path(module_file).with_name("references.bib"))[key]


@cache
def _entries(file: Path) -> dict[str, str]:
    texts = file.read_text("utf-8").strip().split("\n\n")
    return {text.partition("{")[2].partition(",")[0]: text for text in texts}
