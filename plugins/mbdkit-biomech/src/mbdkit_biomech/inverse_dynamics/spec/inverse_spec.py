"""The spec of inverse dynamics: a model, its measured motion, loads and actuators; its loading, changes of its values,
and its JSON schema.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, PrivateAttr

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path as KeyPath
from mbdkit.base.plain_data import path_text, quoted
from mbdkit.base.text import listed
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.checks import check_name
from mbdkit.mechanism.joints import force_of_reaction
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.element_items import ModelKey
from mbdkit.registry.target import Target
from mbdkit.spec.loading import loaded
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import Document, put
from mbdkit.spec.schema import model_schema
from mbdkit.spec.sections import Section
from mbdkit.spec.spec_kinds import spec_loader, spec_schema
from mbdkit.spec.study_measures import DefinedMeasure, RunMeasures, defined
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import (
    Actuator,
    Criterion,
    Emg,
    Frontal,
    Load,
    MeasuredMotion,
    Named,
    Recruitment,
    Span,
)
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import actuators_of, reserves_of
from mbdkit_biomech.persons.person_sections import OF_PERSONS, Subject, Uncertainty

S = TypeVar("S", bound=Section)

#: Named by text, because specs are read by parts of mbdkit that do not compute inverse dynamics.
_PERSON_OF_SPEC: Target[Any] = Target("mbdkit_biomech.persons.person_spec:person_of_spec")


def _named(sections: dict[str, S]) -> dict[str, S]:
    for name in sections:
        if name != GROUND:  # allowed, because "ground" is a natural name for a load
            check_name(name, name)
    return sections


class InverseSpec(ModelSpec):
    """The complete input of inverse dynamics: from a measured motion to the loads of joints and actuators.

    Raises
    ------
    SpecError
        If the spec is not valid, with the key path.
    """

    model_config = ConfigDict(title="mbdkit spec of inverse dynamics", defer_build=True)
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        *("meta", "subject", "parameters", "estimates", "loads", "unmeasured", "actuators", "recruitment"),
        *("frontal", "emg", "uncertainty", "follows", "measures", "unbalanced", "accept"),
    )

    subject: Subject | None = None
    """The person with the markers of `motion.clusters`, to whom the model is scaled."""
    motion: MeasuredMotion
    """The measured motion."""
    loads: Annotated[dict[str, Load], AfterValidator(_named)] = Field(default_factory=dict)
    """Measured loads by name, such as the force of the ground on a foot."""
    unmeasured: list[Named] = Field(default_factory=list)
    """Bodies, such as `foot_left`, on which the ground also acts beside the plates. Residual forces are not judged in
    frames in which no load acts on them."""
    actuators: Annotated[dict[str, Actuator], AfterValidator(_named)] = Field(default_factory=dict)
    """Actuators by name; by default, one for each observed relative angle or travel. Bodies that no joint connects to
    the ground have residual actuators in addition: root.x, root.y and root.angle, or actuators with the names that the
    model gives to these coordinates."""
    recruitment: Recruitment | None = None
    """How the muscles of the model share the moments of the actuators; without it, muscles exert no force."""
    frontal: Frontal | Literal["none"] | None = None
    """The compartments of knees, for recruitment and its results; on by default with `subject` and force plates, if
    landmarks show where the knees are across the plane of motion, and `none` to leave them out."""
    emg: dict[str, Emg | Annotated[str, Field(min_length=1)]] = Field(default_factory=dict)
    """EMG by muscle: a column, or a column with its maximum and deviation. Activations keep near it."""
    uncertainty: Uncertainty | Literal["none"] | None = None
    """How well the person, its loads and its muscles are known, for the error bars; on by default with `subject`, and
    `none` to leave it out."""
    follows: Literal["dynamics"] | None = None
    """`dynamics` if no data observe the bodies of `model.devices`: their motion follows from that of the limbs, and
    their forces act on the limbs as loads (`mbdkit guide wearable`)."""
    unbalanced: Literal["refuse", "report"] = "refuse"
    """What happens if the actuators cannot produce the motion: `refuse` makes this an error; `report` chooses their
    values so that the sum of squares of the unbalanced generalized forces is smallest, and reports these forces."""
    accept: list[Criterion] = Field(default_factory=list)
    """Criteria that are not applied in the verdict on the data, because their findings are known and intended."""
    time: Span = Span()
    """The part of the motion that is used."""
    measures: RunMeasures = Field(default_factory=dict)
    """Measures by name: numbers that expressions, such as `max(abs(joints.B.force))`, take from the result."""

    _person: Any = PrivateAttr(default=None)

    @property
    def person(self) -> Any:
        """The `mbdkit_biomech.persons.person.Person` that the markers determine; None without `subject`. It is computed
        once and cached.

        Raises
        ------
        SpecError
            If markers are missing, or do not determine the person.
        """
        return None if self.subject is None else self._person_and_spec[0]

    @property
    def expanded(self) -> InverseSpec:
        """The spec that is computed: for a person, that of the motion and loads of the scaled model; otherwise this
        one.
        """
        return self if self.subject is None else self._person_and_spec[1]

    @property
    def _person_and_spec(self) -> Any:
        if self._person is None:
            self._person = _PERSON_OF_SPEC()(self)
        return self._person

    def _build(self) -> Mechanism:
        self._check_person()
        return super()._build() if self.subject is None else self.expanded.mechanism()

    def _check_person(self) -> None:
        motion = self.motion
        if self.subject is not None:
            if motion.columns is not None:
                raise SpecError("follow from the markers with `subject`; leave this out", key="motion.columns")
            if motion.is_run:
                raise SpecError("should be a file of markers with `subject`, not a run", key="motion.file")
            return
        if isinstance(self.frontal, Frontal):
            raise SpecError("needs `subject`: only markers show where the knees are", key="frontal")
        for key in OF_PERSONS:
            if getattr(motion, key):
                raise SpecError("needs `subject`, the person with these markers", key=f"motion.{key}")
        for name, load in self.loads.items():
            if load.plates is not None:
                raise SpecError(
                    "needs `subject`; without, give `force` and `point`", key=f"loads.{quoted(name)}.plates"
                )

    def extends(self, key: ModelKey) -> bool:
        """Return whether the values of a key of models are part of the mechanism; not if their bodies follow it."""
        return self.follows is None or key.follow is None

    def _accept(self, mechanism: Mechanism) -> None:
        for key in ("emg", "frontal"):
            if self.recruitment is None and getattr(self, key) not in ({}, None, "none"):
                raise SpecError("needs the section `recruitment`, without which muscles exert no force", key=key)
        if wrong := [name for name in self.unmeasured if name not in mechanism.bodies]:
            known = listed([f"'{name}'" for name in mechanism.bodies])
            raise SpecError(f"should list bodies of the model ({known}), not '{wrong[0]}'", key="unmeasured")
        if contacts := mechanism.elements.get("contacts"):
            raise SpecError(
                "inverse dynamics does not support contacts: omit them, and give the forces of the ground as `loads`",
                key=f"model.contacts.{quoted(next(iter(contacts)))}",
            )
        if force := force_of_reaction(mechanism.joints):
            key, what, remedy = force
            raise SpecError(f"inverse dynamics does not support {what}; {remedy}", key=f"model.joints.{key}")

    @property
    def span(self) -> tuple[float, float] | None:
        """None, because start and end follow from the measured motion."""
        return None

    @property
    def items(self) -> list[Registered]:
        """The registry entries of the model and the force laws."""
        return [self.model_item, *self.force_law_items]

    @property
    def actuator_units(self) -> Mapping[str, str]:
        """Units of the values of the actuators, by name.

        If the observed quantities follow from the data, all possible actuators are listed.
        """
        names = QuantityNames(self.mechanism())
        # checked one by one, because the first of several names of a quantity would hide the others
        if (columns := self.motion.columns) is None:
            groups = [{name: quantity} for name, quantity in names.candidates().items()]
        else:
            groups = [{name: names.find(name, path_text(("motion", "columns", name))) for name in columns}]
        found = [one for group in groups for one in actuators_of(self.actuators, names, group)]
        reserves = [] if self.recruitment is None else reserves_of(self.recruitment, found)
        return {one.name: one.unit for one in [*found, *(reserve.actuator for reserve in reserves)]}

    @property
    def result_names(self) -> Mapping[str, list[str]]:
        """Names of the knees with a patella or with compartments, in the order of the model."""
        if self.recruitment is None:
            return {"knees": []}
        mechanism, person = self.mechanism(), None if self.frontal == "none" else self.person
        own = {one.patella.joint for one in mechanism.muscles.values() if one.patella is not None}
        own |= set() if person is None else person.knees.keys()
        return {"knees": [name for name in mechanism.joints if name in own]}

    def defined_measures(self) -> tuple[DefinedMeasure, ...]:
        """Return the measures of the result."""
        return tuple(defined(self.measures, ("measures",)))


#: A file, the name of a packaged example, a mapping, or a validated spec of inverse dynamics.
InverseSource: TypeAlias = str | Path | Mapping[str, object] | InverseSpec


def load_inverse_spec(
    source: InverseSource | Document, assignments: Iterable[str] = (), **sections: object
) -> InverseSpec:
    """Load and validate a spec of inverse dynamics, build its mechanism, and return the spec.

    Parameters
    ----------
    source, assignments, sections
        See `load_spec`; the source may also be an `InverseSpec`.

    Raises
    ------
    SpecError
        If the spec is not valid, with the file, line and key path if known.
    """
    return loaded("inverse", InverseSpec, source, assignments, sections)


spec_loader(load_inverse_spec)


def varied_inverse(spec: InverseSpec, values: Sequence[tuple[KeyPath, object]]) -> InverseSpec:
    """Return a spec of inverse dynamics with values at key paths; raise SpecError if it is not valid."""
    data = json.loads(spec.canonical_json())
    for path, value in values:
        put(data, path, value)
    varied = InverseSpec(**data)
    varied._document = spec._document
    return varied


@spec_schema
def inverse_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the spec of inverse dynamics.

    Parameters
    ----------
    installed
        Registry of the models and force laws to include; by default, all that are installed.
    """
    return model_schema(InverseSpec, installed)
