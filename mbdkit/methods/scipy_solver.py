"""Solvers of ``scipy.integrate`` as methods: the first-order form y = (q, v, work, dissipated, z) of the equations."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.methods.kinds import Tolerances, Traits
from mbdkit.methods.step_methods import ExternalMethod, Step, StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion

T = TypeVar("T")
_RADAU_FIRST_NODE = (4 - 6**0.5) / 10


class SciPySolver(ExternalMethod):
    """A solver class of ``scipy.integrate`` for the first-order form y = (q, v, work, dissipated, z).

    Both energies [J] are parts of y if loads, drivers or dampers are present, so that they are integrated with the
    weights of the method. Events are located on the dense output of the solver, whose order can be lower than that of
    its steps.

    Parameters
    ----------
    solver
        Name of the `OdeSolver` subclass in ``scipy.integrate``, or the class itself.
    rtol, atol
        Tolerances of the solver.
    needs_jacobian
        Whether the solver uses the Jacobian of the right-hand side; it then receives that of
        `EquationsOfMotion.jacobian`.
    max_step
        Largest step [s], passed to the solver unless it is None.
    by_size
        See `Tolerances`.
    """

    def __init__(
        self,
        solver: str | type[Any],
        rtol: float,
        atol: float,
        needs_jacobian: bool = False,
        max_step: float | None = None,
        by_size: bool = False,
    ):
        self.solver, self.rtol, self.atol = solver, rtol, atol
        self.needs_jacobian, self.max_step, self.by_size = needs_jacobian, max_step, by_size
        self.tolerances = Tolerances(rtol, atol or rtol, max_step, by_size)
        self._energies = np.zeros(2)

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        whose = "SciPy offers" if isinstance(self.solver, str) else "its library offers"
        why = f"{whose} no way to store the state of its solvers"
        return replace(super().traits, integrates_states=True, why_no_checkpoint=why)

    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        """See `ExternalMethod.open`."""
        import scipy.integrate

        self._equations, n = equations, equations.n
        self._parts = np.cumsum([n, n, 2 * equations.has_power])
        self._times: list[float] = []
        solver = getattr(scipy.integrate, self.solver) if isinstance(self.solver, str) else self.solver
        options: dict[str, Any] = {"rtol": self.rtol, "atol": self._absolute()}
        longest = min(math.inf if self.max_step is None else self.max_step, equations.longest_step)
        if longest < math.inf:
            options["max_step"] = longest
        if self.needs_jacobian:
            options["jac"] = self._jacobian
        if equations.first_step is not None:
            options["first_step"] = equations.first_step
        # Energies continue from those at the end of the last step, because their sizes are part of the error norm.
        energies = self._energies if equations.has_power else ()
        y = np.concatenate([state.q, state.v, energies, state.z])
        self._run = self._guarded(lambda: solver(self._rates, t, y, stop, **options))
        if self._error is not None:  # with rates that are not finite, some solvers choose NaN as the first step
            raise self._error

    def advance(self) -> Step:
        """See `ExternalMethod.advance`."""
        run, equations = self._run, self._equations
        begin, before, lu = run.t, run.y, run.nlu
        self._times.clear()
        message = self._guarded(run.step)
        equations.counters.factorizations += run.nlu - lu
        if run.status == "failed":
            if self._error is not None:
                raise self._error
            raise StepError("step-too-small", f"{message}".rstrip("."))
        if run.t == begin:  # LSODA would otherwise continue forever with steps below the round-off of the time
            raise StepError("step-too-small", "the step is below the rounding error of the time")
        if self._error is not None and not np.all(np.isfinite(run.y)):  # LSODA goes on with numbers that are not
            raise self._error
        iterations, attempts = self._effort(begin)
        equations.counters.newton_iterations += iterations
        equations.counters.rejected += attempts - 1
        q, v, energies, z = np.split(run.y, self._parts)
        work = lost = 0.0
        if len(energies):
            self._energies = energies
            work, lost = energies - before[self._parts[1] : self._parts[2]]
        self._before = begin, before
        self._inner: Callable[[float], np.ndarray] | None = None
        size = getattr(run, "h_abs", None)
        return Step(
            StepState(q, v, work=work, dissipated=lost, z=z), dense=self._dense, next_step=size, time=float(run.t)
        )

    def _absolute(self) -> Any:
        """Return the absolute tolerance: a number, or one for each component of y; see `Tolerances.by_size`."""
        equations = self._equations
        length = min(1.0, equations.length) if self.by_size else 1.0
        if length == 1.0:
            return self.atol
        bodies = np.tile([length, length, 1.0], 2 * equations.n // 3)
        energies = np.full(2 * equations.has_power, length * length)
        return self.atol * np.concatenate([bodies, energies, np.ones(len(equations.z0))])

    def _guarded(self, call: Callable[[], T]) -> T:
        """Return what a call of the solver returns; raise StepError if numbers that are not finite have stopped it."""
        self._error: StepError | None = None
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                return call()
        except (ValueError, np.linalg.LinAlgError):
            if self._error is None:
                raise
            raise self._error from None  # SciPy's linear algebra raises these for numbers that are not finite

    def _rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return dy/dt; nan if it is not finite."""
        self._times.append(t)
        equations = self._equations
        q, v, energies, z = np.split(y, self._parts)
        try:
            a, lam, rates = equations.derivatives(t, q, v, z)
        except StepError as error:
            if error.code != "not-finite":
                raise
            self._error = error
            return np.full(len(y), np.nan)
        powers = equations.powers(t, q, v, lam) if len(energies) else ()
        return np.concatenate([v, a, powers, rates])

    def _jacobian(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return the Jacobian of `_rates`; the rows and columns of the energies are zero."""
        q, v, _, z = np.split(y, self._parts)
        out = np.zeros((len(y), len(y)))
        kept = np.delete(np.arange(len(y)), np.s_[self._parts[1] : self._parts[2]])
        try:
            out[np.ix_(kept, kept)] = self._equations.jacobian(t, q, v, z)
        except StepError as error:
            if error.code != "not-finite":
                raise
            self._error = error
            out[:] = np.nan
        self._equations.counters.factorizations += 1
        return out

    def _dense(self, theta: float) -> tuple[Any, ...]:
        """Return the state at a share of the last step, and the energies since its start.

        Raises StepError if the solver has no dense output, or if the additional stages that DOP853 needs for it are at
        a singular position.
        """
        t0, y0 = self._before
        if theta in (0.0, 1.0):
            y = self._run.y if theta else y0
        else:
            if self._inner is None:
                try:
                    self._inner = self._guarded(self._run.dense_output)
                except NotImplementedError:
                    raise StepError("not-finite", "the solver has no dense output") from None
                if self._error is not None:
                    raise self._error
            y = np.asarray(self._inner(t0 + theta * (self._run.t - t0)))
        q, v, energies, z = np.split(y, self._parts)
        gained = energies - y0[self._parts[1] : self._parts[2]] if len(energies) else (0.0, 0.0)
        return q, v, z, float(gained[0]), float(gained[1])

    def _effort(self, t: float) -> tuple[int, int]:
        """Return the numbers of Newton iterations and attempts in the last step, from the times of its evaluations."""
        times = self._times
        stages = getattr(self._run, "n_stages", None)
        if stages:
            return 0, max(1, round(len(times) / stages))
        if type(self._run).__name__ == "Radau":
            sizes: list[float] = []
            i = 0
            while i + 2 < len(times):
                h = times[i + 2] - t
                if h > 0 and abs(times[i] - t - _RADAU_FIRST_NODE * h) < 1e-6 * h:
                    sizes.append(h)
                    i += 3
                else:
                    i += 1
            return len(sizes), max(1, len(set(sizes)))
        return 0, max(1, len({x for x in times if x != t}))
