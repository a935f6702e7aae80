"""The way back through the steps of a run, by the kernels of the adjoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.system import DIVERGED, OK
from mbdkit.engine.kernels.table_rows import PAIR, SPRING
from mbdkit.engine.native import machine_code
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.native.levels import chosen_level
from mbdkit.engine.native.number_arrays import ITEM, new_duals
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.duals.differentiated_stepper import dual_laws
from mbdkit.integrators.duals.dual_run import Seeds, dual_states, new_dual_run
from mbdkit.laws.tabulated import LAW as TABLE
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta
from mbdkit.runs.continuous_motion import MotionPart
from mbdkit_gradients.adjoint_measures import Bars, NotByAdjointError
from mbdkit_gradients.kernels import adjoint as kernels
from mbdkit_gradients.kernels import kept_stages
from mbdkit_gradients.table_derivatives import touched_laws

#: Arrays of a mechanism with respect to which the adjoint gives derivatives; `weight` follows from `mass`.
ARRAYS = ("mass", "gravity", "pair_parameters", "spring_points", "linear", "law_parameters", "load_points")


def is_ready() -> bool:
    """Return whether the machine code of the kernels is stored; to compile it takes minutes."""
    symbol = kernels.differentiate_back.symbol
    return machine_code.IN_PYTHON or machine_code.stored_file(symbol, chosen_level()) is not None


def row_size(workspace: Workspace) -> int:
    """Return the number of values that are kept of a stage; see `kept_stages.keep_stage`."""
    schur, mechanism = workspace.solver.schur, workspace.mechanism
    arrays = schur.diagonal, schur.below, workspace.scratch.response, workspace.scratch.cs[1:]
    return mechanism.size - 3 + 2 * len(mechanism.topology.pairs) + sum(x.size for x in arrays)


def places_in(scratch: Any, name: str) -> np.ndarray:
    """Return the indices in ``Scratch.source`` of the values of an array of terms, in its shape."""
    x, offset = getattr(scratch, name), scratch.source.ctypes.data
    begin = (x.ctypes.data - offset) // x.itemsize
    return np.arange(begin, begin + x.size).reshape(x.shape)


def keep_stages(stepper: Any, rows: np.ndarray) -> PinnedBundle:
    """Let a stepper with fixed steps keep the stages of its steps in `rows` (N S, W); return what has to exist as long
    as it takes steps.
    """
    pinned = PinnedBundle(kept_stages.KeptStages(rows))
    stepper.workspace.scratch.reacting.stages[0] = pinned.address
    if stepper.method.carries_stages:
        stepper.run_state.nodes[0] = kept_stages.keep_accelerations.address
    else:
        stepper.method.attempt = kept_stages.attempt
    return pinned


@dataclass(frozen=True)
class SweptPart:
    """The motion between two stops: numbers of its first and last step end, and its motion; see `MotionPart`."""

    begin: int
    end: int
    motion: MotionPart
    corner: bool  #: Whether it begins at a discontinuity of force laws.
    use: Callable[[], None]  #: Makes force laws use their sides in this part.

    @property
    def plain(self) -> MotionPart:
        """The motion, with the sides of force laws that apply in this part."""
        self.use()
        return self.motion

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the part [s]."""
        time = self.motion.ends.time
        return float(time[0]), float(time[-1])


@dataclass(eq=False)
class SweptSteps:
    """Some steps from step `number` on, or the first part of a step, up to an event, through which derivatives are
    carried back: their method, times (N + 1,), sizes (N,) [s], positions and velocities (N + 1, n + 3) of their ends.
    """

    method: ExplicitRungeKutta | ImplicitRungeKutta
    time: np.ndarray
    size: np.ndarray
    q: np.ndarray
    v: np.ndarray
    rows: np.ndarray  #: (N S, W) stages that the steps have kept; no rows if they have not.
    part: SweptPart  #: The part of the motion that they are in, with their numbers.
    number: int


class BackwardSweep:
    """The kernels of the adjoint for a workspace, and derivatives with respect to numbers of its mechanism."""

    def __init__(self, workspace: Workspace, seeds: Seeds):
        self.workspace = workspace
        mechanism, top = workspace.mechanism, workspace.mechanism.topology
        terms, is_pin = workspace.terms, top.pairs[:, PAIR.kind] == kernels.PIN
        of_pins = [places_in(workspace.scratch, name)[is_pin] for name in ("stiff", "gamma_v", "res_q")]
        is_constant = np.isin(terms.source, np.hstack(of_pins)) | (terms.factor == 0)
        columns = np.column_stack((terms.source, terms.row, terms.column))
        groups = [columns[~is_constant & (terms.factor == 3)], columns[~is_constant & (terms.factor != 3)]]
        kinds = [0 if law < 0 else 1 + (mechanism.laws[law][1].law is not TABLE) for law in top.springs[:, SPRING.law]]
        size, pairs, springs = mechanism.size, len(top.pairs), len(top.springs)
        slots = np.zeros((pairs, 6, 12)), np.zeros((springs, 6, 12))
        for k in range(6):
            slots[0][:, k, k] = slots[1][:, k, 6 + k] = 1.0
        units = Seeds({"pair_parameters": slots[0], "spring_points": slots[1]}, np.ones(12))
        wanted = touched_laws(seeds)
        of_pairs = seeds.get("pair_parameters")
        wants_points = seeds.get("spring_points") is not None or (of_pairs is not None and np.any(of_pairs[~is_pin]))
        try:
            rows = dual_laws(workspace) if wanted is not None or len(top.frictions) else top.laws
        except PluginError as error:
            raise NotByAdjointError(str(error)) from None
        self._run = new_dual_run(workspace, units, rows, 0, 0)
        states = dual_states(self._run, workspace, np.zeros(2), new_duals(2, size), new_duals(2, size))
        self._recorded = PinnedBundle(states._replace(top=self._run.top._replace(baumgarte=states.top.baumgarte)))
        self._stepping = PinnedBundle(states._replace(top=self._run.top))
        w = self._run.w
        self.bundle = kernels.Adjoint(
            only_pins=np.array([int(np.all(is_pin))]),
            terms=np.concatenate(groups).astype(np.int64), by_positions=np.array([len(groups[0])]),
            wants=np.array([wants_points, wanted is not None], dtype=np.int64),
            laws_wanted=(np.zeros(len(top.law_parameters)) if wanted is None else wanted).astype(np.int64),
            kinds=np.array(kinds, dtype=np.int64),
            mu=np.zeros(size), nu=np.zeros((pairs, 2)), right=np.zeros(mechanism.unknowns),
            lam_bar=np.zeros((pairs, 2)), pull_bar=np.zeros((springs, 4)),
            by_reaction=np.zeros(len(top.reactions)), unused=np.zeros((pairs, 6)),
            friction=np.zeros((len(top.frictions), len(top.frictions) + 2)),
            **{name: np.zeros(getattr(top, name).shape) for name in ARRAYS},
            jac=np.asarray(w.jac), gamma=np.asarray(w.gamma), s=np.asarray(w.s), grad=np.asarray(w.grad),
            tension=np.asarray(w.tension), interaction=np.asarray(w.interaction), values=np.asarray(w.law_values),
            rate=np.asarray(states.v)[0, :2],
        )  # fmt: skip
        assert self.bundle.jac.shape[-1] == ITEM
        self._pinned = PinnedBundle(self.bundle)

    def use(self, sides: np.ndarray, places: list[int]) -> None:
        """Use other numbers of force laws, at `places`."""
        for numbers in (self._run.top.law_parameters, self._run.w.law_values):
            np.asarray(numbers)[places, 0] = sides

    def clear(self) -> None:
        """Set the derivatives to zero."""
        for name in ARRAYS:
            getattr(self.bundle, name)[...] = 0.0

    def _call(
        self, engine: int, duals: PinnedBundle, steps: int, task: int, first: int, end: int, given: int = 0
    ) -> tuple[int, int]:
        arguments = engine, duals.address, self._pinned.address, given, steps, task, first, end
        status, place = kernels.differentiate_back(*arguments)
        return int(status), int(place)

    def _retried(self, call: Callable[[int], tuple[int, int]], begin: int, end: int) -> None:
        """Call a kernel from `begin` on until it arrives at `end`; choose new pivots for a state whose system it cannot
        solve.
        """
        failed, place = -1, begin
        while True:
            status, place = call(place)
            if status == OK and place == end:
                return
            if status == DIVERGED:
                raise NotByAdjointError("a fixed-point iteration for the stages of a step does not converge")
            try:
                if status == OK or failed == place:
                    raise SingularSystemError
                self.workspace.use_pivots()
            except SingularSystemError:
                raise NotByAdjointError(
                    "the equations at a stage of a step have no solution, because their system is singular or the "
                    "iteration for the stages diverges"
                ) from None
            failed = place

    def pulled(self, one: Bars) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives (T, n + 3) with respect to positions and velocities of T states."""
        work, states = self.workspace, one.states
        work.clamp_motions(-np.inf, np.inf)
        given = PinnedBundle(kernels.Given(one.reactions, one.forces, one.kinetic, one.gravity, one.multipliers))
        arrays = {
            "q_stage": states.q,
            "v_stage": states.v,
            "to_acc": one.acc,
            "to_q": one.q.copy(),
            "to_v": one.v.copy(),
        }
        steps = example_of(kernels.Steps)._replace(
            time=np.ascontiguousarray(states.time), acc=np.zeros(one.acc.shape), lam=np.zeros(one.multipliers.shape),
            **{name: np.ascontiguousarray(x) for name, x in arrays.items()},
        )  # fmt: skip
        pinned = PinnedBundle(steps)

        def call(begin: int) -> tuple[int, int]:
            for terms in (work.scratch.gamma_v, work.scratch.res_q):  # of Baumgarte, which recorded forces do not have
                terms[...] = 0.0
            end = len(states.time)
            return self._call(work.engine, self._recorded, pinned.address, kernels.PULL, begin, end, given.address)

        self._retried(call, 0, len(states.time))
        return steps.to_q, steps.to_v

    def _steps(self, run: SweptSteps, **arrays: Any) -> Any:
        a, b, c = run.method.tableau.floats()
        stages, size, pairs = len(b), run.q.shape[1], len(self.bundle.nu)
        is_implicit, none = not isinstance(run.method, ExplicitRungeKutta), np.zeros((0, size))
        is_kept = len(run.rows) > 0 and not is_implicit
        top, wants_points = self.workspace.mechanism.topology, self.bundle.wants[kernels.POINTS]
        acting = self.bundle.terms, top.springs, top.loads, top.interactions
        only_pins = self.bundle.only_pins[0] != 0  # the tangents of other joints depend on positions
        needs_positions = any(map(len, acting)) or wants_points or not only_pins or "stage_q_bar" in arrays
        scratch = self.workspace.scratch  # without terms, only the Jacobian is in use
        used = len(scratch.source) if len(self.bundle.terms) else places_in(scratch, "jac").size + size - 3
        names = ("q_stage", "v_stage", "acc", "to_q", "to_v", "to_acc", "by_q", "by_v", "kept")
        vectors = {name: np.zeros((stages, size)) for name in names}
        return kernels.Steps(
            a=np.ascontiguousarray(a), b=np.ascontiguousarray(b), c=np.ascontiguousarray(c),
            **{"q_bar": none, "v_bar": none, "stage_q_bar": none, "stage_v_bar": none, **arrays},
            time=np.ascontiguousarray(run.time[:-1]), size=np.ascontiguousarray(run.size), q=run.q, v=run.v,
            lam=np.zeros((stages, pairs, 2)), **vectors, next=np.zeros(size), is_implicit=np.array([int(is_implicit)]),
            rows=run.rows if is_kept else np.zeros((stages, row_size(self.workspace))), touched=np.zeros(1),
            is_kept=np.array([int(is_kept), int(is_kept and not needs_positions)]), source=np.zeros((stages, used)),
            guess=run.rows if is_implicit else none,
        )  # fmt: skip

    def stages(self, steps: SweptSteps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return times, positions and velocities of the stages of steps."""
        nodes = steps.method.tableau.floats()[2]
        time = (steps.time[:-1, None] + steps.size[:, None] * nodes[: len(steps.method.tableau.floats()[1])]).ravel()
        q, v = (np.zeros((len(time), steps.q.shape[1])) for _ in range(2))
        self._write_stages(steps, self._steps(steps, stage_q_bar=q, stage_v_bar=v))
        return time, q, v

    def end(self, piece: SweptSteps) -> tuple[np.ndarray, np.ndarray]:
        """Return position and velocity at the end of a step."""
        q, v = (np.zeros((len(piece.method.tableau.floats()[1]), piece.q.shape[1])) for _ in range(2))
        steps = self._steps(piece, stage_q_bar=q, stage_v_bar=v)
        self._write_stages(piece, steps)
        weight = piece.size[0] * steps.b
        return piece.q[0] + weight @ steps.v_stage, piece.v[0] + weight @ steps.acc

    def _write_stages(self, run: SweptSteps, steps: Any) -> None:
        """Write the stages of steps."""
        pinned, part = PinnedBundle(steps), run.part
        self.workspace.clamp_motions(*part.plain.sides)

        def call(begin: int) -> tuple[int, int]:
            engine = self.workspace.stepping_engine  # which new pivots may move
            return self._call(engine, self._stepping, pinned.address, kernels.STAGES, begin, part.end)

        self._retried(call, part.begin, part.end)

    def sweep(self, run: SweptSteps, q_bar: np.ndarray, v_bar: np.ndarray, stage_bars: Sequence[np.ndarray]) -> None:
        """Carry the derivatives with respect to the step ends, rows of `q_bar` and `v_bar`, back to the first one."""
        more = dict(zip(("stage_q_bar", "stage_v_bar"), stage_bars, strict=False))
        pinned = PinnedBundle(self._steps(run, q_bar=q_bar, v_bar=v_bar, **more))
        work, part = self.workspace, run.part
        work.clamp_motions(*part.plain.sides)

        def call(left: int) -> tuple[int, int]:
            return self._call(work.stepping_engine, self._stepping, pinned.address, kernels.SWEEP, part.begin, left)

        self._retried(call, part.end, part.begin)
        work.clamp_motions(-np.inf, np.inf)
