"""Numbers of a mechanism that become arguments of functions: controls, and parameters.

A control is added to the mechanism as a first-order state without a rate, which takes the place of the value of a load,
the excitation of a muscle, or any other expression of the state. A state of the mechanism may also be a control itself,
and so may the two unknowns of the equilibrium of fibres with an elastic tendon, whose solution they replace.

How the arrays of a compiled mechanism depend on parameters is known from compiling it with changed values: each number
in them must be a linear function of the parameters, as the stiffness of a spring or a point of a joint is.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from types import MappingProxyType
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import copied, parse_path, path_text, plain
from mbdkit.base.text import did_you_mean
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import run_check
from mbdkit_predict.exported_elements import chosen_equilibria

#: Change of parameters, relative to their values, by which linear functions are recognized, together with its half.
STEP = 0.25
LINEAR = 1e-9  #: Largest difference between the slopes for both changes, relative to the slope.
#: Arrays of numbers that the equations of motion do not contain, only their solution.
NOT_READ = "weight", "length", "row_units"


class ChosenNumbers:
    """Controls and parameters of a mechanism, by key paths such as ``forces.motor.value`` and ``bodies.rod.mass``.

    Named parameters may be among both: `named` are their present values by name, and `rebuilt` returns the mechanism
    with other values. `used` are, by key path in the mechanism, the expressions that contain those that are
    controls, as functions of states. Raises SpecError if a key does not exist, its value is no number, or a control
    cannot change with time.

    Attributes
    ----------
    mechanism
        The mechanism with controls as states.
    control_states
        Names of the states that are the controls; the keys of unknowns of equilibria, which are no states.
    named
        Present values of named parameters.
    equilibria
        Equilibria of elements, such as fibres with an elastic tendon, whose unknowns are controls.
    unknowns
        Equilibrium of each of these controls by key, and which of its unknowns it is.
    control_start, parameter_start
        Present values; 0 for controls that are not numbers.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        controls: Sequence[str],
        parameters: Sequence[str],
        named: Mapping[str, float] = MappingProxyType({}),
        rebuilt: Callable[[Mapping[str, float]], tuple[Mechanism, Mapping[str, str]]] | None = None,
        used: Mapping[str, str] = MappingProxyType({}),
    ):
        self.controls, self.parameters = tuple(controls), tuple(parameters)
        self.named, self._rebuilt = named, rebuilt
        self._original = mechanism
        self._spec = self._with_expressions(mechanism, used)
        self.equilibria = chosen_equilibria(mechanism, controls)
        self.unknowns = {
            controls[i]: (one.equilibrium, k) for one in self.equilibria for k, i in enumerate(one.unknowns)
        }
        self.control_start = [0.0 if key in self.unknowns else self._start(key, used) for key in controls]
        if both := set(controls) & set(parameters):
            raise SpecError("is a control, so that it is no parameter", key=self.place(min(both)))
        self.parameter_start = [self._number(key) for key in parameters]
        self.control_states = [
            key if key in self.unknowns else self._add_control(self._spec, key, start)
            for key, start in zip(controls, self.control_start, strict=True)
        ]
        try:
            self.mechanism = self._mechanism(self._spec) if controls else self._of_run(copy(mechanism))
        except SpecError as error:
            if error.key.removeprefix("model.") not in {*controls, *used}:
                raise
            raise SpecError("is no control, because it cannot change with time", key=error.key) from None

    def _with_expressions(self, mechanism: Mechanism, used: Mapping[str, str]) -> dict[str, Any]:
        """Return the spec of a mechanism with expressions of named parameters that are controls."""
        spec = mechanism.to_spec()
        for key, text in used.items():
            self._set(spec, key, text)
        return spec

    def _add_control(self, spec: dict[str, Any], key: str, start: float) -> str:
        kind, *path = parse_path(key)
        is_own = kind == "states" and len(path) == 1  # the state itself is the control
        state = str(path[0]) if is_own else key
        if path and not is_own:
            self._set(spec, key, f"states[{json.dumps(key)}]")
        spec.setdefault("states", {}).setdefault(state, {}).update({"initial": start, "rate": "0"})
        return state

    def _start(self, key: str, used: Mapping[str, str]) -> float:
        if len(parse_path(key)) > 1:
            value = self._value(key)
        elif any(f"states[{json.dumps(key)}]" in text for text in used.values()):
            value = self.named[key]
            if key in self._original.states:
                raise SpecError("has the name of a state; rename one of them", key=f"controls.{key}")
        else:
            why = f"the model uses no parameter '{key}'{did_you_mean(key, self.named)}"
            raise SpecError(why, key=f"controls.{key}")
        value = getattr(value, "initial", value)  # of a state
        if isinstance(value, list | tuple):
            raise SpecError(f"has components, each a control of its own: {key}[0] and {key}[1]", key=f"model.{key}")
        return float(value) if isinstance(value, int | float) else 0.0

    def place(self, key: str) -> str:
        """Return the key path of a number in specs."""
        return f"{'model' if len(parse_path(key)) > 1 else 'parameters'}.{key}"

    def _number(self, key: str) -> float:
        if key in self.named:
            return self.named[key]
        if len(parse_path(key)) == 1:
            raise SpecError(f"there is no parameter '{key}'{did_you_mean(key, self.named)}", key=self.place(key))
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SpecError("a parameter should be the key of a number of the mechanism", key=f"model.{key}")
        return float(value)

    def _check_apart(self, name: str, value: float) -> None:
        """Raise SpecError if the number at the key path of a parameter changes with a named one, which it replaces."""
        assert self._rebuilt is not None
        changed, _ = self._rebuilt({name: value})
        for key in self.parameters:
            if key not in self.named and self._value(key, changed) != self._value(key):
                why = f"depends on the parameter '{name}', which is asked for too: ask for one of them"
                raise SpecError(why, key=self.place(key))

    def _value(self, key: str, mechanism: Mechanism | None = None) -> object:
        """Return the value of the mechanism, or of a changed one, at a key path; raise SpecError if there is none."""
        value: Any = mechanism or self._original
        path = parse_path(key)
        for i, part in enumerate(path):
            try:
                value = getattr(value, str(part)) if hasattr(value, str(part)) and i != 1 else value[part]
            except (LookupError, TypeError):
                names = list(value) if isinstance(value, Mapping) else list(getattr(value, "__dict__", ()))
                hint = did_you_mean(str(part), [str(name) for name in names])
                raise SpecError(f"the mechanism has no '{part}' here{hint}", key=f"model.{path_text(path)}") from None
        return value

    def _set(self, spec: dict[str, Any], key: str, value: object) -> None:
        *path, last = parse_path(key)
        holder: Any = spec
        for i, part in enumerate(path):
            if isinstance(holder, dict) and part not in holder:  # a default value, which specs leave out
                holder[part] = plain(self._value(path_text(tuple(path[: i + 1]))))
            holder = holder[part]
        holder[last] = value

    def _mechanism(self, spec: dict[str, Any]) -> Mechanism:
        changed, original = Mechanism.from_spec(spec), self._original
        changed.name, changed.treatments = original.name, original.treatments
        for kind in ("bodies", *original.elements):
            setattr(changed, kind, {name: getattr(changed, kind)[name] for name in getattr(original, kind)})
        return self._of_run(changed)

    @staticmethod
    def _of_run(mechanism: Mechanism) -> Mechanism:
        """Return a mechanism with the elements that act only in runs."""
        mechanism.is_of_run = True
        for key, kind in element_kinds().items():
            if kind.acts.check_run is not None and mechanism.elements.get(key):
                run_check.of(kind.acts.check_run)(mechanism)
        return mechanism

    def with_parameters(self, values: Sequence[float]) -> Mechanism:
        """Return the mechanism with other values of the parameters."""
        if not self.parameters:
            return self.mechanism
        given = dict(zip(self.parameters, map(float, values), strict=True))
        spec, renamed = copied(self._spec), {name: given.pop(name) for name in self.named if name in given}
        if renamed:
            assert self._rebuilt is not None
            spec = self._with_expressions(*self._rebuilt(renamed))
            for key, state, start in zip(self.controls, self.control_states, self.control_start, strict=True):
                if state in self._spec["states"]:  # else the unknown of an equilibrium
                    self._add_control(spec, key, start)
        for key, value in given.items():
            self._set(spec, key, value)
        return self._mechanism(spec)

    def topology(self, known: Topology, p: Sequence[Any]) -> Topology:
        """Return the arrays of the mechanism as functions of parameters `p`, given their values without changes.

        Raises SpecError if a parameter is not allowed to change a little, or an array is not a linear function of it.
        """
        arrays = {name: x.astype(object) for name, x in _numbers(known)}
        if not self.parameters:
            return known._replace(**arrays)
        steps = np.array([STEP * (abs(start) or 1.0) for start in self.parameter_start])
        base, initial = self._compiled(0.0 * steps)
        changes: dict[str, list[np.ndarray]] = {name: [] for name in base}
        for k, step in enumerate(np.diag(steps)):
            if self.parameters[k] in self.named:
                self._check_apart(self.parameters[k], self.parameter_start[k] + steps[k])
            (whole_step, start_of_states), (half_step, _) = self._compiled(step), self._compiled(0.5 * step)
            if not np.array_equal(initial, start_of_states):
                why = "is not a parameter that can be exported: the initial value of a state depends on it"
                raise SpecError(why, key=self.place(self.parameters[k]))
            moved = [(steps[k], whole_step), (0.5 * steps[k], half_step)]
            if all(np.array_equal(x, base[name], equal_nan=True) for name, x in moved[0][1].items()):
                why = "is not a parameter that can be exported: the equations of motion do not contain it"
                raise SpecError(why, key=self.place(self.parameters[k]))
            for name, start in base.items():
                slopes = [(x[name] - start) / change for change, x in moved if x[name].shape == start.shape]
                if len(slopes) < 2 or np.any(abs(np.subtract(*slopes)) > LINEAR * np.max(np.abs(slopes), axis=0)):
                    why = "is not a parameter that can be exported: the equations of motion are not linear in it"
                    raise SpecError(why, key=self.place(self.parameters[k]))
                changes[name].append(steps[k] * slopes[0])
                whole = np.rint(slopes[0])
                slope = np.where(abs(slopes[0] - whole) <= LINEAR, whole, slopes[0])
                for index in zip(*np.nonzero(slope), strict=True):
                    arrays[name][index] = arrays[name][index] + slope[index] * (p[k] - self.parameter_start[k])
        together, _ = self._compiled(steps)
        for name, start in base.items():
            size = abs(start) + np.abs(changes[name]).sum(axis=0)
            if np.any(abs(together[name] - start - np.sum(changes[name], axis=0)) > LINEAR * size):
                raise SpecError("the equations contain products of these parameters", key="parameters")
        return known._replace(**arrays)

    def _compiled(self, changes: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the arrays of the mechanism, and the initial values of states, with changed parameters."""
        compiled = compile_mechanism(self.with_parameters((np.array(self.parameter_start) + changes).tolist()))
        return dict(_numbers(compiled.topology)), compiled.initial_states


def _numbers(topology: Topology) -> Iterator[tuple[str, np.ndarray]]:
    for name, x in topology._asdict().items():
        if x.dtype == np.float64 and name not in NOT_READ:
            yield name, x
