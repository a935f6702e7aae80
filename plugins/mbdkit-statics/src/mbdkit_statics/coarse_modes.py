"""Warnings about beams whose elements are too coarse for modes of oscillation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mbdkit.mechanism.beams import Beam
from mbdkit.runs.coarse_beams import advice_on_elements


def coarse_modes(beams: Mapping[str, Beam], bodies: Sequence[str], rates: np.ndarray, shapes: np.ndarray) -> list[str]:
    """Return warnings about beams whose two-node elements are too coarse for bending in modes of oscillation.

    Parameters
    ----------
    beams
        The beams by name.
    bodies
        Names of the bodies.
    rates
        (K,) natural frequencies of the modes, in ascending order [rad/s].
    shapes
        (K, B, 3) shapes of the modes, scaled to unit modal mass.

    Notes
    -----
    The estimated relative error of a frequency is the share of the strain energy that is due to variations of the
    moment within elements, times the share of bending in the energy of the mode. At cantilevers of 4 to 16 elements, it
    is 1.4 times the error of the first mode, and up to 10 times that of higher ones, for which errors of stiffness and
    of mass nearly cancel.
    """
    warnings = []
    for name, beam in beams.items():
        if beam.nodes != 2 or beam.corrected or beam.elements < 2:
            continue
        angles = shapes[:, [bodies.index(node) for node in beam.node_names(name)], 2]
        curvature = np.diff(angles, axis=1) / beam.element_length
        total = np.sum(np.abs(curvature) ** 2, axis=1)
        varied = np.sum(np.abs(np.diff(curvature, axis=1)) ** 2, axis=1) * beam.elements / (beam.elements - 1)
        stiffness = beam.section_stiffness.bending * beam.element_length
        # the strain energy of a mode of unit mass is at most that of its motion, rate^2 / 2
        energy = 12.0 * total * np.maximum(rates**2, stiffness * total)
        is_bent = (rates > 0) & (energy > 0)  # not a motion of rigid bodies, and with this beam
        errors = np.divide(varied * stiffness * total, energy, out=np.zeros_like(total), where=is_bent)
        advices = [advice_on_elements(beam.elements, error) for error in errors.tolist()]
        wrong = [mode for mode, advice in enumerate(advices) if advice]
        if wrong:
            first = wrong[0]
            warnings.append(
                f"the elements of beam '{name}' are too coarse for mode {first + 1}"
                f"{' and higher modes' if len(wrong) > 1 else ''}: the frequency of mode {first + 1} may be wrong by "
                f"up to about {100.0 * errors[first]:.2g} %; {advices[first]}, or elements with three nodes"
            )
    return warnings
