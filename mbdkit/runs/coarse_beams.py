"""Warnings about beams whose elements are too coarse for the forces and the curvature that a run has recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.engine.stored_arrays import fill
from mbdkit.mechanism.beams import Beam

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.states import States
    from mbdkit.trust.energy_record import EnergyRecord

TURN = 0.75
"""Largest angle [rad] by which bending may turn a node relative to its neighbour without a warning.

Measured at clamped cantilevers with a force across their tip: the moment at the clamp has errors of 1 % (elements of
two nodes) and 1.5 % (three nodes) at this angle, and of 2 % and 4 % at 1 rad.
"""

SPACING = 0.7
"""Recommended distance between nodes, relative to ``sqrt(EI / F)`` for a bending stiffness EI and a force F.

A force F bends a beam within about this length. At this distance, a clamped cantilever turns by `TURN` between two
nodes.
"""

VARIATION = 0.01
"""Largest estimated relative error of two-node elements, in bending or in tension, without a warning.

Such elements have constant strains. In bending, the estimate is the share of the strain energy that is due to
variations of the moment within elements. It is the relative error of the deflection of a cantilever under a force at
its tip, 1/(4 n^2) with n elements; for large deflections, it is 1 to 3 times the largest error of deflections and
moments. In tension, `TENSION` times this share is the estimate.
"""

TENSION = 2.0
"""Ratio of the error in tension to the share of the strain energy.

Measured at rods that rotate about one end, with 2 to 8 elements: the estimate lies between the relative errors of the
largest axial force, 1/(4 n^2), and of the elongation, 1/(2 n^2).
"""

SMALL = 1e-3
"""Tension and bending are only judged if they have more than this share of the strain energy of a beam."""

ROUND_OFF = 1e-12
"""Axial strains up to this value, and curvatures up to this value divided by the length of an element, are assumed to
be rounding errors of the coordinates.
"""


class CoarseBeams:
    """How much strains vary between and within the elements of beams, over the recorded states of a run.

    Parameters
    ----------
    mechanism, compiled
        The mechanism, and its compiled form.
    """

    def __init__(self, mechanism: Mechanism, compiled: CompiledMechanism):
        self._beams = [_WatchedBeam(name, beam, compiled) for name, beam in mechanism.beams.items()]

    @classmethod
    def of(cls, mechanism: Mechanism, compiled: CompiledMechanism) -> CoarseBeams | None:
        """Return the `CoarseBeams` of a mechanism; None if it has no beams."""
        return cls(mechanism, compiled) if mechanism.beams else None

    def add(self, states: States) -> None:
        """Take note of states."""
        for beam in self._beams:
            beam.add(states.q, states.observed.beams)

    def warnings(self, _energies: EnergyRecord | None = None) -> tuple[str, ...]:
        """Return a warning for each beam whose elements are too coarse."""
        return tuple(warning for beam in self._beams for warning in beam.warnings())

    def stored(self) -> list[Any]:
        """Return the state as plain values for a checkpoint."""
        return [[beam.turns, beam.largest] for beam in self._beams]

    def restore(self, state: list[Any]) -> None:
        """Continue from the state of a checkpoint; raise ValueError if it does not belong to these beams."""
        for beam, (turns, largest) in zip(self._beams, state, strict=True):
            fill(beam.turns, turns)
            fill(beam.largest, largest)


class _WatchedBeam:
    """A beam, with the largest values of its recorded states.

    Attributes
    ----------
    turns
        (K - 1,) largest angles by which bending turns each of K nodes relative to the one before [rad].
    largest
        Largest sums of the squares of the axial forces of the elements, of their moments, and of the variations of both
        within the elements; largest axial force and largest magnitude of the force [N].
    """

    def __init__(self, name: str, beam: Beam, compiled: CompiledMechanism):
        self.name, self.beam = name, beam
        self.elements = compiled.beam_elements(name)
        places = {body: i for i, body in enumerate(compiled.bodies)}
        self.angles = [3 * places[node] + 2 for node in beam.node_names(name)]
        self.reference = np.diff([place.angle for place in beam.places])
        self.turns, self.largest = np.zeros(len(self.reference)), np.zeros(6)

    def add(self, q: np.ndarray, beams: np.ndarray) -> None:
        """Take note of positions (T, n), and of forces [N] and moments [N m] of all elements (T, E, 4)."""
        turns = np.abs(np.diff(q[:, self.angles], axis=1) - self.reference)
        np.maximum(self.turns, turns.max(axis=0, initial=0.0), out=self.turns)
        axial, shear, moment = np.moveaxis(beams[:, self.elements, :3], -1, 0)
        # In an element in equilibrium, the moment varies by the shear force times the length.
        within = np.diff(axial, axis=1), self.beam.element_length * shear
        sums = [np.sum(x * x, axis=1) for x in (axial, moment, *within)]
        values = [*sums, np.abs(axial).max(axis=1), np.hypot(axial, shear).max(axis=1)]
        np.maximum(self.largest, np.max(values, axis=1, initial=0.0), out=self.largest)

    def warnings(self) -> Iterator[str]:
        """Yield a warning if the elements are too coarse."""
        beam, turn = self.beam, float(np.max(self.turns))
        what, error, count = self._largest_error()
        if turn > TURN:
            node = int(np.argmax(self.turns))
            nodes = beam.length * math.sqrt(self.largest[5] / beam.section_stiffness.bending) / SPACING
            count = max(count, math.ceil(max(nodes / (beam.nodes - 1), beam.elements * turn / TURN)))
            reason = (
                f"bending turns '{self.name}.{node + 1}' by {turn:.2g} rad against '{self.name}.{node}', so that its "
                f"forces and moments may be wrong by more than 1 %"
            )
        elif error > VARIATION:
            reason = f"{what} may be wrong by about {100.0 * error:.2g} %"
        else:
            return
        yield f"the elements of beam '{self.name}' are too coarse: {reason}; use about {_rounded(count)} elements"

    def _largest_error(self) -> tuple[str, float, int]:
        """Return which results of a beam with two-node elements have the largest estimated relative error, this error,
        and the number of elements with which the error is acceptable; the error of other beams is 0.
        """
        beam, section = self.beam, self.beam.section_stiffness
        if beam.nodes != 2:
            return "", 0.0, 0
        tension, bending, of_tension, of_bending, axial, _ = self.largest.tolist()
        energies = tension / section.axial, bending / section.bending
        # n elements have n - 1 differences
        stretch = TENSION * of_tension * beam.elements / max(1, beam.elements - 1) / (12.0 * tension or 1.0)
        errors = stretch, of_bending / (12.0 * bending or 1.0)
        if beam.corrected:
            # Corrected elements represent the variation, by a shear flexibility that adds to the effect of the axial
            # force N on a bent beam: the relative error of the moment is N h^2 / (24 EI), h being the element's length.
            errors = errors[0], axial * beam.element_length**2 / (24.0 * section.bending)
        noise = [
            beam.elements * stiffness * strain**2
            for stiffness, strain in ((section.axial, ROUND_OFF), (section.bending, ROUND_OFF / beam.element_length))
        ]
        judged = [
            error if energy > max(SMALL * sum(energies), least) else 0.0
            for error, energy, least in zip(errors, energies, noise, strict=True)
        ]
        what = ("its axial forces or elongations", "its moments or deflections")[int(np.argmax(judged))]
        # the errors are of order 2 in the length of an element
        return what, max(judged), math.ceil(beam.elements * math.sqrt(max(judged) / VARIATION))


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
        wrong = np.flatnonzero(errors > VARIATION)
        if len(wrong):
            first = int(wrong[0])
            count = _rounded(math.ceil(beam.elements * math.sqrt(errors[first] / VARIATION)))
            warnings.append(
                f"the elements of beam '{name}' are too coarse for mode {first + 1}"
                f"{' and higher modes' if len(wrong) > 1 else ''}: the frequency of mode {first + 1} may be wrong by "
                f"up to about {100.0 * errors[first]:.2g} %; use about {count} elements, or elements with three nodes"
            )
    return warnings


def _rounded(count: int) -> int:
    """Return a number rounded up to two digits."""
    unit: int = 10 ** max(0, len(str(count)) - 2)
    return -(-count // unit) * unit
