"""What authors of plugins import: items, hooks, and the most used names.

Each name is imported when it is first used, so that a plugin costs nothing until a spec or a command names it. Further
names are in doors by subject: `mbdkit.plugin.seams`, `specs`, `archives`, `mechanisms`, `equations`, `methods`,
`measures`, `runs`, `studies` and `reports`; what machine code needs is in `mbdkit.kernels`, and what users need too,
such as `StepMethod`, in `mbdkit`. A name behind no door may change at any time.
"""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.archive.run import Run as Run
    from mbdkit.base.errors import (
        MbdkitError as MbdkitError, RunError as RunError, SpecError as SpecError, UnknownNameError as UnknownNameError,
        UnsupportedMechanismError as UnsupportedMechanismError,
    )
    from mbdkit.base.files_read import read_data as read_data
    from mbdkit.base.html_view import HtmlView as HtmlView
    from mbdkit.base.plain_data import path_text as path_text, quoted as quoted, value_text as value_text
    from mbdkit.base.strict_model import FormatVersion as FormatVersion, StrictModel as StrictModel
    from mbdkit.base.terminal import show as show
    from mbdkit.base.text import (
        counted as counted, did_you_mean as did_you_mean, listed as listed, plus_minus as plus_minus, table as table,
    )
    from mbdkit.base.units import read_quantity as read_quantity, read_unit as read_unit
    from mbdkit.cli.common_options import SpecCommand as SpecCommand
    from mbdkit.engine.compile_forces import Lowering as Lowering
    from mbdkit.engine.compiled_mechanism import ActingForce as ActingForce
    from mbdkit.engine.iteration_matrix import (
        IterationMatrix as IterationMatrix, IterationMatrixWithStates as IterationMatrixWithStates,
    )
    from mbdkit.engine.state_derivatives import Rates as Rates
    from mbdkit.mechanism.bodies import Body as Body, Element as Element, GROUND as GROUND
    from mbdkit.mechanism.force_law import LawState as LawState, TracedLaw as TracedLaw
    from mbdkit.mechanism.joint_base import (
        FunctionJoint as FunctionJoint, Pose as Pose, PoseFunction as PoseFunction, SideForce as SideForce,
    )
    from mbdkit.mechanism.joint_friction import regularised_friction as regularised_friction
    from mbdkit.mechanism.joints import Joint as Joint, Revolute as Revolute
    from mbdkit.mechanism.mechanism import Mechanism as Mechanism
    from mbdkit.mechanism.pathways import LineForce as LineForce, Segment as Segment
    from mbdkit.mechanism.state_values import Expression as Expression
    from mbdkit.mechanism.values import (
        NotNegative as NotNegative, Number as Number, Point as Point, Positive as Positive, Table as Table,
    )
    from mbdkit.methods.kinds import Method as Method
    from mbdkit.methods.method_options import ImplicitOptions as ImplicitOptions
    from mbdkit.methods.scipy_solver import SciPySolver as SciPySolver
    from mbdkit.methods.step_filter import StepFilter as StepFilter
    from mbdkit.methods.step_methods import Why as Why
    from mbdkit.methods.tableau import collocation as collocation
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
        Command as Command, ForceLawPlugin as ForceLawPlugin, IntegratorPlugin as IntegratorPlugin,
        MeasurePlugin as MeasurePlugin, ModelPlugin as ModelPlugin, Orders as Orders, StepControl as StepControl,
    )
    from mbdkit.registry.policy import API as API
    from mbdkit.registry.target import Target as Target
    from mbdkit.runs.simulation import simulate as simulate
    from mbdkit.spec.item_names import TreatmentName as TreatmentName
    from mbdkit.spec.loading import loaded as loaded
    from mbdkit.spec.run_spec import RunSpec as RunSpec
    from mbdkit.trust.finding import Finding as Finding
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
