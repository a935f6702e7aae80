"""How elements of mechanisms export themselves as expressions: what an element kind may offer for optimal control.

The laws and kernels of elements are executed with symbols as they are, so that most kinds need nothing of this file. A
kind whose kernels search, or that records quantities of its own, has a class attribute `symbolic` in its acting
elements, those in `CompiledMechanism.extensions`: a `mbdkit.plugin.Target` of a function that takes them and returns
`SymbolicElements`. A kind with a stiff state, such as the length of fibres on an elastic tendon, has a class attribute
`equilibrium` in the elements of the mechanism: a target of a function that takes one and returns its
`ElementEquilibrium`, or None.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.mechanism.mechanism import Mechanism


class ElementEquilibrium(Protocol):
    """Equilibrium of an element that determines the rate of one of its states; both are unknowns of the optimum."""

    state: str
    unknowns: tuple[str, str]
    """Names of the unknowns: the rate of the state, and the force of the element, both as shares of `sizes`."""
    recorded: tuple[str, str]
    """Quantities of the element in archives that stand for the unknowns."""
    lowest: tuple[float, float]
    """Lower bounds of the unknowns."""
    starts: tuple[float, float]
    """Their values in a first guess."""

    @property
    def sizes(self) -> tuple[float, float]:
        """Largest rate and force, in SI units."""

    def in_si(self, rate: object, force: object, law: Mapping[str, object]) -> tuple[Any, Any]:
        """Return rate and force in SI units, for the parameters of the law of the force element."""

    def conditions(self, rate: object, force: object, length: object, law: Mapping[str, object]) -> tuple[Any, Any]:
        """Return two zeros in equilibrium: the force at this rate less the unknown `force`; and the difference between
        the length of the force element and that which this force determines.

        Parameters
        ----------
        law
            Parameters of the law of the force element, first-order states among them.
        """

    def at_rest(self, lengths: np.ndarray) -> np.ndarray:
        """Return the state at rest for lengths of the force element [m]."""


class ChosenEquilibrium(NamedTuple):
    """An equilibrium whose unknowns are controls: kind and name of the element, and indices of the unknowns."""

    kind: str
    name: str
    equilibrium: ElementEquilibrium
    rate: int
    force: int

    @property
    def unknowns(self) -> tuple[int, int]:
        """Indices of both unknowns."""
        return self.rate, self.force

    @property
    def length(self) -> str:
        """The length of the force element as an expression."""
        return f"{self.kind}[{json.dumps(self.name)}].length"


def equilibria(mechanism: Mechanism) -> dict[tuple[str, str], ElementEquilibrium]:
    """Return the equilibria of elements by kind and name."""
    return {
        (kind, name): equilibrium
        for kind, elements in mechanism.elements.items()
        for name, element in elements.items()
        if hasattr(element, "equilibrium") and (equilibrium := element.equilibrium()(element)) is not None
    }


def unknown_keys(kind: str, name: str, equilibrium: ElementEquilibrium) -> tuple[str, str]:
    """Return the keys of the unknowns of an equilibrium, which are controls."""
    rate, force = (f"{kind}.{quoted(name)}.{unknown}" for unknown in equilibrium.unknowns)
    return rate, force


def chosen_equilibria(mechanism: Mechanism, controls: Sequence[str]) -> list[ChosenEquilibrium]:
    """Return the equilibria whose unknowns are among the controls; raise SpecError if only one of them is."""
    chosen = []
    for (kind, name), equilibrium in equilibria(mechanism).items():
        keys = unknown_keys(kind, name, equilibrium)
        present = [key for key in keys if key in controls]
        if len(present) == 1:
            raise SpecError(f"the equilibrium needs both {listed(keys, 'and')}", key=f"model.{present[0]}")
        if present:
            chosen.append(ChosenEquilibrium(kind, name, equilibrium, *map(controls.index, keys)))
    return chosen


class SymbolTools(NamedTuple):
    """What elements need to execute their kernels with symbols."""

    run: Callable[[Any], Callable[..., Any]]  #: Returns a kernel, or a law, that is executed with symbols.
    #: Returns the second operand where the first one holds, else the third; integers too.
    select: Callable[[Any, Any, Any], Any]
    is_unknown: Callable[[Any], bool]  #: Whether a number depends on symbols.


class SymbolicElements(Protocol):
    """The acting elements of a kind, executed with symbols."""

    searching: tuple[str, ...]
    """Modules whose functions search, so that their branches are merged (`mbdkit_predict.merged_branches`)."""
    kinds: tuple[str, ...]
    """Kinds of quantities that `values` computes."""
    attributes: tuple[str, ...]
    """Names of these quantities."""

    def check(self) -> None:
        """Raise SpecError for an element that cannot be exported."""

    def forms(self, tools: SymbolTools) -> Mapping[Callable[..., object], Callable[..., object]]:
        """Return functions that need a form for symbols, with this form."""

    def values(self, call_law: Callable[..., None], top: object, law_values: np.ndarray) -> Mapping[str, Sequence[Any]]:
        """Return the quantities `attributes` of each element, by its name.

        Parameters
        ----------
        call_law
            Evaluates a law, see `mbdkit.engine.native.calls.call_law`.
        top, law_values
            Topology of the mechanism, and parameters of all laws.
        """


def symbolic_elements(compiled: CompiledMechanism) -> list[SymbolicElements]:
    """Return the acting elements that export themselves."""
    every = [acting for acting in compiled.extensions.values() if isinstance(acting, Sequence) and acting]
    return [cast(SymbolicElements, acting[0].symbolic()(acting)) for acting in every if hasattr(acting[0], "symbolic")]
