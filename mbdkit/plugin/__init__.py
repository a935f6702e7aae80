"""What authors of plugins import: items, hooks, and the most used names.

Each name is imported when it is first used, so that a plugin costs nothing until a spec or a command names it. Further
names are in doors by subject: `mbdkit.plugin.specs`, `archives`, `mechanisms`, `equations`, `methods`, `measures`,
`runs`, `doubts` and `files`; what machine code needs is in `mbdkit.kernels`. A name behind no door may
change at any time.
"""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.archive.accuracy import Accuracy as Accuracy
    from mbdkit.archive.headlines import (
        Headline as Headline, headline_texts as headline_texts, plus_minus as plus_minus,
    )
    from mbdkit.archive.reader import load as load
    from mbdkit.archive.run import Run as Run
    from mbdkit.base.errors import (
        ArchiveError as ArchiveError, MbdkitError as MbdkitError, PluginError as PluginError,
        ResourceError as ResourceError, RunError as RunError, SpecError as SpecError, StepError as StepError,
        UnknownNameError as UnknownNameError, UnsupportedMechanismError as UnsupportedMechanismError,
    )
    from mbdkit.base.files_read import read_data as read_data
    from mbdkit.base.html_view import HtmlView as HtmlView
    from mbdkit.base.plain_data import (
        copied as copied, parse_path as parse_path, path_text as path_text, quoted as quoted, value_text as value_text,
    )
    from mbdkit.base.strict_model import FormatVersion as FormatVersion, StrictModel as StrictModel
    from mbdkit.base.terminal import show as show
    from mbdkit.base.text import (
        counted as counted, did_you_mean as did_you_mean, listed as listed, shown as shown, table as table,
    )
    from mbdkit.base.units import Unit as Unit, read_quantity as read_quantity, read_unit as read_unit
    from mbdkit.cli.common_options import SpecCommand as SpecCommand
    from mbdkit.engine.compile_forces import Lowering as Lowering
    from mbdkit.engine.compiled_mechanism import ActingForce as ActingForce
    from mbdkit.engine.equations_of_motion import EquationsOfMotion as EquationsOfMotion
    from mbdkit.engine.iteration_matrix import (
        IterationMatrix as IterationMatrix, IterationMatrixWithStates as IterationMatrixWithStates,
        StateTangents as StateTangents,
    )
    from mbdkit.engine.state_derivatives import Rates as Rates
    from mbdkit.engine.tangents import Tangents as Tangents
    from mbdkit.mechanism.bodies import Body as Body, Element as Element, GROUND as GROUND
    from mbdkit.mechanism.coordinate_function import CoordinateFunction as CoordinateFunction
    from mbdkit.mechanism.force_law import (
        ExpressionLaw as ExpressionLaw, FunctionLaw as FunctionLaw, LawState as LawState, TracedLaw as TracedLaw,
    )
    from mbdkit.mechanism.joint_base import (
        FunctionJoint as FunctionJoint, Pose as Pose, PoseFunction as PoseFunction, SideForce as SideForce,
    )
    from mbdkit.mechanism.joint_friction import regularised_friction as regularised_friction
    from mbdkit.mechanism.joints import Driver as Driver, Joint as Joint, Revolute as Revolute
    from mbdkit.mechanism.mechanism import Mechanism as Mechanism
    from mbdkit.mechanism.pathways import (
        LawForce as LawForce, LineForce as LineForce, Pathway as Pathway, Segment as Segment,
    )
    from mbdkit.mechanism.quantity_names import QuantityNames as QuantityNames
    from mbdkit.mechanism.state_values import Expression as Expression
    from mbdkit.mechanism.values import (
        NotNegative as NotNegative, Number as Number, Point as Point, Positive as Positive, Table as Table,
    )
    from mbdkit.methods.kinds import (
        ExplicitRungeKutta as ExplicitRungeKutta, ImplicitRungeKutta as ImplicitRungeKutta, Method as Method,
        Tolerances as Tolerances, Traits as Traits,
    )
    from mbdkit.methods.method_options import ImplicitOptions as ImplicitOptions, Options as Options
    from mbdkit.methods.scipy_solver import SciPySolver as SciPySolver
    from mbdkit.methods.step_filter import StepFilter as StepFilter
    from mbdkit.methods.step_methods import (
        ExternalMethod as ExternalMethod, Step as Step, StepEvent as StepEvent, StepMethod as StepMethod,
        StepState as StepState, Why as Why,
    )
    from mbdkit.methods.tableau import (
        ButcherTableau as ButcherTableau, EmbeddedPair as EmbeddedPair, TableauError as TableauError,
        collocation as collocation,
    )
    from mbdkit.quantities.array import Array as Array, Chart as Chart, Recorded as Recorded
    from mbdkit.quantities.entries import name_array as name_array, quantity_group as quantity_group
    from mbdkit.quantities.states import States as States
    from mbdkit.registry.element_items import (
        ElementDerivatives as ElementDerivatives, ElementFailures as ElementFailures, ElementForces as ElementForces,
        ElementKind as ElementKind, JointKind as JointKind, ModelKey as ModelKey, QuantityKind as QuantityKind,
    )
    from mbdkit.registry.feature_items import (
        Accessor as Accessor, CriterionItem as CriterionItem, Example as Example, FileFormat as FileFormat,
        GuidePage as GuidePage, HeadlineItem as HeadlineItem, PlotKind as PlotKind, ReportSection as ReportSection,
        SpecKind as SpecKind, SummaryLine as SummaryLine, TableFormat as TableFormat, Treatment as Treatment,
        ViewItem as ViewItem,
    )
    from mbdkit.registry.hookspecs import hookimpl as hookimpl
    from mbdkit.registry.item import Item as Item
    from mbdkit.registry.items import (
        Claims as Claims, Command as Command, ForceLawPlugin as ForceLawPlugin, IntegratorPlugin as IntegratorPlugin,
        MeasurePlugin as MeasurePlugin, ModelPlugin as ModelPlugin, Orders as Orders, StepControl as StepControl,
        StudyPlugin as StudyPlugin,
    )
    from mbdkit.registry.policy import API as API
    from mbdkit.registry.target import Target as Target
    from mbdkit.runs.simulation import simulate as simulate
    from mbdkit.spec.item_names import TreatmentName as TreatmentName
    from mbdkit.spec.loading import loaded as loaded
    from mbdkit.spec.run_spec import RunSpec as RunSpec
    from mbdkit.trust.criteria import Evidence as Evidence, Judgement as Judgement, Level as Level
    from mbdkit.trust.finding import Finding as Finding, accepted_doubts as accepted_doubts, open_doubts as open_doubts
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
