"""What is known of the errors of a run, and sentences on them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from mbdkit.archive.accuracy import largest_known
from mbdkit.archive.headlines import MESH_ERROR, Headline, excluded_words, headline_items, joint_loads, known_loads
from mbdkit.archive.largest_values import LargestValues
from mbdkit.archive.peak_errors import (
    BETWEEN,
    errors_of_largest,
    excess_between_rows,
    is_resolved,
    jumps,
    measures_of_largest,
    missed_by_rows,
    skips_steps,
)
from mbdkit.archive.run import Run
from mbdkit.base.text import listed
from mbdkit.base.units import read_unit
from mbdkit.registry.feature_items import HeadlineItem
from mbdkit.registry.manager import use
from mbdkit.trust.criteria import NOTHING_SUSPICIOUS


class RunErrors:
    """What is known of the errors of a run, and how it is stated.

    The errors of this class are those of simulated runs: envelopes that never decrease with time, estimated by a check.
    A kind of specs whose runs have other errors names a class derived from this one, `SpecKind.errors`.
    """

    force_in = "force in"  #: Words for the force of a joint, before its name.

    #: Why such runs never have the verdict ``good``, and what would say more; empty if they may have it.
    never_good = ""

    def __init__(self, run: Run):
        self.run = run

    @property
    def are_estimated(self) -> bool:
        """Whether the errors of the results were estimated."""
        return self.run.verdict == "good"

    @property
    def unknown_times(self) -> str:
        """Phrase with the times at which errors are unknown although they were estimated; empty if there are none."""
        return ""

    @property
    def excluded(self) -> str:
        """Error that the estimates do not include: that of the mesh of beams, or what plugins state; else empty."""
        run = self.run
        if run.spec.get("model", {}).get("beams") or (run.records("beams/strain_energy") and run.beams):
            return MESH_ERROR
        stated = [(item, cast(HeadlineItem, item.plugin).excluded) for item in headline_items(run)]
        words = [use(item, partial(excluded_words.of(one), run)) for item, one in stated if one is not None]
        return " and ".join(filter(None, words))

    @property
    def without_suspicion(self) -> str:
        """Clause for a run whose verdict has no reasons."""
        if not self.are_estimated:
            return NOTHING_SUSPICIOUS
        unknown = f"those {times}" if (times := self.unknown_times) else ""
        excluded = " and ".join(filter(None, (self.excluded, unknown)))
        return f"errors estimated{f', except {excluded}; ' if excluded else ', '}nothing suspicious seen"

    def of_largest(
        self, quantity: str, names: Sequence[str], size: np.ndarray, errors: np.ndarray | None = None
    ) -> LargestValues:
        """Return the largest values of elements with their bars.

        `quantity`: quantity of which `size` has the magnitudes, such as ``joints.force``. `names`: names of the
        elements. `size`, `errors`: (T, E) magnitudes in the leading rows of the run, and their errors; None if these
        are unknown.

        If the largest value is also a measure, its bar is that of the measure, so that a number has the same bar
        wherever it is printed.
        """
        missed = self.missed(quantity, names, size) if len(size) == len(self.run.time) else None
        accuracy, bars = self.run.accuracy, None
        if errors is not None:
            bars = self.errors_of_largest(quantity, names, size, errors, missed)
        elif accuracy is not None:
            bars = errors_of_largest(self.run.integrals, accuracy.compared_measures, quantity, names)
        largest = LargestValues.of(size, missed, bars)
        for index, _, _ in self.of_measures(quantity, names):
            if np.isfinite(largest.bars[index, 0]):
                largest.recorded[index] = largest.value[index]  # a measure does not depend on rows
        return largest

    def errors_of_largest(
        self, quantity: str, names: Sequence[str], size: np.ndarray, errors: np.ndarray, missed: np.ndarray | None
    ) -> np.ndarray:
        """Return the errors (E,) of the largest values of elements; see `of_largest`.

        `missed`: (E,) by how much the largest values exceed those of all rows; None if it is not known.

        The error has two terms: the largest error of the method in any of these rows, because the true peak may be in
        another row, and the error of the height by which the largest value during the run exceeds the recorded one.
        This height is known only for all rows. For fewer rows, it is estimated by interpolation, and the error contains
        it, if every step is recorded; otherwise the errors are nan.
        """
        run, of_run = self.run, np.max(errors, axis=0)
        if missed is not None:
            steps_per_row = max(1.0, float(run.stats.get("steps", 1)) / max(1, len(run.time) - 1))
            of_run = of_run + BETWEEN * missed / steps_per_row**2  # peaks are parabolas near their vertices
            for index, _, error in self.of_measures(quantity, names):
                of_run[index] = error
            return np.asarray(of_run)
        if skips_steps(run.spec):
            return np.full(size.shape[1], np.nan)
        return np.asarray(of_run + excess_between_rows(np.asarray(run.time)[: len(size)], size, jumps(run)))

    def of_measures(self, quantity: str, names: Sequence[str]) -> Iterator[tuple[int, float, float]]:
        """Yield the index of each element whose largest magnitude is a measure with a known error, the value of this
        measure and its error, both in SI units.
        """
        run = self.run
        for name, measure in measures_of_largest(run.spec.get("measures") or {}, quantity, names).items():
            if math.isfinite(error := run.measure_errors.get(measure, math.nan)):
                factor = read_unit(run.measures.units[measure]).factor
                yield names.index(name), run.measures[measure] * factor, error * factor

    def missed(self, quantity: str, names: Sequence[str], size: np.ndarray) -> np.ndarray | None:
        """Return the result of `missed_by_rows` for the run; None if nothing happens between its rows."""
        if not self.run.spec_kind.is_integrated:
            return None
        run, skips = self.run, skips_steps(self.run.spec)
        is_checked = run.accuracy is not None
        missed = missed_by_rows(run.integrals, quantity, names, size, skips_steps=skips or not is_checked)
        if missed is None or is_checked or skips:
            return missed
        return np.where(np.isnan(missed) & is_resolved(np.asarray(run.time), size), 0.0, missed)

    def sentence(self, *, with_force: bool = True) -> str:
        """Return a sentence on the errors: of the largest reaction force, and of the positions.

        It is empty if the run has no rows, or if its errors were not estimated.

        `with_force`: whether to state the largest force.
        """
        run, accuracy = self.run, self.run.accuracy
        if accuracy is None or not len(run.time):
            return ""
        if not accuracy.rows_known:
            return f"errors unknown: {accuracy.unknown}"
        position = f"positions known to {accuracy.position_error_max:.2g} m and {accuracy.angle_error_max:.2g} rad"
        position += " for this mesh of beams" if self.excluded else ""
        given = ["inputs"] * run.records("inputs/value")
        given += ["outputs of controllers in Python"] * run.records("samples/value")
        position += f" for given {listed(given, 'and')}" if given else ""
        if accuracy.is_complete:
            return "; ".join(filter(None, (_largest_force(joint_loads(run, "force")) if with_force else "", position)))
        until = f" until {accuracy.known_until:.4g} s"
        force = _largest_force(known_loads(run, "force")) if with_force else ""
        why = f": {accuracy.unknown}" if accuracy.unknown else ""
        return "; ".join(filter(None, (force and force + until, position + until, f"errors unknown afterwards{why}")))


def _largest_force(forces: Sequence[Headline]) -> str:
    """Return the largest of forces with its error, as headlines state it; empty if unknown."""
    largest = next(iter(forces), None)
    return "" if largest is None or not largest.bar.is_known else f"{largest.label} {largest.text()}"


def asked_sentence(run: Run) -> str:
    """Return sentences on the requested accuracy, the accuracy reached, and the choice of method; empty if none was
    requested.
    """
    if (accuracy := run.accuracy) is None or math.isnan(accuracy.asked):
        return ""
    reached = "unknown" if math.isnan(accuracy.reached) else f"{accuracy.reached:.2g}"
    until = "" if accuracy.is_complete or math.isnan(accuracy.reached) else f" until {accuracy.known_until:.4g} s"
    text = f"{accuracy.asked:g} of the mechanism's size, reached by estimate {reached}{until}"
    return f"{text}; chosen: {accuracy.chosen}. {accuracy.why}"


def limit_sentence(run: Run) -> str:
    """Return clauses on what limits the accuracy of positions, angles and forces: the data from which parameters were
    estimated, or the integration; empty without such errors.
    """
    if (accuracy := run.accuracy) is None or not (count := accuracy.rows_known):
        return ""
    position, reaction = accuracy.position_error_parameters, accuracy.reaction_error_parameters
    if position is None or reaction is None:
        return ""
    of_data = replace(accuracy, position_error=position, reaction_error=reaction)
    errors = (
        (one.position_error_max, one.angle_error_max, largest_known(one.reaction_error[:count]))
        for one in (of_data, accuracy)
    )
    clauses = []
    for what, unit, data, steps in zip(("positions", "angles", "forces"), ("m", "rad", "N"), *errors, strict=True):
        which = "unknown" if math.isnan(data + steps) else "the data" if data > steps else "the integration"
        if data or steps:
            sizes = f"{data:.2g} {unit} from parameters, {steps:.2g} {unit} from integration"
            clauses.append(f"{what} by {which} ({sizes})")
    return "; ".join(clauses)
