"""The stages of a design: the optimisation, the errors of its result, comparisons with other settings, robustness."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.known_points import Notify

#: Function called with the number of runs so far, the number of failed runs, and a text that names the stage and its
#: best goal so far.
Progress = Callable[[int, int, str], None]


class Stages:
    """Reports in messages which stage of a design is being computed.

    Parameters
    ----------
    spec
        The design.
    notify
        Called with a sentence when a stage begins or has a result.
    progress
        Called after each run.
    optimum_only
        Whether comparisons are omitted.
    further
        Number of further stages that the caller begins after these.
    """

    def __init__(
        self,
        spec: DesignSpec,
        notify: Notify,
        progress: Progress | None = None,
        *,
        optimum_only: bool = False,
        further: int = 0,
    ):
        self.notify, self.optimum_only = notify, optimum_only
        self._goal, self._progress = spec.totals[0], progress
        self._names = ["optimisation", "errors of the result"]
        self._names += [] if optimum_only else [f"comparison with {name}" for name in spec.compare]
        self._count = len(self._names) + further
        self._words, self._evaluator = "", None  # type: str, Evaluator | None

    def begin(self, name: str, evaluator: Evaluator | None = None) -> None:
        """Begin a stage; progress reports the best goal of `evaluator`."""
        number = self._names.index(name) + 1 if name in self._names else self._count
        self._words, self._evaluator = f"stage {number} of {self._count}: {name}", evaluator
        self.notify(self._words)

    def count(self, done: int, failed: int) -> None:
        """Report the number of runs so far, and the number of failed runs."""
        if self._progress is None:
            return
        least = np.nan if self._evaluator is None else self._evaluator.least
        best = "" if np.isnan(least) else f", best {self._goal} {least:.6g}"
        self._progress(done, failed, self._words + best)
