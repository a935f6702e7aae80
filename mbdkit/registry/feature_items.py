"""Classes of the items with which a plugin extends mbdkit: kinds of specs, examples, pages, and results.

Every item names its code by a `Target`, which is imported when it is first used.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Literal

from mbdkit.base.errors import PluginError
from mbdkit.registry.item import Item, described
from mbdkit.registry.target import Target


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Feature(Item):
    """Base of the items of this file.

    Parameters
    ----------
    name
        Name of the item.
    summary
        One line that describes it.
    order
        Position among the items of its kind; items of lower order come first.
    """

    name: str
    summary: str
    order: int = 500

    def check(self) -> None:
        """Check the fields, and that code is named by targets; raises PluginError."""
        super().check()
        for one in fields(self):
            value = getattr(self, one.name)
            if "Target" in str(one.type) and not isinstance(value, Target) and value is not None:
                raise PluginError(f"its `{one.name}` is {described(value)}, not a Target")

    def check_targets(self) -> None:
        """Check that the targets exist, and that they can be called; raises PluginError."""
        super().check_targets()
        for name, value in vars(self).items():
            if isinstance(value, Target):
                _check_function(value, name)


def _check_function(target: Target[Any], name: str) -> None:
    if not callable(target()):
        raise PluginError(f"its `{name}` is {described(target())}, which cannot be called")


def _check_identifier(item: Item) -> None:
    if not item.name.isidentifier():
        raise PluginError(f"the name {item.name!r} is not made of letters, digits and _, as names in Python are")


_SIMULATE: Target[Callable[..., Any]] = Target("mbdkit.runs.simulation:simulate")


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
        Function that takes a source (a file, the name of an example, a document, a mapping) and assignments, and
        returns the validated spec.
    validate
        Function that takes a source, its name and assignments, checks the spec, and prints what it defines; by default,
        `load` is called, and the spec is called valid.
    is_packaged
        Function that returns whether a name is that of a packaged spec that is no example; None if there are none.
    schema
        Function that takes a registry and returns the JSON schema for ``mbdkit schema NAME``; by default, it is that of
        `model`, a class derived from `mbdkit.plugin.RunSpec`.
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
        `mbdkit.plugin.archives.RunErrors`; by default, that class, for simulated runs.
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
    load: Target[Callable[..., Any]]
    validate: Target[Callable[[Any, str, list[str]], None]] | None = None
    is_packaged: Target[Callable[[str], bool]] | None = None
    schema: Target[Callable[[Any], dict[str, Any]]] | None = None
    run_kind: str = ""
    model: Target[Any] | None = None
    compute: Target[Callable[..., Any]] = _SIMULATE
    differentiate: Target[Callable[..., Any]] | None = None
    errors: Target[Any] | None = None
    is_integrated: bool = True
    repeat: Target[Callable[..., Any]] | None = None
    heading: str = ""

    def __post_init__(self) -> None:
        """Set texts that are not given."""
        phrase = self.phrase or f"a spec of {self.name}"
        instead = self.given_instead or f"this is {phrase}: use `{self.command}`"
        run_instead = self.run_instead or f"this is a run spec, without the section `{self.marker}`: use `mbdkit run`"
        for name, text in (("phrase", phrase), ("given_instead", instead), ("run_instead", run_instead)):
            object.__setattr__(self, name, text)

    def recognises(self, data: Mapping[str, Any]) -> bool:
        """Return whether plain data are, or are meant to be, a spec of this kind."""
        if any(key in data for key in self.absent):
            return False
        return (
            not self.marker or self.marker in data or ("model" not in data and any(key in data for key in self.signs))
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Example(Feature):
    """A packaged example: a spec, or a notebook, that users run and copy by its name.

    Parameters
    ----------
    file
        The file. A table that the spec reads has the same name with the suffix ``.csv``.
    """

    kind: ClassVar[str] = "example"
    key: ClassVar[str] = "example"

    file: Path

    @classmethod
    def folder(cls, folder: Path, suffix: str = ".yaml") -> list[Example]:
        """Return the examples in a folder, which are named like their files."""
        return [
            cls(name=path.stem, summary=f"packaged example {path.stem}", file=path)
            for path in sorted(folder.glob(f"*{suffix}"))
        ]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GuidePage(Feature):
    """A page of ``mbdkit guide``, whose name is its topic.

    Parameters
    ----------
    file
        The page, as Markdown.
    """

    kind: ClassVar[str] = "guide-page"
    key: ClassVar[str] = "page"

    file: Path

    @classmethod
    def folder(cls, folder: Path) -> list[GuidePage]:
        """Return the pages in a folder, whose topics are the names of the files."""
        return [
            cls(name=path.stem, summary=f"page {path.stem} of the guide", file=path)
            for path in sorted(folder.glob("*.md"))
        ]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FileFormat(Feature):
    """A kind of files or folders with results: how it is recognised, checked, exported and reported.

    Parameters
    ----------
    file
        Name of the file whose presence makes a folder one of this kind; empty for files.
    suffix
        Suffix of files of this kind; empty for folders.
    problems
        Function that takes a path and returns the problems found, or None if the file is of another kind.
    export
        Function that takes path, folder, format and ``overwrite`` by name, and returns the files written.
    report
        Function that takes a path and the number of processes, and returns a context manager that yields the page.
    saves_figures
        Whether the charts of the report are also written as images.
    """

    kind: ClassVar[str] = "file-format"
    key: ClassVar[str] = "file"

    file: str = ""
    suffix: str = ""
    problems: Target[Callable[[Path], list[str] | None]] | None = None
    export: Target[Callable[..., list[Path]]] | None = None
    report: Target[Callable[[Path, int], Any]] | None = None
    saves_figures: bool = False

    @classmethod
    def of_folder(cls, folder: Path, formats: Iterable[FileFormat]) -> FileFormat | None:
        """Return the format of a folder; None if it is of no known kind."""
        return next((one for one in formats if one.file and (folder / one.file).is_file()), None)


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
        Function that takes the object and returns the value of the attribute, which runs keep.
    """

    kind: ClassVar[str] = "accessor"
    key: ClassVar[str] = "attribute"

    of: str
    target: Target[Callable[[Any], Any]]

    _check_name = _check_identifier

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
        Function that takes the run and returns lines, each a label and a text; empty texts are left out.
    of
        Names of the kinds of specs whose runs have the lines; empty for all kinds.
    group
        Group of the archive that runs with the lines have; empty for all runs.
    """

    kind: ClassVar[str] = "summary-line"
    key: ClassVar[str] = "summary"

    text: Target[Callable[[Any], list[tuple[str, str]]]]
    of: frozenset[str] = frozenset()
    group: str = ""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ReportSection(Feature):
    """A section of the report of a run.

    Parameters
    ----------
    make
        Function that takes the run and its mechanism, or None if it cannot be built, and returns the sections, of class
        `mbdkit_report.Section`; none if the run has no such section.
    charts
        Function that takes the run and returns charts, of class `mbdkit_report.Figure`.
    film
        Function that takes the run and the data of the player, and returns these data with its additions.
    """

    kind: ClassVar[str] = "report-section"
    key: ClassVar[str] = "section"

    make: Target[Callable[[Any, Any], Iterable[Any]]]
    charts: Target[Callable[[Any], Iterable[Any]]] | None = None
    film: Target[Callable[[Any, dict[str, Any]], dict[str, Any]]] | None = None


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

    _check_name = _check_identifier

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
        Function that takes the object and returns its `mbdkit_report.View`.
    """

    kind: ClassVar[str] = "view"
    key: ClassVar[str] = "view"

    of: str
    make: Target[Callable[[Any], Any]]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CriterionItem(Feature):
    """A criterion of verdicts, or several that one function examines.

    Parameters
    ----------
    stage
        What is examined: the ``spec`` of a run, its ``start`` after assembly, its recorded ``rows``, its ``end``, or
        the ``data`` of inverse dynamics.
    find
        Function that returns `mbdkit.plugin.Finding` objects or sentences. It takes, with ``spec``, the spec and the
        expressions that are evaluated beside its measures; with ``start``, the spec and the
        `mbdkit.engine.assembly.AssembledState`; with ``end``, the spec and the largest energies, a
        `mbdkit.trust.energy_record.EnergyRecord`; with ``data``, the result and its error bars, or None. With ``rows``,
        it takes the spec, the compiled mechanism and its size [m], and returns a
        `mbdkit.runs.state_watchers.StateWatcher`, or None if this run needs none.
    of
        Names of the kinds of specs whose results are examined; ``mechanism`` stands for results without a run, such as
        equilibria.
    criteria
        Names of the criteria, which `accept` in specs of these kinds may list.
    level
        Level of sentences, which become findings of the criterion `name`.
    elements
        Key in the model of a kind of elements; without such elements, nothing is examined. Empty for all mechanisms.
    """

    kind: ClassVar[str] = "criterion"
    key: ClassVar[str] = "accept"

    stage: Literal["spec", "start", "rows", "end", "data"]
    find: Target[Callable[..., Any]]
    of: frozenset[str]
    criteria: tuple[str, ...] = ()
    level: Literal["doubtful", "bad"] | None = "doubtful"
    elements: str = ""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TableFormat(Feature):
    """A format of ``mbdkit archive export --to NAME``.

    Parameters
    ----------
    suffix
        Suffix of the files, with its dot.
    write
        Function that takes a table, see `mbdkit_report.table_formats.ExportedTable`, and the path of the file to write.
    needs
        Name of the package that the function imports, if it is not part of mbdkit's requirements.
    """

    kind: ClassVar[str] = "table-format"
    key: ClassVar[str] = "to"

    suffix: str
    write: Target[Callable[[Any, Path], None]]
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
        for joints. All fields that follow are for such treatments.
    require
        Function that takes a spec and its method, and raises SpecError if they do not suit the treatment.
    begin
        Function that takes the `mbdkit.plugin.Workspace` of a run and returns one that starts with the forces and modes
        of the elements at the initial state.
    method
        Function that takes the method of a run and the section of its spec, and returns the `mbdkit.StepMethod` or
        `mbdkit.ExternalMethod` that takes the steps, or a function that returns this from the
        `mbdkit.integrators.stages.compiled_method.CompiledMethod` of the method. Its memory has the attributes of
        `mbdkit.integrators.run.impulse.ReactingMemory`. By default, the method itself takes the steps.
    guards
        Function that takes the method of a run, and returns names of fixed-step methods for comparison runs, with the
        factors by which their steps are smaller.
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
    require: Target[Callable[[Any, Any], None]] | None = None
    begin: Target[Callable[[Any], Any]] | None = None
    method: Target[Callable[[Any, Any], Any]] | None = None
    guards: Target[Callable[[Any], Mapping[str, int]]] | None = None
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
        Function that takes the run and returns headlines, of class `mbdkit.plugin.Headline`, the most important first.
    group
        Group of the archive that runs with these headlines have.
    excluded
        Function that takes the run and returns what the error bars of such a run do not include, as words that follow
        "without"; empty if they include all.
    """

    kind: ClassVar[str] = "headline"
    key: ClassVar[str] = "headline"

    take: Target[Callable[[Any], Iterable[Any]]]
    group: str
    excluded: Target[Callable[[Any], str]] | None = None


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
"""The kinds of items of this file."""
