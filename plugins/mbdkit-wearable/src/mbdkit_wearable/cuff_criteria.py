"""What runs say of cuffs: doubts about forces that persons do not accept and about cuffs that slide, and a summary."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.plugin import Finding, Run, RunSpec, States
from mbdkit.plugin.equations import CompiledMechanism
from mbdkit.plugin.seams import EnergyRecord, rows_criterion, summary_lines
from mbdkit_wearable.quantities import cuffs_in, displacements

if TYPE_CHECKING:
    from mbdkit_wearable.acting_cuffs import ActingCuff

SHOWN = 4  #: Largest number of cuffs in a summary.


class LoadedCuffs:
    """Largest forces of C cuffs in the recorded states of a run [N], and how far each has slid on the skin [m]."""

    def __init__(self, compiled: CompiledMechanism):
        self._cuffs: tuple[ActingCuff, ...] = compiled.extensions["cuffs"]
        self._largest = np.zeros((2, len(self._cuffs)))
        self._slide = np.full((2, len(self._cuffs)), np.nan)  # lowest and highest displacement from the skin

    def add(self, states: States) -> None:
        """Take note of states."""
        if not len(states.time):
            return
        columns = states.of(cuffs_in)
        force = np.stack([np.abs(columns[name]).max(axis=0) for name in ("normal_force", "shear_force")])
        self._largest = np.fmax(self._largest, force)
        slipping = [k for k, cuff in enumerate(self._cuffs) if cuff.skin >= 0]
        if slipping:
            slide = displacements(states)[:, slipping, 1] - states.z[:, [self._cuffs[k].skin for k in slipping]]
            self._slide[0, slipping] = np.fmin(self._slide[0, slipping], slide.min(axis=0))
            self._slide[1, slipping] = np.fmax(self._slide[1, slipping], slide.max(axis=0))

    def findings(self, _energies: EnergyRecord, _integrals: Mapping[str, object]) -> list[Finding]:
        """Return what is beyond the limits of the cuffs at the end of the run."""
        values = zip(self._cuffs, *self._largest.tolist(), np.ptp(self._slide, axis=0).tolist(), strict=True)
        return [one for values_of_cuff in values for one in _beyond(*values_of_cuff)]

    def stored(self) -> dict[str, np.ndarray]:
        """Return the state for a checkpoint."""
        return {"largest": self._largest, "slide": self._slide}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from a checkpoint."""
        self._largest, self._slide = state["largest"], state["slide"]


def _beyond(cuff: ActingCuff, normal: float, shear: float, slide: float) -> Iterator[Finding]:
    limits, area = cuff.cuff.limits, cuff.cuff.area
    pressure = 0.0 if area is None else normal / area
    key = f"model.cuffs.{json.dumps(cuff.name)}.limits"
    for name, what, value, limit, unit, factor in (
        ("normal_force", "presses on the limb with", normal, limits.normal_force, "N", 1.0),
        ("shear_force", "shears the skin with", shear, limits.shear_force, "N", 1.0),
        ("pressure", "presses on the limb with", pressure, limits.pressure, "kPa", 1e3),
    ):
        if value > limit:
            sentence = (
                f"cuff '{cuff.name}' {what} {value / factor:.3g} {unit}, above its limit of {limit / factor:.3g} "
                f"{unit}, beyond which persons report discomfort or pain"
            )
            yield Finding("cuff-loads", "doubtful", sentence, f"{key}.{name}")
    if slide > limits.slip:
        sentence = (
            f"cuff '{cuff.name}' slides by {1e3 * slide:.3g} mm on the skin, more than {1e3 * limits.slip:.3g} mm"
        )
        yield Finding("cuff-slip", "doubtful", sentence, f"{key}.slip")


@rows_criterion
def watch_cuffs(_spec: RunSpec, compiled: CompiledMechanism, _size: float) -> LoadedCuffs:
    """Return the `LoadedCuffs` of a mechanism."""
    return LoadedCuffs(compiled)


@summary_lines
def cuff_lines(run: Run) -> list[tuple[str, str]]:
    """Return the largest forces and displacements of cuffs."""
    if not run.cuffs or not all(run.records(f"cuffs/{name}") for name in ("normal_force", "shear_force")):
        return []
    parts = []
    for name, cuff in list(run.cuffs.items())[:SHOWN]:
        normal, shear = (np.abs(force).max() for force in (cuff.normal_force, cuff.shear_force))
        text = f"{name} {normal:.4g} N normal, {shear:.4g} N shear"
        if run.records("cuffs/displacement"):
            text += f", {1e3 * np.linalg.norm(cuff.displacement, axis=1).max():.3g} mm"
        parts.append(text)
    more = f"; and {len(run.cuffs) - SHOWN} more" if len(run.cuffs) > SHOWN else ""
    return [("cuffs", f"at most: {'; '.join(parts)}{more}")]
