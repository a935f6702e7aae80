"""BibTeX entries of the sources of the methods, in ``references.bib``."""

from __future__ import annotations

from functools import cache
from pathlib import Path


@cache
def _entries() -> dict[str, str]:
    texts = Path(__file__).with_suffix(".bib").read_text("utf-8").strip().split("\n\n")
    return {text.partition("{")[2].partition(",")[0]: text for text in texts}


def entry(key: str) -> str:
    """Return the entry with a key, such as ``kutta1901``."""
    return _entries()[key]
