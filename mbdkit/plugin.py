"""Everything that a plugin imports: ``from mbdkit.plugin import ModelPlugin, Target, hookimpl``.

Each name is imported when it is first used, so that a plugin costs nothing until a spec or a command names it. The
names in `STABLE` change only with the version of the plugin API. The others serve mbdkit's own plugins and may change
with any version.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import lazy

if TYPE_CHECKING:  # an alias exports a name for type checkers
    from mbdkit.archive.accuracy import Accuracy as Accuracy
    from mbdkit.archive.finished_run import FinishedRun as FinishedRun
    from mbdkit.archive.headlines import Headline as Headline
    from mbdkit.archive.headlines import headline_texts as headline_texts
    from mbdkit.archive.headlines import plus_minus as plus_minus
    from mbdkit.archive.reader import load as load
    from mbdkit.archive.run import Run as Run
    from mbdkit.base.errors import MbdkitError as MbdkitError
    from mbdkit.base.errors import PluginError as PluginError
    from mbdkit.base.errors import ResourceError as ResourceError
    from mbdkit.base.errors import RunError as RunError
    from mbdkit.base.errors import SpecError as SpecError
    from mbdkit.base.errors import StepError as StepError
    from mbdkit.base.errors import UnsupportedMechanismError as UnsupportedMechanismError
    from mbdkit.base.errors import file_error as file_error
    from mbdkit.base.files import check_output as check_output
    from mbdkit.base.files import check_suffix as check_suffix
    from mbdkit.base.files import replacing as replacing
    from mbdkit.base.files_read import read_data as read_data
    from mbdkit.base.plain_data import copied as copied
    from mbdkit.base.plain_data import parse_path as parse_path
    from mbdkit.base.plain_data import path_text as path_text
    from mbdkit.base.plain_data import plain as plain
    from mbdkit.base.plain_data import quoted as quoted
    from mbdkit.base.plain_data import value_text as value_text
    from mbdkit.base.progress_bars import progress_bar as progress_bar
    from mbdkit.base.strict_model import FormatVersion as FormatVersion
    from mbdkit.base.strict_model import StrictModel as StrictModel
    from mbdkit.base.terminal import say as say
    from mbdkit.base.terminal import show as show
    from mbdkit.base.terminal import show_json as show_json
    from mbdkit.base.terminal import silence as silence
    from mbdkit.base.text import counted as counted
    from mbdkit.base.text import did_you_mean as did_you_mean
    from mbdkit.base.text import listed as listed
    from mbdkit.base.text import one_line as one_line
    from mbdkit.base.text import shown as shown
    from mbdkit.base.text import table as table
    from mbdkit.base.units import Unit as Unit
    from mbdkit.base.units import read_quantity as read_quantity
    from mbdkit.base.units import read_unit as read_unit
    from mbdkit.cli.common_options import Archive as Archive
    from mbdkit.cli.common_options import AsJson as AsJson
    from mbdkit.cli.common_options import Debug as Debug
    from mbdkit.cli.common_options import Overwrite as Overwrite
    from mbdkit.cli.common_options import Printing as Printing
    from mbdkit.cli.common_options import Quiet as Quiet
    from mbdkit.cli.common_options import Set as Set
    from mbdkit.cli.common_options import check_new as check_new
    from mbdkit.cli.common_options import grouped as grouped
    from mbdkit.cli.common_options import output_to as output_to
    from mbdkit.cli.common_options import stem as stem
    from mbdkit.engine.compile_forces import Lowering as Lowering
    from mbdkit.engine.compiled_mechanism import ActingForce as ActingForce
    from mbdkit.engine.compiled_mechanism import CompiledMechanism as CompiledMechanism
    from mbdkit.engine.compiled_mechanism import LawForce as LawForce
    from mbdkit.engine.equations_of_motion import EquationsOfMotion as EquationsOfMotion
    from mbdkit.engine.iteration_matrix import IterationMatrix as IterationMatrix
    from mbdkit.engine.iteration_matrix import IterationMatrixWithStates as IterationMatrixWithStates
    from mbdkit.engine.iteration_matrix import StateTangents as StateTangents
    from mbdkit.engine.kernels.observe import Observed as Observed
    from mbdkit.engine.nearest_state import nearest_positions as nearest_positions
    from mbdkit.engine.nearest_state import nearest_velocities as nearest_velocities
    from mbdkit.engine.observed_states import StateObserver as StateObserver
    from mbdkit.engine.state_derivatives import Rates as Rates
    from mbdkit.engine.tangents import Tangents as Tangents
    from mbdkit.engine.workspace import Workspace as Workspace
    from mbdkit.mechanism.bodies import GROUND as GROUND
    from mbdkit.mechanism.bodies import Body as Body
    from mbdkit.mechanism.bodies import Element as Element
    from mbdkit.mechanism.coordinate_function import CoordinateFunction as CoordinateFunction
    from mbdkit.mechanism.force_law import ExpressionLaw as ExpressionLaw
    from mbdkit.mechanism.force_law import FunctionLaw as FunctionLaw
    from mbdkit.mechanism.force_law import LawState as LawState
    from mbdkit.mechanism.force_law import TracedLaw as TracedLaw
    from mbdkit.mechanism.joint_friction import regularised_friction as regularised_friction
    from mbdkit.mechanism.joints import Driver as Driver
    from mbdkit.mechanism.joints import Joint as Joint
    from mbdkit.mechanism.joints import Revolute as Revolute
    from mbdkit.mechanism.mechanism import Mechanism as Mechanism
    from mbdkit.mechanism.model_methods import of_models as of_models
    from mbdkit.mechanism.pathways import LineForce as LineForce
    from mbdkit.mechanism.pathways import Pathway as Pathway
    from mbdkit.mechanism.pathways import Segment as Segment
    from mbdkit.mechanism.quantity_names import QuantityNames as QuantityNames
    from mbdkit.mechanism.state_values import Expression as Expression
    from mbdkit.mechanism.values import NotNegative as NotNegative
    from mbdkit.mechanism.values import Number as Number
    from mbdkit.mechanism.values import Point as Point
    from mbdkit.mechanism.values import Positive as Positive
    from mbdkit.mechanism.values import Table as Table
    from mbdkit.methods.kinds import ExplicitRungeKutta as ExplicitRungeKutta
    from mbdkit.methods.kinds import ImplicitRungeKutta as ImplicitRungeKutta
    from mbdkit.methods.kinds import Method as Method
    from mbdkit.methods.kinds import Tolerances as Tolerances
    from mbdkit.methods.kinds import Traits as Traits
    from mbdkit.methods.method_options import ImplicitOptions as ImplicitOptions
    from mbdkit.methods.method_options import Options as Options
    from mbdkit.methods.scipy_solver import SciPySolver as SciPySolver
    from mbdkit.methods.step_methods import ExternalMethod as ExternalMethod
    from mbdkit.methods.step_methods import Step as Step
    from mbdkit.methods.step_methods import StepEvent as StepEvent
    from mbdkit.methods.step_methods import StepMethod as StepMethod
    from mbdkit.methods.step_methods import StepState as StepState
    from mbdkit.methods.step_methods import Why as Why
    from mbdkit.methods.tableau import ButcherTableau as ButcherTableau
    from mbdkit.methods.tableau import EmbeddedPair as EmbeddedPair
    from mbdkit.methods.tableau import TableauError as TableauError
    from mbdkit.methods.tableau import collocation as collocation
    from mbdkit.quantities.array import Array as Array
    from mbdkit.quantities.array import Chart as Chart
    from mbdkit.quantities.array import Kind as Kind
    from mbdkit.quantities.array import Recorded as Recorded
    from mbdkit.quantities.entries import AXIS as AXIS
    from mbdkit.quantities.entries import JOINT as JOINT
    from mbdkit.quantities.entries import name_array as name_array
    from mbdkit.quantities.entries import quantity_group as quantity_group
    from mbdkit.quantities.entries import unit_array as unit_array
    from mbdkit.quantities.names import archive_names as archive_names
    from mbdkit.quantities.names import with_members as with_members
    from mbdkit.quantities.registered_kinds import kind_of_group as kind_of_group
    from mbdkit.quantities.registered_kinds import sizes_of as sizes_of
    from mbdkit.quantities.states import States as States
    from mbdkit.registry.element_items import ElementKind as ElementKind
    from mbdkit.registry.element_items import QuantityKind as QuantityKind
    from mbdkit.registry.feature_items import Accessor as Accessor
    from mbdkit.registry.feature_items import CriterionItem as CriterionItem
    from mbdkit.registry.feature_items import Example as Example
    from mbdkit.registry.feature_items import FileFormat as FileFormat
    from mbdkit.registry.feature_items import GuidePage as GuidePage
    from mbdkit.registry.feature_items import HeadlineItem as HeadlineItem
    from mbdkit.registry.feature_items import PlotKind as PlotKind
    from mbdkit.registry.feature_items import ReportSection as ReportSection
    from mbdkit.registry.feature_items import SpecKind as SpecKind
    from mbdkit.registry.feature_items import SummaryLine as SummaryLine
    from mbdkit.registry.feature_items import TableFormat as TableFormat
    from mbdkit.registry.feature_items import Treatment as Treatment
    from mbdkit.registry.feature_items import ViewItem as ViewItem
    from mbdkit.registry.hookspecs import hookimpl as hookimpl
    from mbdkit.registry.item import Item as Item
    from mbdkit.registry.items import Claims as Claims
    from mbdkit.registry.items import Command as Command
    from mbdkit.registry.items import ForceLawPlugin as ForceLawPlugin
    from mbdkit.registry.items import IntegratorPlugin as IntegratorPlugin
    from mbdkit.registry.items import MeasurePlugin as MeasurePlugin
    from mbdkit.registry.items import ModelPlugin as ModelPlugin
    from mbdkit.registry.items import Orders as Orders
    from mbdkit.registry.items import StudyPlugin as StudyPlugin
    from mbdkit.registry.target import Target as Target
    from mbdkit.registry.use import use as use
    from mbdkit.runs.findings import findings as findings
    from mbdkit.runs.preparation import build as build
    from mbdkit.runs.preparation import caution as caution
    from mbdkit.runs.simulation import run as run
    from mbdkit.runs.simulation import simulate as simulate
    from mbdkit.spec.item_names import TreatmentName as TreatmentName
    from mbdkit.spec.loading import example_names as example_names
    from mbdkit.spec.loading import loaded as loaded
    from mbdkit.spec.loading import read_source as read_source
    from mbdkit.spec.model_spec import ModelSpec as ModelSpec
    from mbdkit.spec.model_spec import StrictSpec as StrictSpec
    from mbdkit.spec.reading import Document as Document
    from mbdkit.spec.reading import parse_key as parse_key
    from mbdkit.spec.reading import put as put
    from mbdkit.spec.reading import read_file as read_file
    from mbdkit.spec.reading import set_value as set_value
    from mbdkit.spec.run_spec import RunSpec as RunSpec
    from mbdkit.spec.sections import Count as Count
    from mbdkit.spec.sections import Section as Section
    from mbdkit.spec.study_measures import DefinedMeasure as DefinedMeasure
    from mbdkit.spec.study_measures import defined as defined
    from mbdkit.spec.varied_specs import VariedSpecs as VariedSpecs
    from mbdkit.spec.yaml_reader import write_yaml as write_yaml
    from mbdkit.trust.criteria import Evidence as Evidence
    from mbdkit.trust.criteria import Judgement as Judgement
    from mbdkit.trust.criteria import Level as Level
    from mbdkit.trust.criteria import judge as judge
    from mbdkit.trust.finding import Finding as Finding
    from mbdkit.trust.finding import accepted_doubts as accepted_doubts
    from mbdkit.trust.finding import open_doubts as open_doubts
    from mbdkit_studies.prepared_run import PreparedRun as PreparedRun
    from mbdkit_studies.prepared_run import prepare as prepare

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
    "mbdkit.base.strict_model": "FormatVersion StrictModel",
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

if not TYPE_CHECKING:  # type checkers see only the names above
    __all__ = ["STABLE", *_HOME]
    __getattr__ = lazy(globals(), _HOME)


def __dir__() -> list[str]:
    return sorted(["STABLE", *_HOME])
