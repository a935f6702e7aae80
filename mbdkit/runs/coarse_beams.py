"""Warnings about beams whose elements are too coarse for the forces and the curvature that a run has recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from mbdkit.archive.measured_values import Integrals
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.stored_arrays import fill
from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.quantities.states import States
from mbdkit.runs.run_seams import rows_criterion
from mbdkit.spec import RunSpec
from mbdkit.trust.energy_record import EnergyRecord

#: Largest angle [rad] by which bending may turn a node relative to its neighbour without a warning.
#:
#: Measured at clamped cantilevers with a force across their tip: the moment at the clamp has errors of 1 % (elements of
#: two nodes) and 1.5 % (three nodes) at this angle, and of 2 % and 4 % at 1 rad.
TURN = 0.75

#: Recommended distance between nodes, relative to ``sqrt(EI / F)`` for a bending stiffness EI and a force F, by the
#: number of nodes of an element.
#:
#: A force F bends a beam within about this length. At a distance of 0.7, a strongly bent cantilever turns by `TURN`
#: between two nodes; at 0.39, the estimated error of two-node elements is `VARIATION`.
SPACING = {2: 0.39, 3: 0.7}

#: Largest estimated relative error, in bending or in tension, without a warning.
#:
#: Two-node elements have constant strains. In bending, their estimate is the share of the strain energy that is due to
#: variations of the moment within elements. It is the relative error of the deflection of a cantilever under a force at
#: its tip, 1/(4 n^2) with n elements; for large deflections, it is 1 to 3 times the largest error of deflections and
#: moments. In tension, `TENSION` times this share is the estimate. For three-node elements, see `CURVED`.
VARIATION = 0.01

#: Ratio of the error of moments to the square root of a share of the strain energy, in three-node elements.
#:
#: Their moments vary linearly. The share is that of the parabola q x (h - x) / 2 which a load per length q adds to the
#: moment within an element of length h: q^2 h^5 / 120 of the integral of M^2. In a cantilever of n elements under its
#: own weight, this share is n^-4 / 6, and the error of the moment in the middle of an element is q h^2 / 24, 1/(12 n^2)
#: of the moment at the clamp, which defines the ratio.
#:
#: Measured at damped cantilevers of 1 to 4 elements that move under a sudden or growing force at the tip, a suddenly
#: applied weight or a sudden motion of the clamp, or that begin to rotate: the largest one of the errors of the largest
#: deflection, moment, and torque of the clamp is 0.4 to 3.7 times the estimate, and up to 1.4 times from 3 elements on.
CURVED = math.sqrt(6.0) / 12.0

#: Ratio of the error in tension to the share of the strain energy.
#:
#: Measured at rods that rotate about one end, with 2 to 8 elements: the estimate lies between the relative errors of
#: the largest axial force, 1/(4 n^2), and of the elongation, 1/(2 n^2).
TENSION = 2.0

#: Tension and bending are only judged if they have more than this share of the strain energy of a beam.
SMALL = 1e-3

#: Ratio of the recommended number of elements to the one with which the present estimate would be acceptable.
#:
#: Coarse elements underestimate the needed number, because they lack peaks of curvature and higher modes. At
#: cantilevers of 1 to 6 two-node or 1 to 4 three-node elements with the loads of `CURVED`, the needed number was up to
#: 1.3 times the one that follows from the estimate.
MARGIN = 1.25

#: Largest number of elements that is recommended. If more are needed, a stiffness or a load is probably wrong.
MOST_ADVISED = 200

#: Axial and shear strains up to this value, and curvatures up to this value divided by the length of an element, are
#: assumed to be rounding errors of the coordinates.
ROUND_OFF = 1e-12


class CoarseBeams:
    """How much strains vary between and within the elements of beams, over the recorded states of a run.

    `mechanism`, `compiled`: the mechanism, and its compiled form.
    """

    def __init__(self, mechanism: Mechanism, compiled: CompiledMechanism):
        self._beams = [_WatchedBeam(name, beam, compiled) for name, beam in mechanism.beams.items()]

    def add(self, states: States) -> None:
        """Take note of states."""
        for beam in self._beams:
            beam.add(states.q, states.observed.beams)

    def findings(self, _energies: EnergyRecord | None = None, _integrals: Integrals | None = None) -> tuple[str, ...]:
        """Return a warning for each beam whose elements are too coarse."""
        return tuple(warning for beam in self._beams for warning in beam.warnings())

    def stored(self) -> list[object]:
        """Return the state as plain values for a checkpoint."""
        return [[beam.turns, beam.largest] for beam in self._beams]

    def restore(self, state: Sequence[Sequence[object]]) -> None:
        """Continue from the state of a checkpoint; raise ValueError if it does not belong to these beams."""
        for beam, (turns, largest) in zip(self._beams, state, strict=True):
            fill(beam.turns, turns)
            fill(beam.largest, largest)


@rows_criterion
def watch_coarse_beams(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> CoarseBeams | None:
    """Return the `CoarseBeams` of a mechanism; None if it has no beams."""
    return CoarseBeams(spec.mechanism(), compiled) if spec.mechanism().beams else None


class _WatchedBeam:
    """A beam, with the largest values of its recorded states.

    - `turns`: (K - 1,) largest angles by which bending turns each of K nodes relative to the one before [rad].
    - `largest`: largest sums of the squares of the axial forces of the elements, of their moments, and of the
      variations of both within the elements; largest axial force and largest magnitude of the force [N]. The variation
      of the moment in an element of length h is h times the shear force; with three nodes, it is h^2 times the load per
      length.
    """

    def __init__(self, name: str, beam: Beam, compiled: CompiledMechanism):
        self.name, self.beam = name, beam
        self.elements = compiled.beam_elements(name)
        places = {body: i for i, body in enumerate(compiled.bodies)}
        self.angles = [3 * places[node] + 2 for node in beam.node_names(name)]
        self.reference = np.diff([point.angle for point in beam.places])
        sections = list(beam.sections(name)) if beam.nodes == 3 else []
        self.shapes, self.slopes = (
            np.array([getattr(section, key) for section in sections[:2]]) for key in ("shape", "slope")
        )
        strains = np.array([section.reference[:2] for section in sections]).reshape(-1, 2, 2)
        self.unstrained = np.moveaxis(strains, -1, 0).swapaxes(1, 2)[:, :, None]
        self.turns, self.largest = np.zeros(len(self.reference)), np.zeros(6)

    def add(self, q: np.ndarray, beams: np.ndarray) -> None:
        """Take note of positions (T, n), and of forces [N] and moments [N m] of all elements (T, E, 4)."""
        turns = np.abs(np.diff(q[:, self.angles], axis=1) - self.reference)
        np.maximum(self.turns, turns.max(axis=0, initial=0.0), out=self.turns)
        axial, shear, moment = np.moveaxis(beams[:, self.elements, :3], -1, 0)
        # In an element in equilibrium, the moment varies by the shear force times the length.
        stretched, varied = np.diff(axial, axis=1), self.beam.element_length * shear
        squares = [axial**2, moment**2, stretched**2, varied**2]
        if self.beam.nodes == 3:
            squares[1] += squares[3] / 12.0
            squares[3] = (math.sqrt(3.0) * self.beam.element_length * self._shear_changes(q)) ** 2
        sums = [np.sum(x, axis=1) for x in squares]
        values = [*sums, np.abs(axial).max(axis=1), np.hypot(axial, shear).max(axis=1)]
        np.maximum(self.largest, np.max(values, axis=1, initial=0.0), out=self.largest)

    def _shear_changes(self, q: np.ndarray) -> np.ndarray:
        """Return by how much the shear force changes between the Gauss points of three-node elements (T, E) [N].

        The distance of these points is h/sqrt(3) in an element of length h. In equilibrium, the change is due to
        gravity, inertia and all loads on the middle node.
        """
        stiffness = self.beam.section_stiffness
        first = 2 * np.arange(self.beam.elements)[:, None]
        angles = np.array(self.angles)[first + np.arange(3)]
        x, y, angle = (
            np.einsum("gi,tei->gte", weights, q[:, angles + d])
            for weights, d in ((self.slopes, -2), (self.slopes, -1), (self.shapes, 0))
        )
        turn, (along, across) = np.exp(1j * angle), self.unstrained
        strained = (x + 1j * y) / turn
        forces = turn * (stiffness.axial * (strained.real - along) + 1j * stiffness.shear * (strained.imag - across))
        return np.asarray((np.exp(-1j * q[:, angles[:, 1]]) * (forces[1] - forces[0])).imag)

    def warnings(self) -> Iterator[str]:
        """Yield a warning if the elements are too coarse."""
        beam, turn = self.beam, float(np.max(self.turns))
        what, error, count = self._largest_error()
        if turn > TURN:
            node = int(np.argmax(self.turns))
            nodes = beam.length * math.sqrt(self.largest[5] / beam.section_stiffness.bending) / SPACING[beam.nodes]
            # Two nodes tell the mean curvature only, which is half of that at the clamp of a cantilever.
            uneven = 2.0 if beam.node_count == 2 else 1.0
            count = max(count, nodes / (beam.nodes - 1), uneven * beam.elements * turn / TURN)
            reason = (
                f"bending turns '{self.name}.{node + 1}' by {turn:.2g} rad against '{self.name}.{node}', so that its "
                f"forces and moments may be wrong by more than 1 %"
            )
        elif error > VARIATION:
            reason = f"{what} may be wrong by about {100.0 * error:.2g} %"
        else:
            return
        yield f"the elements of beam '{self.name}' are too coarse: {reason}; {_advice_for(count)}"

    def _largest_error(self) -> tuple[str, float, float]:
        """Return which results of a beam have the largest relative error, the error, and how many elements suffice."""
        beam, section = self.beam, self.beam.section_stiffness
        tension, bending, of_tension, of_bending, axial, _ = self.largest.tolist()
        length, count = beam.element_length, beam.elements
        energies = tension / section.axial, bending / section.bending
        # n elements have n - 1 differences
        stretch = TENSION * of_tension * count / max(1, count - 1) / (12.0 * tension or 1.0)
        errors = stretch, of_bending / (12.0 * bending or 1.0)
        if beam.corrected:
            # Corrected elements represent the variation, by a shear flexibility that adds to the effect of the axial
            # force N on a bent beam: the relative error of the moment is N h^2 / (24 EI), h being the element's length.
            errors = errors[0], axial * length**2 / (24.0 * section.bending)
        elif beam.nodes == 3:
            noise = 3.0 * count * (length * section.shear * ROUND_OFF) ** 2
            errors = 0.0, CURVED * math.sqrt(of_bending / (120.0 * bending or 1.0)) if of_bending > noise else 0.0
        least = [
            count * stiffness * strain**2
            for stiffness, strain in ((section.axial, ROUND_OFF), (section.bending, ROUND_OFF / length))
        ]
        judged = [
            error if energy > max(SMALL * sum(energies), lowest) else 0.0
            for error, energy, lowest in zip(errors, energies, least, strict=True)
        ]
        what = ("its axial forces or elongations", "its moments or deflections")[int(np.argmax(judged))]
        return what, max(judged), _needed_elements(count, max(judged))


def _needed_elements(elements: int, error: float) -> float:
    """Return the number of elements with which an estimate of order 2 in the length of an element is acceptable."""
    return elements * math.sqrt(error / VARIATION)


def advice_on_elements(elements: int, error: float) -> str:
    """Return the advice of a warning about a relative error with this number of elements; empty if it is acceptable."""
    return _advice_for(_needed_elements(elements, error)) if error > VARIATION else ""


def _advice_for(needed: float) -> str:
    """Return the advice of a warning, if the present state of a beam asks for this number of elements."""
    if not MARGIN * needed <= MOST_ADVISED:
        return f"more than {MOST_ADVISED} elements would be needed, so check its stiffness and its loads"
    count = math.ceil(MARGIN * needed)
    unit = 1 if count < 100 else 10
    return f"use about {-(-count // unit) * unit} elements"
