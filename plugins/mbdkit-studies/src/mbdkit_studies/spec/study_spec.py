"""The study spec, a strict, frozen pydantic model: a base run spec and the parameters that vary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path as FilePath
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, PrivateAttr, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import LONGEST_NAME, Path, copied, parse_path, path_text
from mbdkit.base.strict_model import FormatVersion
from mbdkit.base.text import listed, shortened
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.spec.estimates import Estimated, Estimates
from mbdkit.spec.model_spec import StrictSpec
from mbdkit.spec.reading import Document, parse_key, put
from mbdkit.spec.sections import Section
from mbdkit.spec.study_measures import DefinedMeasure, Measures, built_in_measures, defined
from mbdkit_studies.spec.sample_section import Sample, comparable
from mbdkit_studies.spec.tolerance_section import Tolerance
from mbdkit_studies.spec.value_sets import ValueSet, sets_together, size

#: What a built-in measure may need in addition to the run.
#:
#: Measures that need a second run are computed only if a study lists them.
REFERENCE, SECOND_RUN = "reference", "second run"


def expressions_of(measures: Iterable[DefinedMeasure]) -> tuple[str, ...]:
    """Return the expressions of the measures that a study itself defines; those of its bases are part of the run
    specs.
    """
    return tuple(measure.expression for measure in measures if measure.item is None and not measure.of_base)


def _check_key(key: str, place: Path) -> None:
    if not parse_key(key):
        raise SpecError("should be a dotted key of a run spec, such as time.step", key=path_text(place))


def _check_keys(keys: dict[str, object]) -> dict[str, object]:
    for key in keys:
        _check_key(key, (key,))
    return keys


def _check_axis(axis: dict[str, Any]) -> dict[str, object]:
    _check_keys(axis)
    sizes = {}
    for key, values in axis.items():
        sizes[key] = size(values)
        together = sets_together(values)
        path = parse_key(key)
        for place, keys in together if len(together) < sizes[key] else ():
            if not any(path[: len(inner)] == inner for inner in map(parse_key, keys) if inner):
                message = f"a `set` beside values of '{key}' should also set '{key}'"
                raise SpecError(message, key=path_text((key, place[0])))
        for place, keys in together:
            for inner in keys:
                _check_key(inner, (key, *place, inner))
    if not sizes:
        raise SpecError("needs at least one key of a run spec, such as `time.step: [0.1, 0.01]`")
    if len(set(sizes.values())) > 1:
        text = listed([f"'{key}' has {size}" for key, size in sizes.items()], "and")
        raise SpecError(f"the keys of one axis vary together and must have the same number of values; here {text}")
    return axis


def _check_axes(axes: tuple[dict[str, Any], ...]) -> tuple[dict[str, object], ...]:
    taken: dict[Path, tuple[str, int]] = {}  # key and axis by the path of the key, and by that of each section above it
    names: dict[str, int] = {}
    for number, axis in enumerate(axes):
        for name, values in axis.items():
            if name in names:
                raise SpecError(f"is already in axes[{names[name]}], as '{name}'", key=path_text((number, name)))
            names[name] = number
            keys = _keys_set(name, values)
            for key in keys:
                if (path := parse_key(key)) in taken:
                    other, where = taken[path]
                    how = "is already" if other == key else "would replace a key that is set"
                    raise SpecError(f"{how} in axes[{where}], as '{other}'", key=path_text((number, name)))
            for key in keys:
                path = parse_key(key)
                for length in range(1, len(path) + 1):
                    taken.setdefault(path[:length], (key, number))
    return axes


def _keys_set(name: str, values: object) -> list[str]:
    """Return the dotted keys that an axis sets: its own key, or the keys in the `set` of its values."""
    together = sets_together(values)
    return list(dict.fromkeys(key for _, keys in together for key in keys)) if together else [name]


def check_axes_of_sample(sample: Sample, axes: tuple[dict[str, Any], ...], place: Path) -> None:
    """Raise SpecError if an axis sets a variable of a sample, or a part of such a variable."""
    variables = {comparable(parse_key(key)): key for key in sample.variables}
    for number, axis in enumerate(axes):
        for key in [key for name, values in axis.items() for key in _keys_set(name, values)]:
            path = comparable(parse_key(key))
            if drawn := [variables[path[:end]] for end in range(1, len(path) + 1) if path[:end] in variables]:
                message = f"sets '{key}', but '{drawn[0]}' is a variable of the sample; remove one of them"
                raise SpecError(message, key=path_text((*place, number)))


Overrides = Annotated[dict[str, Any], AfterValidator(_check_keys)]
Axes = Annotated[tuple[Annotated[dict[str, ValueSet], AfterValidator(_check_axis)], ...], AfterValidator(_check_axes)]
Base = str | dict[str, Any]
Reference = Literal["none"] | Overrides
Repeats = Annotated[int, Field(ge=1, le=1000)]
Storing = Literal["files", "all", "histories", "summary", "hashes"]

LARGEST_TABLE = 1_000_000  #: Largest number of runs in a study that is stored in blocks.


class Family(Section):
    """One of several grids of runs; omitted keys default to those at the top level of the study."""

    title: str = ""
    """Title, free text."""
    base: Base | None = None
    """The base run spec: the name of a packaged example, a file, or a mapping."""
    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base, applied after those at the top level of the study."""
    axes: Axes = ()
    """Parameters that vary. Each axis maps dotted keys to value sets; the keys of one axis vary together, and the runs
    are all combinations of the axes."""
    reference: Reference | None = None
    """Dotted keys to set in the spec of a run to obtain its reference run; `none` for no reference."""
    repeats: Repeats | None = None
    """Number of times that each run is timed. If it is above 1, the runs are timed one after another, after all runs
    have been computed."""


class Members(Section):
    """A table of values in an HDF5 file beside study.yaml, with a column for each key that varies."""

    file: Literal["members.h5"] = "members.h5"
    """Name of the file in the folder of the study spec."""
    runs: Annotated[int, Field(ge=1, le=LARGEST_TABLE)]
    """Number of rows."""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """Hash of the columns."""


class StudySpec(StrictSpec):
    """The complete input of a study: a base run spec, the parameters that vary, and the measures to compute.

    Raises
    ------
    SpecError
        If the spec is not valid, with the key path.
    """

    model_config = ConfigDict(title="mbdkit study spec", defer_build=True)
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        "sample", "tolerances", "added", "store", "block", "compress", "members",
    )  # fmt: skip
    """Keys that the canonical form omits if they have their default values.

    Studies written before these keys existed therefore keep their hash.
    """

    mbdkit_study: FormatVersion
    """Version of the spec format."""
    title: str = ""
    """Title, free text."""
    base: Base | None = None
    """The base run spec: the name of a packaged example, a file, or a mapping. It need not have the keys that
    the axes set."""
    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base, such as `time.end: 5.0`."""
    axes: Axes = ()
    """Parameters that vary. Each axis maps dotted keys to value sets; the keys of one axis vary together, and the runs
    are all combinations of the axes."""
    families: dict[str, Family] = Field(default_factory=dict)
    """Several sets of axes by name, instead of `axes`."""
    sample: Sample | None = None
    """Keys whose values are drawn from distributions. A study may have axes or families as well: the sample is then
    repeated for each combination of these."""
    tolerances: dict[str, Tolerance] = Field(default_factory=dict)
    """How far numbers of the base may deviate: names of its `parameters`, or keys such as `model.bodies.rod.mass`, each
    with `plus` and `minus`. The runs are the base, each number at both limits, and all corners of the box of the
    limits; with more than six numbers, the two corners to which the gradient of each measure points. The answer is the
    largest and the smallest value of each measure."""
    reference: Reference = "none"
    """Dotted keys to set in the spec of a run to obtain its reference run; `none` for no reference."""
    repeats: Repeats = 1
    """Number of times that each run is timed. If it is above 1, the runs are timed one after another, after all runs
    have been computed."""
    measures: Measures = "all"
    """Measures to compute for each run, in addition to counters and times. `all` selects the built-in measures that are
    computed from the archive, but not the reversibility defects and the velocity misalignment over every step, which
    need a second run. A mapping defines further measures by expressions, such as `peak: max(abs(joints.B.force))`, or
    by measures of plugins, in addition to all built-in ones. A list selects only its entries: names and such
    mappings."""
    verdict: str = ""
    """Name of the function that evaluates the results in the report; empty for none."""
    added: tuple[str, ...] = ()
    """Labels of methods that `mbdkit study ... --with` has added to the axes of methods. The report lists their results
    in a table; the claims of a verdict are about the other methods."""

    store: Storing | None = None
    """What is stored of each run. `files` writes one archive per run, beside blocks if the runs are those of a sample,
    a table or tolerances. The other values write blocks of many runs: `all`
    keeps all arrays; `histories` keeps time, positions, velocities, reactions and misalignments; `summary` keeps
    counters, times, the misalignment of each joint, and warnings; `hashes` keeps none of these. Every value keeps the
    spec, status, verdict, largest misalignment, measures and hash of each run. The default is `files` for up to 500
    runs, and `all` for more."""
    block: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """Number of runs in a block; by default an eighth of all runs, from 64 to 1000, a 20th of more than 20,000 runs, up
    to 5000, or fewer if the arrays of a block would exceed 64 MiB."""
    compress: bool = False
    """Whether the arrays of blocks are compressed."""
    members: Members | None = None
    """A table of values, one row for each run, instead of `axes`; `mbdkit.ensemble` writes it, and each study with a
    `sample` or `tolerances` writes the table of its values into its folder."""

    _bases: dict[Path, Document] = PrivateAttr(default_factory=dict)
    _folder: FilePath = PrivateAttr(default_factory=FilePath)
    _columns: dict[str, np.ndarray] | None = PrivateAttr(default=None)  #: The table of members, after it has been read.

    @model_validator(mode="after")
    def _consistent(self) -> StudySpec:
        if self.axes and self.families:
            raise SpecError("cannot be combined with `families`; give each family its own axes", key="axes")
        if self.tolerances and (self.axes or self.families or self.sample is not None):
            raise SpecError("cannot be combined with `axes`, `families` and `sample`", key="tolerances")
        if self.members is not None and self.sample is None and (self.axes or self.families):
            raise SpecError("cannot be combined with `axes` and `families`", key="members")
        if not self.axes and not self.families and not self.has_table:
            raise PydanticCustomError(
                "mbdkit",
                "needs `axes` (parameters that vary), `families` (several grids of runs), `sample` (values from "
                "distributions) or `tolerances` (worst cases)",
            )
        self._check_sample()
        for name, family in self.families.items():
            if not name.strip() or "/" in name or len(name) > LONGEST_NAME:
                wanted = f"it should be non-empty, contain no '/', and have at most {LONGEST_NAME} characters"
                raise SpecError(f"'{shortened(name)}' is not a valid name: {wanted}", key="families")
            if self.base is None and family.base is None:
                message = "is missing: give the run spec to vary, here or at the top level of the study"
                raise SpecError(message, key=path_text(("families", name, "base")))
        if not self.families and self.base is None:
            raise SpecError("is missing: the run spec to vary (a packaged example, a file or a mapping)", key="base")
        if isinstance(self.measures, list) and not self.has_references:
            for index, measure in enumerate(self.measures):
                if isinstance(measure, str) and built_in_measures().get(measure) == REFERENCE:
                    raise SpecError(f"'{measure}' needs a `reference` to compare with", key=f"measures[{index}]")
        if self.has_table and self.needs_files:
            key = "tolerances" if self.tolerances else "members" if self.sample is None else "sample"
            raise SpecError(f"cannot be combined with {self.needs_files}", key=key)
        if self.in_blocks and self.needs_files:
            message = f"blocks cannot be combined with {self.needs_files}, which needs `store: files`"
            raise SpecError(message, key="store")
        return self

    def _check_sample(self) -> None:
        """Raise SpecError if the table of members does not have a row for each run of the sample, or if an axis sets a
        variable of the sample or a part of it.
        """
        if self.sample is None:
            return
        if self.members is not None and self.members.runs != self.sample.runs:
            message = f"has {self.members.runs} rows, but the sample makes {self.sample.runs} runs"
            raise SpecError(message, key="members.runs")
        check_axes_of_sample(self.sample, self.axes, ("axes",))
        for name, family in self.families.items():
            check_axes_of_sample(self.sample, family.axes, ("families", name, "axes"))

    @property
    def has_table(self) -> bool:
        """Whether the values that distinguish the runs are in a table: of `members`, a `sample` or `tolerances`."""
        return self.members is not None or self.sample is not None or bool(self.tolerances)

    @property
    def is_sampled(self) -> bool:
        """Whether the values that distinguish the runs are drawn, so that the runs have statistics."""
        return self.has_table and not self.tolerances

    @property
    def in_blocks(self) -> bool:
        """Whether the study requests blocks, instead of or beside a file for each run."""
        return self.store is not None and (self.store != "files" or self.has_table)

    @property
    def has_references(self) -> bool:
        """Whether the runs of the study, or of a family, are compared with reference runs."""
        given = (self.reference, *(family.reference for family in self.families.values()))
        return any(reference not in ("none", None) for reference in given)

    @property
    def needs_files(self) -> str:
        """A phrase that names a key or measure for which each run needs a file; empty if there is none."""
        if self.has_references:
            return "`reference`"
        if any((repeats or 1) > 1 for repeats in (self.repeats, *(one.repeats for one in self.families.values()))):
            return "`repeats`"
        return f"the measure {self.second_run_measures[0]}" if self.second_run_measures else ""

    def stored_as(self, store: Storing | None) -> StudySpec:
        """Return this spec with another `store`."""
        return self if store == self.store else self.changed(store=store)

    def with_members(self, members: Members | None) -> StudySpec:
        """Return this spec with another table of members, which is read from the folder of the study when needed."""
        spec = self.changed(members=members)
        spec._columns = None
        return spec

    def changed(self, **values: object) -> StudySpec:
        """Return this spec with other values of keys; a key whose value is None is left out."""
        sections = self.sections() | values
        given = (self.model_fields_set | values.keys()) - {key for key, value in values.items() if value is None}
        spec = type(self)(**{name: section for name, section in sections.items() if name in given})
        spec._document, spec._bases, spec._folder = self._document, self._bases, self._folder
        spec._columns = self._columns
        return spec

    @property
    def built_in_measures(self) -> tuple[str, ...] | None:
        """Names of the built-in measures to compute; None for all that are computed from the archive."""
        if not isinstance(self.measures, list):
            return None
        return tuple(entry for entry in self.measures if isinstance(entry, str) and entry in built_in_measures())

    @property
    def second_run_measures(self) -> tuple[str, ...]:
        """Names of the measures to compute that need a second run."""
        second = [name for name, needed in built_in_measures().items() if needed == SECOND_RUN]
        return tuple(name for name in second if name in (self.built_in_measures or ()))

    def defined_measures(self) -> tuple[DefinedMeasure, ...]:
        """Return the measures that the study and its bases define by expressions or take from plugins.

        Raises
        ------
        SpecError
            If a measure of a base is not valid, or has the name of a measure with another definition.
        """
        found = {measure.name: measure for measure in defined(self.measures, ("measures",))}
        of_bases = (_measures_of(base, place, keys) for base, place, keys, _ in self._bases_of_families())
        for measure in chain.from_iterable(of_bases):
            other = found.setdefault(measure.name, measure)
            if not other.is_like(measure):
                raise SpecError(
                    f"'{measure.name}' is defined differently in {path_text(other.place)}; a column of the study has "
                    "one definition, so choose another name",
                    key=path_text(measure.place),
                )
        return tuple(found.values())

    def _bases_of_families(self) -> Iterator[tuple[Mapping[str, Any], Path, dict[Path, object], Axes]]:
        """Yield the base of each family, its key path, the overrides by their key path, and the axes."""
        families: dict[str, Family | None] = {**self.families} or {"": None}
        for name, family in families.items():
            base: Base | None = self.base
            place: Path = ("base",)
            keys: dict[Path, object] = {("overrides", key): value for key, value in self.overrides.items()}
            if family is not None:
                if family.base is not None:
                    base, place = family.base, ("families", name, "base")
                keys |= {("families", name, "overrides", key): value for key, value in family.overrides.items()}
            if isinstance(base, Mapping):  # otherwise, a name or a file that has not been read yet
                yield base, place, keys, self.axes if family is None else family.axes

    def estimated(self) -> Estimated | None:
        """Return the estimated parameters that the sample draws; None if it draws none.

        Raises
        ------
        SpecError
            If the bases have no estimates, or different ones.
        """
        if self.sample is None or not self.sample.estimates:
            return None
        found: list[Estimated] = []
        for base, place, overrides, axes in self._bases_of_families():
            set_by_study = [str(path[-1]) for path in overrides] + [*self.sample.variables]
            set_by_study += [key for axis in axes for name, values in axis.items() for key in _keys_set(name, values)]
            others = {parse_key(key)[1:] for key in set_by_study if parse_key(key)[:1] == ("parameters",)}
            free = {name: value for name, value in (base.get("parameters") or {}).items() if not {(), (name,)} & others}
            try:
                found.append(Estimates(**base.get("estimates") or {"values": {}, "covariance": []}).within(free))
            except ValidationError as error:
                raise self.placed(spec_error(error, Estimates, prefix=path_text((*place, "estimates")))) from None
        if not found or not found[0].names:
            message = "draws nothing: the base takes no parameters from an identification, or all are set otherwise"
            raise self.placed(SpecError(message, key="sample.estimates"))
        names, values, factor = found[0]
        if any(
            one.names != names or not np.array_equal(one.values, values) or not np.array_equal(one.factor, factor)
            for one in found
        ):
            message = "draws different parameters for the families; make a study of each"
            raise self.placed(SpecError(message, key="sample.estimates"))
        return found[0]

    def placed(self, error: SpecError) -> SpecError:
        """Return an error about this study with file and line of its key, which may be in the file of a base."""
        path = parse_path(error.key)
        for place, document in self._bases.items():
            if document.file and path[: len(place)] == place:
                return document.place(SpecError(error.message, key=path_text(path[len(place) :])))
        return super().placed(error)


def _measures_of(base: Mapping[str, object], place: Path, overrides: Mapping[Path, object]) -> Iterator[DefinedMeasure]:
    """Yield the measures of a base.

    Parameters
    ----------
    overrides
        Values to set in the base, by key path in the study; the last part of a key path is the dotted key.
    """
    data = {"measures": copied(base.get("measures") or {})}
    above = dict.fromkeys(data["measures"], place) if isinstance(data["measures"], Mapping) else {}
    for where, value in overrides.items():
        path = parse_key(str(where[-1]))
        if path[:1] == ("measures",):
            put(data, path, value)
            names = data["measures"] if len(path) == 1 and isinstance(value, Mapping) else path[1:2]
            above |= dict.fromkeys(map(str, names), where[:-1])
    if not isinstance(data["measures"], Mapping):
        return  # the error is raised for the spec of each run
    for name, definition in data["measures"].items():
        found = defined({name: definition}, (*above[name], "measures"))
        yield from (replace(measure, of_base=True) for measure in found)
