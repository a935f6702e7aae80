"""What functions that judge measured data take and return."""

from __future__ import annotations

from collections.abc import Iterable

from mbdkit.registry.seam import Seam
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars


@Seam
def data_criterion(result: Inverse, bars: ResultBars | None, /) -> Iterable[str | Finding]:
    """Return what is doubtful in measured data, from the result of inverse dynamics and its error bars, if any."""
    raise NotImplementedError
