"""The loggers of modules, such as `mbdkit.runs.simulation`; they are silent unless a program configures `logging`.

Messages of level INFO report the start and the end of runs and studies. Messages of level WARNING report runs that stop
early, and the warnings of runs and studies. Messages of level DEBUG report details. Warnings about plugins and the
cache go to the logger `mbdkit` itself, which prints them on stderr by default.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable

from mbdkit.base.text import shown


def logger_of(module: str) -> logging.Logger:
    """Return the logger of a module, such as ``mbdkit.runs.simulation``; ``mbdkit.studies.batch`` in mbdkit_studies.

    All are below the logger ``mbdkit``, by which a program sets what it wants to see. The logger has a handler that
    does nothing; without a handler, logging would print warnings to stderr a second time.
    """
    logger = logging.getLogger(module.replace("mbdkit_", "mbdkit.", 1))
    logger.addHandler(logging.NullHandler())
    return logger


def to_stderr(message: str) -> None:
    """Print a message to stderr, like progress."""
    print(message, file=sys.stderr, flush=True)


def warn_on_stderr(warnings: Iterable[str]) -> None:
    """Print the warnings of a run or analysis that a Python program started.

    Commands print warnings in their summary instead.
    """
    for warning in warnings:
        to_stderr(f"warning: {shown(warning)}")
