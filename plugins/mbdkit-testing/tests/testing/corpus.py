"""Plugins that are each wrong in one way, and a registry that offers one of them beside what mbdkit ships.

The right method behind most of them is the classical Runge-Kutta method or the implicit midpoint rule, written down as
their textbooks have them; what is wrong with a copy is said in its one-line docstring.
"""

from __future__ import annotations

import functools
import importlib.metadata
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.integrate
import sympy
from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit import Claims, EquationsOfMotion, ExpressionLaw, FunctionLaw, Mechanism, StepError, StepMethod, StepState
from mbdkit.methods import gauss
from mbdkit.methods.scipy_solver import SciPySolver
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.manager import load_registry

GAUSS_3: dict[str, Any] = {
    "order": 6, "stages": 3, "symmetric": True, "symplectic": True, "quadratic_invariants": True,
    "needs": ("tangents",),
}  # fmt: skip


class NoOptions(BaseModel):
    """Nothing to choose."""

    model_config = ConfigDict(frozen=True)


# --- methods ---------------------------------------------------------------------------------------------------------


class RungeKutta(StepMethod):
    """The classical method of order 4; nothing is wrong with it."""

    weights = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
    nodes = (0.0, 0.5, 0.5, 1.0)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        w, c, q, v = self.weights, self.nodes, state.q, state.v
        a1, _ = self.rates(equations, t + c[0] * h, q, v)
        v2 = v + h / 2 * a1
        a2, _ = self.rates(equations, t + c[1] * h, q + h / 2 * v, v2)
        v3 = v + h / 2 * a2
        a3, _ = self.rates(equations, t + c[2] * h, q + h / 2 * v2, v3)
        v4 = v + h * a3
        a4, _ = self.rates(equations, t + c[3] * h, q + h * v3, v4)
        dq = h * (w[0] * v + w[1] * v2 + w[2] * v3 + w[3] * v4)
        return state.moved(dq, h * (w[0] * a1 + w[1] * a2 + w[2] * a3 + w[3] * a4))

    def rates(self, equations: EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray) -> Any:
        return equations.accelerations(t, q, v)


class SymplecticEuler(StepMethod):
    """Conserves angular momentum and the symplectic form, not every quadratic invariant; nothing is wrong with it."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a, _ = equations.accelerations(t, state.q, state.v)
        return state.moved(h * (state.v + h * a), h * a)


class WrongCoefficient(RungeKutta):
    """Two of its weights are swapped by a typing error."""

    weights = (1 / 6, 1 / 6, 1 / 3, 1 / 3)


class WrongStageTime(RungeKutta):
    """Its third stage is at the time of the first: only problems that depend on time notice."""

    nodes = (0.0, 0.5, 0.0, 1.0)


class ChangesItsInput(RungeKutta):
    """It moves the state that it was handed in place before it makes the new one."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        state.q[:] = new.q
        return new


class ReturnsItsBuffer(RungeKutta):
    """It returns its result in the same two arrays in every step."""

    def __init__(self) -> None:
        self.q, self.v = np.zeros(0), np.zeros(0)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        if not self.q.size:
            self.q, self.v = np.zeros_like(new.q), np.zeros_like(new.v)
        self.q[:], self.v[:] = new.q, new.v
        return StepState(self.q, self.v)


class LyingCounter(RungeKutta):
    """It counts only one of its four evaluations."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        equations.counters.rhs_evaluations -= 3
        return new


class SwallowsNaN(RungeKutta):
    """Without a solution for the accelerations, it continues with zeros."""

    def rates(self, equations: EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray) -> Any:
        try:
            return equations.accelerations(t, q, v)
        except StepError:
            return np.zeros(equations.n), np.zeros(equations.m)


class Forgetful(StepMethod):
    """Adams-Bashforth of two steps whose memory is in the object, not in the state."""

    def __init__(self) -> None:
        self.before: np.ndarray | None = None

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a, _ = equations.accelerations(t, state.q, state.v)
        now = np.concatenate([state.v, a])
        slope = now if self.before is None else 1.5 * now - 0.5 * self.before
        self.before = now
        return state.moved(h * slope[: equations.n], h * slope[equations.n :])


class Alternating(StepMethod):
    """Symplectic Euler in its two forms by turns; the object, not the state, counts whose turn it is."""

    def __init__(self) -> None:
        self.taken = 0

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        self.taken += 1
        early = self.taken % 2 == 0
        q = state.q + h * state.v if early else state.q
        a, _ = equations.accelerations(t, q, state.v)
        return state.moved(h * (state.v if early else state.v + h * a), h * a)


class Endless(RungeKutta):
    """It repeats a failed evaluation for ever."""

    def rates(self, equations: EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray) -> Any:
        while True:
            try:
                return equations.accelerations(t, q, v)
            except StepError:
                continue


class Idle(RungeKutta):
    """It waits for ever for something that does not change."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        while h > 0.0:
            pass
        return state


class Stabilized(RungeKutta):
    """It projects after each step although the spec does not ask for it."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        q = equations.project_positions(t + h, new.q)
        return StepState(q, equations.project_velocities(t + h, q, new.v))


class Midpoint(StepMethod):
    """The implicit midpoint rule by Newton iteration to rounding; nothing is wrong with it."""

    enough, tangent, lazy = 0.0, 1.0, 0.0

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a = self.solved(equations, t, state, t + h / 2, state.q, state.v, h / 2)
        return state.moved(h * (state.v + h / 2 * a), h * a)

    def solved(
        self, equations: EquationsOfMotion, t: float, state: StepState, at: float, q0: Any, v0: Any, c: float
    ) -> np.ndarray:
        """Return the accelerations a at the time `at` with v = v0 + c a and q = q0 + c v."""
        a, lam = equations.accelerations(t, state.q, state.v)
        before = math.inf
        for _ in range(40):
            q, v = q0 + c * (v0 + c * a), v0 + c * a
            matrix = equations.iteration_matrix(
                at, q, v, a, lam,
                damping=self.tangent * c, stiffness=self.tangent * c * c,
                gamma_v=-self.tangent * c, residual_q=self.tangent * c * c,
            )  # fmt: skip
            rows = equations.constraint_jacobian(at, q) @ a - equations.gamma(at, q, v)
            da, dlam = matrix.solve(-equations.residual(at, q, v, a, lam), -rows)
            change = equations.relative_change(q, c * c * da)
            if change < self.lazy:
                return a
            a, lam = a + da, lam + dlam
            if change <= max(self.enough, 4e-16) or (change >= before / 2 and change < 1e-9):
                return a
            before = change
        raise StepError("newton-failed", "the iteration does not converge")


class LooseNewton(Midpoint):
    """It stops to iterate while a step still moves a body by a ten-thousandth of its place."""

    enough = 1e-4


class LazyNewton(Midpoint):
    """It takes the accelerations of the last step for good where an iteration would move bodies by a millionth only."""

    lazy = 1e-6


def loose_gauss(tolerance: float) -> Registry:
    """Return the Gauss method with 3 stages, whose iteration ends early, and does not say so."""
    return offer(lambda options: mbdkit.ImplicitRungeKutta(gauss.tableau(3), tolerance=tolerance), **GAUSS_3)


class LyingSolver(scipy.integrate.RK45):
    """A solver of SciPy that accepts every step, whatever its error."""

    def __init__(self, fun: Any, t0: float, y0: Any, t_bound: float, **options: Any) -> None:
        super().__init__(fun, t0, y0, t_bound, **(options | {"rtol": 1e-2, "atol": 1e-2}))


class Tolerances(BaseModel):
    """Those of SciPy."""

    rtol: float = 1e-8
    """Relative tolerance."""
    atol: float = 1e-10
    """Absolute tolerance."""


def trapezoid(symmetric: bool) -> Any:
    """Return Heun's method, which is explicit and so not symmetric."""
    tableau = mbdkit.ButcherTableau("heun", [[], [1]], ["1/2", "1/2"], [0, 1], 2)
    return offer(lambda options: mbdkit.ExplicitRungeKutta(tableau), order=2, stages=2, symmetric=symmetric)


# --- models ----------------------------------------------------------------------------------------------------------


def pendulum(motion: str = "", random: bool = False) -> Mechanism:
    """Return a rod; with a motor at its joint if it has a motion, and of an unpredictable mass if `random`."""
    m = Mechanism()
    mass = 1.0 + (np.random.default_rng().random() if random else 0.0)
    m.body("rod", mass=mass, inertia=1 / 12, position=(0.5, 0.0))
    m.revolute("A", m.ground, "rod", at=(0.0, 0.0))
    if motion:
        m.driver("motor", m.ground, "rod", coordinate="angle", motion=motion)
    return m


# --- force laws ------------------------------------------------------------------------------------------------------


def hardening(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    """A spring that hardens, with a damper; nothing is wrong with it."""
    return 3 * length + 5 * length**3 + rate, 3 + 15 * length**2, 1.0, 1.5 * length**2 + 1.25 * length**4


# --- the registry ----------------------------------------------------------------------------------------------------


def offer(create: Any, options: type[BaseModel] = NoOptions, *, dense_output: bool = False, **claims: Any) -> Registry:
    """Return what mbdkit ships and one integrator more, ``acme:mine``."""
    item = mbdkit.IntegratorPlugin(
        name="mine", summary="A method under test", options=options, create=create,
        claims=lambda options: Claims(**{"drift": "of the method's order"} | claims), references=("@misc{acme}",),
        dense_output=dense_output,
    )  # fmt: skip
    return _with(mbdkit_integrators=item)


def offer_method(method: type[StepMethod], **claims: Any) -> Registry:
    return offer(functools.partial(_made, method), **claims)


def _made(method: type[StepMethod], options: Any) -> StepMethod:
    return method()


def offer_solver() -> Registry:
    return offer(lambda o: SciPySolver(LyingSolver, o.rtol, o.atol), Tolerances, adaptive=True)


def offer_model(**options: Any) -> Registry:
    plugin = mbdkit.ModelPlugin("mine", "A rod", NoOptions, lambda chosen: pendulum(**options), ("@misc{acme}",))
    return _with(mbdkit_models=plugin)


def offer_law(function: Any, *, potential: bool = True, passive: bool = True) -> Registry:
    law: Any = function
    if not isinstance(function, ExpressionLaw | FunctionLaw):
        law = FunctionLaw(function, potential=potential, passive=passive)
    return _with(mbdkit_force_laws=mbdkit.ForceLawPlugin("mine", "A law", NoOptions, law, ("@misc{acme}",)))


@functools.cache
def _ours() -> tuple[importlib.metadata.EntryPoint, ...]:
    """Return the entry points of mbdkit, without those of its plugins."""
    found = importlib.metadata.entry_points(group="mbdkit")
    return tuple(one for one in found if one.dist and one.dist.name == "mbdkit")


def _with(**hooks: Any) -> Any:
    def answering(name: str, item: Any) -> Any:
        def hook() -> Any:
            return [item]

        hook.__name__ = name
        return mbdkit.hookimpl(hook)

    module = SimpleNamespace(**{name: answering(name, item) for name, item in hooks.items()})
    dist = SimpleNamespace(name="acme", version="1.0")
    mine: Any = SimpleNamespace(name="mine", value="acme", dist=dist, load=lambda: module)
    return _OnDemand([*_ours(), mine])


class _OnDemand:
    """A registry that is loaded when it is used: the corpus has more than a hundred, most of them in slow tests."""

    def __init__(self, entry_points: list[Any]):
        self._entry_points = entry_points

    @functools.cached_property
    def _registry(self) -> Registry:
        return load_registry(self._entry_points)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._registry, name)


# --- what is wrong away from the defaults ----------------------------------------------------------------------------


class LooseDamping(BaseModel):
    """A damping that may be negative, though the law calls itself passive."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    damping: float = 0.0
    """Force by rate [N s/m]."""


class BoundedDamping(BaseModel):
    """A damping that may not."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    damping: float = Field(default=0.0, ge=0.0)
    """Force by rate [N s/m]."""


def offer_damper(options: type[BaseModel]) -> Registry:
    """Offer a passive damper whose damping is 0 by default."""
    damping, rate = sympy.symbols("damping rate")
    law = ExpressionLaw(force=damping * rate, passive=True)
    return _with(mbdkit_force_laws=mbdkit.ForceLawPlugin("mine", "A damper", options, law, ("@misc{acme}",)))


class Fragile(BaseModel):
    """An option of a method."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    order: int = Field(default=4, ge=1, le=4)
    """Order."""


def fragile(options: Any) -> Any:
    """Create the classical method, and fail for the order 1."""
    return {4: RungeKutta}.get(options.order, RungeKutta if options.order > 1 else None)()  # type: ignore[misc]


class Raises(RungeKutta):
    """It raises in the middle of its step."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        raise LookupError("no table for this step")


class FreeLength(BaseModel):
    """A spring with a free length, which its law may forget."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    stiffness: float = Field(default=0.0, ge=0.0)
    """Stiffness [N/m]."""
    free_length: float = 0.3
    """Length without force [m]."""


def offer_spring(force: sympy.Expr, **law: Any) -> Registry:
    """Offer a spring with a free length; its stiffness is 0 by default, so that the free length has no effect then."""
    made = ExpressionLaw(force=force, **law)
    return _with(mbdkit_force_laws=mbdkit.ForceLawPlugin("mine", "A spring", FreeLength, made, ("@misc{acme}",)))
