"""Plots and videos of runs, drawn by Matplotlib from recorded data; `compare` draws several runs in one pair of axes.

Matplotlib is imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbdkit_report.plot.comparison import compare

__all__ = ["compare"]


if not TYPE_CHECKING:  # type checkers see only the names above

    def __getattr__(name):
        if name == "compare":
            from mbdkit_report.plot.comparison import compare

            return compare
        raise AttributeError(f"module 'mbdkit.plot' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
