"""Limit of the number of parts of a model by the available memory."""

from __future__ import annotations

from mbdkit.base.errors import SpecError
from mbdkit.base.memory import available_memory, in_bytes


def check_memory(count: int, what: str, each: int) -> None:
    """Raise SpecError for the key ``n`` of a model if the available memory does not suffice.

    Parameters
    ----------
    count, what
        Number of parts, and their name in plural.
    each
        Memory that one part needs [bytes].
    """
    needed, available = count * each, available_memory()
    if available is not None and needed > available:
        raise SpecError(
            f"{count:,} {what} need about {in_bytes(needed)} of memory, but only {in_bytes(available)} are available: "
            f"use at most {available // each:,}",
            key="n",
        )
