"""Muscles that act in a run: force elements along their paths, with the law of `mbdkit_biomech.muscles.hill_laws`; and
the equilibrium of their fibres in predictions, where velocity and force are unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np

from mbdkit.base import elementary, higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.engine.compile_forces import Lowering, expression_lowering, lowering
from mbdkit.engine.compiled_mechanism import ActingForce
from mbdkit.engine.consistent_start import start_values
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.kernels.table_rows import SPRING
from mbdkit.engine.workspace import Workspace
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import Program
from mbdkit.integrators.loop.failed_steps import obstacle_clause, stiffness_clause
from mbdkit.mechanism.element_kinds import element_forces
from mbdkit.mechanism.force_law import TracedLaw
from mbdkit.mechanism.joints import Joint, Revolute
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import run_check
from mbdkit.mechanism.pathways import Segment
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.mechanism.state_values import is_of_state
from mbdkit.mechanism.values import Table, curve_of
from mbdkit.runs.run_seams import spec_criterion
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.finding import Finding
from mbdkit_biomech.muscles.force_curves import CURVES
from mbdkit_biomech.muscles.hill_laws import (
    LAW_ID,
    MOST_NUMBERS,
    Form,
    TableForm,
    activation_rate_text,
    excitation_of,
    fiber_pull,
    muscle_law,
    tendon_gap,
)
from mbdkit_biomech.muscles.muscle import Muscle, PathItem
from mbdkit_biomech.muscles.muscle_path import MusclePath

#: Shortest fibres allowed for an equilibrium at the start, in optimal lengths; the passive force is zero there.
SHORTEST = 0.2

SAMPLES = 1001  #: Number of times at which excitations are compared with 0 and 1.

#: Excitations outside the range 0 to 1 by more than this count as wrong; splines through 0 and 1 exceed the range a
#: little.
OVERSHOOT = 0.01


@dataclass(frozen=True)
class MuscleForce:
    """A muscle as a force element of a run. This object is also the pathway.

    Attributes
    ----------
    name, muscle
        Name of the muscle, and the muscle.
    """

    name: str
    muscle: Muscle
    law_id: ClassVar[str] = LAW_ID
    length_unit: ClassVar[str] = "m"

    @property
    def pathway(self) -> MuscleForce:
        """The pathway along which the force acts, which is this object."""
        return self

    @cached_property
    def force_law(self) -> TracedLaw:
        """The law of the tension."""
        return muscle_law(self.muscle.tendon, self.muscle.curves, self._excitation[0])

    @property
    def numbers(self) -> list[float]:
        """Numbers in an excitation that is a function of time, in the order of `excitation_of`; empty for others."""
        return self._excitation[1]

    @cached_property
    def _excitation(self) -> tuple[Form, list[float]]:
        """The form of an excitation that is a function of time, and its numbers; see `excitation_of`."""
        if (given := self.muscle.excitation) is None or is_of_state(given):
            return (), []
        if isinstance(given, Table):
            curve = curve_of(given)
            terms, pieces = curve.c.shape
            return TableForm(pieces, terms, given.period > 0), [*curve.x.tolist(), *curve.c.T.ravel().tolist()]
        program = Expression.parse(given if isinstance(given, str) else repr(float(given))).program
        form = tuple((name, 0.0 if name == "const" else number) for name, number in program)
        return form, [number for name, number in program if name == "const"]

    def excitation_at(self, time: np.ndarray) -> np.ndarray:
        """Return an excitation that is a function of time, at times (T,).

        Values are computed one by one, because rounding errors of NumPy's functions depend on the length of the array.
        """
        form, numbers = self._excitation
        return np.array([excitation_of(form, t, numbers) for t in time.tolist()])

    def excitation_outside(self, start: float, end: float) -> tuple[float, float] | None:
        """Return a time between start and end at which the excitation is far outside the range 0 to 1, and the value of
        the excitation at this time.

        None if there is no such time, or if the excitation is not a function of time.
        """
        form, numbers = self._excitation
        if not form:
            return None
        time = np.linspace(start, end, SAMPLES)
        with np.errstate(all="ignore"):
            value = np.broadcast_to(excitation_of(form, time, [np.float64(number) for number in numbers]), time.shape)
            beyond = np.abs(value - 0.5) - 0.5
        if not np.any(beyond > OVERSHOOT):
            return None
        worst = int(np.nanargmax(beyond))
        return float(time[worst]), float(value[worst])

    def segments(self, joints: Mapping[str, Joint]) -> tuple[Segment, ...]:
        """Return the segments of the path: straight ones; for each circle, its two tangents and the straight line
        past it; and that with the patella.
        """
        found: list[Segment] = []
        path = self.muscle.path
        for before, item, after in zip([None, *path], path, [*path[1:], None], strict=False):
            if after is None:
                break
            if item.wrap is None and after.wrap is None:
                found.append(_segment("lifted", item, after, after.offset - item.offset))
            elif item.wrap is not None:
                assert before is not None
                radius = item.wrap.radius if item.wrap.side == "left" else -item.wrap.radius
                found += [_segment("tangent", before, item, radius), _segment("tangent", item, after, -radius)]
                found.append(_segment("lifted", before, after, 0.0))
        if self.muscle.patella is not None:
            knee = joints[self.muscle.patella.joint]
            assert isinstance(knee, Revolute)  # `PatellaPath` says so
            assert knee.points is not None
            found.append(Segment("guided", knee.bodies, (*knee.points[0], *knee.points[1])))
        return tuple(found)

    def fiber_length_at(self, length: float) -> float:
        """Return the length of the fibres [m] for a length of the path [m].

        With an elastic tendon, the fibres are at rest and in equilibrium with the tendon.

        Raises
        ------
        SpecError
            If a rigid tendon is longer than the path, or there is no equilibrium.
        """
        muscle = self.muscle
        curves, thickness, along = CURVES[muscle.curves], muscle.thickness, length - muscle.tendon_length
        lengths = f"the path is {length:.6g} m long, the tendon {muscle.tendon_length:.6g} m"
        key = f"model.muscles.{quoted(self.name)}.tendon_length"
        longest = float(elementary.hypot(along, thickness))
        if muscle.tendon == "rigid":
            if along <= 0.0:
                raise SpecError(f"the tendon is longer than the path at the start: {lengths}", key=key)
            return longest

        def surplus(fiber: float) -> float:
            along = np.sqrt(fiber * fiber - thickness * thickness)
            normal = np.array(fiber / muscle.optimal_length)
            pull = muscle.activation.initial * curves.active(normal)[0] + curves.passive(normal)[0]
            tendon = curves.tendon(np.array((length - along) / muscle.tendon_length))[0]
            return float(pull * along / fiber - tendon)

        shortest = max(SHORTEST * muscle.optimal_length, 1.001 * thickness)
        if along <= 0.0 or longest <= shortest or surplus(shortest) >= 0.0:
            raise SpecError(
                f"no length of the fibres is in equilibrium with the tendon at the start: {lengths}; correct "
                "`tendon_length` or the path",
                key=key,
            )
        from scipy.optimize import brentq  # loaded only if a run has such muscles

        # Brent's method needs at most the square of the steps of bisection, more than its default for flat functions
        return float(brentq(surplus, shortest, longest, xtol=1e-15, rtol=1e-15, maxiter=10_000))


def _segment(kind: str, first: PathItem, second: PathItem, constant: float) -> Segment:
    return Segment(kind, (first.on, second.on), (*_fixed(first), *_fixed(second)), (constant, 0.0))


def _fixed(item: PathItem) -> tuple[float, float]:
    x, y = item.center
    assert isinstance(x, int | float)
    assert isinstance(y, int | float)
    return float(x), float(y)


@dataclass(frozen=True)
class ActingMuscle:
    """A muscle that acts in runs.

    Attributes
    ----------
    force
        The muscle as a force element.
    activation
        Index of its activation among the first-order states. If the tendon is elastic, the fibre length is the next
        state.
    place
        Index among all force elements.
    excitation
        Program and quantities of an excitation that is an expression of the state; see
        `mbdkit.events.state_program.state_program`. None for any other excitation.
    """

    force: MuscleForce
    activation: int
    place: int
    excitation: tuple[Program, list[tuple[str, str, str]]] | None = None


def forces_of(muscles: Mapping[str, Muscle]) -> dict[str, MuscleForce]:
    """Return muscles as force elements by name."""
    return {name: MuscleForce(name, muscle) for name, muscle in muscles.items()}


element_forces(forces_of)


@lowering
def lower(
    _muscles: Mapping[str, Muscle], lowering: Lowering, acting: tuple[ActingForce, ...]
) -> tuple[ActingMuscle, ...]:
    """Return the muscles of a mechanism that is compiled, whose forces have been added."""
    for one in acting:
        muscle = cast("MuscleForce", one.force).muscle
        if muscle.patella is not None:
            path = MusclePath(one.name, muscle, QuantityNames(lowering.mechanism))
            assert path.patella is not None
            lowering.guide(one, path.patella.guide)
    return tuple(ActingMuscle(cast("MuscleForce", one.force), one.state, one.place) for one in acting)


@expression_lowering
def lower_excitations(muscles: tuple[ActingMuscle, ...], lowering: Lowering) -> tuple[ActingMuscle, ...]:
    """Replace the rates of activations by expressions, for excitations that are expressions of the state."""
    return tuple(_with_excitation(muscle, lowering) for muscle in muscles)


def _with_excitation(one: ActingMuscle, lowering: Lowering) -> ActingMuscle:
    for key, text in one.force.muscle.expressions():
        name = one.force.name
        rate = activation_rate_text(one.force.muscle.activation, text, f'states["{name}.activation"]')
        lowering.set_rate(one.activation, lowering.expression(f"model.muscles.{quoted(name)}.{key}", name, rate))
        return replace(one, excitation=higher_layers.state_program(text, lowering.mechanism))
    return one


@start_values
def fibers_at_start(
    muscles: tuple[ActingMuscle, ...], mechanism: Mechanism, t0: float, q: np.ndarray
) -> dict[int, float]:
    """Return lengths of the fibres on elastic tendons [m], in equilibrium at positions `q`, by index of the state."""
    names, found = QuantityNames(mechanism), {}
    for muscle in muscles:
        path = MusclePath(muscle.force.name, muscle.force.muscle, names).at(np.array([t0]), q.reshape(1, -1))
        fiber = muscle.force.fiber_length_at(float(path.length[0]))
        if muscle.force.muscle.tendon == "elastic":
            found[muscle.activation + 1] = fiber
    return found


@obstacle_clause
def torn_path(muscles: tuple[ActingMuscle, ...], workspace: Workspace, t: float, q: np.ndarray, v: np.ndarray) -> str:
    """Return a clause that names a muscle whose path cannot pass a circle at a position; empty if there is none.

    Parameters
    ----------
    muscles
        The muscles.
    workspace
        The mechanism; its working arrays are overwritten.
    t, q, v
        Time [s], positions and velocities (3 (B + 1),).
    """
    if not np.all(np.isfinite(q)):
        return ""
    top = workspace.mechanism.topology
    tangents_at(workspace.engine, t, q, v, np.zeros_like(q), np.zeros((len(top.pairs), 2)))
    rows = np.flatnonzero(np.isnan(workspace.scratch.s[:, 0]) & (top.springs[:, SPRING.segments] > 0))
    names = {muscle.place: muscle.force.name for muscle in muscles}
    if not (torn := [names[place] for place in top.force_place[rows].tolist() if place in names]):
        return ""
    return f"muscle '{torn[0]}' would pass a circle on its other side, or a point of its path is inside of a circle"


@stiffness_clause
def stiffest(muscles: tuple[ActingMuscle, ...]) -> str:
    """Return a clause that names the muscle with the shortest elastic tendon, relative to the speed of its fibres.

    It is empty if all tendons are rigid.
    """
    elastic = [muscle.force for muscle in muscles if muscle.force.muscle.tendon == "elastic"]
    if not elastic:
        return ""

    def slack(one: MuscleForce) -> float:
        return one.muscle.tendon_length / (one.muscle.max_velocity * one.muscle.optimal_length)

    name = min(elastic, key=slack).name
    return f"the fibres of muscle '{name}' are stiff: they need smaller steps, or an implicit method (radau-iia)"


@run_check
def check_acting(mechanism: Mechanism) -> None:
    """Raise a SpecError for the first muscle with a property that runs do not support, or without an excitation."""
    for name, muscle in mechanism.muscles.items():
        if muscle.patella is not None:
            MusclePath(name, muscle, QuantityNames(mechanism))
        for key, sentence in _unsupported(name, muscle):
            raise SpecError(sentence, key=f"model.muscles.{quoted(name)}.{key}")


def _unsupported(name: str, muscle: Muscle) -> Iterator[tuple[str, str]]:
    """Yield keys of a muscle whose values runs do not support, with sentences on them."""
    if muscle.excitation is None:
        why = "a muscle needs an excitation between 0 and 1 (number, expression or table)"
        yield "excitation", f"is missing: in a run, {why}"
    if len(MuscleForce(name, muscle).numbers) > MOST_NUMBERS[muscle.curves]:
        yield "excitation", "the excitation has too many points for a run; leave out some, or split the run"
    if muscle.tendon == "elastic" and not muscle.tendon_length:
        yield "tendon_length", "should be greater than 0, because an elastic tendon needs a length"
    if muscle.tendon == "elastic" and muscle.curves == "millard" and not muscle.damping:
        why = "undamped fibres cannot be in equilibrium with every force of an elastic tendon"
        yield "damping", f"should be greater than 0: with the curves millard, {why}"
    for key, what in _of_inverse_dynamics(muscle):
        yield key, f"in a run, {what} are for inverse dynamics only"


def _of_inverse_dynamics(muscle: Muscle) -> Iterator[tuple[str, str]]:
    """Yield keys of items of a path that only inverse dynamics supports, with what runs support and what not."""
    for index, item in enumerate(muscle.path):
        key = f"path[{index}]"
        if item.wrap is not None:
            before, after = muscle.path[index - 1], muscle.path[index + 1]
            if before.wrap is not None or after.wrap is not None:
                yield f"{key}.wrap", "a path has at most one circle between two points; several"
            if before.offset != after.offset:
                yield f"{key}.wrap", "the points next to a circle have equal offsets from the plane; different ones"
        if item.when is not None:
            yield f"{key}.when", "a path has all of its points at all times; conditions"
        if item.moves:
            yield f"{key}.point", "points of muscles are fixed to their bodies; points that move with a coordinate"


@spec_criterion
def excitations(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a warning for each muscle whose excitation leaves the range 0 to 1 as a function of time."""
    for name, muscle in forces_of(spec.mechanism().muscles).items():
        if (outside := muscle.excitation_outside(spec.time.start, spec.time.final)) is not None:
            time, value = outside
            reached = f"{value:.3g} at t = {time:.6g} s"
            sentence = f"the excitation of muscle '{name}' is {reached}; it should stay between 0 and 1"
            key = f"model.muscles.{quoted(name)}.excitation"
            yield Finding("excitations", "doubtful", sentence, key, is_named=False)


@dataclass(frozen=True)
class FiberEquilibrium:
    """The equilibrium of the fibres of a muscle; see `mbdkit_predict.exported_elements.ElementEquilibrium`."""

    muscle: Muscle
    state: ClassVar[str] = "fiber_length"
    unknowns: ClassVar[tuple[str, str]] = ("fiber_velocity", "tendon_force")
    recorded: ClassVar[tuple[str, str]] = ("fiber_rate", "force")
    lowest: ClassVar[tuple[float, float]] = (-math.inf, 0.0)
    starts: ClassVar[tuple[float, float]] = (0.0, 0.1)

    @property
    def sizes(self) -> tuple[float, float]:
        """Largest velocity [m/s] and force [N] of the fibres."""
        return self.muscle.max_velocity * self.muscle.optimal_length, self.muscle.max_force

    def in_si(self, rate: Any, force: Any, law: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return the velocity of the fibres [m/s] and the force of the tendon [N]."""
        return law["max_speed"] * rate, law["max_force"] * force

    def conditions(self, rate: object, force: object, length: object, law: Mapping[str, object]) -> tuple[Any, Any]:
        """Return the force of the fibres along the tendon less that of the tendon, as a share of the largest force; and
        the room for the tendon less its length, as a share of it (with the curves `millard`, a difference of forces).
        """
        curves = CURVES[self.muscle.curves]
        return fiber_pull(rate, law, curves) - force, tendon_gap(length, force, law, curves)

    def at_rest(self, lengths: np.ndarray) -> np.ndarray:
        """Return the lengths of the fibres on a slack tendon for lengths of the muscle [m]."""
        own = self.muscle
        along = np.maximum(lengths - own.tendon_length, SHORTEST * own.optimal_length)
        return np.asarray(np.hypot(along, own.thickness))


def equilibrium_of(muscle: Muscle) -> FiberEquilibrium | None:
    """Return the equilibrium of the fibres of a muscle with an elastic tendon; None if the tendon is rigid."""
    return FiberEquilibrium(muscle) if muscle.tendon == "elastic" else None
