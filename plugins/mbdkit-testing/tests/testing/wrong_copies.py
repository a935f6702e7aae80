"""Copies of the methods of other distributions, each with one mistake that a convergent end does not show."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

import mbdkit
from mbdkit import EquationsOfMotion, Step, StepState
from mbdkit.plugin.methods import ControlledOptions

from . import corpus
from .wrong_steps import Tolerance

sys.path += [
    str(Path(__file__).parents[3] / f"mbdkit-{name}" / "src")
    for name in ("energy", "half-explicit", "multistep", "radau")
]

from mbdkit_energy import line_integral
from mbdkit_energy import methods as energy
from mbdkit_half_explicit import methods as half_explicit
from mbdkit_half_explicit.half_explicit import HalfExplicit
from mbdkit_multistep import adams, bdf
from mbdkit_radau import radau

Vector = np.ndarray

# --- half-explicit methods --------------------------------------------------------------------------------------------


class EarlyCurve(HalfExplicit):
    """Its dense output has the accelerations of the start of the step at both ends."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made, (a, _, rates) = super().step(equations, t, state, h), state.memory
        end = made.state
        change = end.q - state.q, end.v - state.v, end.z - state.z
        return replace(made, dense=state.interpolant(h, change, (a, a), (rates, rates)))


class EarlyMultipliers(HalfExplicit):
    """Its multipliers are those of the start of the step."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made = super().step(equations, t, state, h)
        return replace(made, state=replace(made.state, multipliers=state.memory[1]))


class SmallEstimate(HalfExplicit):
    """Its error estimate is a hundredth of the right one."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made = super().step(equations, t, state, h)
        return replace(made, error=None if made.error is None else 0.01 * np.asarray(made.error))


class StaleStart(HalfExplicit):
    """After a discontinuity, its first stage has the acceleration from before."""

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: object) -> Any:
        return super().begin(equations, t, state, why) if state.memory is None else state.memory


def misprint(options: BaseModel) -> HalfExplicit:
    """Return PHEM56 with two digits of a coefficient exchanged: 5013 instead of 5103."""
    a = half_explicit.PHEM56.a.copy()
    a[5, 4] *= 5013 / 5103
    return HalfExplicit(replace(half_explicit.PHEM56, a=a))


# --- multistep methods ------------------------------------------------------------------------------------------------


class KeepsHistory(bdf.Bdf):
    """It interpolates across discontinuities."""

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
        return state.memory


class OwnOrder(bdf.Bdf):
    """It keeps the order of the next step to itself."""

    order = 1

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        if state.memory is not None:
            order = min(self.order, len(state.memory[2]) - 1)
            state = replace(state, memory=(order, *state.memory[1:]))
        made = super().step(equations, t, state, h)
        self.order = made.state.memory[0] if made.accepted else self.order
        return replace(made, state=replace(made.state, memory=(1, *made.state.memory[1:])))


class LateMultipliers(bdf.Bdf):
    """Its multipliers are those of the last step."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made = super().step(equations, t, state, h)
        late = made.state.memory[3][1, 2 * equations.n + len(state.z) :]
        return replace(made, state=replace(made.state, multipliers=late))


class Index2(bdf.Bdf):
    """It integrates the index-2 equations, whichever are chosen."""

    def solve(self, equations: EquationsOfMotion, *arguments: Any) -> tuple[Vector, Vector]:
        return super().solve(Disguised(equations), *arguments)  # type: ignore[arg-type]


class Disguised:
    """Equations that say that their formulation is index-2."""

    formulation = "index-2"

    def __init__(self, equations: EquationsOfMotion):
        self.equations = equations

    def __getattr__(self, name: str) -> Any:
        return getattr(self.equations, name)


class ShortCurve(adams.Adams):
    """Its dense output is the line through both ends."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made = super().step(equations, t, state, h)
        ends = [(x, y) for x, y in zip(_parts(state), _parts(made.state), strict=True)]
        return replace(made, dense=lambda theta: tuple(x + theta * (y - x) for x, y in ends))


def _parts(state: StepState) -> tuple[Vector, Vector, Vector]:
    return state.q, state.v, state.z


class OneOrder(adams.Adams):
    """Its order stays at 2."""

    def __init__(self, options: adams.AdamsOptions):
        super().__init__(options.model_copy(update={"max_order": 2}))


# --- Radau IIA --------------------------------------------------------------------------------------------------------


class FirstStage(radau.Radau):
    """Its multipliers are those of its first stage."""

    def solve(self, *arguments: Any) -> radau.Stages:
        found = super().solve(*arguments)
        return found._replace(lam=np.vstack([found.lam[1:], found.lam[:1]]))


class EstimatesRate(radau.Radau):
    """Its error estimate lacks a factor of the size of the step."""

    def error(self, equations: EquationsOfMotion, t: float, state: StepState, h: float, found: Any) -> Vector | None:
        error = super().error(equations, t, state, h, found)
        return None if error is None else error / h


class EstimateWithoutStates(radau.Radau):
    """Its error estimate leaves out first-order states."""

    def error(self, equations: EquationsOfMotion, *arguments: Any) -> Vector | None:
        error = super().error(equations, *arguments)
        if error is not None:
            error[2 * equations.n :] = 0.0
        return error


class ReversedNodes(radau.Radau):
    """The weights of its stages are those of the reflected method."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made = super().step(equations, t, state, h)
        assert made.stages is not None
        times, weights, states = made.stages
        return replace(made, stages=(times, weights[::-1], states))


class CurveOfStages(radau.Radau):
    """Its dense output lacks the term of the highest degree."""

    def completed(self, *arguments: Any) -> Step:
        made = super().completed(*arguments)
        assert made.dense is not None
        right, end = made.dense, made.dense(1.0)
        return replace(made, dense=lambda x: tuple(y - x**2 * (1 - x) * e for y, e in zip(right(x), end, strict=True)))


# --- energy-conserving methods ----------------------------------------------------------------------------------------


class LosesEnergy(line_integral.LineIntegral):
    """It projects velocities at the end of a step, and does not restore their energy."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made = super().step(equations, t, state, h)
        return replace(made, state=replace(made.state, v=(1 - 1e-9) * made.state.v))


class Unprojected(line_integral.LineIntegral):
    """It leaves out the projection of velocities."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        class Equations(Disguised):
            formulation = "index-3"

            def project_velocities(self, t: float, q: Vector, v: Vector) -> Vector:
                return v

        return super().step(Equations(equations), t, state, h)  # type: ignore[arg-type]


# --- the corpus -------------------------------------------------------------------------------------------------------


def copy(create: Any, options: BaseModel, claims: mbdkit.Claims, **changes: Any) -> Any:
    """Return a registry with one method more: with the claims that it has with `options`, apart from `changes`.

    Methods with adaptive steps have the tolerances of the original as options, those with fixed steps have none.
    """
    claimed = {field.name: getattr(claims, field.name) for field in fields(claims)} | changes

    def made(given: BaseModel) -> Any:
        return create(options.model_copy(update=given.model_dump()))

    return corpus.offer(made, Tolerance if claims.adaptive else corpus.NoOptions, dense_output=True, **claimed)


def explicit(method: type[HalfExplicit], **options: Any) -> Any:
    """Return a copy of PHEM56."""
    given = ControlledOptions(**options)
    create = lambda given: method(half_explicit.PHEM56, given.tolerances())  # noqa: E731
    return copy(create, given, half_explicit.claims_of_phem56(given))


def backward(method: type[bdf.Bdf]) -> Any:
    """Return a copy of BDF."""
    return copy(method, bdf.BdfOptions(), bdf.claims(bdf.BdfOptions()))


def predicting(method: type[adams.Adams]) -> Any:
    """Return a copy of the Adams methods."""
    return copy(method, adams.AdamsOptions(), adams.claims(adams.AdamsOptions()))


def collocation(method: type[radau.Radau], changes: dict[str, Any] | None = None, **options: Any) -> Any:
    """Return a copy of Radau IIA, with changed claims."""
    given = radau.RadauOptions(**options)
    return copy(method, given, radau.claims(given), **changes or {})


def conserving(method: Any, s: int, **changes: Any) -> Any:
    """Return a copy of HBVM(8, s)."""
    given = energy.LineIntegralOptions(s=s)
    return copy(lambda _: method(), given, energy.claims_of_hbvm(given), **changes)


FIXED = {"adaptive": False}
FIXED_STEPS = ControlledOptions(**FIXED)
LINE = line_integral.LineIntegral
WRONG: dict[str, tuple[Any, str, str]] = {
    "PHEM56, dense output with accelerations of the start": (
        explicit(EarlyCurve), "order.dense-output", "it claims dense output of order 3",
    ),
    "PHEM56, multipliers of the start of the step": (explicit(EarlyMultipliers), "order.multipliers", "observed one"),
    "PHEM56, error estimate of a hundredth": (
        explicit(SmallEstimate, adaptive=True), "tolerance.error-estimate", "times its estimate",
    ),
    "PHEM56, acceleration before a discontinuity": (
        explicit(StaleStart), "restart.discontinuities", "a step uses the memory of the steps before",
    ),
    "PHEM56, misprinted coefficient": (
        copy(misprint, FIXED_STEPS, half_explicit.claims_of_phem56(FIXED_STEPS)), "order.forced-pendulum",
        "it claims order 5",
    ),
    "BDF, history across discontinuities": (
        backward(KeepsHistory), "restart.discontinuities", "a step uses the memory of the steps before",
    ),
    "BDF, order outside the memory": (backward(OwnOrder), "restart.state", "its state does not contain everything"),
    "BDF, multipliers of the last step": (backward(LateMultipliers), "tolerance.multipliers", "multipliers"),
    "BDF, index-2 instead of ggl": (backward(Index2), "drift.formulations", "on ggl the constraints should hold"),
    "Adams, a line as dense output": (predicting(ShortCurve), "order.dense-output", "it claims dense output"),
    "Adams, order 2 only": (predicting(OneOrder), "tolerance.variable-order", "it claims variable order"),
    "Radau, multipliers of the first stage": (
        collocation(FirstStage, **FIXED), "order.multipliers", "the observed one",
    ),
    "Radau, error estimate that lacks a factor of the step": (
        collocation(EstimatesRate), "tolerance.error-estimate", "its error estimate should be of order 4",
    ),
    "Radau, error estimate without states": (
        collocation(EstimateWithoutStates), "tolerance.error-estimate", "for first-order states",
    ),
    "Radau, reflected weights": (collocation(ReversedNodes, **FIXED), "order.quadrature-nodes", "its nodes"),
    "Radau, dense output that lacks a term": (collocation(CurveOfStages, **FIXED), "order.dense-output", ""),
    "Radau, order of velocities with index-3": (
        collocation(radau.Radau, {"orders": {}}, **FIXED), "order.formulations", "on index-3",
    ),
    "HBVM(2, 2), too few nodes": (
        conserving(partial(LINE, 2, 2, 50), 2), "geometry.conserved-energy", "it claims to conserve energy",
    ),
    "discrete gradient without its correction": (
        conserving(partial(LINE, 1, 1, 50), 1), "geometry.conserved-energy", "it claims to conserve energy",
    ),
    "HBVM(8, 1), kinetic energy that is lost": (
        conserving(partial(LosesEnergy, 8, 1, 50), 1), "geometry.conserved-energy", "it claims to conserve energy",
    ),
    "HBVM(8, 1), angular momentum": (
        conserving(partial(LINE, 8, 1, 50), 1, conserves=("energy", "angular-momentum")),
        "geometry.conserved-angular-momentum", "it claims to conserve angular-momentum",
    ),
    "HBVM(8, 2), velocities that are not projected": (
        conserving(partial(Unprojected, 8, 2, 50), 2), "order.four-bar", "it claims order 4",
    ),
}  # fmt: skip
"""By what is wrong: the method, the check that refuses it, and a part of the cause."""
SLOW = (
    "PHEM56, multipliers of the start of the step", "PHEM56, misprinted coefficient", "Adams, order 2 only",
    "Radau, multipliers of the first stage", "Radau, order of velocities with index-3",
    "HBVM(8, 2), velocities that are not projected",
)  # fmt: skip
