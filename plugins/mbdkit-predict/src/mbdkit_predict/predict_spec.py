"""The spec of a prediction: a base, controls, conditions, and what is minimized."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, ConfigDict, Field, PrivateAttr, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import copied, path_text, quoted
from mbdkit.base.strict_model import FormatVersion
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.units import read_unit
from mbdkit.mechanism.checks import check_name, check_tables
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import parameters_in_use
from mbdkit.mechanism.values import Columns, Ends, Interpolation, Number, Positive, Table, curve_of, number_or_table
from mbdkit.registry.catalogue import Registered
from mbdkit.spec.loading import loaded
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import Document
from mbdkit.spec.sections import Count, Section
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_predict.chosen_numbers import ChosenNumbers
from mbdkit_predict.exported_elements import equilibria, unknown_keys

SAME = 1e-4  #: Optima on one mesh whose relative difference is below this count as one.
#: Smallest error of the objective, relative to its size, due to the tolerance of the optimizer.
ROUNDING = 1e-8
NOTHING = 1e-9  #: Changes of the objective below this, relative to its natural size, count as zero.
STAGES = {"radau": (2, 3, 5, 7), "gauss": (1, 2, 3, 4, 5, 6)}  #: Numbers of collocation points of each method.


def _ordered(bounds: object) -> object:
    if isinstance(bounds, tuple) and bounds[0] > bounds[1]:
        raise SpecError(f"the lower bound {bounds[0]:g} is above the upper bound {bounds[1]:g}")
    return bounds


Bounds = Annotated[tuple[Number, Number], AfterValidator(_ordered)]
Wanted = Annotated[Number | tuple[Number, Number], AfterValidator(_ordered)]


class Variable(Section):
    """A number or a function of time that is optimized."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("start",)

    bounds: Bounds | Literal["none"]
    """Smallest and largest value, or `none`."""
    start: Number | None = None
    """Value with which the optimization begins; by default, that of the base."""

    @model_validator(mode="after")
    def _starts_within(self) -> Variable:
        low, high = self.limits
        if self.start is not None and not low <= self.start <= high:
            raise SpecError(f"should be within the bounds, {low:g} to {high:g}, not {self.start:g}", key="start")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest value, infinite without bounds."""
        return (-math.inf, math.inf) if isinstance(self.bounds, str) else self.bounds


class Duration(Variable):
    """A free duration."""

    bounds: Annotated[tuple[Positive, Positive], AfterValidator(_ordered)]
    """Shortest and longest duration [s]."""
    start: Positive | None = None
    """Duration with which the optimization begins [s]; by default, the mean of the bounds."""


class PathCondition(Section):
    """A condition along the path."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("min", "max")

    value: str
    """An expression of quantities."""
    min: Number | None = None
    """Its smallest value."""
    max: Number | None = None
    """Its largest value."""

    @model_validator(mode="after")
    def _limits(self) -> PathCondition:
        if self.min is None and self.max is None:
            raise SpecError("has no effect without `min` or `max`")
        _ordered(self.bounds)
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value, infinite if there is none."""
        return -math.inf if self.min is None else self.min, math.inf if self.max is None else self.max


class Phase(Section):
    """A part of a motion with a duration and conditions of its own."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("subject_to", "final", "intervals")

    duration: Positive | Duration
    """Duration of the phase [s], or its bounds."""
    subject_to: dict[str, PathCondition] = Field(default_factory=dict)
    """Conditions at all collocation points of the phase, by name."""
    final: dict[str, Wanted] = Field(default_factory=dict)
    """Values at the end of the phase, or their bounds, by expression of quantities."""
    intervals: Count | None = None
    """Intervals of the first mesh; by default, those of `collocation`."""


class TimeLimit(Section):
    """Limits of the effort of an optimization."""

    wall_time: Positive
    """Largest elapsed real time of the optimization [s]. The best motion so far is kept."""


class Collocation(Section):
    """The collocation method, and the mesh with which the refinement begins."""

    method: Literal["radau", "gauss"] = "radau"
    """Radau IIA, or Gauss-Legendre."""
    points: Count = 3
    """Collocation points of an interval: 2, 3, 5 or 7 with radau, 1 to 6 with gauss."""
    intervals: Count = 20
    """Intervals of the first mesh, of equal length."""

    @model_validator(mode="after")
    def _has_points(self) -> Collocation:
        if self.points not in STAGES[self.method]:
            known = listed(map(str, STAGES[self.method]), "or")
            raise SpecError(f"{self.method} has {known} points, not {self.points}", key="points")
        return self


class MeasuredFunction(Section):
    """A function of time: a table, or two columns of a file."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("table", "interpolation", "ends", "file", "x", "y", "unit")

    table: Columns | None = None
    """Times [s] and values: `[[t, ...], [value, ...]]`."""
    interpolation: Interpolation = "cubic"
    """A cubic or quintic spline, or straight lines between the points."""
    ends: Ends = "not-a-knot"
    """Condition at the ends of a spline, as in tables of drivers."""
    file: str | None = None
    """File with a table, such as CSV with a line of headings, or .mot, relative to the folder of the spec; as an
    alternative to `table`."""
    x: str = "time"
    """Heading of the column with the times [s]."""
    y: str = ""
    """Heading of the column with the values."""
    unit: str | None = None
    """Unit of the values, such as deg or mm, or 1 for a number; by default, that in the file, or SI units."""

    @model_validator(mode="after")
    def _one(self) -> MeasuredFunction:
        if (self.table is None) == (self.file is None) or (self.file and not self.y):
            raise SpecError("needs either `table: [[t, ...], [value, ...]]` or `file`, `x`, `y` and `unit`")
        return self

    def read(self, folder: Path) -> Table:
        """Return the function in SI units; raise SpecError if the file, or what it contains, is wrong."""
        unit = None if self.unit is None else read_unit(self.unit)
        if self.table is None:
            columns = read_table(folder / str(self.file), "file").function(self.x, self.y, unit)
        else:
            columns = [*self.table[0]], [(1.0 if unit is None else unit.factor) * value for value in self.table[1]]
        options = {"interpolation": self.interpolation, "ends": self.ends}
        function: Table = number_or_table({"table": columns, **options}, Table, "")
        return function


class PredictSpec(ModelSpec):
    """The complete input of a prediction: a motion that nobody measured, by optimal control.

    The controls are first-order states of its mechanism, whose values are optimized.
    """

    model_config = ConfigDict(title="mbdkit spec of a prediction", defer_build=True)
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        "parameters", "estimates", "optimized", "duration", "phases", "switching", "initial", "final", "subject_to",
        "periodic", "measured", "sensitivities", "compare", "guess", "starts", "seed", "limits",
    )  # fmt: skip

    mbdkit_predict: FormatVersion
    """Version of the format of predictions."""
    controls: dict[str, Variable]
    """Functions of time that are optimized, by the key path of the value in the model that they replace, such as
    `forces.motor.value` and `muscles.soleus.excitation`, or by the name of a parameter that the model uses."""
    optimized: dict[str, Variable] = Field(default_factory=dict)
    """Numbers that are optimized, by their key path in the model, such as `forces.spring.stiffness`, or named
    parameters, by name. In specs with a `base`, they are called `parameters`."""
    duration: Positive | Duration | None = None
    """Duration of the motion [s], or its bounds; needed without `phases`."""
    phases: list[Phase] = Field(default_factory=list)
    """Parts of the motion, each with a duration and conditions of its own; states are continuous."""
    switching: Literal["auto"] | None = None
    """With `auto`, phases have parts that end where the motion passes a jump of a force, a rate or an integrand, at
    times that are optimized. By default, such a jump is a doubt."""
    initial: dict[str, Wanted] = Field(default_factory=dict)
    """Values at the start, or their bounds, by expression of quantities; by default, nothing but the joints."""
    final: dict[str, Wanted] = Field(default_factory=dict)
    """Values at the end, or their bounds, by expression of quantities."""
    subject_to: dict[str, PathCondition] = Field(default_factory=dict)
    """Conditions at all collocation points, by name."""
    periodic: list[str | dict[str, str]] = Field(default_factory=list)
    """Expressions of quantities whose values are equal at the start and at the end. With `{FIRST: SECOND}`, the
    value of each at the end is that of the other one at the start, as for left and right after half a step."""
    measured: dict[str, MeasuredFunction] = Field(default_factory=dict)
    """Functions of time by name, such as a measured angle: expressions of conditions and of `minimize` may contain
    `measured.NAME`. The duration must be a number, and the tables must cover it."""
    minimize: str
    """What is minimized: an expression of measures such as `integral(forces.motor.value**2)` and `final(t)`."""
    coordinates: Literal["joint", "absolute"] = "joint"
    """Unknowns of the motion: coordinates of the joints of the spanning tree, and angles of the lines to point masses
    at a distance from other bodies; or x, y and angle of each body. Mechanisms with friction in
    joints always take the latter."""
    collocation: Collocation = Collocation()
    """The collocation method and the first mesh."""
    tolerance: Positive = 1e-6
    """Largest change of the objective by halving all intervals, relative to its size. Intervals are halved until the
    change is smaller."""
    sensitivities: list[str] = Field(default_factory=list)
    """Key paths of numbers in the model, or named parameters: the derivative of the optimum by each is computed from
    the multipliers."""
    compare: dict[str, Any] = Field(default_factory=dict)
    """Values in the model or its named parameters, by key path, such as `model.forces.spring.stiffness: 0`. The motion
    is optimized with them too, and the gain is the difference of both optima. Numbers in `parameters` that are given
    here are not optimized."""
    guess: str | dict[str, Any] | None = None
    """The motion that is the first guess. An archive, relative to the folder of the spec: an earlier prediction, a run,
    or inverse dynamics; its bodies, states and controls are found by name, and its duration is stretched. Or sections,
    such as `controls` and `minimize`, that replace those of the spec: the optimum of that simpler problem on its first
    mesh."""
    starts: Count = 1
    """Number of first guesses; all but the first one are drawn."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the drawn guesses."""
    limits: TimeLimit | None = None
    """When the optimization is stopped."""

    @model_validator(mode="after")
    def _is_complete(self) -> PredictSpec:
        if not self.controls:
            raise SpecError("needs at least one control, which moves the mechanism", key="controls")
        if self.duration is None and not self.phases:
            raise SpecError("is missing: a number [s], `bounds`, or `phases` with a duration each", key="duration")
        if self.duration is not None and self.phases:
            raise SpecError("has no effect, because each of the `phases` has its own", key="duration")
        if self.switching and self.measured:
            raise SpecError("has no effect with `measured` functions, which need fixed times", key="switching")
        for name in self.measured:
            check_name(name, f"measured.{quoted(name)}")
        limits = [*self.subject_to.values(), *(one for phase in self.phases for one in phase.subject_to.values())]
        for key, texts in {
            "minimize": [self.minimize],
            "initial": [*self.initial],
            "final": [*self.final, *(text for phase in self.phases for text in phase.final)],
            "subject_to": [limit.value for limit in limits],
            "periodic": [text for pair in self.repeated_values for text in pair],
        }.items():
            if used := parameters_in_use(self.parameters, texts) & {*self.optimized, *self.sensitivities}:
                why = f"depends on '{min(used)}', which therefore can neither be optimized nor have a sensitivity"
                raise SpecError(why, key=key)
        return self

    @property
    def whole(self) -> dict[str, Phase]:
        """The phases by the beginning of the key paths in them; without `phases`, the whole motion is one."""
        if self.duration is not None:
            return {"": Phase.model_construct(duration=self.duration, subject_to=self.subject_to, final=self.final)}
        return {f"phases[{k}].": phase for k, phase in enumerate(self.phases)}

    @property
    def repeated_values(self) -> list[tuple[str, str]]:
        """Pairs of expressions: the first one at the end of the motion equals the second one at its start."""
        items = [{item: item} if isinstance(item, str) else item for item in self.periodic]
        pairs = [pair for item in items for pair in (*item.items(), *((b, a) for a, b in item.items()))]
        return list(dict.fromkeys(pairs))

    @property
    def span(self) -> None:
        """None, because the duration may be free."""
        return

    @property
    def items(self) -> list[Registered]:
        """The registry entries of the model and the force laws."""
        return [self.model_item, *self.force_law_items]

    def defined_measures(self) -> tuple[DefinedMeasure, ...]:
        """Return no measures."""
        return ()

    @property
    def chosen(self) -> ChosenNumbers:
        """Controls and parameters of the mechanism of the model."""
        self.mechanism()
        return self._chosen

    def with_states(self, text: str, at: float | None = None) -> str:
        """Return an expression in which controls, ``controls["forces.motor.value"]``, and measured functions are states
        of the mechanism; the latter are numbers if the time `at` is given.
        """
        names = {
            "controls": dict(zip(self.chosen.controls, self.chosen.control_states, strict=True)),
            "measured": {name: f"measured.{name}" for name in self.measured},
        }

        def state(match: re.Match[str]) -> str:
            kind, name = match[1], match[3] or match[4]
            if name not in names[kind]:
                what = {"controls": "control", "measured": "measured function"}[kind]
                raise SpecError(f"there is no {what} '{name}'{did_you_mean(name, names[kind])}")
            if kind == "measured" and at is not None:
                return f"({float(curve_of(self.tables[name])(at))!r})"
            return f"states[{json.dumps(names[kind][name])}].value"

        pattern = r"(?<![\w.\"'])(controls|measured)(?:\[([\"'])(.*?)\2\]|\.(\w+))"
        return re.sub(pattern, state, self._with_controls(text))

    def control(self, name: str) -> Variable:
        """Return the bounds and the start of a control; unknowns of equilibria have bounds and starts of their own."""
        if name in self.controls:
            return self.controls[name]
        low, start = -math.inf, 0.0  # of measured functions
        if name in self.chosen.unknowns:
            equilibrium, k = self.chosen.unknowns[name]
            low, start = equilibrium.lowest[k], equilibrium.starts[k]
        return Variable.model_construct(bounds=(low, math.inf), start=start)

    @contextmanager
    def blaming(self, key: str) -> Iterator[None]:
        """Raise errors at a key, with messages in which states that stand for controls are called controls."""
        try:
            yield
        except SpecError as error:
            message = error.message
            for name in self.controls:
                message = message.replace(f"states[{name!r}]", f"controls[{name!r}]")
            message = message.replace("states['measured.", "measured['")
            raise SpecError(message, key=key) from None

    _chosen: ChosenNumbers = PrivateAttr()
    _tables: dict[str, Table] = PrivateAttr(default_factory=dict)

    @property
    def tables(self) -> Mapping[str, Table]:
        """The measured functions by name, which are read together with the model."""
        return self._tables

    def _accept(self, mechanism: Mechanism) -> None:
        durations = [phase.duration for phase in self.whole.values()]
        mechanism.check_span(0.0, sum(x.bounds[1] if isinstance(x, Duration) else x for x in durations))
        if not self.measured or self._tables:
            return
        lengths = [phase.duration for phase in self.whole.values() if isinstance(phase.duration, float)]
        if len(lengths) < len(self.whole):
            raise SpecError("measured functions of time need a duration that is a number", key="measured")
        with self.recording_files():
            for name, given in self.measured.items():
                key = f"measured.{quoted(name)}"
                with SpecError.locate(key):
                    self._tables[name] = given.read(self.folder)
                check_tables([(key, self._tables[name])], 0.0, sum(lengths))

    def _with_controls(self, text: str) -> str:
        """Return an expression with states in place of the named parameters that are controls."""
        return self._in_terms_of(text, {name: f"states[{json.dumps(name)}].value" for name in self.controls})

    def _with_named(self, values: Mapping[str, float]) -> tuple[Mechanism, dict[str, str]]:
        """Return the mechanism of the model with other values of named parameters, and expressions of controls."""
        data = copied(json.loads(self.canonical_json()))
        for key in ("optimized", "sensitivities", "compare", "guess", "measured"):
            data.pop(key, None)
        data["parameters"] = data["parameters"] | values
        other = loaded("predict", PredictSpec, Document(data, folder=self.folder), (), {})
        return self._with_functions(ModelSpec._built(other)), other._used()

    def _used(self) -> dict[str, str]:
        """Return the expressions of the model that contain controls, by key path in the mechanism."""
        texts = {path_text(path[1:]): (text, self._with_controls(text)) for path, text in self.written.items()}
        return {key: after for key, (before, after) in texts.items() if after != before}

    def _with_functions(self, mechanism: Mechanism) -> Mechanism:
        for name in self.measured:
            mechanism.state(f"measured.{name}", rate="0")
        return mechanism

    def _built(self) -> Mechanism:
        mechanism = self._with_functions(super()._built())
        unknowns = [key for (kind, name), own in equilibria(mechanism).items() for key in unknown_keys(kind, name, own)]
        functions = [path_text(("states", f"measured.{name}")) for name in self.measured]
        controls = list(dict.fromkeys([*self.controls, *unknowns, *functions]))
        parameters = [*self.optimized, *(key for key in self.sensitivities if key not in self.optimized)]
        self._chosen = chosen = ChosenNumbers(
            mechanism, controls, parameters, self.numbers, self._with_named, self._used()
        )
        for i, (name, variable) in enumerate(self.optimized.items()):
            for bound in filter(math.isfinite, variable.limits):
                try:
                    chosen.with_parameters([*chosen.parameter_start[:i], bound, *chosen.parameter_start[i + 1 :]])
                except SpecError as error:
                    why = f"the bound {bound:g} of this parameter is not possible: {error.message}"
                    raise SpecError(why, key=chosen.place(name)) from None
        return chosen.mechanism
