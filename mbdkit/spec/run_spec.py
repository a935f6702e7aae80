"""The run spec, a strict, frozen pydantic model; models, integrators and force laws come from the registry."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    PrivateAttr,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from mbdkit.base.errors import MissingPartError, PluginError, SpecError, blaming
from mbdkit.base.files_read import FilesRead
from mbdkit.base.parts import SECTIONS_OF_PARTS
from mbdkit.base.plain_data import canonical, canonical_text, quoted
from mbdkit.base.text import listed
from mbdkit.engine.formulation import FORMULATIONS, Formulation
from mbdkit.engine.input_schedule import InputSchedule
from mbdkit.engine.stabilization import Stabilization
from mbdkit.mechanism.element_kinds import ChosenTreatment, element_kinds, kinds_with_section
from mbdkit.mechanism.mechanism_seams import run_check
from mbdkit.mechanism.parameters import parameters_in_use
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.element_items import ElementKind
from mbdkit.registry.item_options import is_of_item, item_of
from mbdkit.registry.items import Claims, IntegratorPlugin
from mbdkit.spec.choices import Choice, choice_of
from mbdkit.spec.formulation_choice import BY_ACCELERATIONS, NAMES, FormulationChoice, formulation_of, name_of
from mbdkit.spec.input_tables import InputTable, schedules_of
from mbdkit.spec.item_names import CriterionName
from mbdkit.spec.model_spec import ModelSpec, choosing_from
from mbdkit.spec.sections import (
    LARGEST_COUNT,
    UNSTABILIZED,
    Event,
    Gradients,
    Limits,
    Output,
    StabilizationChoice,
    Time,
    named_events,
    stabilization_of,
)
from mbdkit.spec.study_measures import DefinedMeasure, RunMeasures, defined

if TYPE_CHECKING:
    from pydantic.json_schema import JsonSchemaValue

    from mbdkit.events.event_expression import RunExpression
    from mbdkit.mechanism.mechanism import Mechanism


#: Limits of `accuracy`: below the first, rounding errors dominate; above the second, no digit is correct.
SMALLEST_ACCURACY, LARGEST_ACCURACY = 1e-12, 0.1

#: Method tried first for `accuracy` if the spec names none. For stiff mechanisms, another one is chosen later.
FIRST_EXPLICIT: Mapping[str, object] = {"name": "dop853", "adaptive": True}

#: Method tried first for formulations that solve for multipliers, which explicit methods do not support.
FIRST_IMPLICIT: Mapping[str, object] = {"name": "radau-iia", "stages": 5, "adaptive": True}

#: Method tried first with symmetric projection, which needs fixed steps.
FIRST_SYMMETRIC: Mapping[str, object] = {"name": "gauss", "stages": 3}


def _with_accuracy(data: Mapping[str, object]) -> dict[str, Any]:
    """Return the data of a run spec with the keys that `accuracy` implies added.

    Raises SpecError if `choose` is given without `accuracy`.
    """
    data = dict(data)
    if data.get("accuracy") is None:
        if data.get("choose") is not None:
            raise SpecError("takes effect only with `accuracy`; leave it out", key="choose")
        return data
    if data.get("choose") is None:
        data["choose"] = "step" if data.get("integrator") is not None else "method"
    if data["choose"] == "method":
        data["integrator"] = dict(_first_method(data))
    return data


def _first_method(data: Mapping[str, object]) -> Mapping[str, object]:
    stabilization = data.get("stabilization")
    if getattr(stabilization, "symmetric", False) or (
        isinstance(stabilization, Mapping) and stabilization.get("symmetric")
    ):
        return FIRST_SYMMETRIC
    formulation = FORMULATIONS.get(name_of(data.get("formulation", BY_ACCELERATIONS)))
    return FIRST_IMPLICIT if formulation is None or formulation.solves_multipliers else FIRST_EXPLICIT


class RunSpec(ModelSpec):
    """The complete input of a run; equal specs give equal runs.

    `name` selects one of the installed models and integrators; its options are further keys of the same mapping.

    Raises
    ------
    SpecError
        If the spec is not valid, with the key path.
    """

    model_config = ConfigDict(title="mbdkit run spec", defer_build=True)
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        "meta",
        "parameters",
        "estimates",
        "inputs",
        "events",
        "measures",
        "gradients",
        "check",
        "accuracy",
        "choose",
        "impacts",
        "accept",
    )

    FURTHER_AFTER: ClassVar[str] = "impacts"

    formulation: FormulationChoice = BY_ACCELERATIONS
    """Equations of motion with constraints on accelerations (index-1, the default), velocities (index-2), positions
    (index-3), or on positions and velocities (ggl), all in the coordinates of the bodies; or equations in the
    coordinates of the joints of a spanning tree (joint-coordinates). A name, or a name and its options."""
    stabilization: StabilizationChoice = UNSTABILIZED
    """Method against constraint drift: a name, or a name and its options."""
    integrator: Annotated[BaseModel, Choice("integrator")]
    """The integrator: its name and its options, such as `{name: dop853}`."""
    time: Time
    """Start time, end time and step."""
    output: Output = Field(default_factory=lambda: Output(every=1))
    """Recorded quantities and the recording interval."""
    inputs: dict[str, InputTable] = Field(default_factory=dict)
    """Values of the inputs of the mechanism over time, by name of the input."""
    events: Annotated[dict[str, Event], AfterValidator(named_events)] = Field(default_factory=dict)
    """Events by name: zero crossings of expressions in the state of the run, which are recorded or stop the run."""
    measures: RunMeasures = Field(default_factory=dict)
    """Measures by name: numbers that expressions, such as `max(abs(joints.B.force))`, or plugins take from the run."""
    gradients: list[str] | Gradients = Field(default_factory=list)
    """Parameters with respect to which mbdkit differentiates all measures when the run is complete: names of
    `parameters`, or key paths of numbers such as `model.bodies.rod.mass`; or a mapping of `parameters` and `mode`."""
    limits: Limits = Limits()
    """Limits that stop the run early."""
    check: bool = False
    """Estimate the errors of the recorded results by comparison runs. This usually takes 4 to 15 times as long as
    the run (30 to 80 times with beams or controllers, 60 to 140 times with time-stepping methods)."""
    accuracy: Annotated[float, Field(ge=SMALLEST_ACCURACY, le=LARGEST_ACCURACY)] | None = None
    """Accuracy of positions over the whole run, as a share of the mechanism's size. Trial runs (pilot runs) choose the
    method, or only the step or tolerance of the given integrator. An estimate of the errors then confirms the choice:
    from the pilot runs if they suffice and `check` is false, otherwise from comparison runs."""
    choose: Literal["method", "step", "nothing"] | None = None
    """What is chosen for `accuracy`. `method` (the default if `integrator` is omitted): the method and its step. `step`
    (the default if `integrator` is given): only the step or the tolerance of `integrator`; the search starts from a
    given value. `nothing`: the spec is run unchanged, and the verdict says whether the accuracy is reached. The spec in
    an archive contains the method and step that were chosen, with `choose: nothing`."""
    impacts: Literal["refuse", "allow"] = "refuse"
    """Whether the velocity of a driver may be discontinuous: `refuse` reports a discontinuity as an error of the
    motion; `allow` changes velocities at a discontinuity by the smallest impulse that satisfies the constraints, and
    records the work of the impulse."""
    accept: list[Annotated[str, CriterionName("run", ("law-ranges",))]] = Field(default_factory=list)
    """Criteria that are not applied in the verdict, because their findings are known and intended. `left-out`: effects
    that the file of a model describes, but the mechanism lacks; `law-ranges`: arguments that leave the range of a force
    law; `mbdkit guide trust` describes the others."""

    _watched: Any = PrivateAttr(default=None)
    _settings: Any = PrivateAttr(default=None)
    _schedules: Any = PrivateAttr(default=())
    _claims: Any = PrivateAttr(default=None)
    _around_model: tuple[str, str] | None = PrivateAttr(default=None)
    """The canonical JSON before and after the value of `model`; None until it is needed."""

    def __new__(cls, **data: object) -> RunSpec:
        """Create a spec of a derived class if there are sections for kinds of elements that plugins add."""
        return super().__new__(with_sections(cls, data))

    def __init__(self, **data: object):
        super().__init__(**_with_accuracy(data))

    if not TYPE_CHECKING:  # otherwise any attribute would be valid

        def __getattr__(self, name: str) -> Any:
            """Return a section with default values for a kind of elements that a plugin adds, which is not in the spec,
            or another attribute.
            """
            kind = None if name.startswith("_") else kinds_with_section().get(name)
            return super().__getattr__(name) if kind is None else kind.section_model()()

    @classmethod
    def further_keys(cls) -> list[str]:
        """Return the keys of the sections for kinds of elements that plugins add."""
        return list(kinds_with_section())

    @classmethod
    def further_field(cls, key: str | int) -> FieldInfo | None:
        """Return the field of such a section; None for any other key."""
        return with_sections(cls, kinds_with_section()).model_fields.get(str(key))

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the schema with the sections of plugins in their place."""
        schema = super().__get_pydantic_json_schema__(core_schema, handler)
        resolved = handler.resolve_ref_schema(schema)
        properties = resolved["properties"]
        further = {key: properties.pop(key) for key in cls.further_keys() if key in properties}
        first = list(properties)[: list(properties).index(cls.FURTHER_AFTER) + 1]
        resolved["properties"] = {key: properties[key] for key in first} | further | properties
        return schema

    @model_validator(mode="after")
    def _suits_the_method(self) -> RunSpec:
        item, claims, formulation = self.integrator_item, self.claims, self.formulated.name
        if formulation not in claims.formulations:
            own = claims.formulations[0]
            is_missing = "formulation" not in self.model_fields_set and own in NAMES
            remedy = f"add `formulation: {own}` to the spec, or choose another integrator; " if is_missing else ""
            raise SpecError(
                f"integrator '{item.name}' does not support the formulation '{formulation}', "
                f"only {listed(claims.formulations, 'and')}; {remedy}"
                f"{self._able(lambda other: formulation in other.formulations)}",
                key="formulation",
            )
        self._check_stabilization(item, claims)
        if self.is_to_be_chosen and claims.adaptive and "rtol" not in type(self.integrator).model_fields:
            raise SpecError(
                f"integrator '{item.name}' adapts its step but has no option `rtol`, so its accuracy cannot be chosen; "
                "leave `integrator` out, or use another one",
                key="accuracy",
            )
        if self.time.step is None and not claims.adaptive and not self.is_to_be_chosen:
            choice = ", or its option `adaptive: true`" if "adaptive" in type(self.integrator).model_fields else ""
            raise SpecError(
                f"is missing: the fixed-step method '{item.name}' needs a step in seconds{choice}", key="time.step"
            )
        interval = self.output.interval
        if interval is not None and not (self.time.final - self.time.start) / interval < LARGEST_COUNT:
            raise SpecError(f"{interval!r} is too small: the run would have too many rows", key="output.interval")
        if interval is not None and not self.integrator_plugin.dense_output:
            items = choice_of(type(self), "integrator").registry.of_kind("integrator")
            dense = [one.name for one in items if isinstance(one.plugin, IntegratorPlugin) and one.plugin.dense_output]
            raise SpecError(
                f"integrator '{item.name}' has no dense output, so use `every` (a number of steps) instead; "
                f"methods with dense output: {listed(dense) or 'none installed'}",
                key="output.interval",
            )
        return self

    def _check_stabilization(self, item: Registered, claims: Claims) -> None:
        chosen = self.stabilized
        if chosen.kind == "baumgarte" and self.formulated.solves_multipliers:
            raise SpecError(
                f"Baumgarte stabilization modifies the acceleration constraints, which the formulation "
                f"'{self.formulated.name}' does not have; use index-1, or another stabilization",
                key="stabilization",
            )
        if chosen.symmetric and self.formulated.coordinates == "joint":
            raise SpecError(
                "symmetric projection moves bodies off their joints within a step, which joint coordinates cannot "
                "express; omit `symmetric`",
                key="stabilization.symmetric",
            )
        if chosen.name not in claims.stabilizations:
            served = listed((f"'{name}'" for name in claims.stabilizations), "and")
            name, formulation = chosen.name, self.formulated.name
            raise SpecError(
                f"integrator '{item.name}' does not support the stabilization '{name}', only {served}; "
                + self._able(lambda other: name in other.stabilizations and formulation in other.formulations),
                key="stabilization",
            )
        if chosen.symmetric and claims.adaptive:
            raise SpecError(
                f"symmetric projection needs a fixed step, but '{item.name}' adapts its step with these options, so "
                "a run backward in time would use different steps; omit `symmetric`",
                key="stabilization.symmetric",
            )

    @property
    def reacting(self) -> ChosenTreatment | None:
        """The treatment of elements whose reactions the steps of the run determine; None if there are none."""
        return self.mechanism().reacting

    @property
    def checks_measures(self) -> bool:
        """See `ModelSpec.checks_measures`."""
        return self.check

    @property
    def undecided(self) -> str:
        """See `ModelSpec.undecided`."""
        return "" if self.reacting is None else self.reacting.item.undecided

    @property
    def estimates_errors(self) -> bool:
        """Whether the errors of the recorded states are estimated."""
        return self.check or self.accuracy is not None

    @property
    def is_to_be_chosen(self) -> bool:
        """Whether method or step have yet to be chosen for the requested accuracy."""
        return self.accuracy is not None and self.choose != "nothing"

    def with_choice(self, integrator: dict[str, object], step: float | None) -> RunSpec:
        """Return this spec with the method and step that were chosen for its accuracy.

        `integrator`: the integrator: its name and its options. `step`: step [s]; for an adaptive method the first step,
        or None.
        """
        time = {"start": self.time.start, "end": self.time.final, "step": step, "stops": self.time.stops}
        data = self.sections()
        spec = type(self)(**data | {"integrator": integrator, "time": time, "choose": "nothing"})
        spec._document, spec._mechanism, spec._watched = self._document, self._mechanism, self._watched
        spec._settings, spec._files, spec._schedules = self._settings, self._files, self._schedules
        return spec

    def with_model(
        self,
        model: BaseModel,
        parameters: Mapping[str, float | str] | None = None,
        numbers: Mapping[str, float] | None = None,
    ) -> RunSpec:
        """Return this spec with other valid parameters of its model; no other section is validated again.

        `parameters`, `numbers`: other named parameters, and their values, with which the expressions of `model` were
        evaluated. Without them, this spec must have no expressions.
        """
        assert type(model) is type(self.model)
        if parameters is not None:
            canonical_json, update = "", {"model": model, "parameters": dict(parameters)}
        else:
            assert not self.written
            canonical_json, update = self._canonical_with(model), {"model": model}
        spec = self.model_copy(update=update)
        assert spec.__pydantic_private__ is not None
        spec.__pydantic_private__ |= dict.fromkeys(("_document", "_mechanism", "_watched"))
        spec.__pydantic_private__ |= {"_files": FilesRead(), "_run_id": "", "_canonical": canonical_json}
        if parameters is not None:
            spec.__pydantic_private__ |= {"_numbers": numbers, "_around_model": None}
        return spec

    def _canonical_with(self, model: BaseModel) -> str:
        if self._around_model is None:
            sections = canonical(self)
            index = list(sections).index("model")
            before, after = dict(list(sections.items())[:index]), dict(list(sections.items())[index + 1 :])
            head, tail = canonical_text(before)[:-1], canonical_text(after)[1:]
            self._around_model = head + "," * bool(before) + '"model":', "," * bool(after) + tail
        return canonical_text(canonical(model)).join(self._around_model)

    @property
    def formulated(self) -> Formulation:
        """The formulation, in the form that the engine uses."""
        return formulation_of(self.formulation)

    @property
    def stabilized(self) -> Stabilization:
        """The stabilization, in the form that the engine uses."""
        return stabilization_of(self.stabilization)

    def _able(self, can: Callable[[Claims], bool]) -> str:
        """Return a phrase that lists the installed integrators for whose claims `can` is true."""
        able = []
        for item in choice_of(type(self), "integrator").registry.of_kind("integrator"):
            with suppress(Exception, SystemExit):  # the options have no defaults, or the plugin raises any exception
                plugin = cast(IntegratorPlugin, item.plugin)
                if can(plugin.claims(plugin.options())):
                    able.append(item.name)
        return f"integrators that support it: {listed(able)}" if able else "no installed integrator supports it"

    @property
    def integrator_item(self) -> Registered:
        """The registry entry of the integrator, including its origin."""
        return item_of(self.integrator)

    @property
    def step_control_item(self) -> Registered | None:
        """The registry entry of the controller of adaptive steps; None for the default one."""
        chosen = getattr(self.integrator, "step_control", None)
        return item_of(chosen) if isinstance(chosen, BaseModel) and is_of_item(type(chosen)) else None

    @property
    def integrator_plugin(self) -> IntegratorPlugin:
        """The integrator plugin."""
        return cast(IntegratorPlugin, self.integrator_item.plugin)

    @property
    def claims(self) -> Claims:
        """The capabilities that the integrator claims with these options."""
        known: Claims | None = self._private["_claims"]
        if known is not None:
            return known
        with blaming(f"{self.integrator_item.id} failed to return its claims"):
            claims: Any = self.integrator_plugin.claims(self.integrator)
        if not isinstance(claims, Claims):
            raise PluginError(
                f"{self.integrator_item.id} returned its claims as {type(claims).__name__}, not as Claims"
            )
        self._claims = claims
        return claims

    @property
    def finer(self) -> str:
        """What makes the error of the integration smaller: ``smaller steps`` or, with controlled steps, ``smaller
        tolerances``.
        """
        return "smaller tolerances" if self.claims.adaptive else "smaller steps"

    def watched(self) -> dict[str, RunExpression]:
        """Return the parsed expressions of the events by name. Raises the errors of `mechanism`."""
        self.mechanism()
        return cast("dict[str, RunExpression]", self._watched)

    def defined_measures(self) -> tuple[DefinedMeasure, ...]:
        """Return the measures of the run."""
        return tuple(defined(self.measures, ("measures",)))

    @property
    def expressions_outside_model(self) -> list[str]:
        """The expressions of events and measures, which may contain names of parameters."""
        of_events = [text for event in self.events.values() for text in (event.when, *event.set.values())]
        return [*of_events, *(measure.expression for measure in self.defined_measures())]

    def used_parameters(self, texts: Iterable[str] = ()) -> set[str]:
        """Return the names of the parameters that the expressions of the spec, or further ones, use."""
        return parameters_in_use(self.parameters, [*self.written.values(), *self.expressions_outside_model, *texts])

    def settings(self) -> dict[str, dict[str, RunExpression]]:
        """Return the parsed expressions of new state values, by event and state. Raises the errors of `mechanism`."""
        self.mechanism()
        return cast("dict[str, dict[str, RunExpression]]", self._settings)

    def schedules(self) -> tuple[InputSchedule, ...]:
        """Return the schedule of each input of the mechanism. Raises the errors of `mechanism`."""
        self.mechanism()
        return cast("tuple[InputSchedule, ...]", self._schedules)

    @property
    def span(self) -> tuple[float, float]:
        """Start and end of the run [s]."""
        return self.time.start, self.time.final

    @property
    def recorded(self) -> frozenset[str]:
        """Groups of quantities that the run records in addition to the trajectory."""
        return self.output.recorded

    @property
    def event_names(self) -> tuple[str, ...]:
        """Names of the events."""
        return tuple(self.events)

    @property
    def items(self) -> list[Registered]:
        """The registry entries of the model, the integrator, the controller of its steps and the force laws."""
        control = self.step_control_item
        return [self.model_item, self.integrator_item, *([control] if control else []), *self.force_law_items]

    def _accept(self, mechanism: Mechanism) -> None:
        mechanism.is_of_run = True
        elements = mechanism.elements
        kinds = [kind for key, kind in element_kinds().items() if elements.get(key)]
        mechanism.treatments = tuple(
            ChosenTreatment(kind.key_in_model, getattr(self, kind.section)) for kind in kinds if kind.section
        )
        if len(reacting := [chosen.key for chosen in mechanism.treatments if chosen.item.reacting]) > 1:
            raise SpecError(f"a run can determine reactions of one kind of elements only, not of {listed(reacting)}")
        for kind in kinds:
            if kind.acts.check_run is not None:
                run_check.of(kind.acts.check_run)(mechanism)
        self._schedules = schedules_of(self.inputs, mechanism.inputs)
        self._watched = self._parsed(mechanism)
        self._settings = self._parsed_settings(mechanism)

    def _parsed(self, mechanism: Mechanism) -> dict[str, RunExpression]:
        if not self.events:
            return {}
        from mbdkit.events.event_expression import RunExpression

        parsed = {}
        for name, event in self.events.items():
            with SpecError.rekey(f"events.{quoted(name)}.when"):
                parsed[name] = RunExpression.parse(event.when, mechanism, self.numbers)
        return parsed

    def _parsed_settings(self, mechanism: Mechanism) -> dict[str, dict[str, RunExpression]]:
        from mbdkit.events.event_expression import RunExpression, check_state

        parsed: dict[str, dict[str, RunExpression]] = {}
        for name, event in self.events.items():
            for state, text in event.set.items():
                with SpecError.rekey(f"events.{quoted(name)}.set.{quoted(state)}"):
                    check_state(state, mechanism)
                    value = RunExpression.parse(text, mechanism, self.numbers, crosses=False)
                parsed.setdefault(name, {})[state] = value
        return parsed


def with_sections(cls: type[RunSpec], keys: Collection[str]) -> type[RunSpec]:
    """Return a class of run specs with fields for those of the given keys that are sections of plugins' elements.

    Raises SpecError if the part of mbdkit that adds a section is not installed.
    """
    if not (further := set(keys) - cls.model_fields.keys()):
        return cls
    known = kinds_with_section()
    for key in further & SECTIONS_OF_PARTS.keys() - known.keys():
        raise SpecError(str(MissingPartError("a run spec with this key", SECTIONS_OF_PARTS[key])), key=key)
    kinds = tuple(kind for key, kind in known.items() if key in further)
    return _derived(cls, kinds) if kinds else cls


@cache
def _derived(cls: type[RunSpec], kinds: tuple[ElementKind, ...]) -> type[RunSpec]:
    fields: dict[str, Any] = {}
    for kind in kinds:
        assert kind.section_model is not None
        model = cast("type[BaseModel]", kind.section_model())
        fields[kind.section] = (model, Field(default=model(), description=f"How {kind.key_in_model} act."))
    derived = create_model(cls.__name__, __base__=cls, __module__=cls.__module__, __doc__=cls.__doc__, **fields)
    derived.ABSENT_BY_DEFAULT = (*cls.ABSENT_BY_DEFAULT, *fields)
    return derived


def spec_type(installed: Registry) -> type[RunSpec]:
    """Return a class of run specs with all sections, which selects from the given registry instead of the installed
    plugins.
    """
    return choosing_from(installed, with_sections(RunSpec, kinds_with_section()))
