"""What a plugin hands over: models, integrators and force laws, with their options, references and claims."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from pydantic import BaseModel

    from mbdkit.mechanism.force_law import ForceLaw
    from mbdkit.mechanism.mechanism import Mechanism


class Orders(NamedTuple):
    """Orders of convergence on one formulation."""

    positions: float
    velocities: float
    multipliers: float | None = None
    """Of the multipliers that the method itself carries; None where it carries none."""


@dataclass(frozen=True)
class Claims:
    """What an integrator claims of itself; the conformance checks hold it to its word.

    Parameters
    ----------
    order
        Order of convergence of positions and velocities; None where the method controls its own error.
    multiplier_order
        Order of convergence of the multipliers that the method itself carries; None where it carries none.
    symmetric
        A step back by -h undoes a step by h.
    symplectic
        The method conserves the symplectic form of an unconstrained Hamiltonian system.
    quadratic_invariants
        The method conserves quadratic first integrals.
    adaptive
        The method chooses its own steps; ``time.step`` is only its first one.
    stages
        Number of stages, where that means something.
    drift
        One sentence on how the constraints drift.
    needs
        What the method asks of the problem beyond accelerations, such as ``"tangents"``.
    formulations
        Formulations of the equations that the method can serve.
    stabilizations
        What it can be stabilized by, of ``none``, ``baumgarte``, ``projection`` and ``symmetric-projection``.
        Baumgarte's terms are part of the equations; projections are made by what steps the method.
    orders
        Orders by formulation, where they differ from `order` and `multiplier_order`, which hold for the first one.
    """

    order: float | None = None
    multiplier_order: float | None = None
    symmetric: bool = False
    symplectic: bool = False
    quadratic_invariants: bool = False
    adaptive: bool = False
    stages: int | None = None
    drift: str = ""
    needs: tuple[str, ...] = ()
    formulations: tuple[str, ...] = ("index-1",)
    stabilizations: tuple[str, ...] = ("none", "baumgarte", "projection", "symmetric-projection")
    orders: Mapping[str, Orders] = field(default_factory=dict)

    def orders_on(self, formulation: str) -> Orders | None:
        """Return the orders claimed on a formulation; None where the method controls its own error."""
        if formulation in self.orders:
            return Orders(*self.orders[formulation])
        return None if self.order is None else Orders(self.order, self.order, self.multiplier_order)


@dataclass(frozen=True)
class ModelPlugin:
    """A model: parameters in, mechanism out.

    Parameters
    ----------
    name
        Short name, such as ``double-pendulum``; what a spec says under ``model.name``.
    summary
        One line of what it is.
    options
        Pydantic model of the parameters, without ``name``.
    build
        Turns an instance of `options` into a Mechanism; raises SpecError for parameters that make none. Any other
        exception counts as a failure of the plugin.
    references
        BibTeX entries of the sources.
    """

    name: str
    summary: str
    options: type[BaseModel]
    build: Callable[[Any], Mechanism]
    references: tuple[str, ...] = ()


@dataclass(frozen=True)
class ForceLawPlugin:
    """A force law: the tension of a force element from its length, rate and time.

    Parameters
    ----------
    name
        Short name, such as ``one-sided``; what a spec says under ``law`` in an element of type ``law``.
    summary
        One line of what it is.
    options
        Pydantic model of the options, which stand beside ``type``, ``law`` and ``pathway`` in the element.
    law
        The law, as an ``ExpressionLaw`` in SymPy or as a ``FunctionLaw`` that Numba compiles.
    references
        BibTeX entries of the sources.
    """

    name: str
    summary: str
    options: type[BaseModel]
    law: ForceLaw
    references: tuple[str, ...] = ()


@dataclass(frozen=True)
class IntegratorPlugin:
    """An integrator: how the state is advanced.

    Parameters
    ----------
    name
        Short name, such as ``gauss``; what a spec says under ``integrator.name``.
    summary
        One line of what it is.
    options
        Pydantic model of the options, without ``name``.
    create
        Turns an instance of `options` into the method that the simulation steps.
    claims
        Turns an instance of `options` into the claims of that method.
    references
        BibTeX entries of the sources.
    dense_output
        The method can be evaluated between its steps, so ``output.interval`` may be used.
    """

    name: str
    summary: str
    options: type[BaseModel]
    create: Callable[[Any], Any]
    claims: Callable[[Any], Claims]
    references: tuple[str, ...] = ()
    dense_output: bool = False


Plugin = ModelPlugin | IntegratorPlugin | ForceLawPlugin
