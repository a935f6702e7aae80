"""What is known of the errors of a run, and sentences on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.accuracy import largest_known
from mbdkit.archive.headlines import excluded_error, largest_forces, plus_minus
from mbdkit.archive.peak_errors import peak_errors, simulated_peak_errors
from mbdkit.base.text import listed

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


class RunErrors:
    """What is known of the errors of a run, and how it is stated.

    The errors of this class are those of simulated runs: envelopes that never decrease with time, estimated by a check.
    A kind of specs whose runs have other errors names a class derived from this one, `SpecKind.errors`.
    """

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

    def of_largest(self, quantity: str, names: Sequence[str], size: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """Return the errors (E,) of the largest values of elements.

        `quantity`: quantity of which `size` has the magnitudes, such as ``joints.force``. `names`: names of the
        elements. `size`, `errors`: (T, E) magnitudes in the leading rows of the run, and their errors.
        """
        return simulated_peak_errors(self.run, quantity, names, size, errors)

    def sentence(self, *, with_force: bool = True) -> str:
        """Return a sentence on the errors: of the largest reaction force, and of the positions.

        It is empty if the run has no rows, or if its errors were not estimated.

        `with_force`: whether to state the largest force if all errors are known.
        """
        run, accuracy = self.run, self.run.accuracy
        if accuracy is None or not len(run.time):
            return ""
        if not accuracy.rows_known:
            return f"errors unknown: {accuracy.unknown}"
        position = f"positions known to {accuracy.position_error_max:.2g} m and {accuracy.angle_error_max:.2g} rad"
        position += " for this mesh of beams" if excluded_error(run) else ""
        given = ["inputs"] * run.records("inputs/value")
        given += ["outputs of controllers in Python"] * run.records("samples/value")
        position += f" for given {listed(given, 'and')}" if given else ""
        if accuracy.is_complete:
            return "; ".join(filter(None, (_largest_force(run) if with_force else "", position)))
        until = f" until {accuracy.known_until:.4g} s"
        force = _largest_known_force(run, accuracy.rows_known) if accuracy.rows_known > 1 else ""
        why = f": {accuracy.unknown}" if accuracy.unknown else ""
        return "; ".join(filter(None, (force and force + until, position + until, f"errors unknown afterwards{why}")))


def _largest_force(run: Run) -> str:
    """Return the largest force of all joints with its error, as headlines state it; empty if unknown."""
    largest = next(iter(largest_forces(run)), None)
    return "" if largest is None or math.isnan(largest.error) else f"{largest.label} {largest.text()}"


def _largest_known_force(run: Run, count: int) -> str:
    """Return the largest force of joints in the first `count` rows with its error; empty if there is none."""
    if not run.joints or not run.records("joints/reaction_force"):
        return ""
    size = np.linalg.norm(run.array("joints/reaction_force"), axis=2)[:count]
    errors = peak_errors(run, "reaction_error", size, count)
    joint = int(np.argmax(np.max(size, axis=0)))
    largest = float(np.max(size[:, joint]))
    if errors is None or math.isnan(errors[joint]) or largest <= 0:
        return ""
    return f"largest force in {run.joint_names[joint]} {plus_minus(largest, float(errors[joint]))} N"


def asked_sentence(run: Run) -> str:
    """Return sentences on the requested accuracy, the accuracy reached, and the choice of method; empty if none was
    requested.
    """
    accuracy = run.accuracy
    if accuracy is None or math.isnan(accuracy.asked):
        return ""
    reached = "unknown" if math.isnan(accuracy.reached) else f"{accuracy.reached:.2g}"
    until = "" if accuracy.is_complete or math.isnan(accuracy.reached) else f" until {accuracy.known_until:.4g} s"
    text = f"{accuracy.asked:g} of the mechanism's size, reached by estimate {reached}{until}"
    return f"{text}; chosen: {accuracy.chosen}. {accuracy.why}"


def limit_sentence(run: Run) -> str:
    """Return clauses on what limits the accuracy of positions, angles and forces: the data from which parameters were
    estimated, or the integration; empty without such errors.
    """
    accuracy = run.accuracy
    if accuracy is None or not (count := accuracy.rows_known):
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
