"""The run spec as one strict, frozen pydantic model; models, integrators and force laws come from the registry."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    create_model,
    model_validator,
)

from mbdkit.engine.stabilization import Stabilization
from mbdkit.errors import PluginError, SpecError
from mbdkit.mechanism.law_element import Law
from mbdkit.registry.catalogue import Kind, Registered, Registry
from mbdkit.registry.item_options import item_of
from mbdkit.registry.items import Claims, IntegratorPlugin, ModelPlugin
from mbdkit.spec.choices import Choice, choice_of
from mbdkit.spec.sections import Event, Limits, Output, Time, named_events
from mbdkit.spec.stabilization_section import UNSTABILIZED, stabilization_of
from mbdkit.spec.stabilization_section import Choice as StabilizationChoice
from mbdkit.spec.strict_spec import StrictSpec
from mbdkit.text import listed, one_line

if TYPE_CHECKING:
    from mbdkit.events.event_expression import RunExpression
    from mbdkit.mechanism.mechanism import Mechanism


_CHOSEN: tuple[Kind, ...] = ("model", "integrator")
"""What a spec chooses by name."""


class RunSpec(StrictSpec):
    """All that a run is told; equal specs give equal runs.

    Models and integrators are those of the installed plugins, told apart by `name`, with their own options beside it.

    Raises
    ------
    SpecError
        If anything is wrong, with the key path.
    """

    model_config = ConfigDict(title="mbdkit run spec", defer_build=True)
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("events",)
    """Keys that the canonical form leaves out while they are empty: specs from before them keep hash and run id."""

    mbdkit: Literal[1]
    """Version of the spec."""
    title: str = ""
    """Free text."""
    model: Annotated[BaseModel, Choice("model")]
    """What moves: the name of a model and its parameters."""
    formulation: Literal["index-1", "index-2", "index-3", "ggl"] = "index-1"
    """Formulation of the equations of motion: the constraints of accelerations, velocities, positions, or both last."""
    stabilization: StabilizationChoice = UNSTABILIZED
    """What is done against the drift of constraints: a name, or a name and its options."""
    integrator: Annotated[BaseModel, Choice("integrator")]
    """How it is integrated: the name of a method and its options."""
    time: Time
    """Start, end and step."""
    output: Output = Field(default_factory=lambda: Output(every=1))
    """What is recorded, and how often."""
    events: Annotated[dict[str, Event], AfterValidator(named_events)] = Field(default_factory=dict)
    """What to watch for, by name: expressions over the run that cross zero, to be noted, or to stop it."""
    limits: Limits = Limits()
    """What stops the run early."""

    _mechanism: Any = PrivateAttr(default=None)
    _watched: Any = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _suits_the_method(self) -> RunSpec:
        item, claims = self.integrator_item, self.claims
        if self.formulation not in claims.formulations:
            raise SpecError(
                f"integrator '{item.name}' cannot serve the formulation '{self.formulation}', "
                f"only {listed(claims.formulations, 'and')}; "
                f"{self._able(lambda other: self.formulation in other.formulations)}",
                key="formulation",
            )
        self._check_stabilization(item, claims)
        if self.time.step is None and not claims.adaptive:
            choice = ", or `adaptive: true`" if "adaptive" in type(self.integrator).model_fields else ""
            raise SpecError(
                f"is missing: the fixed-step method '{item.name}' needs a step in seconds{choice}", key="time.step"
            )
        if self.output.interval is not None and not self.integrator_plugin.dense_output:
            dense = [
                other.name
                for other in choice_of(type(self), "integrator").registry.of_kind("integrator")
                if isinstance(other.plugin, IntegratorPlugin) and other.plugin.dense_output
            ]
            raise SpecError(
                f"integrator '{item.name}' has no dense output, so use `every` (a number of steps) instead; "
                f"methods with dense output: {listed(dense) or 'none installed'}",
                key="output.interval",
            )
        return self

    def _check_stabilization(self, item: Registered, claims: Claims) -> None:
        """Raise SpecError where the stabilization does not go with the formulation or the method."""
        chosen = self.stabilized
        if chosen.kind == "baumgarte" and self.formulation != "index-1":
            raise SpecError(
                f"Baumgarte's terms act on the constraints of accelerations, which the formulation "
                f"'{self.formulation}' does not have; use index-1, or another stabilization",
                key="stabilization",
            )
        if chosen.name not in claims.stabilizations:
            served = listed((f"'{name}'" for name in claims.stabilizations), "and")
            raise SpecError(
                f"integrator '{item.name}' cannot serve the stabilization '{chosen.name}', only {served}; "
                f"{self._able(lambda other: chosen.name in other.stabilizations)}",
                key="stabilization",
            )
        if chosen.symmetric and claims.adaptive:
            raise SpecError(
                f"symmetric projection needs fixed steps, but '{item.name}' chooses its own with these options: "
                "a run back would not take the same ones; leave out `symmetric`",
                key="stabilization.symmetric",
            )

    @property
    def stabilized(self) -> Stabilization:
        """What is done against the drift of constraints, as the engine takes it."""
        return stabilization_of(self.stabilization)

    def _able(self, can: Callable[[Claims], bool]) -> str:
        """Return in words which of the installed integrators can do what is asked for, by their claims."""
        able = []
        for item in choice_of(type(self), "integrator").registry.of_kind("integrator"):
            with suppress(Exception):  # options without defaults, or a plugin that fails in any way
                plugin = item.plugin
                assert isinstance(plugin, IntegratorPlugin)
                if can(plugin.claims(plugin.options())):
                    able.append(item.name)
        return f"integrators that can: {listed(able)}" if able else "no installed integrator can"

    @property
    def model_item(self) -> Registered:
        """The model in the registry, with where it came from."""
        return item_of(self.model)

    @property
    def integrator_item(self) -> Registered:
        """The integrator in the registry, with where it came from."""
        return item_of(self.integrator)

    @property
    def model_plugin(self) -> ModelPlugin:
        """The model as its plugin registered it."""
        plugin = self.model_item.plugin
        assert isinstance(plugin, ModelPlugin)
        return plugin

    @property
    def integrator_plugin(self) -> IntegratorPlugin:
        """The integrator as its plugin registered it."""
        plugin = self.integrator_item.plugin
        assert isinstance(plugin, IntegratorPlugin)
        return plugin

    @property
    def force_law_items(self) -> list[Registered]:
        """The force laws that the mechanism uses, in the registry, each once, by name."""
        laws = {item_of(force) for force in self.mechanism().forces.values() if isinstance(force, Law)}
        return sorted(laws, key=lambda item: item.id)

    @property
    def claims(self) -> Claims:
        """What the integrator claims of itself with these options."""
        try:
            claims = self.integrator_plugin.claims(self.integrator)
        except SpecError:
            raise
        except Exception as error:
            raise PluginError(f"{self.integrator_item.id} failed to state its claims: {one_line(error)}") from error
        if not isinstance(claims, Claims):
            raise PluginError(f"{self.integrator_item.id} stated its claims as {type(claims).__name__}, not as Claims")
        return claims

    def mechanism(self) -> Mechanism:
        """Return the mechanism that the model builds from its parameters; built once.

        Raises
        ------
        SpecError
            If the parameters make no mechanism, or the events name what it does not have.
        PluginError
            If the model of a plugin fails.
        """
        if self._mechanism is None:
            mechanism = self._build()
            self._watched = self._parsed(mechanism)
            self._mechanism = mechanism
        built: Mechanism = self._mechanism
        return built

    def watched(self) -> dict[str, RunExpression]:
        """Return what the events look for in the mechanism, by their names; raises as `mechanism` does."""
        self.mechanism()
        watched: dict[str, RunExpression] = self._watched
        return watched

    def _parsed(self, mechanism: Mechanism) -> dict[str, RunExpression]:
        if not self.events:
            return {}
        from mbdkit.events.event_expression import RunExpression

        parsed = {}
        for name, event in self.events.items():
            try:
                parsed[name] = RunExpression.parse(event.when, mechanism)
            except SpecError as error:
                raise SpecError(error.message, key=f"events.{name}.when") from None
        return parsed

    def _build(self) -> Mechanism:
        from mbdkit.mechanism.mechanism import Mechanism

        try:
            mechanism = self.model_plugin.build(self.model)
            if isinstance(mechanism, Mechanism):
                mechanism.check_span(self.time.start, self.time.final)
        except SpecError as error:
            raise error if error.key.startswith("model") else error.located(prefix="model") from None
        except Exception as error:
            raise PluginError(f"model {self.model_item.id} failed to build: {one_line(error)}") from error
        if not isinstance(mechanism, Mechanism):
            raise PluginError(f"model {self.model_item.id} built {type(mechanism).__name__}, not a Mechanism")
        return mechanism

    def run_id(self) -> str:
        """Return 16 hexadecimal digits that name this spec run with these versions of its plugins."""
        items = [self.model_item, self.integrator_item, *self.force_law_items]
        used = [f"{item.id}=={item.origin.version}" for item in items]
        return hashlib.sha256("\n".join([self.canonical_json(), *used]).encode()).hexdigest()[:16]


def spec_type(installed: Registry) -> type[RunSpec]:
    """Return the RunSpec whose choices are those of the given registry, not of what is installed."""
    fields: dict[str, Any] = {
        kind: (Annotated[BaseModel, Choice(kind, installed)], Field(description=RunSpec.model_fields[kind].description))
        for kind in _CHOSEN
    }
    return create_model("RunSpec", __base__=RunSpec, __doc__=RunSpec.__doc__, **fields)
