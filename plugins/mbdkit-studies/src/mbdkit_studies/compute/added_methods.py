"""Methods that are added to a study of methods, as by `mbdkit study paper --with NAME`."""

from __future__ import annotations

import copy
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from pydantic import ValidationError

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.plain_data import value_text
from mbdkit.base.text import listed
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.registry.item_options import named_options
from mbdkit.registry.items import Claims
from mbdkit.registry.manager import registry
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec.formulation_choice import choice_of, name_of
from mbdkit.spec.reading import parse_key, put
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.yaml_reader import read_data
from mbdkit_studies.points.planned_points import HOW, Grid, PlannedPoints, Setting, grids, sets_method
from mbdkit_studies.results.point_selection import IN_TOLERANCES
from mbdkit_studies.spec.method_claims import METHOD, claims_of
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.spec.value_sets import Value, is_labelled, label_of

#: The name of an integrator, a mapping of its name and options, or a labelled value ``{label, set}`` of an axis; as
#: data, or as text in YAML.
MethodSource: TypeAlias = str | Mapping[str, Any]

#: Tolerances of an adaptive method, where a study varies the steps of the others.
TOLERANCES = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10]

_MOST_CHECKED = 200  #: Largest number of runs of one family that are checked before a method is added to it.

#: Name that the axes of a study without families get if an adaptive method adds a family.
_ONLY_FAMILY = "steps"

#: Keys that are chosen for a method, with their default values.
_HOW = {"formulation": "index-1", "stabilization": "none"}


@dataclass(frozen=True)
class AddedMethod:
    """A method to add.

    Parameters
    ----------
    given
        The method as the user wrote it, for messages.
    label
        Its label; without formulation and stabilization, unless the user has chosen it.
    settings
        Keys of the run spec that the user has chosen: ``integrator``, and others for a labelled value.
    claims, options
        What the method claims with its options, and the names of these options.
    """

    given: str
    label: str
    settings: Mapping[str, Any]
    claims: Claims
    options: frozenset[str]
    is_labelled: bool = False

    @classmethod
    def read(cls, given: MethodSource) -> AddedMethod:
        """Return the method with a name, or of a mapping.

        Raises
        ------
        SpecError
            If there is no such integrator, or its options are not valid.
        """
        where = f"--with {given if isinstance(given, str) else json.dumps(given, default=str)}"
        try:
            data = read_data(given) if isinstance(given, str) else given
            labelled = is_labelled(data)
            settings = data.get("set", {METHOD: data.get("value")}) if labelled else {METHOD: data}
            chosen = settings.get(METHOD) if isinstance(settings, Mapping) else None
            chosen = {"name": chosen} if isinstance(chosen, str) else chosen
            if not isinstance(chosen, Mapping) or not isinstance(chosen.get("name"), str):
                forms = "the name of an integrator, or a mapping of its name and options"
                raise SpecError(f"should be {forms}, not {value_text(chosen if labelled else data)}")
            item = registry().get("integrator", chosen["name"])
            model = named_options(item)
            claims = claims_of(chosen)
        except ValidationError as error:
            raise spec_error(error, model).located(file=where) from None
        except SpecError as error:
            raise error.located(file=where) from None
        label = str(data["label"]) if labelled else label_of({**chosen, "name": item.name})
        settings = {**settings, METHOD: {**chosen, "name": item.spec_name}}
        return cls(where, str(label), settings, claims, frozenset(model.model_fields), labelled)

    @property
    def formulations(self) -> list[Any]:
        """The formulation that the user has chosen, or those of the claims in their order."""
        if "formulation" in self.settings:
            return [self.settings["formulation"]]
        return [choice_of(name) for name in self.claims.formulations]

    @property
    def stabilizations(self) -> list[object]:
        """The stabilization that the user has chosen, or those of the claims, of which `none` comes first."""
        if "stabilization" in self.settings:
            return [self.settings["stabilization"]]
        names = sorted(self.claims.stabilizations, key=lambda name: name != "none")
        symmetric = {"name": "projection", "symmetric": True}
        return [symmetric if name == "symmetric-projection" else name for name in names]


@dataclass(frozen=True)
class _Place:
    """A family whose axis `number`, with the single key `key`, varies the method."""

    grid: Grid
    number: int
    key: str

    @property
    def values(self) -> tuple[Value, ...]:
        """The methods, as values of the axis."""
        return self.grid.axes[self.number][0][1]

    def keys_set(self, number: int) -> set[str]:
        """Return the keys that an axis sets."""
        values = [(key, value) for key, values in self.grid.axes[number] for value in values]
        return {one for key, value in values for one in (value.value if value.together else [key])}

    @property
    def others(self) -> dict[int, set[str]]:
        """The keys that the other axes set, by the number of the axis."""
        return {number: self.keys_set(number) for number in range(len(self.grid.axes)) if number != self.number}

    @property
    def step_axis(self) -> int | None:
        """Number of the axis that varies the step; None if there is none."""
        return next((number for number, keys in self.others.items() if "time.step" in keys), None)

    @property
    def varies_tolerances(self) -> bool:
        """Whether an axis varies the tolerance of the methods."""
        return any(f"{METHOD}.rtol" in keys for keys in self.others.values())

    def data(self, chosen: Mapping[str, object], without: int | None = None) -> Iterator[dict[str, Any]]:
        """Yield the data of run specs with the values of the other axes except the axis `without`."""
        axes = tuple(axis for number, axis in enumerate(self.grid.axes) if number not in (self.number, without))
        others = replace(self.grid, axes=axes)
        for index in itertools.islice(range(0, others.count, others.rows), _MOST_CHECKED):
            data = json.loads(self.grid.base_json)
            _put(data, [Setting(parse_key(key), value, ()) for key, value in chosen.items()])
            _put(data, others.point(index)[1])
            yield data

    def words_of(self, value: Value) -> str:
        """Return `_words` of a method that the family has; empty if it is not installed."""
        with suppress(MbdkitError):
            return _words(RunSpec(**next(self.data(value.value if value.together else {self.key: value.value}))))
        return ""


def _put(data: dict[str, Any], settings: Sequence[Setting]) -> None:
    for setting in settings:
        put(data, setting.path, copy.deepcopy(setting.value))


def _place(grid: Grid) -> _Place | None:
    """Return the axis of a family that varies the method; None if there is none."""
    for number, axis in enumerate(grid.axes):
        for key, values in axis:
            named = {json.dumps(value.value.get(METHOD)) for value in values if value.together}
            if len(axis) == 1 and (key in (METHOD, f"{METHOD}.name") or len(named) > 1):
                return _Place(grid, number, key)
    return None


def with_methods(
    spec: StudySpec, methods: Sequence[MethodSource] | MethodSource, notify: Callable[[str], None]
) -> StudySpec:
    """Return a study with further methods, each as one more value of every axis of methods.

    A method joins with the formulation and stabilization that the study sets, or with the first ones of its claims,
    whichever suit most families. Where every method of the study states its formulation, it joins in each formulation
    of its claims; results that the study has already are then listed as those of an added method. Where the study
    varies the step, an adaptive method joins in a family of its own, with tolerances in place of steps.

    Parameters
    ----------
    spec
        The study spec with its bases resolved.
    methods
        The methods; see `MethodSource`.
    notify
        Called with a warning for families that a method does not suit.

    Raises
    ------
    SpecError
        If there is no such method, if no axis of the study varies the method, if the study has the method already, or
        if the method suits no family; the reason is then that of the first family.
    """
    for given in [methods] if isinstance(methods, str | Mapping) else methods:
        method = AddedMethod.read(given)
        spec = _with_each(spec, method, notify) if _states_formulations(spec) else _with(spec, method, notify)
    return spec


def _states_formulations(spec: StudySpec) -> bool:
    """Return whether every method of the study states its formulation."""
    places = [place for grid in grids(spec) if (place := _place(grid)) is not None]
    return bool(places) and all(
        value.together and "formulation" in value.value for place in places for value in place.values
    )


def _with_each(spec: StudySpec, method: AddedMethod, notify: Callable[[str], None]) -> StudySpec:
    """Return a study with a method in each formulation that it claims and that suits any family."""
    errors = []
    for formulation in method.formulations:
        label = method.label if method.is_labelled else f"{method.label}, {name_of(formulation)}"
        one = replace(method, label=label, settings={**method.settings, "formulation": formulation}, is_labelled=True)
        try:
            spec = _with(spec, one, notify, repeated=True)
        except SpecError as error:
            errors.append(error)
    if len(errors) == len(method.formulations):
        raise errors[0]
    return spec


def _with(spec: StudySpec, method: AddedMethod, notify: Callable[[str], None], *, repeated: bool = False) -> StudySpec:
    """Return a study with a method in one formulation; if it has the method already and this may be `repeated`, with
    the label of the method among the added ones.
    """
    first = next((point for point in PlannedPoints(spec) if not point.lacking), None)
    assert first is None or first.spec  # errors of the study itself are reported as such
    places = [place for grid in grids(spec) if (place := _place(grid)) is not None]
    if not places:
        message = "no axis of this study varies the integrator alone, so that no method can be added"
        raise SpecError(message, file=method.given)
    base = json.loads(places[0].grid.base_json)
    usual = {key: base.get(key, default) for key, default in _HOW.items()}
    options = {"formulation": method.formulations, "stabilization": method.stabilizations}
    ways = itertools.product(*([usual[key]] * (key in base) + options[key] for key in _HOW))  # the study's own first
    attempts = []
    for way in ways:
        attempts.append(_Attempt(method, dict(zip(_HOW, way, strict=True)), usual, places))
        if not attempts[-1].refused:
            break
    best = min(attempts, key=lambda attempt: len(attempt.refused))  # the first of equal ones
    if not best.joined and best.same and repeated:
        return spec.changed(added=list(dict.fromkeys((*spec.added, *best.same))))
    if not best.joined:
        reason = next(iter(best.refused.values()), "has fixed steps, but this study varies the tolerance")
        raise SpecError(f"is already in this study, as '{best.same[0]}'" if best.same else reason, file=method.given)
    reasons: dict[str, list[str]] = {}
    for name, reason in best.refused.items():
        reasons.setdefault(reason.partition("; ")[0], []).append(f"'{name}'")  # without advice
    for reason, names in reasons.items():
        notify(f"warning: {best.label} is left out of {listed(names, 'and')}: {reason}")
    return _joined(spec, best)


@dataclass
class _Attempt:
    """The attempt to add a method to families with one formulation and stabilization.

    Attributes
    ----------
    label
        Label of the method, with formulation and stabilization unless these are the `usual` ones of the study.
    joined
        Families that the method joins, each with the keys that it sets.
    same
        Labels of the method in the families that have it already.
    refused
        Reasons why the method does not suit other families, by name.
    """

    method: AddedMethod
    how: Mapping[str, Any]
    usual: Mapping[str, Any]
    places: Sequence[_Place]
    label: str = ""
    joined: list[tuple[_Place, dict[str, Any]]] = field(default_factory=list)
    same: list[str] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.label = self.method.label
        if not self.method.is_labelled:
            told = [str(label_of(value)) for key, value in self.how.items() if value != self.usual[key]]
            self.label = ", ".join([self.label, *("not stabilized" if one == "none" else one for one in told)])
        adaptive, has_tolerances = self.method.claims.adaptive, any(place.varies_tolerances for place in self.places)
        for place in self.places:
            if place.varies_tolerances if not adaptive else has_tolerances and place.step_axis is not None:
                continue  # it joins the families of its kind
            try:
                self._try(place)
            except MbdkitError as error:
                self.refused[place.grid.name] = getattr(error, "message", str(error))

    def _try(self, place: _Place) -> None:
        """Find out whether the method suits a family; raise SpecError or PluginError if it does not."""
        base, others = json.loads(place.grid.base_json), set().union(*place.others.values())
        how = {key: value for key, value in self.how.items() if key not in others and base.get(key, _HOW[key]) != value}
        chosen = {**self.method.settings, **how}
        without = None
        if self.method.claims.adaptive:
            without = self._step_axis(place, chosen)
            start, end = RunSpec(**next(place.data(chosen))).span
            varied = others if without is None else others - place.keys_set(without)
            # The method chooses its first step, and the time span is kept.
            has_steps = base["time"].get("steps") and not any(key.partition(".")[0] == "time" for key in varied)
            chosen |= {"time": {"start": start, "end": end}} if has_steps else {"time.step": None}
        name, formulation = self.method.settings[METHOD]["name"].rpartition(":")[2], self.how["formulation"]
        same = {
            place.words_of(value): value.label
            for value in place.values
            if name in json.dumps(value.value)  # other methods differ anyway, and their specs take long to build
            and (not value.together or value.value.get("formulation", formulation) == formulation)
        }
        left_out = HOW if sets_method(place.grid.reference or ()) else ()
        shared = {key: value for key, value in chosen.items() if key not in left_out}
        both = zip(place.data(chosen, without), place.data(shared, without), strict=True)
        for number, (data, referred) in enumerate(both):
            spec = RunSpec(**data)
            spec.mechanism()
            if number == 0:
                if without is None and (label := same.get(_words(spec))) is not None:
                    self.same.append(str(label))
                    return
                RunSetup.of(spec).require_support()
            if place.grid.reference is not None:
                _put(referred, place.grid.reference)
                RunSpec(**referred)
        self.joined.append((place, chosen))

    def _step_axis(self, place: _Place, chosen: Mapping[str, object]) -> int | None:
        """Return the number of the axis in whose place tolerances vary; None if the step does not vary.

        Raises
        ------
        SpecError
            If tolerances cannot take its place.
        """
        if (number := place.step_axis) is None:
            return None
        if "rtol" not in self.method.options:
            raise SpecError("it adapts its step and has no option `rtol`, which would vary in place of the step")
        if not all(key.startswith(("time.", "output.")) for key in place.keys_set(number)):
            raise SpecError("the axis of the step varies other keys, too, so that tolerances cannot take its place")
        if len({RunSpec(**data).span for data in place.data(chosen)}) > 1:
            raise SpecError("the time span varies with the step, so that tolerances cannot take the place of steps")
        return number


def _words(spec: RunSpec) -> str:
    """Return what makes a method another one: integrator, formulation and stabilization."""
    data = json.loads(spec.canonical_json())
    return json.dumps([data.get(key) for key in (METHOD, *_HOW)])


def _joined(spec: StudySpec, attempt: _Attempt) -> StudySpec:
    """Return a study with the method of an attempt in the families that it joins."""
    data = spec.model_dump(exclude_unset=True)
    families = data.get("families") or {"": {key: data[key] for key in ("axes", "reference") if key in data}}
    made = {}
    for name, family in families.items():
        place, chosen = next((one for one in attempt.joined if one[0].grid.name == name), (None, {}))
        made[name] = family
        if place is None:
            continue
        axes = list(family["axes"])
        without = place.step_axis if attempt.method.claims.adaptive else None
        new = {"label": attempt.label, "set": chosen}
        if without is None:
            axes[place.number] = {place.key: [*axes[place.number][place.key], new]}
            made[name] = {**family, "axes": axes}
        else:
            axes[place.number] = {place.key: [new]}
            tolerances = {f"{METHOD}.{key}": TOLERANCES for key in ("rtol", "atol") if key in attempt.method.options}
            title = ", ".join(filter(None, (family.get("title", name), "tolerances in place of steps")))
            axes = [axis for number, axis in enumerate(axes) if number != without] + [tolerances]
            made[(name or _ONLY_FAMILY) + IN_TOLERANCES] = {**family, "title": title, "axes": axes}
    added = list(dict.fromkeys((*spec.added, attempt.label)))
    if made.keys() == {""}:
        return spec.changed(added=added, **made[""])
    if "" in made:
        made = {name or _ONLY_FAMILY: family for name, family in made.items()}
    return spec.changed(added=added, axes=None, families=made)
