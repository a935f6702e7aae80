"""Modules of the core that the builder generates."""

from __future__ import annotations

from pathlib import Path


def write(target: Path, text: str, *, check: bool) -> int:
    """Write a generated module, or check that it has this text; return the exit status."""
    if check:
        is_fresh = target.read_text(encoding="utf-8") == text
        print(f"{target.name} is {'fresh' if is_fresh else 'out of date'}")
        return 0 if is_fresh else 1
    target.write_text(text, encoding="utf-8", newline="\n")
    return 0
