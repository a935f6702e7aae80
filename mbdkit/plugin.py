"""Everything that a plugin imports: ``from mbdkit.plugin import ModelPlugin, Target, hookimpl``.

Each name is imported when it is first used, so that a plugin costs nothing until a spec or a command names it. The
names in `STABLE` change only with the version of the plugin API. The others serve mbdkit's own plugins and may change
with any version.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import lazy

if TYPE_CHECKING:
    from mbdkit.archive.accuracy import Accuracy
    from mbdkit.archive.finished_run import FinishedRun
    from mbdkit.archive.headlines import Headline, headline_texts, plus_minus
    from mbdkit.archive.reader import load
    from mbdkit.archive.run import Run
    from mbdkit.base.errors import (
        MbdkitError,
        PluginError,
        ResourceError,
        RunError,
        SpecError,
        StepError,
        UnsupportedMechanismError,
        file_error,
    )
    from mbdkit.base.files import check_output, check_suffix, replacing
    from mbdkit.base.files_read import read_data
    from mbdkit.base.plain_data import copied, parse_path, path_text, plain, quoted, value_text
    from mbdkit.base.progress_bars import progress_bar
    from mbdkit.base.strict_model import StrictModel
    from mbdkit.base.terminal import say, show, show_json, silence
    from mbdkit.base.text import counted, did_you_mean, listed, one_line, shown, table
    from mbdkit.base.units import Unit, read_quantity, read_unit
    from mbdkit.cli.common_options import (
        Archive,
        AsJson,
        Debug,
        Overwrite,
        Printing,
        Quiet,
        Set,
        check_new,
        grouped,
        output_to,
        stem,
    )
    from mbdkit.engine.compile_forces import Lowering
    from mbdkit.engine.compiled_mechanism import ActingForce, CompiledMechanism, LawForce
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.engine.iteration_matrix import IterationMatrix, IterationMatrixWithStates, StateTangents
    from mbdkit.engine.kernels.observe import Observed
    from mbdkit.engine.nearest_state import nearest_positions, nearest_velocities
    from mbdkit.engine.observed_states import StateObserver
    from mbdkit.engine.state_derivatives import Rates
    from mbdkit.engine.tangents import Tangents
    from mbdkit.engine.workspace import Workspace
    from mbdkit.mechanism.bodies import GROUND, Body, Element
    from mbdkit.mechanism.coordinate_function import CoordinateFunction
    from mbdkit.mechanism.force_law import ExpressionLaw, FunctionLaw, LawState, TracedLaw
    from mbdkit.mechanism.joint_friction import regularised_friction
    from mbdkit.mechanism.joints import Driver, Joint, Revolute
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.mechanism.model_methods import of_models
    from mbdkit.mechanism.pathways import LineForce, Pathway, Segment
    from mbdkit.mechanism.quantity_names import QuantityNames
    from mbdkit.mechanism.state_values import Expression
    from mbdkit.mechanism.values import NotNegative, Number, Point, Positive, Table
    from mbdkit.methods.kinds import (
        ExplicitRungeKutta,
        ImplicitRungeKutta,
        Method,
        Tolerances,
        Traits,
    )
    from mbdkit.methods.method_options import ImplicitOptions, Options
    from mbdkit.methods.scipy_solver import SciPySolver
    from mbdkit.methods.step_methods import ExternalMethod, Step, StepEvent, StepMethod, StepState, Why
    from mbdkit.methods.tableau import ButcherTableau, EmbeddedPair, TableauError, collocation
    from mbdkit.quantities.array import Array, Chart, Kind, Recorded
    from mbdkit.quantities.entries import AXIS, JOINT, name_array, quantity_group, unit_array
    from mbdkit.quantities.names import archive_names, with_members
    from mbdkit.quantities.registered_kinds import kind_of_group, sizes_of
    from mbdkit.quantities.states import States
    from mbdkit.registry.element_items import ElementKind, QuantityKind
    from mbdkit.registry.feature_items import (
        Accessor,
        CriterionItem,
        Example,
        FileFormat,
        GuidePage,
        HeadlineItem,
        PlotKind,
        ReportSection,
        SpecKind,
        SummaryLine,
        TableFormat,
        Treatment,
        ViewItem,
    )
    from mbdkit.registry.hookspecs import hookimpl
    from mbdkit.registry.item import Item
    from mbdkit.registry.items import (
        Claims,
        Command,
        ForceLawPlugin,
        IntegratorPlugin,
        MeasurePlugin,
        ModelPlugin,
        Orders,
        StudyPlugin,
    )
    from mbdkit.registry.target import Target
    from mbdkit.registry.use import use
    from mbdkit.runs.findings import findings
    from mbdkit.runs.preparation import build, caution
    from mbdkit.runs.simulation import run, simulate
    from mbdkit.spec.item_names import TreatmentName
    from mbdkit.spec.loading import example_names, loaded, read_source
    from mbdkit.spec.model_spec import ModelSpec, StrictSpec
    from mbdkit.spec.reading import Document, parse_key, put, read_file, set_value
    from mbdkit.spec.run_spec import RunSpec
    from mbdkit.spec.sections import Count, Section
    from mbdkit.spec.study_measures import DefinedMeasure, defined
    from mbdkit.spec.varied_specs import VariedSpecs
    from mbdkit.spec.yaml_reader import write_yaml
    from mbdkit.trust.criteria import Evidence, Judgement, Level, judge
    from mbdkit.trust.finding import Finding, accepted_doubts, open_doubts
    from mbdkit_studies.prepared_run import PreparedRun, prepare

_STABLE = {
    "mbdkit.base.files_read": "read_data",
    "mbdkit.runs.findings": "findings",
    "mbdkit.trust.finding": "Finding accepted_doubts open_doubts",
    "mbdkit.registry.element_items": "ElementKind QuantityKind",
    "mbdkit.registry.feature_items": "Accessor CriterionItem "
    "Example FileFormat GuidePage HeadlineItem PlotKind ReportSection SpecKind "
    "SummaryLine TableFormat Treatment ViewItem",
    "mbdkit.registry.hookspecs": "hookimpl",
    "mbdkit.registry.target": "Target",
    "mbdkit.registry.item": "Item",
    "mbdkit.registry.items": "Claims Command ForceLawPlugin IntegratorPlugin "
    "MeasurePlugin ModelPlugin Orders StudyPlugin",
    "mbdkit.base.errors": "MbdkitError PluginError ResourceError RunError SpecError "
    "StepError UnsupportedMechanismError",
    "mbdkit.base.terminal": "show show_json",
    "mbdkit.base.text": "counted did_you_mean listed one_line shown table",
    "mbdkit.base.plain_data": "copied parse_path path_text plain quoted value_text",
    "mbdkit.base.units": "Unit read_quantity read_unit",
    "mbdkit.base.strict_model": "StrictModel",
    "mbdkit.mechanism.state_values": "Expression",
    "mbdkit.mechanism.values": "NotNegative Number Point Positive Table",
    "mbdkit.methods.kinds": "ExplicitRungeKutta ImplicitRungeKutta Method Tolerances Traits",
    "mbdkit.methods.scipy_solver": "SciPySolver",
    "mbdkit.methods.step_methods": "ExternalMethod Step StepEvent StepMethod StepState Why",
    "mbdkit.methods.tableau": "ButcherTableau EmbeddedPair TableauError collocation",
    "mbdkit.methods.method_options": "ImplicitOptions Options",
    "mbdkit.engine.compile_forces": "Lowering",
    "mbdkit.engine.compiled_mechanism": "ActingForce LawForce",
    "mbdkit.engine.equations_of_motion": "EquationsOfMotion",
    "mbdkit.engine.iteration_matrix": "IterationMatrix IterationMatrixWithStates StateTangents",
    "mbdkit.engine.state_derivatives": "Rates",
    "mbdkit.engine.tangents": "Tangents",
    "mbdkit.mechanism.mechanism": "Mechanism",
    "mbdkit.mechanism.bodies": "GROUND Body Element",
    "mbdkit.mechanism.joints": "Driver Joint Revolute",
    "mbdkit.mechanism.force_law": "ExpressionLaw FunctionLaw LawState TracedLaw",
    "mbdkit.mechanism.model_methods": "of_models",
    "mbdkit.mechanism.joint_friction": "regularised_friction",
    "mbdkit.mechanism.pathways": "LineForce Pathway Segment",
    "mbdkit.mechanism.coordinate_function": "CoordinateFunction",
    "mbdkit.mechanism.quantity_names": "QuantityNames",
    "mbdkit.archive.run": "Run",
    "mbdkit.archive.reader": "load",
    "mbdkit.spec.run_spec": "RunSpec",
    "mbdkit.spec.item_names": "TreatmentName",
    "mbdkit.spec.loading": "loaded",
    "mbdkit.runs.simulation": "run simulate",
    "mbdkit_studies.prepared_run": "PreparedRun prepare",
    "mbdkit.quantities.array": "Array Chart Kind Recorded",
    "mbdkit.quantities.entries": "name_array quantity_group",
    "mbdkit.quantities.states": "States",
    "mbdkit.archive.accuracy": "Accuracy",
    "mbdkit.archive.headlines": "Headline headline_texts plus_minus",
    "mbdkit.trust.criteria": "Evidence Judgement Level judge",
}
"""Names for all plugins, by module."""

_OWN = {
    "mbdkit.spec.sections": "Count Section",
    "mbdkit.spec.reading": "Document parse_key put read_file set_value",
    "mbdkit.spec.model_spec": "ModelSpec StrictSpec",
    "mbdkit.spec.loading": "example_names read_source",
    "mbdkit.spec.yaml_reader": "write_yaml",
    "mbdkit.spec.study_measures": "DefinedMeasure defined",
    "mbdkit.spec.varied_specs": "VariedSpecs",
    "mbdkit.cli.common_options": "Archive AsJson Debug Overwrite Printing Quiet Set check_new grouped output_to stem",
    "mbdkit.base.terminal": "say silence",
    "mbdkit.registry.use": "use",
    "mbdkit.base.progress_bars": "progress_bar",
    "mbdkit.base.files": "check_output check_suffix replacing",
    "mbdkit.base.errors": "file_error",
    "mbdkit.engine.workspace": "Workspace",
    "mbdkit.engine.compiled_mechanism": "CompiledMechanism",
    "mbdkit.engine.observed_states": "StateObserver",
    "mbdkit.engine.kernels.observe": "Observed",
    "mbdkit.engine.nearest_state": "nearest_positions nearest_velocities",
    "mbdkit.quantities.entries": "AXIS JOINT unit_array",
    "mbdkit.quantities.names": "archive_names with_members",
    "mbdkit.quantities.registered_kinds": "kind_of_group sizes_of",
    "mbdkit.archive.finished_run": "FinishedRun",
    "mbdkit.runs.preparation": "build caution",
}
"""Names for mbdkit's own plugins, by module."""

STABLE = frozenset(name for names in _STABLE.values() for name in names.split())
"""Names that change only with the version of the plugin API."""

_HOME = {name: module for table in (_STABLE, _OWN) for module, names in table.items() for name in names.split()}

__all__ = [
    "AXIS",
    "GROUND",
    "JOINT",
    "STABLE",
    "Accessor",
    "Accuracy",
    "ActingForce",
    "Archive",
    "Array",
    "AsJson",
    "Body",
    "ButcherTableau",
    "Chart",
    "Claims",
    "Command",
    "CompiledMechanism",
    "CoordinateFunction",
    "Count",
    "CriterionItem",
    "Debug",
    "DefinedMeasure",
    "Document",
    "Driver",
    "Element",
    "ElementKind",
    "EmbeddedPair",
    "EquationsOfMotion",
    "Evidence",
    "Example",
    "ExplicitRungeKutta",
    "Expression",
    "ExpressionLaw",
    "ExternalMethod",
    "FileFormat",
    "Finding",
    "FinishedRun",
    "ForceLawPlugin",
    "FunctionLaw",
    "GuidePage",
    "Headline",
    "HeadlineItem",
    "ImplicitOptions",
    "ImplicitRungeKutta",
    "IntegratorPlugin",
    "Item",
    "IterationMatrix",
    "IterationMatrixWithStates",
    "Joint",
    "Judgement",
    "Kind",
    "LawForce",
    "LawState",
    "Level",
    "LineForce",
    "Lowering",
    "MbdkitError",
    "MeasurePlugin",
    "Mechanism",
    "Method",
    "ModelPlugin",
    "ModelSpec",
    "NotNegative",
    "Number",
    "Observed",
    "Options",
    "Orders",
    "Overwrite",
    "Pathway",
    "PlotKind",
    "PluginError",
    "Point",
    "Positive",
    "PreparedRun",
    "Printing",
    "QuantityKind",
    "QuantityNames",
    "Quiet",
    "Rates",
    "Recorded",
    "ReportSection",
    "ResourceError",
    "Revolute",
    "Run",
    "RunError",
    "RunSpec",
    "SciPySolver",
    "Section",
    "Segment",
    "Set",
    "SpecError",
    "SpecKind",
    "StateObserver",
    "StateTangents",
    "States",
    "Step",
    "StepError",
    "StepEvent",
    "StepMethod",
    "StepState",
    "StrictModel",
    "StrictSpec",
    "StudyPlugin",
    "SummaryLine",
    "Table",
    "TableFormat",
    "TableauError",
    "Tangents",
    "Target",
    "Tolerances",
    "TracedLaw",
    "Traits",
    "Treatment",
    "TreatmentName",
    "Unit",
    "UnsupportedMechanismError",
    "VariedSpecs",
    "ViewItem",
    "Why",
    "Workspace",
    "accepted_doubts",
    "archive_names",
    "build",
    "caution",
    "check_new",
    "check_output",
    "check_suffix",
    "collocation",
    "copied",
    "counted",
    "defined",
    "did_you_mean",
    "example_names",
    "file_error",
    "findings",
    "grouped",
    "headline_texts",
    "hookimpl",
    "judge",
    "kind_of_group",
    "listed",
    "load",
    "loaded",
    "name_array",
    "nearest_positions",
    "nearest_velocities",
    "of_models",
    "one_line",
    "open_doubts",
    "output_to",
    "parse_key",
    "parse_path",
    "path_text",
    "plain",
    "plus_minus",
    "prepare",
    "progress_bar",
    "put",
    "quantity_group",
    "quoted",
    "read_data",
    "read_file",
    "read_quantity",
    "read_source",
    "read_unit",
    "regularised_friction",
    "replacing",
    "run",
    "say",
    "set_value",
    "show",
    "show_json",
    "shown",
    "silence",
    "simulate",
    "sizes_of",
    "stem",
    "table",
    "unit_array",
    "use",
    "value_text",
    "with_members",
    "write_yaml",
]

if not TYPE_CHECKING:  # type checkers see only the names above
    __getattr__ = lazy(globals(), _HOME)


def __dir__() -> list[str]:
    return sorted(__all__)
