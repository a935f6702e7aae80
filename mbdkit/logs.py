"""The loggers of the package: `mbdkit` and its children, silent unless a program configures `logging`.

Level INFO tells the start and the end of runs and studies, WARNING their warnings and runs that stop early, DEBUG
details.
"""

from __future__ import annotations

import logging

logging.getLogger("mbdkit").addHandler(logging.NullHandler())  # else warnings would be printed twice


def logger_of(module: str) -> logging.Logger:
    """Return the logger of a module, such as ``mbdkit.simulation``."""
    return logging.getLogger(module)
