"""Checks of a kind of elements, on the mechanism and the run of its packaged example."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, cast

import numpy as np

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.plain_data import parse_path
from mbdkit.base.strict_model import description
from mbdkit.base.text import listed
from mbdkit.base.units import described_units, read_unit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.observed_states import StateObserver
from mbdkit.mechanism.bodies import GROUND, Element
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import lines_of
from mbdkit.quantities.array import Kind, Recorded
from mbdkit.quantities.registered_kinds import kind_of_group
from mbdkit.registry.element_items import ElementKind
from mbdkit.spec.reading import put
from mbdkit.spec.run_spec import RunSpec
from mbdkit_gradients import Gradient, gradient
from mbdkit_statics.equilibrium import equilibrium
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed, skipped
from mbdkit_testing.example_checks import SAME, TINY, balance, checkpoint, tangents, without_plugin
from mbdkit_testing.example_under_test import ADAPTIVE, ExampleUnderTest, completed, with_units

#: Columns that the equations also contain, by their index in `mbdkit.kernels.Observed.forces`.
OF_FORCES = {"length": 0, "rate": 1, "force": 2, "power": 3}
#: Name of a body in place of the ground, angle by which all bodies turn [rad], and number of rows that are compared.
STILL, TURN, ROWS = "instead of the ground", 0.7, 50


class ElementUnderTest(ExampleUnderTest[ElementKind]):
    """A kind of elements under test."""

    @property
    def key(self) -> str:
        """Key of the elements in the model."""
        return self.plugin.key_in_model

    @property
    def what(self) -> str:
        """What the example must have, in the plural."""
        return self.key

    def members(self, spec: RunSpec) -> Mapping[str, Any]:
        """Return the elements of a spec by name."""
        return spec.mechanism().elements.get(self.key, {})

    @cached_property
    def groups(self) -> list[Kind]:
        """The groups of archives that belong to the kind."""
        items: list[Any] = [item.plugin for item in self.installed.of_kind("quantity")]
        return [kind_of_group(item.group) for item in items if item.of == self.key]


@check("element.spec")
def spec(kind: ElementUnderTest) -> Result:
    """Elements round-trip through a spec, are added alike in Python, and take numbers with the units of their keys."""
    data = kind.spec.mechanism().to_spec()
    if Mechanism.from_spec(data).to_spec() != data:
        return failed("its elements change in a round trip through a spec")
    again = Mechanism.from_spec({name: value for name, value in data.items() if name != kind.key})
    model, stated = cast("type[Element]", kind.plugin.model()), dict[str, Any]()
    for name, one in data[kind.key].items():
        again.add(kind.key, name, **one)
        stated[name] = with_units(model, one)
    if again.to_spec()[kind.key] != data[kind.key]:
        return failed(f"elements that are added by `Mechanism.add('{kind.key}', ...)` differ from those of a spec")
    if kind.changed(data | {kind.key: stated}).mechanism().to_spec() != data:
        return failed("its numbers change if they are written with units")
    return passed(elements=len(kind.elements))


@check("element.bodies")
def bodies(kind: ElementUnderTest) -> Result:
    """Elements list the bodies that they refer to; unknown ones are refused, and the error names the element."""
    for name, one in kind.elements.items():
        if not one.places():
            return failed(f"'{name}' lists no bodies in `places`")
        for place, body in one.places():
            data = kind.spec.mechanism().to_spec()
            put(data[kind.key][name], parse_path(place), "nowhere")
            try:
                kind.changed(data)
                return failed(f"'{name}' refers to '{body}' by {place}, but an unknown body is not refused there")
            except SpecError as error:
                if name not in error.key:
                    return failed(f"the error for an unknown body has the key '{error.key}', without '{name}'")
    return passed(elements=len(kind.elements))


@check("element.states")
def states(kind: ElementUnderTest) -> Result:
    """States have the announced names, in the same order, and units that fit those of keys and columns."""
    compiled = {state.name: state.unit for state in kind.workspace.mechanism.states}
    announced = kind.spec.mechanism().state_names()
    if list(compiled)[: len(announced)] != announced:
        return failed(f"its elements announce the states {listed(announced)}, but have {listed(compiled)}")
    columns = {array.name: array.units for group in kind.groups for array in group.columns}
    for name, one in kind.elements.items():
        for state in one.state_names:
            unit, known = compiled[f"{name}.{state}"], [columns[state]] if state in columns else []
            if state in type(one).model_fields:
                known += described_units(description(type(one), state))[:1]
            if wrong := [other for other in known if not read_unit(unit).fits(read_unit(other))]:
                return failed(f"the unit of the state '{name}.{state}' is {unit}, that of its key or column {wrong[0]}")
    return passed(states=len(announced)) if announced else skipped("its elements have no states")


@check("element.columns")
def columns(kind: ElementUnderTest) -> Result:
    """States, lengths, rates, forces and powers of elements in archives are those of the equations."""
    observer, (times, q, v, z) = StateObserver(kind.workspace), kind.rows
    observed = observer.arrays(len(times))
    observer.observe(times, q, v, observed, z=z)
    places = {one.name: one.place for one in kind.workspace.mechanism.acting if one.kind == kind.plugin.name}
    for array in (column for group in kind.groups for column in group.columns if isinstance(column, Recorded)):
        found = kind.run.array(array.path)
        for index, (name, one) in enumerate(kind.elements.items()):
            if array.name in one.state_names:
                known = kind.run.states[f"{name}.{array.name}"].value
            elif array.name in OF_FORCES and name in places:
                known = observed.forces[:, places[name], OF_FORCES[array.name]]
            else:
                continue
            off = float(np.max(np.abs(found[:, index] - known)) / max(np.max(np.abs(known)), TINY))
            if not off <= SAME:
                return failed(f"{array.path} of '{name}' is not the {array.name} in the equations", off=off)
    return passed(groups=len(kind.groups)) if kind.groups else skipped("no quantity belongs to it")


@check("order.states")
def order(kind: ElementUnderTest) -> Result:
    """States at the end of the example converge with the order of the method."""
    if not any(element.state_names for element in kind.elements.values()):
        raise Skip("its elements have no states")
    ends = []
    for stages, factor in ((2, 1.0), (2, 0.5), (4, 0.5)):
        gauss = {"name": "gauss", "stages": stages}
        with completed(kind.changed(integrator=gauss, time=kind.times(factor), output={})) as run:
            ends.append(run.array("states/value")[-1])
    coarse, fine = (float(np.max(np.abs(one - ends[-1]) / np.maximum(np.abs(ends[-1]), TINY))) for one in ends[:-1])
    if fine < SAME:
        return passed(error=fine)
    if not (measured := math.log2(coarse / fine)) >= 3.0:
        return failed(f"its states converge with order {measured:.1f} instead of 4", error=fine)
    return passed(order=measured, error=fine).within({"order": "at least 3"})


@check("element.balance")
def balanced(kind: ElementUnderTest) -> Result:
    """The forces of an element on its bodies are in balance, and their moments; a body at rest stands for the ground.

    Elements whose forces change as all their bodies turn and move together, as those of wind do, act from outside.
    """
    worst, names = list[float](), list(kind.workspace.mechanism.bodies)
    for name, one in kind.elements.items():
        if len({body for _, body in one.places()}) < 2:
            continue
        whole, rest = _equations(kind, name, one), _equations(kind)
        order = [names.index(body) if body in names else -1 for body in whole.bodies]  # the ground comes last

        def force(t: float, x: np.ndarray, u: np.ndarray, both: Any = (rest, whole)) -> np.ndarray:
            no = np.zeros(x.size), np.zeros(both[0].m)
            without, acting = (one.residual(t, x.ravel(), u.ravel(), *no) for one in both)
            return np.asarray(without - acting).reshape(-1, 3)

        times, q, v, _ = kind.rows
        states = (rows.reshape(len(rows), -1, 3)[:, order] for rows in (q, v))
        rows = list(zip(times, *states, strict=True))[:: max(1, len(times) // ROWS)]
        forces = [force(*row) for row in rows]
        size = max(float(np.max(np.abs(forces))), TINY)
        for (t, x, u), acting in zip(rows, forces, strict=True):
            moments = acting[:, 2] + x[:, 0] * acting[:, 1] - x[:, 1] * acting[:, 0]
            worst.append(float(np.max(np.abs([*acting[:, :2].sum(axis=0), np.sum(moments)]))) / size)
            again = force(t, _turned(x, 0.3, -0.2, TURN), _turned(u, 0.5, 0.4, 0.0))
            if worst[-1] > SAME and np.max(np.abs(again - _turned(acting))) <= SAME * size:
                cause = f"the forces of '{name}' on its bodies, or their moments, are not in balance"
                return failed(f"{cause} at t = {t:g} s", off=worst[-1])
    return passed(off=max(worst)) if worst else skipped("its elements act on one body each")


def _turned(x: np.ndarray, *by: float) -> np.ndarray:
    """Return vectors, in the first two columns, turned by `TURN`, and with `by` added to all columns."""
    c, s = math.cos(TURN), math.sin(TURN)
    turned = np.column_stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]])
    return np.asarray(turned + np.array(by or 0.0))


def _equations(kind: ElementUnderTest, name: str = "", one: Element | None = None) -> EquationsOfMotion:
    """Return the equations with a body in place of the ground, and with one element or none of a kind."""
    data = kind.spec.mechanism().to_spec()
    element = data.pop(kind.key).get(name)
    for place, body in () if one is None else one.places():
        put(element, parse_path(place), STILL if body == GROUND else body)
    data["bodies"][STILL] = {"mass": 1.0, "inertia": 1.0, "position": [0.0, 0.0]}
    return EquationsOfMotion.of(Mechanism.from_spec(data if one is None else {**data, kind.key: {name: element}}))


@check("drawing.lines")
def drawing(kind: ElementUnderTest) -> Result:
    """Lines with which elements are drawn have finite points, each on a body of the mechanism."""
    mechanism, lines = kind.spec.mechanism(), 0
    for name, one in kind.elements.items():
        for line in lines_of(kind.plugin, mechanism, one):
            lines += 1
            for body, point in line:
                if body != GROUND and body not in mechanism.bodies:
                    return failed(f"'{name}' is drawn on '{body}', which is not a body of the mechanism")
                if not np.all(np.isfinite(point)):
                    return failed(f"'{name}' is drawn at {point!r} on '{body}'")
    return passed(lines=lines) if lines else skipped("its elements are not drawn as lines")


@check("support.computations")
def support(kind: ElementUnderTest) -> Result:
    """Computations that are not supported are refused by their sentence; other gradients agree with differences."""
    calls: dict[str, Any] = {"gradients": _gradient, "statics": lambda kind: equilibrium(kind.spec)}
    for what, sentence in kind.plugin.supports.items():
        if what not in calls:
            return failed(f"no computation asks whether elements support '{what}', only {listed(calls, 'and')} do")
        try:
            calls[what](kind)
            return failed(f"{what} are computed in spite of the sentence that refuses them")
        except MbdkitError as error:
            if sentence not in str(error):
                return failed(f"{what} are refused, but with another sentence: {error}".rstrip("."))
    found = None if "gradients" in kind.plugin.supports else _gradient(kind).check
    if found is not None and not np.all(found.is_like_steps):
        return failed(str(found))
    return passed(refused=len(kind.plugin.supports), parameters=0 if found is None else len(found.parameters))


def _gradient(kind: ElementUnderTest) -> Gradient:
    """Return the gradient of the last body's position at the end with respect to the first numbers of an element."""
    data = kind.spec.mechanism().to_spec()
    name, one = next(iter(data[kind.key].items()))
    parts = {"": one} | {f"{part}.": inner for part, inner in one.items() if isinstance(inner, dict)}
    flat = {f"{part}{option}": value for part, keys in parts.items() for option, value in keys.items()}
    numbers = [f"model.{kind.key}.{name}.{option}" for option, x in flat.items() if isinstance(x, float) and x]
    measures = [f"final(bodies.{list(data['bodies'])[-1]}.{axis})" for axis in "xy"]
    method: dict[str, Any] = {"integrator": ADAPTIVE} if kind.spec.claims.adaptive else {}
    return gradient(kind.changed(events={}, measures={}, parameters={}, **method), measures, numbers[:4])


CHECKS = (
    spec, bodies, states, columns, balanced, balance, tangents, order, checkpoint, drawing, support, without_plugin
)  # fmt: skip
