"""A run with derivatives of its recorded states, and of what is computed from them, by parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.jit.bundle import PinnedBundle
from mbdkit.engine.jit.dual_arrays import Duals
from mbdkit.engine.jit.dual_types import DIRECTIONS
from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.dual_observe import observe_duals
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.workspace import Workspace
from mbdkit.errors import RunError, SpecError
from mbdkit.run_preparation import build, guards, make_method, size_at_start, timetable
from mbdkit.spec import RunSpec
from mbdkit.stepping.differentiated_stepper import DifferentiatedStepper, NoDerivativeError
from mbdkit.stepping.dual_run import Seeds, constants, dual_states
from mbdkit.stepping.start import start_differentiated


@dataclass(frozen=True)
class States:
    """T states of a run with derivatives by K parameters, and what is computed from them.

    All arrays but `time` and `weight` have a last axis of 1 + K: the value, then the derivatives.

    Parameters
    ----------
    workspace
        The mechanism.
    time
        (T,) times [s].
    weight
        (T,) weights of an integral over time [s]; None for recorded states.
    q, v
        (T, 3 (B + 1), 1 + K) positions and velocities, ground last.
    energy
        (T, 2, 1 + K) work and dissipated energy [J]; None where they are not known.
    observed
        Accelerations, reactions, forces, markers and energies.
    """

    workspace: Workspace
    time: np.ndarray
    weight: np.ndarray | None
    q: np.ndarray
    v: np.ndarray
    energy: np.ndarray | None
    observed: Observed

    @cached_property
    def reactions(self) -> np.ndarray:
        """(T, J, 3, 1 + K) reaction force (x, y) [N] and torque [N m] of each joint."""
        x = self.observed.reactions
        flat = x.reshape(*x.shape[:2], 3 * x.shape[-1])
        summed = JointSums(self.workspace.mechanism).sum(flat)
        return summed.reshape(*summed.shape[:2], 3, x.shape[-1])


@dataclass(frozen=True)
class DifferentiatedRun:
    """The recorded states of a run, and the stages of its steps as nodes of integrals, with derivatives."""

    rows: States
    nodes: States


def differentiated_run(spec: RunSpec, seeds: Seeds, count: int, *, with_nodes: bool) -> DifferentiatedRun:
    """Run a spec, and differentiate it by parameters.

    Parameters
    ----------
    seeds
        Derivatives of the prepared run by the parameters.
    count
        Number of parameters.
    with_nodes
        Whether the stages of the steps are kept as nodes of integrals.

    Raises
    ------
    SpecError
        If runs of this spec cannot be differentiated.
    RunError
        If the run stops early.
    """
    refuse(spec)
    parts = []
    for first in range(0, max(count, 1), DIRECTIONS):
        some = slice(first, first + DIRECTIONS)
        parts.append(
            _pass(spec, {name: x[..., some] for name, x in seeds.items()}, min(DIRECTIONS, count - first), with_nodes)
        )
    if len(parts) == 1:
        return parts[0]
    return DifferentiatedRun(_joined([one.rows for one in parts]), _joined([one.nodes for one in parts]))


def refuse(spec: RunSpec) -> None:
    """Raise SpecError if runs of a spec have no derivatives."""
    if spec.is_to_be_chosen:
        raise SpecError("a gradient needs a method and a step; it does not choose them", key="accuracy")
    if spec.output.interval is not None:
        raise SpecError(
            "states recorded by `interval` have no derivatives; record every k-th step by `every`",
            key="output.interval",
        )
    if spec.events:
        raise SpecError("runs with events have no derivatives", key="events")


def _pass(spec: RunSpec, seeds: Seeds, count: int, with_nodes: bool) -> DifferentiatedRun:
    """Run a spec with the derivatives by up to `DIRECTIONS` parameters."""
    method = make_method(spec)
    workspace, _ = build(spec)
    table = timetable(spec, guards(spec, size_at_start(spec, workspace)))
    if table.impacts:
        raise SpecError("runs with impacts of drivers have no derivatives", key="impacts")
    try:
        stepper = start_differentiated(method, workspace, table, seeds, with_nodes=with_nodes)
    except NoDerivativeError as error:
        raise SpecError(
            f"{spec.integrator_item.id} has no derivatives by parameters: {error}", key="integrator"
        ) from None
    except SingularSystemError as error:
        name = workspace.mechanism.unknown_name(error.index)
        raise RunError(f"the stage equations are singular at the start, near {name}") from None
    times = [np.array([workspace.t0])]
    while not (stepper.finished or stepper.failure):
        times.append(stepper.advance().time)
    if stepper.failure:
        raise RunError(f"a run that stops early has no gradient: {stepper.failure.code}: {stepper.failure.sentence}")
    return DifferentiatedRun(*_observed(stepper, np.concatenate(times), seeds, 1 + count))


def _observed(stepper: DifferentiatedStepper, time: np.ndarray, seeds: Seeds, width: int) -> tuple[States, States]:
    """Return recorded states and nodes, with what is computed from them."""
    workspace, steps = stepper.workspace, stepper.steps
    assert steps is not None
    q0, v0 = (constants(x, seeds.get(name))[None] for name, x in (("q", workspace.q0), ("v", workspace.v0)))
    q, v, energy = steps.recorded(len(time) - 1)
    q, v = np.concatenate([q0, q]), np.concatenate([v0, v])
    energy = np.concatenate([np.zeros((1, *energy.shape[1:])), energy])
    workspace.clamp_motions(-np.inf, np.inf)
    rows = _evaluated(stepper, time, None, q, v, energy, width)
    return rows, _evaluated(stepper, *steps.nodes(), None, width)


def _evaluated(
    stepper: DifferentiatedStepper,
    time: np.ndarray,
    weight: np.ndarray | None,
    q: np.ndarray,
    v: np.ndarray,
    energy: np.ndarray | None,
    width: int,
) -> States:
    """Return states with what is computed from them."""
    steps, workspace = stepper.steps, stepper.workspace
    assert steps is not None
    steps.take_up_solver()
    states = dual_states(steps.run, workspace, time, q.view(Duals), v.view(Duals))
    pinned = PinnedBundle(states)
    status, row = observe_duals(pinned.address)
    if status != OK:
        raise RunError(f"the derivatives of the accelerations at t = {time[row]:.6g} s cannot be computed")
    observed = Observed(*(np.asarray(x[..., :width]) for x in states.observed))
    cut = [None if x is None else np.asarray(x[..., :width]) for x in (q, v, energy)]
    assert cut[0] is not None
    assert cut[1] is not None
    return States(workspace, time, weight, cut[0], cut[1], cut[2], observed)


def _joined(parts: Sequence[States]) -> States:
    """Return the same states with the derivatives of several passes."""

    def together(arrays: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([arrays[0], *(x[..., 1:] for x in arrays[1:])], axis=-1)

    first = parts[0]
    energy = None if first.energy is None else together([one.energy for one in parts if one.energy is not None])
    return States(
        first.workspace, first.time, first.weight,
        together([one.q for one in parts]), together([one.v for one in parts]), energy,
        Observed(*(together(x) for x in zip(*(one.observed for one in parts), strict=True))),
    )  # fmt: skip
