"""Classes of the items (models, integrators, ...) that plugins offer, one for each kind, and claims of integrators."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Never, Protocol

from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.text import listed
from mbdkit.registry.item import NAME, Given, Item, Plugin, described
from mbdkit.registry.seam import Arguments, OwnSeam
from mbdkit.registry.target import Target

if TYPE_CHECKING:
    from pydantic import BaseModel


#: Keys of every element of type ``law``, and arguments of `Mechanism.law`; options of a law must have other names.
LAW_KEYS = ("type", "law", "pathway", "name", "a", "b", "along", "from_", "to", "points")


CONSERVED = ("energy", "linear-momentum", "angular-momentum")  #: What an integrator may claim to conserve.


class Orders(NamedTuple):
    """Orders of convergence on one formulation."""

    positions: float
    velocities: float
    multipliers: float | None = None
    """Order of the multipliers that the method itself computes; None if it computes none."""


@dataclass(frozen=True)
class Claims:
    """The properties that an integrator claims; the conformance checks test them.

    Parameters
    ----------
    order
        Order of convergence of positions and velocities; None for adaptive methods.
    multiplier_order
        Order of convergence of the multipliers that the method itself computes; None if it computes none.
    symmetric
        Whether a step by -h undoes a step by h.
    symplectic
        Whether the method conserves the symplectic form of an unconstrained Hamiltonian system.
    quadratic_invariants
        Whether the method conserves quadratic first integrals of bodies without joints.
    adaptive
        Whether the method chooses its own step sizes; ``time.step`` is then only the first of them.
    stages
        Number of stages; None where the method has no stages.
    drift
        One sentence on how the constraint residuals drift; ``none`` claims that the constraints hold in positions to
        round-off.
    constraints_hold
        The levels among ``position`` and ``velocity`` at which the constraints hold to round-off after every step, on
        the first of `formulations`.
    needs
        What the method evaluates of the equations of motion: ``"accelerations"``, and ``"tangents"`` if it calls
        `tangents`, `iteration_matrix` or `jacobian`, which the conformance checks test.
    formulations
        Formulations of the equations that the method supports.
    stabilizations
        Supported stabilizations: some of ``none``, ``baumgarte``, ``projection`` and ``symmetric-projection``.
        Baumgarte's terms are part of the equations; the step loop applies the projections.
    mechanisms
        The mechanisms that the method supports, as a noun phrase; empty if it supports all. For other mechanisms the
        method raises UnsupportedMechanismError, and conformance checks that use such mechanisms are skipped.
    orders
        Orders by formulation, where they differ from `order` and `multiplier_order`, which are those on the first
        formulation.
    states
        Whether the method integrates first-order states of elements, such as those of controllers.
    variable_order
        Whether the method, which is adaptive, changes its order during a run. A multistep method of a fixed order that
        only starts, and restarts after discontinuities, with a lower order does not claim this.
    dense_order
        Order of convergence of the dense output in the interior of steps; None if it is not claimed.
    conserves
        What every step conserves to round-off, whatever its size: some of ``energy`` (of bodies and joints under
        conservative forces), ``linear-momentum`` and ``angular-momentum`` (of bodies and joints on which only forces
        between them act). The claim is about the first of `formulations` without stabilization: joints that drift, as
        in index-1, exert torques that change the angular momentum, projections change it too, and steps in joint
        coordinates change both.
    a_stable
        Whether steps of any size are stable for linear systems of which all eigenvalues have real parts of at most
        zero (Dahlquist 1963).
    l_stable
        Whether the method is A-stable and damps modes completely in one step as the eigenvalue times the step tends to
        infinity (Ehle 1969).
    restartable
        Whether the memory of the method can be stored, so that an interrupted run is resumed to the same bits.

    Raises
    ------
    PluginError
        If one of the fields from `states` on has a value that is not possible.
    """

    order: float | None = None
    multiplier_order: float | None = None
    symmetric: bool = False
    symplectic: bool = False
    quadratic_invariants: bool = False
    adaptive: bool = False
    stages: int | None = None
    drift: str = ""
    constraints_hold: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    formulations: tuple[str, ...] = ("index-1",)
    stabilizations: tuple[str, ...] = ("none", "baumgarte", "projection", "symmetric-projection")
    mechanisms: str = ""
    orders: Mapping[str, Orders] = field(default_factory=dict)
    states: bool = False
    variable_order: bool = False
    dense_order: float | None = None
    conserves: tuple[str, ...] = ()
    a_stable: bool = False
    l_stable: bool = False
    restartable: bool = True

    def __post_init__(self) -> None:
        for name in ("states", "variable_order", "a_stable", "l_stable", "restartable"):
            if not isinstance(getattr(self, name), bool):
                raise PluginError(f"its claim `{name}` is {getattr(self, name)!r}, not True or False")
        dense: object = self.dense_order
        if dense is not None and (
            isinstance(dense, bool) or not isinstance(dense, int | float) or not 0 < dense < math.inf
        ):
            raise PluginError(f"its claim `dense_order` is {dense!r}, not a positive number or None")
        if not isinstance(self.conserves, tuple) or any(quantity not in CONSERVED for quantity in self.conserves):
            raise PluginError(
                f"its claim `conserves` is {self.conserves!r}, not a tuple of some of {listed(CONSERVED)}"
            )
        if self.variable_order and not self.adaptive:
            raise PluginError("it claims `variable_order`, but not `adaptive`, which changes of the order require")
        if self.l_stable and not self.a_stable:
            raise PluginError("it claims `l_stable`, but not `a_stable`, which every L-stable method is")

    def orders_on(self, formulation: str) -> Orders | None:
        """Return the orders claimed on a formulation; None for adaptive methods."""
        if formulation in self.orders:
            return Orders(*self.orders[formulation])
        return None if self.order is None else Orders(self.order, self.order, self.multiplier_order)


@OwnSeam
def integrator_claims(options: Never, /) -> Claims:
    """Return what the method with these options claims; the conformance checks test it."""
    raise NotImplementedError


@dataclass(frozen=True, eq=False, repr=False)
class ModelPlugin(Plugin):
    """A model: builds a mechanism from parameters.

    Parameters
    ----------
    name
        Short name, such as ``double-pendulum``, for ``model.name`` in a spec.
    summary
        One line that describes the model.
    options
        Pydantic model of the parameters, without ``name``.
    build
        Function that takes an instance of `options` and returns a `Mechanism`; decorated with `model_builder` if it is
        named by a target.
    references
        BibTeX entries of the sources.
    """

    kind: ClassVar[str] = "model"
    hook: ClassVar[str] = "mbdkit_models"
    key: ClassVar[str] = "model.name"
    arguments: ClassVar[Mapping[str, Arguments]] = {"build": Arguments("model_builder", ("options",))}

    options: Given[type[BaseModel]] = Given()
    build: Given[Callable[..., object]] = Given()
    references: Given[tuple[str, ...]] = Given(())


@dataclass(frozen=True, eq=False, repr=False)
class IntegratorPlugin(Plugin):
    """An integrator: a method that advances the state in time.

    Parameters
    ----------
    name
        Short name, such as ``gauss``, for ``integrator.name`` in a spec.
    summary
        One line that describes the method.
    options
        Pydantic model of the options, without ``name``.
    create
        Function that takes an instance of `options` and returns the method; decorated with `integrator_method` if it is
        named by a target.
    claims
        Function that takes an instance of `options` and returns the `Claims` of that method; decorated with
        `integrator_claims` if it is named by a target.
    references
        BibTeX entries of the sources.
    dense_output
        Whether the method can be evaluated between its steps, so that ``output.interval`` may be used.
    """

    kind: ClassVar[str] = "integrator"
    added: ClassVar[Mapping[str, Target]] = {"step_control": Target("mbdkit.spec.choices:STEP_CONTROL")}
    hook: ClassVar[str] = "mbdkit_integrators"
    key: ClassVar[str] = "integrator.name"
    arguments: ClassVar[Mapping[str, Arguments]] = {
        "create": Arguments("integrator_method", ("options",)),
        "claims": integrator_claims.arguments,
    }

    options: Given[type[BaseModel]] = Given()
    create: Given[Callable[..., object]] = Given()
    claims: Given[Callable[..., Claims]] = Given()
    references: Given[tuple[str, ...]] = Given(())
    dense_output: bool = False

    def check_targets(self) -> None:
        """Also check the claims with default options, if the options have defaults."""
        super().check_targets()
        try:
            self.claims(self.options())
        except PluginError:
            raise
        except (Exception, SystemExit):  # an option has no default; other errors are reported where claims are used
            pass

    def claimed(self) -> Mapping[str, object]:
        """Return the claims with default options, by name; empty if an option has no default, or if `claims` fails."""
        try:
            claims: object = self.claims(self.options())
        except (Exception, SystemExit):  # an option has no default, or the plugin fails in any way
            return {}
        if not isinstance(claims, Claims):
            return {}
        values = {name: getattr(claims, name) for name in Claims.__dataclass_fields__}
        return values | {"orders": {name: Orders(*orders)._asdict() for name, orders in claims.orders.items()}}


@dataclass(frozen=True, eq=False, repr=False)
class StepControl(Plugin):
    """A controller of adaptive steps, which a spec chooses by ``integrator.step_control``.

    Parameters
    ----------
    name
        Short name, such as ``h211b``, for ``name`` in ``integrator.step_control``.
    summary
        One line that describes the controller.
    options
        Pydantic model of the options, without ``name``.
    create
        Function that takes an instance of `options` and returns the coefficients, a `StepFilter`; decorated with
        `step_filter` if it is named by a target.
    references
        BibTeX entries of the sources.
    """

    kind: ClassVar[str] = "step-control"
    key: ClassVar[str] = "integrator.step_control.name"
    arguments: ClassVar[Mapping[str, Arguments]] = {"create": Arguments("step_filter", ("options",))}

    options: Given[type[BaseModel]] = Given()
    create: Given[Callable[..., object]] = Given()
    references: Given[tuple[str, ...]] = Given(())


class _Law(Protocol):
    """What is asked of laws here, which cannot import their classes."""

    passive: bool
    potential: object


@dataclass(frozen=True, eq=False, repr=False)
class ForceLawPlugin(Plugin):
    """A force law: the tension of a force element as a function of its length, rate and time.

    Parameters
    ----------
    name
        Short name, such as ``one-sided``, for ``law`` in an element of type ``law``.
    summary
        One line that describes the law.
    options
        Pydantic model of the options. In the element of a spec they are keys beside ``type``, ``law`` and ``pathway``.
    law
        The law: an ``ExpressionLaw`` written in SymPy, or a ``FunctionLaw`` that Numba compiles.
    references
        BibTeX entries of the sources.
    """

    kind: ClassVar[str] = "force-law"
    hook: ClassVar[str] = "mbdkit_force_laws"
    key: ClassVar[str] = "law"
    name_key: ClassVar[str] = "law"

    options: Given[type[BaseModel]] = Given()
    law: Given[_Law] = Given()
    references: Given[tuple[str, ...]] = Given(())

    def _check_law(self) -> None:
        # Laws are recognised by their attributes instead of their class, because `mbdkit.registry` may not import
        # `mbdkit.mechanism`.
        law: object = self.law
        is_law = hasattr(law, "passive") and (hasattr(law, "force") or hasattr(law, "function"))
        if not is_law or isinstance(law, type):
            raise PluginError(f"its law is {described(law)}, not an ExpressionLaw or a FunctionLaw")

    def _check_options(self) -> None:
        super()._check_options()
        for name, info in self.options.model_fields.items():
            if name in LAW_KEYS or info.alias in LAW_KEYS:
                raise PluginError(f"its option '{name}' has the name of a key that every element of type law has")

    def claimed(self) -> Mapping[str, object]:
        """Return whether the law has a potential and whether it is passive."""
        return {"potential": self.law.potential not in (None, False), "passive": self.law.passive}


@dataclass(frozen=True, eq=False, repr=False)
class StudyPlugin(Plugin):
    """A packaged study: a study spec that runs by name, and the function that judges its results.

    Parameters
    ----------
    name
        Short name, such as ``paper``, for ``mbdkit study NAME`` and for ``verdict`` in a study spec.
    summary
        One line that describes the study.
    spec
        File of the study spec (YAML, TOML or JSON), with paths relative to its folder; or a function that returns the
        spec as a mapping. The function takes whether the short form of the study is wanted, as by ``--quick``.
    verdict
        Function that takes the `mbdkit.Study`, complete or not, and returns the verdict of the report, a
        `mbdkit_report.Verdict`; None for the general verdict of a study. Decorated with
        `mbdkit_studies.results.judge.study_verdict` if it is named by a target.
    references
        BibTeX entries of the sources.
    """

    kind: ClassVar[str] = "study"
    hook: ClassVar[str] = "mbdkit_studies"
    key: ClassVar[str] = "study"
    arguments: ClassVar[Mapping[str, Arguments]] = {
        "spec": Arguments("study_spec", ("quick",)),
        "verdict": Arguments("study_verdict", ("study",)),
    }

    spec: Given[Path | Callable[[bool], Mapping[str, object]]] = Given()
    verdict: Given[Callable[..., object] | None] = Given(None)
    references: Given[tuple[str, ...]] = Given(())

    @property
    def options(self) -> type[BaseModel]:
        """The model of the options, which is empty, because a study has no options."""
        from pydantic import BaseModel

        return BaseModel

    def seam_of(self, field: str) -> str:
        """Return the decorator of a field; functions that return specs have none."""
        return "" if field == "spec" else super().seam_of(field)

    @property
    def has_verdict(self) -> bool:
        """Whether the study has a verdict of its own, which is not imported to answer this."""
        return vars(self)["verdict"] is not None

    def _check_spec(self) -> None:
        if callable(self.spec):
            return
        if not isinstance(self.spec, Path):
            raise PluginError(f"its spec is {described(self.spec)}, not a pathlib.Path or a function")
        if not self.spec.is_file():
            raise PluginError(f"its spec is not a file: {self.spec}")

    def _check_verdict(self) -> None:
        if not (self.verdict is None or callable(self.verdict)):
            raise PluginError("its `verdict` cannot be called")


@dataclass(frozen=True, eq=False, repr=False)
class MeasurePlugin(Plugin):
    """A measure of studies: a function that computes one number from a run.

    Parameters
    ----------
    name
        Short name, such as ``jump-height``, for ``measures`` in a study spec.
    summary
        One line that describes the measure.
    options
        Pydantic model of the options, without ``name``; `pydantic.BaseModel` itself if it has none.
    units
        Unit of the number, such as ``N m``; ``1`` for a pure number.
    take
        Function that takes the `mbdkit.Run`, complete or not, and an instance of `options`, and returns the number: nan
        if it cannot be computed for this run. Decorated with `measure_function` if it is named by a target.
    references
        BibTeX entries of the sources.
    """

    kind: ClassVar[str] = "measure"
    hook: ClassVar[str] = "mbdkit_measures"
    key: ClassVar[str] = "name"
    arguments: ClassVar[Mapping[str, Arguments]] = {"take": Arguments("measure_function", ("run", "options"))}

    options: Given[type[BaseModel]] = Given()
    units: str  # type: ignore[misc]  # `options` has no default, although mypy assumes one
    take: Given[Callable[..., float]] = Given()
    references: Given[tuple[str, ...]] = Given(())

    def _check_units(self) -> None:
        from mbdkit.base.units import read_unit

        if not isinstance(self.units, str):
            raise PluginError(f"its units are {described(self.units)}, not a text such as 'N m'")
        try:
            read_unit(self.units)
        except SpecError as error:
            raise PluginError(f"its units: {error.message}") from None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Command(Item):
    """A command of the command line: ``mbdkit NAME`` or ``mbdkit GROUP NAME``.

    Parameters
    ----------
    name
        The word that calls the command.
    summary
        First paragraph of its help, on one line.
    target
        Function with the annotations of typer, whose docstring is the help of the command, or a `typer.Typer` with one
        command; None for a group, whose commands are the items with this name as `group`.
    group
        Name of the group of the command; empty for a command or a group of ``mbdkit`` itself.
    order
        Position in the list of ``--help``.
    """

    kind: ClassVar[str] = "command"
    key: ClassVar[str] = "command"

    target: Target | None = None
    group: str = ""

    @property
    def full_name(self) -> str:
        """The words that call the command."""
        return f"{self.group} {self.name}".strip()

    def _check_group(self) -> None:
        if self.group != "" and (not isinstance(self.group, str) or not NAME.fullmatch(self.group)):
            raise PluginError(f"its group {self.group!r} is not made of letters, digits and . _ -")
        if (target := vars(self)["target"]) is not None and not isinstance(target, Target):
            raise PluginError(f"its target is {described(target)}, not a Target")

    def check_targets(self) -> None:
        """Check that the target can be called, and that the summary begins its docstring; raises PluginError."""
        super().check_targets()
        if self.target is None:
            return
        function = self.target()
        if not callable(function):
            raise PluginError(f"its target is {described(function)}, which cannot be called")
        commands = getattr(function, "registered_commands", None)
        if commands and getattr(function, "registered_callback", None):  # a group, whose help typer takes elsewhere
            return
        text = (commands[0].callback if commands else function).__doc__ or ""
        paragraph = " ".join(text.strip().partition("\n\n")[0].split())
        if paragraph != self.summary:
            raise PluginError(f"its summary is {self.summary!r}, and its docstring begins with {paragraph!r}")


#: The kinds of items, in the order in which they are listed.
ITEM_CLASSES: tuple[type[Item], ...] = (
    ModelPlugin,
    IntegratorPlugin,
    StepControl,
    ForceLawPlugin,
    StudyPlugin,
    MeasurePlugin,
    Command,
)
