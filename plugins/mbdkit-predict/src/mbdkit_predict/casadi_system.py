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
from mbdkit.engine.consistent_start import mechanism_at_start
from mbdkit.engine.kernels import acting, applied_forces, equations, frames, observe, system
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.kernels.frames import Reactions
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.table_rows import LAW_ROW, SPRING, LawRow
from mbdkit.engine.workspace import Workspace
from mbdkit.events.event_expression import RunExpression
from mbdkit.expressions.program import value_of
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.states import States
from mbdkit.quantities.table import KINDS
from mbdkit_predict.chosen_numbers import ChosenNumbers
from mbdkit_predict.exported_elements import ElementEquilibrium, symbolic_elements
from mbdkit_predict.interpreted import Interpreter
from mbdkit_predict.joint_coordinates import JointCoordinates, Motion
from mbdkit_predict.symbols import BranchError, Symbol, column, symbols

ARGUMENTS = ("q", "v", "a", "lam", "z", "u", "p", "t")  #: Arguments of all functions.


class _Balanced(NamedTuple):
    equilibrium: ElementEquilibrium
    segment: int  #: Index of its segment among the springs.
    state: int
    rate: Symbol
    force: Symbol
    law: Mapping[str, Any]  #: Parameters of its law by name.

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
        start = mechanism_at_start(self.chosen.mechanism, t0)
        self._compiled = start.mechanism
        self._elements = symbolic_elements(self._compiled)
        for elements in self._elements:
            elements.check()
        self._controls = {name: i for i, name in enumerate(chosen.control_states)}
        names = [state.name for state in self._compiled.states]
        self._is_state = [name not in self._controls for name in names]
        self.bodies, self.compiled_states = self._compiled.bodies, tuple(names)
        self.state_names = tuple(name for name in names if name not in self._controls)
        self.control_names, self.parameter_names = chosen.controls, chosen.parameters
        work = Workspace(self._compiled, 0.0, *np.zeros((2, self._compiled.size)))
        self._joints: JointCoordinates | None = None
        if is_joint and not len(self._compiled.topology.frictions):
            joints = JointCoordinates(self._compiled.topology, work.solver.row_index)
            self._joints = joints if joints.places.size else None
        whole, solved = 3 * len(self._compiled.bodies), self._compiled.solved_rows
        in_tree = self._joints.tree_rows if self._joints else set()
        self._cut = [k for k in range(len(solved)) if k not in in_tree]
        self.places = self._joints.places if self._joints else np.arange(whole)
        self.is_angle, n = self.places % 3 == 2, len(self.places)
        self.constraint_names = tuple(solved[k].label for k in self._cut)
        sizes = (n, n, n, len(self._cut), sum(self._is_state), len(chosen.controls), len(chosen.parameters), 1)
        self.symbols = {name: ca.SX.sym(name, size) for name, size in zip(ARGUMENTS, sizes, strict=True)}
        *of_joints, lam, z, self._u, self._p, (self.time,) = map(_elements, self.symbols.values())
        states = iter(z)
        self._z = [self._u[self._controls[name]] if name in self._controls else next(states) for name in names]
        self.z0 = self._compiled.initial_states[self._is_state]
        self.u0, self.p0 = np.array(chosen.control_start), np.array(chosen.parameter_start)
        self._run = Interpreter(self._compiled.laws, self._elements)
        self._equations = self._new_equations(work)
        self.taken = self._taken()
        given = start.q0[:whole], start.v0[:whole], np.zeros(whole), self.p0, t0
        self.q0, self.v0, _ = (np.array(x).ravel() for x in self.taken(*given))
        self._q, self._v, self._a = own = self._bodies(Motion(*map(np.array, of_joints)))
        self.placed = ca.Function("placed", [*(self.symbols[x] for x in "qvapt")], [*map(column, own)])
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

    def _new_equations(self, work: Workspace) -> equations.Equations:
        top = self.chosen.topology(self._compiled.topology, self._p)
        scratch = _objects(work.scratch)
        scratch.law_values[:] = top.law_parameters
        bundle: equations.Equations = _objects(equations.new_equations(top, scratch, work.solver))
        self._run(applied_forces.take_states)(top, scratch, self._z)
        return bundle

    def _taken(self) -> ca.Function:
        """Return positions, velocities and accelerations of the coordinates as a function of those of all bodies, and
        of parameters and time.
        """
        given = [ca.SX.sym(name, 3 * len(self.bodies)) for name in "qva"]
        own = Motion(*(np.array(_elements(x), dtype=object) for x in given))
        eq = self._equations
        if self._joints is not None:
            self._run(system.prepare)(eq.top, eq.w, self.time, np.append(own.q, np.zeros(3)))
            own = self._joints.coordinates(self._run, eq.top, eq.w, own)
        return ca.Function("taken", [*given, self.p, self.t], [*map(column, own)])

    def coordinates_of(self, *whole: np.ndarray, time: np.ndarray) -> list[np.ndarray]:
        """Return positions, velocities and accelerations (n, T) of the coordinates, given those of all bodies (3 B, T)
        at times (T,).
        """
        p = np.tile(self.p0[:, None], len(time))
        return [*map(np.array, self.taken.map(len(time))(*whole, p, time[None]))]

    def _bodies(self, own: Motion) -> Motion:
        """Return the motion of all bodies, given that of the coordinates."""
        eq = self._equations
        return own if self._joints is None else self._joints.bodies(self._run, eq.top, eq.w, self.time, own)

    def _add_functions(self) -> None:
        eq, run = self._equations, self._run
        top, w = eq.top, eq.w
        for element in self._balanced():
            address, begin, _, program = LawRow(*map(int, top.laws[int(top.springs[element.segment, SPRING.law])]))
            run.known_forces[address, program, begin] = element.in_si[1]
        residual = _zeros(len(self._q))
        run(equations.residual_of)(eq, self.time, self._q, self._v, self._a, self._lam, True, residual)
        run(applied_forces.applied_forces)(top, w, eq.q, eq.v)
        rates = self._rates(top)
        position, velocity, gamma, acceleration = _zeros(4, len(self._lam))
        run(equations.rows_of)(eq, self.time, self._q, self._v, position, velocity, gamma)
        balance = column(residual)
        if self._joints is not None:
            balance = ca.jtimes(column(self._v), self.v, balance, True)
            for k, row, multiplier in self._joints.multipliers(top, w.jac, residual):
                self._lam[eq.solver.row_index[k, row] - len(residual)] = multiplier
        eq.a[: len(self._a)] = self._a
        for k, row in np.ndindex(*w.phi.shape):
            if row < top.rows[k]:
                index = eq.solver.row_index[k, row] - len(self._q)
                by_acceleration = run(system.constraint_rate)(top.pairs, w.jac, _zeros(*w.phi_t.shape), eq.a, k, row)
                acceleration[index] = by_acceleration - gamma[index]
        rows = {"position": position, "velocity": velocity, "acceleration": acceleration}
        rows = {name: column(values[self._cut]) for name, values in rows.items()}
        self.residual = self.function("residual", {"residual": balance})
        self.constraints = self.function("constraints", rows)
        self.rates = self.function("rates", {"rates": column(rates[self._is_state])})
        self.equilibrium = self.function("equilibrium", {"equilibrium": column(list(self._equilibrium()))})

    def _rates(self, top: Topology) -> np.ndarray:
        rates = _zeros(len(self._z))
        self._run(applied_forces.state_rates)(top, self._equations.w, self._equations.v, rates)
        for element in self._balanced():
            rates[element.state] = element.in_si[0]
        return rates

    def _balanced(self) -> Iterator[_Balanced]:
        known, law_values = self._compiled, self._equations.w.law_values
        top = known.topology
        for kind, name, equilibrium, rate, force in self.chosen.equilibria:
            (place,) = (acting.place for acting in known.extensions[kind] if acting.force.name == name)
            (segment,) = np.flatnonzero((top.force_place == place) & (top.springs[:, SPRING.segments] > 0)).tolist()
            law = int(top.springs[segment, SPRING.law])
            names = [parameter for parameter, _ in known.laws[law][1].parameters]
            values = dict(zip(names, law_values[int(top.laws[law, LAW_ROW.parameters]) + 1 :], strict=False))
            state = self.compiled_states.index(f"{name}.{equilibrium.state}")
            yield _Balanced(equilibrium, segment, state, self._u[rate], self._u[force], values)

    def _equilibrium(self) -> Iterator[Any]:
        for element in self._balanced():
            length = self._equations.w.s[element.segment, 0]
            yield from element.equilibrium.conditions(element.rate, element.force, length, element.law)

    @cached_property
    def _states(self) -> States:
        """The state as that of a run with one row, from which quantities are taken."""
        eq, run = self._equations, self._run
        top, w = eq.top._replace(gravity=eq.gravity), eq.w  # the equations subtract gravity apart
        t, q, v, lam = (np.array([x], dtype=object) for x in (self.time, self._q, self._v, self._lam))
        forces = _objects(Reactions.zeros(1, len(top.pairs)))
        run(equations.residual_of)(eq, self.time, self._q, self._v, self._a, self._lam, True, _zeros(len(self._q)))
        run(frames.reactions_in_frames)(eq, t, q, v, lam, forces)
        observed = _objects(Observed.zeros(1, self._compiled.topology))
        observed.lam[:], observed.acc[0, : len(self._a)] = forces.lam, self._a
        observed.state_rates[0] = self._rates(top)
        run(observe.describe)(top, w, eq.q, eq.v, observed, 0)
        run(acting.joint_values)(top, w, eq.q, forces.lam[0], observed.reactions[0], observed.joints[0])
        observed = Observed(*map(symbols, observed))
        q, v, z = (symbols(x)[None] for x in (eq.q, eq.v, self._z))
        return States(self._compiled, t, q, v, lambda: observed, z=z)

    @cached_property
    def _own_values(self) -> dict[str, tuple[tuple[str, ...], Mapping[str, Sequence[Any]]]]:
        """By kind of quantities that elements compute themselves: names, and their values by name of the element."""
        w, top, call = self._equations.w, self._equations.top, self._run.call_law
        every = [(element, element.values(call, top, w.law_values)) for element in self._elements]
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
        return RunExpression.parse(text, self.chosen.mechanism, crosses=False)

    def _value(self, parsed: RunExpression) -> Any:
        def leaf(operation: str, number: float) -> Any:
            if operation == "get":
                return self.quantity(parsed.quantities[int(number)])
            return self.time if operation == "t" else number

        return value_of(parsed.program, leaf)

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


def _elements(vector: ca.SX) -> list[Symbol]:
    return [Symbol(x) for x in ca.vertsplit(vector)] if vector.numel() else []


def _zeros(*shape: int) -> np.ndarray:
    return np.full(shape, 0.0, dtype=object)


def _objects(bundle: Any) -> Any:
    """Return a bundle with its numbers, not integers, as objects."""
    return type(bundle)(
        *(x.astype(object) if isinstance(x, np.ndarray) and x.dtype == np.float64 else x for x in bundle)
    )
