"""Further plugins that are each wrong in one way, of all kinds, and right ones that are unusual."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any

import numpy as np
import sympy
from pydantic import BaseModel, ConfigDict, Field, field_validator

import mbdkit
from mbdkit import EquationsOfMotion, ExpressionLaw, Mechanism, StepError, StepMethod, StepState

from . import corpus
from .corpus import Midpoint, RungeKutta, SymplecticEuler
from .wrong_steps import Library, Pair, adaptive, fixed

Vector = np.ndarray

# --- methods: nothing is wrong with these -----------------------------------------------------------------------------


class HalfExplicitEuler(StepMethod):
    """The half-explicit Euler method of index 2 (Hairer, Lubich and Roche 1989)."""

    carries_multipliers = True

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        q = state.q + h * state.v
        force, rows = self.force(equations, t, state), -self.rates(equations, t + h, q, state.v)
        dv, impulse = equations.solve(t + h, q, h * force, rows)
        return StepState(q, state.v + dv, multipliers=impulse / h)

    def force(self, equations: EquationsOfMotion, t: float, state: StepState) -> Vector:
        return equations.forces(t, state.q, state.v)

    def rates(self, equations: EquationsOfMotion, t: float, q: Vector, v: Vector) -> Vector:
        return equations.constraint_rates(t, q, v)


class ImplicitEuler(StepMethod):
    """Implicit Euler on the index-3 equations, of order 1; it starts from the multipliers of the last step."""

    carries_multipliers = True

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        if state.multipliers is None:
            a, lam = equations.accelerations(t, state.q, state.v)
        else:
            (a,), lam = state.memory, state.multipliers  # the memory is None only where the multipliers are None, too
        before = np.inf
        for _ in range(40):
            v = state.v + h * a
            q = state.q + h * v
            matrix = equations.iteration_matrix(t + h, q, v, a, lam, damping=h, stiffness=h * h)
            da, dlam = matrix.solve(-equations.residual(t + h, q, v, a, lam), -equations.constraints(t + h, q) / h / h)
            a, lam = a + da, lam + dlam
            change = equations.relative_change(q, h * h * da)
            if change <= 4e-16 or (change >= before / 2 and change < 1e-9):
                v = state.v + h * a
                return StepState(state.q + h * v, v, multipliers=lam, memory=(a,))
            before = change
        raise StepError("newton-failed", "the iteration does not converge")


class ExplicitEuler(StepMethod):
    """Explicit Euler, of order 1."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a, _ = equations.accelerations(t, state.q, state.v)
        return state.moved(h * state.v, h * a)


# --- methods: friction ------------------------------------------------------------------------------------------------


class WithoutFriction(HalfExplicitEuler):
    """It takes the forces from the residual with multipliers of zero, which cause no friction."""

    def force(self, equations: EquationsOfMotion, t: float, state: StepState) -> Vector:
        return -equations.residual(t, state.q, state.v, np.zeros(equations.n), np.zeros(equations.m))


class LateFriction(RungeKutta):
    """Heun's method with the friction of the start of the step in its second stage."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a, lam = equations.accelerations(t, state.q, state.v)
        q, v = state.q + h * state.v, state.v + h * a
        none = np.zeros(equations.n)
        force = equations.constraint_forces(t + h, q, lam) - equations.residual(t + h, q, v, none, lam)
        end, _ = equations.solve(t + h, q, force, equations.gamma(t + h, q, v))
        return state.moved(h / 2 * (state.v + v), h / 2 * (a + end))


# --- methods: formulations and constraints ----------------------------------------------------------------------------


class ForgetsMotionOfDrivers(HalfExplicitEuler):
    """Its constraints on the velocities lack the partial derivative with respect to time."""

    def rates(self, equations: EquationsOfMotion, t: float, q: Vector, v: Vector) -> Vector:
        return np.asarray(equations.constraint_jacobian(t, q) @ v)


class IgnoresBaumgarte(SymplecticEuler):
    """It differentiates the constraints itself, and so leaves out Baumgarte's terms."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        q, v, e = state.q, state.v, 1e-5
        rates = [equations.constraint_rates(t + s * e, q + s * e * v, v) for s in (1, -1)]
        force = equations.forces(t, q, v)
        a, _ = equations.solve(t, q, force, -(rates[0] - rates[1]) / (2 * e))
        return state.moved(h * (v + h * a), h * a)


# --- methods: multipliers and memory ----------------------------------------------------------------------------------


class EarlyMultipliers(RungeKutta):
    """It returns the multipliers of the start of the step."""

    carries_multipliers = True

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        return replace(new, multipliers=self.found(equations, t, state, new, h))

    def found(self, equations: EquationsOfMotion, t: float, state: StepState, new: StepState, h: float) -> Vector:
        return equations.accelerations(t, state.q, state.v)[1]


class SwappedMultipliers(EarlyMultipliers):
    """Its multipliers are in the order from the last constraint to the first."""

    def found(self, equations: EquationsOfMotion, t: float, state: StepState, new: StepState, h: float) -> Vector:
        return equations.accelerations(t + h, new.q, new.v)[1][::-1].copy()


class GrowsMemory(RungeKutta):
    """It appends to the list that is its memory."""

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
        return {"times": []}

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        with contextlib.suppress(AttributeError, TypeError):  # the framework protects the memory
            state.memory["times"].append(t)
        return replace(new, memory=state.memory)


class KeepsMemoryAfterImpacts(Pair):
    """It keeps its last slope after impacts only."""

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
        return state.memory if why == "impact" else None


class Unpicklable(RungeKutta):
    """It has a function without a name as an attribute."""

    def __init__(self) -> None:
        self.scale = lambda x: x


class Random(RungeKutta):
    """It adds random rounding errors."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        return StepState(new.q, new.v * (1.0 + 1e-15 * np.random.default_rng().standard_normal(len(new.v))))


class SingleTime(RungeKutta):
    """It evaluates at times in single precision."""

    def rates(self, equations: EquationsOfMotion, t: float, q: Vector, v: Vector) -> Any:
        return super().rates(equations, float(np.float32(t)), q, v)


class NeedsJoints(RungeKutta):
    """It looks at its first multiplier, also where there is none."""

    def rates(self, equations: EquationsOfMotion, t: float, q: Vector, v: Vector) -> Any:
        a, lam = equations.accelerations(t, q, v)
        return a + 0.0 * lam[0], lam


# --- methods: claims of geometry and stability ------------------------------------------------------------------------


class Trapezoid(Midpoint):
    """The trapezoidal rule, which is symmetric, and conserves quadratic invariants of linear equations only."""

    share = 0.5

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a0, _ = equations.accelerations(t, state.q, state.v)
        c, early = self.share * h, (1.0 - self.share) * h
        q0, v0 = state.q + early * state.v, state.v + early * a0
        a = self.solved(equations, t, state, t + h, q0, v0, c)
        return state.moved(early * state.v + c * (v0 + c * a), early * a0 + c * a)


class AlmostTrapezoid(Trapezoid):
    """The theta method with theta = 0.501, which is neither of order 2 nor symmetric."""

    share = 0.501


class Explicitish(Trapezoid):
    """The theta method with theta = 0.49, which is not A-stable."""

    share = 0.49


# --- methods: steps that contain more ---------------------------------------------------------------------------------


class PositionsOnly(Pair):
    """Its error estimate is zero for velocities."""

    def made(self, new: StepState, error: Any, dense: Any, h: float, t: float, stages: Vector, parts: Any) -> Any:
        error = error.copy()
        error[parts[0] : parts[1]] = 0.0
        return super().made(new, error, dense, h, t, stages, parts)


class FrozenStates(Pair):
    """Its forces see the first-order states of the start of the step."""

    def increment(self, dy: Vector, euler: Vector, motions: int) -> Vector:
        return dy

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Any:
        frozen = state.z.copy()
        return super().step(_Frozen(equations, frozen), t, state, h)


class _Frozen:
    """Equations of motion whose accelerations are those at fixed first-order states."""

    def __init__(self, equations: EquationsOfMotion, z: Vector):
        self.equations, self.z, self.n = equations, z, equations.n

    def derivatives(self, t: float, q: Vector, v: Vector, z: Vector) -> tuple[Vector, Vector, Vector]:
        _, lam, rates = self.equations.derivatives(t, q, v, z)
        a, _, _ = self.equations.derivatives(t, q, v, self.z)
        return a, lam, rates


class PassesTheStop(Library):
    """Its library does not know where to stop."""

    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        super().open(equations, t, state, stop + 1.0)


class Percent(BaseModel):
    """An option that is another one when it is read again."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    damping: float = 50.0
    """Numerical damping [%]."""

    @field_validator("damping")
    @classmethod
    def _as_share(cls, value: float) -> float:
        return value / 100.0


class Changeable(BaseModel):
    """Options that `create` may change."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    used: list[str] = Field(default_factory=list)
    """Names."""


def changes_options(options: Any) -> StepMethod:
    """Create the classical method, and note this in the options."""
    options.used.append("once")
    return RungeKutta()


# --- models -----------------------------------------------------------------------------------------------------------


class Lengths(BaseModel):
    """The length of a rod."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    length: float = 1.0
    """Length [m]."""


def rod_of(options: Any) -> Mechanism:
    """Return a rod of one of two lengths, without a word about others."""
    return {1.0: corpus.pendulum, 2.0: corpus.pendulum}[options.length]()


def rod_with_changing_options(options: Any) -> Mechanism:
    """Return a rod, and change the options."""
    options.__dict__["length"] = 2.0 * options.length
    return corpus.pendulum()


def gone(options: Any) -> Mechanism:
    """Return a rod with a torque that is no number after half a second."""
    m = corpus.pendulum()
    m.torque("motor", "rod", value="sqrt(0.5 - t)")
    return m


def apart(options: Any) -> Mechanism:
    """Return a rod between two pins that are farther apart than its ends."""
    m = corpus.pendulum()
    m.revolute("B", m.ground, "rod", points=((1.5, 0.0), (0.5, 0.0)))
    return m


def counted(options: Any, built: list[int] = []) -> Mechanism:  # noqa: B006 - this is what is wrong
    """Return a rod that is called by the number of rods built so far."""
    built.append(len(built))
    m = Mechanism()
    m.body(f"rod{len(built)}", mass=1.0, inertia=0.1)
    return m


def model(build: Any, options: type[BaseModel] = corpus.NoOptions) -> Any:
    plugin = mbdkit.ModelPlugin("mine", "A rod", options, build, ("@misc{acme}",))
    return corpus._with(mbdkit_models=plugin)


# --- force laws -------------------------------------------------------------------------------------------------------

Four = tuple[float, float, float, float]


def half_potential(s: float, v: float, t: float, p: Any) -> Four:
    """Its potential lacks the cubic part of the force in tension."""
    return 3.0 * s + max(s, 0.0) ** 3, 3.0 + 3.0 * max(s, 0.0) ** 2, 0.0, 1.5 * s * s


def saturating(s: float, v: float, t: float, p: Any) -> Four:
    """It is no number at a length of exactly zero."""
    return (s / abs(s)) if s != 0.0 else float("nan"), 0.0, 0.0, abs(s)


class Grip(BaseModel):
    """The first value of a state."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    grip: float = 0.0
    """Force at the start [N]."""


def law_with_state(rate: Any) -> Any:
    """Return a law with a state."""
    s, state = sympy.symbols("length grip")
    law = ExpressionLaw(force=3 * s + state, rates={"grip": (rate, "N")})
    return corpus._with(mbdkit_force_laws=mbdkit.ForceLawPlugin("mine", "A law", Grip, law, ("@misc{acme}",)))


# --- measures ---------------------------------------------------------------------------------------------------------


def measure(take: Any) -> Any:
    item = mbdkit.MeasurePlugin("mine", "A measure", corpus.NoOptions, "s", take)
    return corpus._with(mbdkit_measures=item)


def as_text(run: Any, options: Any) -> Any:
    """Return a text instead of a number."""
    return f"{run.time[-1]:g} s"


def random_measure(run: Any, options: Any) -> Any:
    """Return another number each time."""
    return float(np.random.default_rng().random())


def endless(run: Any, options: Any) -> Any:
    """Return infinity where nan should say that there is no value."""
    return float("inf")


def crashing(run: Any, options: Any) -> Any:
    """Raise an error for every run."""
    return run.time[len(run.time)]


# --- tables -----------------------------------------------------------------------------------------------------------

EULER: dict[str, Any] = {"order": 1, "needs": ("accelerations",)}
INDEX_2: dict[str, Any] = {**EULER, "formulations": ("index-2",), "stabilizations": ("none", "projection")}
INDEX_3: dict[str, Any] = {
    "order": 1, "needs": ("tangents",), "formulations": ("index-3",), "stabilizations": ("none", "projection"),
}  # fmt: skip
RK4: dict[str, Any] = {"order": 4, "needs": ("accelerations",)}
IMPLICIT: dict[str, Any] = {"order": 2, "needs": ("tangents",)}
_method = corpus.offer_method

RIGHT = {
    "half-explicit Euler": _method(HalfExplicitEuler, **INDEX_2),
    "implicit Euler on index 3": _method(ImplicitEuler, **INDEX_3),
    "explicit Euler": _method(ExplicitEuler, **EULER),
    "the trapezoidal rule": _method(Trapezoid, **IMPLICIT, symmetric=True, a_stable=True),
}
"""Methods of order 1, one of them with multipliers whose memory is None where they are None; nothing is wrong."""

METHODS: dict[str, tuple[Any, str, str]] = {
    "half-explicit, without friction": (_method(WithoutFriction, **INDEX_2), "state.joint-friction", "with friction"),
    "friction of the start of the step": (
        _method(LateFriction, order=2, needs=("accelerations",)), "state.joint-friction", "it has the order 1.",
    ),
    "index-2, but index-1 is integrated": (
        _method(ExplicitEuler, **INDEX_2), "drift.formulations", "on index-2 the constraints should hold at velocity",
    ),
    "ggl, but index-3 is integrated": (
        _method(ImplicitEuler, **INDEX_3 | {"formulations": ("ggl",)}), "drift.formulations",
        "on ggl the constraints should hold at velocity level",
    ),
    "constraints without the motion of drivers": (
        _method(ForgetsMotionOfDrivers, **INDEX_2), "drift.formulations", "on index-2 the constraints should hold",
    ),
    "Baumgarte's terms left out": (_method(IgnoresBaumgarte, **EULER), "drift.baumgarte", "Baumgarte"),
    "multipliers of the start of the step": (
        _method(EarlyMultipliers, **RK4, multiplier_order=4), "order.multipliers", "the observed one is 1.",
    ),
    "multipliers in another order": (
        _method(SwappedMultipliers, **RK4, multiplier_order=4), "order.multipliers", "follow no power",
    ),
    "a memory that grows": (_method(GrowsMemory, **RK4), "contract.inputs", "memory"),
    "a memory that is kept after impacts": (
        fixed(KeepsMemoryAfterImpacts), "restart.discontinuities", "after the velocities have jumped",
    ),
    "a function as an attribute": (_method(Unpicklable, **RK4), "contract.picklable", "its method cannot be pickled"),
    "random rounding": (_method(Random, **RK4), "contract.repeatable", "two runs of the same spec differ"),
    "times in single precision": (_method(SingleTime, **RK4), "contract.start-time", "ends in another state"),
    "multipliers of bodies without joints": (_method(NeedsJoints, **RK4), "state.free-fall", "IndexError"),
    "a symplectic trapezoidal rule": (_method(Trapezoid, **IMPLICIT, symplectic=True), "geometry.symplectic-form", ""),
    "theta = 0.501": (_method(AlmostTrapezoid, **IMPLICIT, symmetric=True), "geometry.reversibility-pendulum", ""),
    "theta = 0.49": (_method(Explicitish, order=1, needs=("tangents",), a_stable=True), "stability.a-stable", ""),
    "an error estimate without velocities": (adaptive(PositionsOnly, dense_order=3), "tolerance.error-estimate", ""),
    "forces of old states": (fixed(FrozenStates, dense_order=None), "order.states", "the observed one is"),
    "a library that passes its stop": (
        adaptive(PassesTheStop, dense_order=4, stabilizations=("none",)), "contract.end-time", "",
    ),
    "an option that changes when it is read again": (
        corpus.offer(lambda options: RungeKutta(), Percent, **RK4), "contract.options", "in a JSON round trip",
    ),
    "changed options": (corpus.offer(changes_options, Changeable, **RK4), "contract.inputs", "it modified its options"),
}  # fmt: skip

OTHERS: dict[str, tuple[Any, Any, str, str]] = {
    "a length without a rod": ("model", model(rod_of, Lengths), "model.other-options", "KeyError"),
    "changed parameters": ("model", model(rod_with_changing_options, Lengths), "model.repeatable", "it modified"),
    "pins that are too far apart": ("model", model(apart), "model.start", "joint"),
    "names that are counted": ("model", model(counted), "model.repeatable", "two different mechanisms"),
    "a torque that is no number": ("model", model(gone), "energy.run", "did not complete"),
    "half a potential": ("force-law", corpus.offer_law(half_potential), "law.potential", ""),
    "no number at zero": ("force-law", corpus.offer_law(saturating, passive=False), "law.finite", ""),
    "a state that ends in infinity": ("force-law", law_with_state(sympy.Symbol("grip") ** 2 + 900), "law.states", ""),
    "a text": ("measure", measure(as_text), "measure.value", "an object of type str"),
    "another number each time": ("measure", measure(random_measure), "measure.value", "and then"),
    "an error for every run": ("measure", measure(crashing), "measure.value", "IndexError"),
    "infinity": ("measure", measure(endless), "measure.value", "it returned inf"),
}  # fmt: skip
WRONG = {name: ("integrator", *rest) for name, rest in METHODS.items()} | OTHERS
"""By what is wrong: the kind of plugin, the registry, the check that refuses it, and a part of the cause."""
