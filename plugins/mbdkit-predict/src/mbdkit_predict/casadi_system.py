"""A mechanism as functions of CasADi, whose equations of motion and quantities are evaluated with symbols."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.engine.interpreted_mechanism import InterpretedMechanism, Motion
from mbdkit.events.event_expression import RunExpression
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.program import execute
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.states import States
from mbdkit.quantities.table import KINDS
from mbdkit_predict.chosen_numbers import ChosenNumbers
from mbdkit_predict.exported_elements import ElementEquilibrium, SymbolTools, symbolic_elements
from mbdkit_predict.merged_branches import SYMBOLS, select
from mbdkit_predict.symbols import BranchError, Symbol, column, symbols

ARGUMENTS = ("q", "v", "a", "lam", "z", "u", "p", "t")  #: Arguments of all functions.


class _Balanced(NamedTuple):
    equilibrium: ElementEquilibrium
    state: int
    length: Any  #: Length of its force element [m].
    law: Mapping[str, Any]  #: Parameters of its law by name.
    rate: Symbol
    force: Symbol

    @property
    def in_si(self) -> tuple[Any, Any]:
        """Rate of the state, and force, in SI units."""
        return self.equilibrium.in_si(self.rate, self.force, self.law)


class CasadiSystem:
    """A mechanism as functions of CasADi's SX, executed from the definitions of the machine code.

    ::

        M a + Phi_q^T lam = Q(q, v, lam, z, u, p, t),      Phi(q, p, t) = 0,      z' = rates(q, v, lam, z, u, p, t)

    Functions have the arguments ``(q, v, a, lam, z, u, p, t)``. Q depends on lam only with friction in joints.
    Jacobians are those of CasADi; at corners of the model, such as the beginning of contact, they are one-sided.

    Attributes
    ----------
    bodies : tuple of str
        Names of the B bodies.
    q, v, a : (n, 1) SX
        Coordinates x, y, angle of each body in turn [m, rad], n = 3 B, their velocities and accelerations.
    lam : (m, 1) SX
        Multipliers of the independent constraint rows [N, N m].
    z : (Z, 1) SX
        First-order states, each in its own unit. Outputs and states of sampled controllers are among them, with the
        rate 0: they change only at the samples.
    u, p : SX
        Controls and parameters, (U, 1) and (P, 1).
    t : SX
        Time [s].
    places : (n,) array of int
        Index of each coordinate among x, y and angle of all bodies.
    constraint_names, state_names, control_names, parameter_names, compiled_states : tuple of str
        Names of the rows ``joint.row``, states, controls and parameters, and of states with the controls among them.
    q0, v0, z0, u0, p0 : arrays
        The consistent start of the mechanism, its states, and present values of controls and parameters.
    residual : casadi.Function
        ``M a + Phi_q^T lam - Q``, (n, 1).
    constraints : casadi.Function
        Three results (m, 1): ``position`` Phi, ``velocity`` its first and ``acceleration`` its second time derivative.
    rates : casadi.Function
        Derivatives of the states by time, (Z, 1).
    equilibrium : casadi.Function
        Zeros in a motion, two for each element whose unknowns are controls, such as a muscle with an elastic tendon:
        see `mbdkit_predict.exported_elements.ElementEquilibrium.conditions`.
    """

    def __init__(self, chosen: ChosenNumbers, t0: float, *, is_joint: bool = False):
        self.chosen = chosen
        self._mechanism = InterpretedMechanism(self.chosen.mechanism, t0, is_joint=is_joint)
        start, self._compiled = self._mechanism.start, self._mechanism.compiled
        self._elements = symbolic_elements(self._compiled)
        for elements in self._elements:
            elements.check()
        self._controls = {name: i for i, name in enumerate(chosen.control_states)}
        names = [state.name for state in self._compiled.states]
        self._is_state = [name not in self._controls for name in names]
        self.bodies, self.compiled_states = self._compiled.bodies, tuple(names)
        self.state_names = tuple(name for name in names if name not in self._controls)
        self.control_names, self.parameter_names = chosen.controls, chosen.parameters
        whole, self._cut, self.places = 3 * len(self.bodies), self._mechanism.cut, self._mechanism.places
        solved = self._compiled.solved_rows
        self.is_angle, self.is_arm, n = self.places % 3 == 2, self._mechanism.is_arm, len(self.places)
        self.constraint_names = tuple(solved[k].label for k in self._cut)
        sizes = (n, n, n, len(self._cut), sum(self._is_state), len(chosen.controls), len(chosen.parameters), 1)
        self.symbols = {name: ca.SX.sym(name, size) for name, size in zip(ARGUMENTS, sizes, strict=True)}
        *of_joints, lam, z, self._u, self._p, (self.time,) = map(_elements, self.symbols.values())
        states = iter(z)
        self._z = [self._u[self._controls[name]] if name in self._controls else next(states) for name in names]
        self.z0 = self._compiled.initial_states[self._is_state]
        self.u0, self.p0 = np.array(chosen.control_start), np.array(chosen.parameter_start)
        searching = [module for element in self._elements for module in element.searching]
        self._run = self._mechanism.interpreter(SYMBOLS, searching)
        tools = SymbolTools(self._run, select, lambda x: isinstance(x, Symbol) and not x.sx.is_constant())
        for elements in self._elements:
            self._run.known |= elements.forms(tools)
        self._mechanism.load(chosen.topology(self._compiled.topology, self._p), self._z)
        self.taken = self._taken()
        given = start.q0[:whole], start.v0[:whole], np.zeros(whole), self.p0, t0
        self.q0, self.v0, _ = (np.array(x).ravel() for x in self.taken(*given))
        self._motion = self._mechanism.bodies(self.time, Motion(*map(np.array, of_joints)))
        self.placed = ca.Function("placed", [*(self.symbols[x] for x in "qvapt")], [*map(column, self._motion)])
        self._lam = np.full(len(solved), 0.0, dtype=object)
        self._lam[self._cut] = lam
        self._add_functions()

    def __repr__(self) -> str:
        n, m, z = len(self.q0), len(self.constraint_names), len(self.state_names)
        chosen = f"{len(self.control_names)} controls, {len(self.parameter_names)} parameters"
        return f"<CasadiSystem: {n} coordinates, {m} constraint rows, {z} states, {chosen}>"

    def __getattr__(self, name: str) -> ca.SX:
        if name in ARGUMENTS:
            return self.symbols[name]
        raise AttributeError(f"a CasadiSystem has no attribute '{name}'")

    def function(self, name: str, results: Mapping[str, ca.SX]) -> ca.Function:
        """Return a function of ``(q, v, a, lam, z, u, p, t)`` with named results, expressions in these symbols."""
        given, values = list(self.symbols.values()), ca.cse(list(results.values()))
        return ca.Function(name, given, values, list(self.symbols), list(results))

    def _taken(self) -> ca.Function:
        """Return positions, velocities and accelerations of the coordinates as a function of those of all bodies, and
        of parameters and time.
        """
        given = [ca.SX.sym(name, 3 * len(self.bodies)) for name in "qva"]
        whole = Motion(*(np.array(_elements(x), dtype=object) for x in given))
        own = self._mechanism.coordinates(self.time, whole)
        return ca.Function("taken", [*given, self.p, self.t], [*map(column, own)])

    def coordinates_of(self, *whole: np.ndarray, time: np.ndarray) -> list[np.ndarray]:
        """Return positions, velocities and accelerations (n, T) of the coordinates, given those of all bodies (3 B, T)
        at times (T,).
        """
        p = np.tile(self.p0[:, None], len(time))
        q, *rates = map(np.array, self.taken.map(len(time))(*whole, p, time[None]))
        q[self.is_arm] = np.unwrap(q[self.is_arm])
        return [q, *rates]

    def _add_functions(self) -> None:
        mechanism = self._mechanism
        for chosen, element in zip(self.chosen.equilibria, self._balanced(), strict=True):
            mechanism.give_force(chosen.kind, chosen.name, element.in_si[1])
        residual = mechanism.residual(self.time, self._motion, self._lam)
        rates = self._with_balanced(mechanism.state_rates(renew=True))
        rows = mechanism.constraints(self.time, self._motion)
        balance = column(residual)
        if mechanism.is_joint:
            balance = ca.jtimes(column(self._motion.v), self.v, balance, True)
            mechanism.add_multipliers(residual, self._lam)
        named = zip(("position", "velocity", "acceleration"), rows, strict=True)
        self.residual = self.function("residual", {"residual": balance})
        self.constraints = self.function("constraints", {name: column(values[self._cut]) for name, values in named})
        self.rates = self.function("rates", {"rates": column(rates[self._is_state])})
        self.equilibrium = self.function("equilibrium", {"equilibrium": column(list(self._equilibrium()))})

    def _with_balanced(self, rates: np.ndarray) -> np.ndarray:
        """Return the rates of the states, of elements in equilibrium as their unknowns say."""
        for element in self._balanced():
            rates[element.state] = element.in_si[0]
        return rates

    def _balanced(self) -> Iterator[_Balanced]:
        for kind, name, equilibrium, rate, force in self.chosen.equilibria:
            state = self.compiled_states.index(f"{name}.{equilibrium.state}")
            length, law = self._mechanism.force_element(kind, name)
            yield _Balanced(equilibrium, state, length, law, self._u[rate], self._u[force])

    def _equilibrium(self) -> Iterator[Any]:
        for element in self._balanced():
            yield from element.equilibrium.conditions(element.rate, element.force, element.length, element.law)

    @cached_property
    def _states(self) -> States:
        """The state as that of a run with one row, from which quantities are taken."""
        q, v, recorded = self._mechanism.observed(self.time, self._motion, self._lam)
        self._with_balanced(recorded.state_rates[0])
        observed = type(recorded)(*map(symbols, recorded))
        t = np.array([self.time], dtype=object)
        q, v, z = (symbols(x)[None] for x in (q, v, self._z))
        return States(self._compiled, t, q, v, lambda: observed, z=z)

    @cached_property
    def _own_values(self) -> dict[str, tuple[tuple[str, ...], Mapping[str, Sequence[Any]]]]:
        """By kind of quantities that elements compute themselves: names, and their values by name of the element."""
        top, law_values = self._mechanism.topology, self._mechanism.law_values
        every = [(element, element.values(self._run.call_law, top, law_values)) for element in self._elements]
        return {kind: (one.attributes, values) for one, values in every for kind in one.kinds}

    @cached_property
    def _quantities(self) -> tuple[dict[str, ca.SX], dict[str, str]]:
        values, refused = {}, {}
        for name in self._names():
            try:
                parsed = self._parsed(name)
            except SpecError:  # such as the angle of a point mass
                continue
            try:
                values[name] = column([self._value(parsed)])
            except SpecError as error:
                refused[name] = error.message
        return values, refused

    @property
    def quantity_names(self) -> tuple[str, ...]:
        """Names of the quantities in `quantities`, as expressions contain them, such as ``joints.A.force_x``."""
        return tuple(self._quantities[0])

    @property
    def refused(self) -> dict[str, str]:
        """Reasons, by name, why other quantities are not in `quantities`."""
        return self._quantities[1]

    @cached_property
    def quantities(self) -> ca.Function:
        """Function that returns all quantities of the mechanism, in the order of `quantity_names`."""
        return self.function("quantities", {"quantities": ca.vertcat(*self._quantities[0].values())})

    def _names(self) -> Iterator[str]:
        names = archive_names(self._compiled)
        for kind in KINDS:
            every = kind.attributes.values()
            attributes = [x for x in every if x.in_events and not (x.is_vector or x.array.is_of_steps)]
            axis = next((array for array in kind.arrays if kind.axis and array.path == kind.named_by), None)
            elements = [""] if axis is None or axis.texts is None else list(axis.texts(names))
            for element in dict.fromkeys(elements):
                if kind.word == "states" and element in self._controls:
                    continue
                owner = f".{element}" if element.isidentifier() else element and f"[{json.dumps(element)}]"
                for attribute in attributes:
                    is_whole = not kind.owner or attribute.array.of_whole
                    suffixes = [""] if is_whole else [f"[{i}]" for i in range(elements.count(element))]
                    yield from (f"{kind.word}{owner}.{attribute.name}{suffix}" for suffix in suffixes)

    def expression(self, text: str) -> ca.SX:
        """Return an expression of quantities, such as ``"max(knee.force, 0)**2"``, in the symbols of the system.

        Raises
        ------
        SpecError
            If the text is not valid, or contains a quantity that cannot be exported.
        """
        return column([self._value(self._parsed(text))])

    def _parsed(self, text: str) -> RunExpression:
        return RunExpression.parse(text, self.chosen.mechanism, self.chosen.named, crosses=False)

    def operands(self, text: str) -> ca.SX:
        """Return the operands of all operations of an expression, (K, 1); see `operands_of`."""
        operands = list[Any]()
        self._value(self._parsed(text), operands)
        return column(operands)

    def _value(self, parsed: RunExpression, known: list[Any] | None = None) -> Any:
        """Return the value of an expression; its operands are added to those that are known."""

        def step(operation: str, number: float, *operands: Any) -> Any:
            if operation == "get":
                return self.quantity(parsed.quantities[int(number)])
            if operation in ("const", "t"):
                return self.time if operation == "t" else number
            if known is not None:
                known.extend(operands_of(operation, operands))
            return OPERATIONS[operation].array(*operands, *(number,) * (operation == "powi"))

        return execute(parsed.program, step)

    def quantity(self, quantity: Quantity) -> Any:
        """Return a quantity as a symbol, the norm of a vector; raise SpecError if it cannot be exported."""
        name, reason = quantity.name, ""
        if quantity.recorded.array.is_shared and name in self._compiled.redundancy.not_unique:
            reason = "redundant joints share it, so that it does not follow from the multipliers"
        elif quantity.kind in self._own_values:
            attributes, values = self._own_values[quantity.kind]
            if quantity.attribute in attributes and name in values:
                return values[name][attributes.index(quantity.attribute)]
            reason = f"of {quantity.kind}, there are {listed(attributes, 'and')}"
        else:
            try:
                value = quantity.taker(archive_names(self._compiled))(self._states)
                return elementary.hypot(*value[0]) if quantity.is_vector else value[0]
            except (BranchError, TypeError, ValueError, AttributeError) as error:
                reason = f"its definition cannot be executed with symbols ({error})"
        raise SpecError(f"{quantity} cannot be exported: {reason}")


def operands_of(operation: str, operands: Sequence[Any]) -> list[Any]:
    """Return the operands of an operation, and the difference at whose zero it switches."""
    switches = OPERATIONS[operation].switch == "difference"
    return [*operands, *([operands[0] - operands[1]] if switches else [])]


def _elements(vector: ca.SX) -> list[Symbol]:
    return [Symbol(x) for x in ca.vertsplit(vector)] if vector.numel() else []


class StatesInEquilibrium:
    """The states of a mechanism whose rates, and forces, are unknowns; the equilibrium is a condition.

    As functions of the state, rates of fibres on an elastic tendon are stiff, and forces of tendons grow exponentially
    with errors of the state. With velocities and forces as unknowns, both are bounded during all iterations, and
    equilibrium is reached together with the optimum, as in F. De Groote et al., Annals of Biomedical Engineering
    44:2922-2936, 2016.

    Attributes
    ----------
    states
        Index of each of the F states among the first-order states.
    at_rest
        (F,) expressions in the symbols of the system that are zero if the states are in equilibrium at rest.
    """

    def __init__(self, chosen: ChosenNumbers, system: CasadiSystem):
        self._chosen = chosen.equilibria
        self.states = [system.state_names.index(f"{one.name}.{one.equilibrium.state}") for one in self._chosen]
        still = ca.SX(system.u)
        still[[index for one in self._chosen for index in one.unknowns]] = 0.0
        pull: ca.SX = system.equilibrium(*{**system.symbols, "u": still}.values())[0::2]  # the forces
        gaps = system.equilibrium(*system.symbols.values())[1::2]
        forces = [one.force for one in self._chosen]
        self.at_rest = ca.vertsplit(ca.substitute(gaps, system.u[forces], pull)) if self._chosen else []
        lengths = [system.expression(one.length) for one in self._chosen]
        self._lengths = ca.Function("lengths", [system.q, system.p], [ca.vertcat(ca.SX(0, 1), *lengths)])

    def guess(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the states (F, T) at rest, without forces, at positions (n, T), for parameters (P,)."""
        lengths = np.array(self._lengths(q, p)).reshape(len(self.states), q.shape[1])
        rows = [one.equilibrium.at_rest(row) for one, row in zip(self._chosen, lengths, strict=True)]
        return np.reshape(rows, lengths.shape)
