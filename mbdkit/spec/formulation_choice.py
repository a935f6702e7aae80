"""The key `formulation` of a run spec: a name, or a name and its options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, get_args

from pydantic import AfterValidator, BeforeValidator, PlainSerializer

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import canonical
from mbdkit.engine.formulation import FORMULATIONS, INDEX_1, Formulation, FormulationName, LoopsName, formulation_name
from mbdkit.spec.sections import OrName, Section, named

NAMES: tuple[str, ...] = get_args(FormulationName)


class FormulationOptions(Section):
    """A formulation and its options."""

    name: FormulationName
    """The formulation."""
    loops: LoopsName = "index-1"
    """How cut joints, which close loops, are imposed in joint-coordinates: on accelerations (index-1), velocities
    (index-2), positions (index-3), or positions and velocities (ggl)."""


def _plainly(options: FormulationOptions) -> FormulationOptions | str:
    if "loops" in options.model_fields_set and options.name != "joint-coordinates":
        raise SpecError("is an option of joint-coordinates only; omit it", key="loops")
    return options.name if options.loops == "index-1" else options


#: Type of the key `formulation` of a spec; its value is a name, or a model with options.
FormulationChoice = Annotated[
    FormulationOptions,
    BeforeValidator(lambda given: named(given, NAMES, "formulation")),
    AfterValidator(_plainly),
    PlainSerializer(canonical),
    OrName(NAMES),
]


BY_ACCELERATIONS: Any = INDEX_1.name  #: Default value of the key `formulation`.


def name_of(given: object) -> str:
    """Return the name of the formulation that a value of the key, which need not be valid, selects."""
    options = canonical(given)
    if isinstance(options, Mapping):
        return formulation_name(str(options.get("name")), options.get("loops"))
    return str(options)


def formulation_of(choice: object) -> Formulation:
    """Return a validated choice in the form that the engine uses."""
    return FORMULATIONS[name_of(choice)]


def choice_of(name: str) -> str | dict[str, str]:
    """Return the value of the key for a name in `mbdkit.engine.formulation.FORMULATIONS`."""
    loops = {formulation_name("joint-coordinates", loop): loop for loop in get_args(LoopsName)}
    return name if name in NAMES or name not in loops else {"name": "joint-coordinates", "loops": loops[name]}
