"""The stages of a design: the optimisation, the errors of its result, comparisons with other settings, robustness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field

import numpy as np

from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.known_points import Notify

#: Function called with the number of runs so far, the number of failed runs, and a text that names the stage and its
#: best goal so far.
Progress = Callable[[int, int, str], None]


@dataclass
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

    Attributes
    ----------
    words, evaluator
        The present stage in words, and the evaluator whose best goal progress reports.
    """

    spec: DesignSpec
    notify: Notify
    progress: Progress | None = None
    _: KW_ONLY
    optimum_only: bool = False
    further: int = 0
    words: str = field(default="", init=False)
    evaluator: Evaluator | None = field(default=None, init=False)

    def begin(self, name: str, evaluator: Evaluator | None = None) -> None:
        """Begin a stage; progress reports the best goal of `evaluator`."""
        compared = [] if self.optimum_only else [f"comparison with {one}" for one in self.spec.compare]
        names = ["optimisation", "errors of the result", *compared]
        count = len(names) + self.further
        number = names.index(name) + 1 if name in names else count
        self.words, self.evaluator = f"stage {number} of {count}: {name}", evaluator
        self.notify(self.words)

    def count(self, done: int, failed: int) -> None:
        """Report the number of runs so far, and the number of failed runs."""
        if self.progress is None:
            return
        least = np.nan if self.evaluator is None else self.evaluator.least
        best = "" if np.isnan(least) else f", best {self.spec.totals[0]} {least:.6g}"
        self.progress(done, failed, self.words + best)
