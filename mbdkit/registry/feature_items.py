"""Classes of the items with which a plugin extends mbdkit: kinds of specs, examples, pages, and results.

Every item names its code by a `Target`, which is imported when it is first used. The decorators in
`mbdkit.plugin.seams`, which the annotations of the fields name, declare what the functions take and return.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from mbdkit.base.errors import PluginError
from mbdkit.base.frozen import dataclass, field, fields
from mbdkit.registry.item import Item, described, seams_of
from mbdkit.registry.target import Target


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Feature(Item):
    """Base of the items of this file.

    `name`: name of the item. `summary`: one line that describes it. `order`: position among the items of its kind;
    items of lower order come first.
    """

    def check(self) -> None:
        """Check the fields, and that code is named by targets; raises PluginError."""
        super().check()
        for own in fields(self):
            value = getattr(self, own.name)
            if "Target" in str(own.type) and not isinstance(value, Target) and value is not None:
                raise PluginError(f"its `{own.name}` is {described(value)}, not a Target")

    def seam_of(self, field: str) -> str:
        """Return the decorator that the annotation of a field names; empty if there is none."""
        return seams_of(type(self)).get(field, "")

    def check_targets(self) -> None:
        """Check that the targets exist, and that they can be called as declared; raises PluginError."""
        for name, target in self.targets().items():
            _check_function(target, name)
        super().check_targets()


def _check_function(target: Target, name: str) -> None:
    if not callable(target()):
        raise PluginError(f"its `{name}` is {described(target())}, which cannot be called")


def check_identifier(item: Item) -> None:
    """Raise PluginError if the name of an item cannot be a name in Python."""
    if not item.name.isidentifier():
        raise PluginError(f"the name {item.name!r} is not made of letters, digits and _, as names in Python are")


_SIMULATE = Target("mbdkit.runs.simulation:simulate")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SpecKind(Feature):
    """A kind of specs: how it is recognised, checked, computed again and documented.

    Parameters
    ----------
    name
        Name of the kind, for ``mbdkit schema NAME``.
    order
        Kinds of lower order are recognised first.
    marker
        Top-level key that only specs of this kind have; empty for run specs, which are recognised last.
    signs
        Further top-level keys. A document without a model that has one of them counts as a spec of this kind, so that
        errors are about the kind that was intended.
    absent
        Top-level keys that a spec of this kind never has.
    phrase
        The kind with its article, such as ``a study spec``.
    command
        The command that takes a spec of this kind, such as ``mbdkit study``.
    given_instead
        Error in place of another kind; by default it names the command.
    run_instead
        Error for a run spec in place of this kind.
    load
        Function that loads and validates a spec.
    validate
        Function that checks a spec and prints what it defines; by default, `load` is called, and the spec is called
        valid.
    is_packaged
        Function that returns whether a name is that of a packaged spec that is no example; None if there are none.
    schema
        Function that returns the JSON schema for ``mbdkit schema NAME``; by default, it is that of `model`, a class
        derived from `mbdkit.plugin.RunSpec`.
    run_kind
        `Run.kind` of the archives of this kind; empty if there are none.
    model
        Class of the validated spec that such an archive contains.
    compute
        Function that computes the run of a validated spec: it takes the spec, and by name ``path``, the archive to
        write or None, ``overwrite`` and ``progress``. By default, the spec is simulated.
    differentiate
        Function that computes derivatives of measures: it takes a validated spec, the definitions of the measures, the
        parameters, and ``check`` by name, and returns a `mbdkit_gradients.Gradient`; None if runs of this kind have no
        derivatives.
    errors
        Class of what is known of the errors of the quantities of such runs, derived from
        `mbdkit.archive.accuracy_summary.RunErrors`; by default, that class, for simulated runs.
    is_integrated
        Whether such runs are integrated step by step from an initial state, so that a longer run may continue them.
    repeat
        Function that computes the run of an archive again: it takes the `Run`, the path of its archive, the path of the
        new archive or None, and ``overwrite`` and ``progress`` by name. By default, the spec in the archive is loaded
        and computed.
    heading
        Heading of its examples in ``mbdkit examples``.
    """

    kind: ClassVar[str] = "spec-kind"
    key: ClassVar[str] = "spec"

    phrase: str = ""
    marker: str = ""
    signs: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    command: str = ""
    given_instead: str = ""
    run_instead: str = ""
    load: Annotated[Target, "spec_loader"]
    validate: Annotated[Target | None, "spec_check"] = None
    is_packaged: Annotated[Target | None, "packaged_spec"] = None
    schema: Annotated[Target | None, "spec_schema"] = None
    run_kind: str = ""
    model: Target | None = None
    compute: Annotated[Target, "computed_run"] = _SIMULATE
    differentiate: Target | None = None
    errors: Target | None = None
    is_integrated: bool = True
    repeat: Annotated[Target | None, "repeated_run"] = None
    heading: str = ""

    def __post_init__(self) -> None:
        """Set texts that are not given."""
        phrase = self.phrase or f"a spec of {self.name}"
        instead = self.given_instead or f"this is {phrase}: use `{self.command}`"
        run_instead = self.run_instead or f"this is a run spec, without the section `{self.marker}`: use `mbdkit run`"
        for name, text in (("phrase", phrase), ("given_instead", instead), ("run_instead", run_instead)):
            object.__setattr__(self, name, text)

    def recognises(self, data: Mapping[str, object]) -> bool:
        """Return whether plain data are, or are meant to be, a spec of this kind."""
        is_signed = "model" not in data and any(key in data for key in self.signs)
        is_marked = not self.marker or self.marker in data or is_signed
        return is_marked and not any(key in data for key in self.absent)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PackagedFile(Feature):
    """Base of items that are files, which users read by their names.

    Parameters
    ----------
    file
        The file.
    group
        Heading under which lists of such items show it; empty for none.
    """

    phrase: ClassVar[str] = ""
    suffix: ClassVar[str] = ""

    file: Path
    group: str = ""

    @classmethod
    def folder(cls, folder: Path, groups: str | Mapping[str, str] = "", suffix: str | None = None) -> list[Self]:
        """Return the items in a folder, which are named like their files.

        `groups`: their group; or their names, separated by spaces, by their group, in the order of lists. `suffix`:
        that of the files.
        """
        names = groups if isinstance(groups, Mapping) else {}
        group_of = {name: group for group, members in names.items() for name in members.split()}
        places = {name: place for place, name in enumerate(group_of, 1)}
        default = groups if isinstance(groups, str) else ""
        return [
            cls(
                name=path.stem, summary=cls.phrase.format(path.stem), file=path,
                group=group_of.get(path.stem, default), order=places.get(path.stem, 500),
            )
            for path in sorted(folder.glob(f"*{suffix or cls.suffix}"))
        ]  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Example(PackagedFile):
    """A packaged example: a spec, or a notebook, that users run and copy by its name.

    Tables and other files that the spec reads lie in the folder of its file. ``mbdkit examples`` lists specs of runs by
    their group.
    """

    kind: ClassVar[str] = "example"
    key: ClassVar[str] = "example"
    phrase: ClassVar[str] = "packaged example {}"
    suffix: ClassVar[str] = ".yaml"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GuidePage(PackagedFile):
    """A page of ``mbdkit guide``, as Markdown, whose name is its topic.

    Groups of mbdkit's own pages are Start, Model, Analyse, Persons, and Trust and extend.
    """

    kind: ClassVar[str] = "guide-page"
    key: ClassVar[str] = "page"
    phrase: ClassVar[str] = "page {} of the guide"
    suffix: ClassVar[str] = ".md"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FileFormat(Feature):
    """A kind of files or folders with results: how it is recognised, checked, exported and reported.

    Parameters
    ----------
    file
        Name of the file whose presence makes a folder one of this kind; empty for files.
    suffix
        Suffix of files of this kind; empty for folders.
    format
        Root attribute ``format`` of HDF5 files of this kind, of which `report` makes a page; empty for other files.
    problems
        Function that checks a file.
    export
        Function that writes tables in a format of ``mbdkit archive export``.
    report
        Function that makes the page of the report.
    saves_figures
        Whether the charts of the report are also written as images.
    """

    kind: ClassVar[str] = "file-format"
    key: ClassVar[str] = "file"

    file: str = ""
    suffix: str = ""
    format: str = ""
    problems: Annotated[Target | None, "file_problems"] = None
    export: Annotated[Target | None, "exported_files"] = None
    report: Annotated[Target | None, "report_of_folder"] = None
    saves_figures: bool = False

    @classmethod
    def of_folder(cls, folder: Path, formats: Iterable[FileFormat]) -> FileFormat | None:
        """Return the format of a folder; None if it is of no known kind."""
        return next((own for own in formats if own.file and (folder / own.file).is_file()), None)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Accessor(Feature):
    """An attribute of results that a plugin computes, such as `Run.plot`, or a method of mechanisms.

    Parameters
    ----------
    name
        Name of the attribute.
    of
        Class that has the attribute: ``Run`` or ``Mechanism``.
    target
        Function that returns the value of the attribute, which runs keep.
    """

    kind: ClassVar[str] = "accessor"
    key: ClassVar[str] = "attribute"

    of: str
    target: Target

    _check_name = check_identifier

    def seam_of(self, field: str) -> str:
        """Return the decorator of the function, which depends on the class."""
        return f"{self.of.lower()}_attribute" if field == "target" else ""

    def _check_of(self) -> None:
        if self.of not in ("Run", "Mechanism"):
            raise PluginError(f"its class is {self.of!r}, and attributes can be added to 'Run' and 'Mechanism'")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SummaryLine(Feature):
    """Lines of the summary of a run.

    Parameters
    ----------
    name
        Name of the item; the function gives the labels.
    text
        Function that returns the lines.
    of
        Names of the kinds of specs whose runs have the lines; empty for all kinds.
    group
        Group of the archive that runs with the lines have; empty for all runs.
    """

    kind: ClassVar[str] = "summary-line"
    key: ClassVar[str] = "summary"

    text: Annotated[Target, "summary_lines"]
    of: frozenset[str] = frozenset()
    group: str = ""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ReportSection(Feature):
    """A section of the report of a run.

    Parameters
    ----------
    make, charts, film
        Functions that return the sections, their charts, and additions to the data of the player.
    """

    kind: ClassVar[str] = "report-section"
    key: ClassVar[str] = "section"

    make: Annotated[Target, "report_sections"]
    charts: Annotated[Target | None, "report_charts"] = None
    film: Annotated[Target | None, "film_data"] = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PlotKind(Feature):
    """A kind of plot of runs, for ``mbdkit plot --kind NAME``.

    Parameters
    ----------
    module
        Name of the module with the functions of the plot; see `mbdkit_report.plot.plot_kinds.PlotModule`.
    """

    kind: ClassVar[str] = "plot-kind"
    key: ClassVar[str] = "kind"

    module: str

    _check_name = check_identifier

    def check_targets(self) -> None:
        """Check that the module has the functions `charts` and `chart`; raises PluginError."""
        super().check_targets()
        for function in ("charts", "chart"):
            _check_function(Target(f"{self.module}:{function}"), f"{self.module}.{function}")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ViewItem(Feature):
    """What notebooks show of the objects of a class.

    Parameters
    ----------
    of
        Full name of the class, ``module:name``.
    make
        Function that returns the view of an object.
    """

    kind: ClassVar[str] = "view"
    key: ClassVar[str] = "view"

    of: str
    make: Annotated[Target, "object_view"]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CriterionItem(Feature):
    """A criterion of verdicts, or several that one function examines.

    Parameters
    ----------
    stage
        What is examined: the ``spec`` of a run, its ``start`` after assembly, its recorded ``rows``, its ``end``, or
        the ``data`` of inverse dynamics.
    find
        Function that returns `mbdkit.plugin.Finding` objects or sentences, or with ``rows`` a watcher of rows. Its
        decorator is named after the stage: `spec_criterion`, `start_criterion`, `rows_criterion`, `end_criterion` or
        `data_criterion`.
    of
        Names of the kinds of specs whose results are examined; ``mechanism`` stands for results without a run, such as
        equilibria.
    criteria
        Names of the criteria, which `accept` in specs of these kinds may list; by default, that of the item if it has a
        level.
    level
        Level of sentences, which become findings of the criterion `name`.
    elements
        Key in the model of a kind of elements; without such elements, nothing is examined. Empty for all mechanisms.
    types
        Types of these elements; without elements of one of these types, nothing is examined. Empty for all types.
    """

    kind: ClassVar[str] = "criterion"
    key: ClassVar[str] = "accept"

    stage: Literal["spec", "start", "rows", "end", "data"]
    find: Target
    of: frozenset[str] = frozenset({"run"})
    criteria: tuple[str, ...] | None = None
    level: Literal["doubtful", "bad"] | None = "doubtful"
    elements: str = ""
    types: frozenset[str] = frozenset()

    @property
    def accepted(self) -> tuple[str, ...]:
        """Names of the criteria, which `accept` may list."""
        return ((self.name,) if self.level else ()) if self.criteria is None else self.criteria

    def examines(self, elements: Mapping[str, Mapping[str, object]]) -> bool:
        """Return whether there are elements of the kind and the types that the criterion is about."""
        of_kind = elements.get(self.elements, {})
        is_of_type = not self.types or any(getattr(element, "type", "") in self.types for element in of_kind.values())
        return not self.elements or (bool(of_kind) and is_of_type)

    def seam_of(self, field: str) -> str:
        """Return the decorator of the function, which depends on the stage."""
        return f"{self.stage}_criterion" if field == "find" else ""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TableFormat(Feature):
    """A format of ``mbdkit archive export --to NAME``.

    Parameters
    ----------
    suffix
        Suffix of the files, with its dot.
    write
        Function that writes a table to a file.
    write_all
        Function that writes all tables to one file; a format has this function or `write`.
    needs
        Name of the package that the function imports, if it is not part of mbdkit's requirements.
    """

    kind: ClassVar[str] = "table-format"
    key: ClassVar[str] = "to"

    suffix: str
    write: Annotated[Target | None, "table_writer"] = None
    write_all: Annotated[Target | None, "workbook_writer"] = None
    needs: str = ""

    def _check_suffix(self) -> None:
        if not isinstance(self.suffix, str) or not re.fullmatch(r"\.[A-Za-z0-9.]+", self.suffix):
            raise PluginError(f"its suffix {self.suffix!r} is not a dot followed by letters and digits")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Treatment(Feature):
    """A treatment of elements in runs, which the key ``treatment`` of a section of run specs chooses.

    The section belongs to a kind of elements, see `ElementKind.section`.

    Parameters
    ----------
    of
        Key of the elements in the model.
    reacting
        Whether the elements exert no forces of their own: the steps of the run determine their reactions, as they do
        for joints. All fields that follow but `method` are for such treatments.
    require
        Function that raises SpecError if a run does not suit the treatment.
    begin
        Function that returns a workspace which starts with the forces and modes of the elements.
    method
        Function that returns what takes the steps of a run; by default, the method of the run does.
    guards
        Function that returns fixed-step methods for comparison runs.
    guarded_by
        Treatment of these comparison runs.
    factors
        Factors by which the steps of two comparison runs with the method of the run are smaller; by default, those of
        runs without such elements.
    includes_impacts
        Whether steps include impacts without locating them, so that states within a step are on straight lines and
        forces are means over steps.
    undecided
        Clause on why errors of measures are unknown if the errors of the motion are not known to the end of the run;
        by default, they are known.
    supports
        Sentences that refuse what does not support the treatment, ``gradients`` or ``statics``, by its name.
    """

    kind: ClassVar[str] = "treatment"
    key: ClassVar[str] = "treatment"

    of: str
    reacting: bool = False
    require: Annotated[Target | None, "treatment_condition"] = None
    begin: Annotated[Target | None, "treatment_start"] = None
    method: Annotated[Target | None, "treatment_method"] = None
    guards: Annotated[Target | None, "treatment_guards"] = None
    guarded_by: str = ""
    factors: tuple[int, int] | None = None
    includes_impacts: bool = False
    undecided: str = ""
    supports: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class HeadlineItem(Feature):
    """Headlines of a run without measures, which come before those of joints.

    Parameters
    ----------
    take
        Function that returns the headlines.
    group
        Group of the archive that runs with these headlines have.
    excluded
        Function that returns what the error bars of such a run do not include.
    """

    kind: ClassVar[str] = "headline"
    key: ClassVar[str] = "headline"

    take: Annotated[Target, "run_headlines"]
    group: str
    excluded: Annotated[Target | None, "excluded_words"] = None


#: The kinds of items of this file.
FEATURES: tuple[type[Feature], ...] = (
    SpecKind,
    Example,
    GuidePage,
    FileFormat,
    Accessor,
    SummaryLine,
    ReportSection,
    PlotKind,
    ViewItem,
    TableFormat,
    CriterionItem,
    Treatment,
    HeadlineItem,
)
