"""mbdkit: simulation of planar multibody systems with constraints.

Public names are imported on first use, which keeps ``import mbdkit`` fast.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from mbdkit.base import higher_layers, moved_modules
from mbdkit.base.lazy_names import import_part, lazy

if TYPE_CHECKING:
    from mbdkit import spec
    from mbdkit.archive.reader import load
    from mbdkit.archive.run import Run
    from mbdkit.base.errors import (
        ArchiveError,
        MbdkitError,
        PluginError,
        ResourceError,
        RunError,
        SpecError,
        StepError,
    )
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.mechanism.force_law import ExpressionLaw, FunctionLaw
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Tolerances
    from mbdkit.methods.step_methods import ExternalMethod, Step, StepMethod, StepState
    from mbdkit.methods.tableau import ButcherTableau, EmbeddedPair
    from mbdkit.registry.hookspecs import hookimpl
    from mbdkit.registry.items import Claims, ForceLawPlugin, IntegratorPlugin, MeasurePlugin, ModelPlugin, StudyPlugin
    from mbdkit.runs.resuming import resume
    from mbdkit.runs.simulation import run
    from mbdkit.spec import DesignSpec, InverseSpec, RunSpec, StudySpec
    from mbdkit_biomech.inverse_dynamics.inverse_gradient import inverse_gradient
    from mbdkit_biomech.inverse_dynamics.inverse_run import inverse
    from mbdkit_biomech.inverse_dynamics.workload import Workload, workload
    from mbdkit_design.design import Design
    from mbdkit_design.solve_design import design, load_design
    from mbdkit_explore.server import explore
    from mbdkit_gradients.gradient import Gradient, gradient
    from mbdkit_predict.prediction import predict
    from mbdkit_report import plot
    from mbdkit_statics.equilibrium import Equilibrium, equilibrium
    from mbdkit_statics.equilibrium_path import EquilibriumPath, equilibrium_path
    from mbdkit_statics.kinematics import Kinematics, kinematics
    from mbdkit_statics.modes import Linearization, Modes, linearize, modes
    from mbdkit_studies.carry_out import ensemble, load_study, study
    from mbdkit_studies.prepared_run import PreparedRun, prepare
    from mbdkit_studies.study import Study

    __version__: str

__all__ = [
    "ArchiveError",
    "ButcherTableau",
    "Claims",
    "Design",
    "DesignSpec",
    "EmbeddedPair",
    "EquationsOfMotion",
    "Equilibrium",
    "EquilibriumPath",
    "ExplicitRungeKutta",
    "ExpressionLaw",
    "ExternalMethod",
    "ForceLawPlugin",
    "FunctionLaw",
    "Gradient",
    "ImplicitRungeKutta",
    "IntegratorPlugin",
    "InverseSpec",
    "Kinematics",
    "Linearization",
    "MbdkitError",
    "MeasurePlugin",
    "Mechanism",
    "ModelPlugin",
    "Modes",
    "PluginError",
    "PreparedRun",
    "ResourceError",
    "Run",
    "RunError",
    "RunSpec",
    "SpecError",
    "Step",
    "StepError",
    "StepMethod",
    "StepState",
    "Study",
    "StudyPlugin",
    "StudySpec",
    "Tolerances",
    "Workload",
    "__version__",
    "design",
    "ensemble",
    "equilibrium",
    "equilibrium_path",
    "explore",
    "gradient",
    "hookimpl",
    "inverse",
    "inverse_gradient",
    "kinematics",
    "linearize",
    "load",
    "load_design",
    "load_study",
    "modes",
    "plot",
    "predict",
    "prepare",
    "resume",
    "run",
    "spec",
    "study",
    "workload",
]

_HOME = {
    "ArchiveError": "mbdkit.base.errors",
    "ButcherTableau": "mbdkit.methods.tableau",
    "Claims": "mbdkit.registry.items",
    "Design": "mbdkit_design.design",
    "DesignSpec": "mbdkit.spec",
    "design": "mbdkit_design.solve_design",
    "load_design": "mbdkit_design.solve_design",
    "EmbeddedPair": "mbdkit.methods.tableau",
    "Equilibrium": "mbdkit_statics.equilibrium",
    "EquilibriumPath": "mbdkit_statics.equilibrium_path",
    "ExplicitRungeKutta": "mbdkit.methods.kinds",
    "ExpressionLaw": "mbdkit.mechanism.force_law",
    "ForceLawPlugin": "mbdkit.registry.items",
    "ExternalMethod": "mbdkit.methods.step_methods",
    "FunctionLaw": "mbdkit.mechanism.force_law",
    "Gradient": "mbdkit_gradients.gradient",
    "ImplicitRungeKutta": "mbdkit.methods.kinds",
    "IntegratorPlugin": "mbdkit.registry.items",
    "InverseSpec": "mbdkit.spec",
    "Kinematics": "mbdkit_statics.kinematics",
    "Linearization": "mbdkit_statics.modes",
    "MbdkitError": "mbdkit.base.errors",
    "MeasurePlugin": "mbdkit.registry.items",
    "Mechanism": "mbdkit.mechanism.mechanism",
    "ModelPlugin": "mbdkit.registry.items",
    "Modes": "mbdkit_statics.modes",
    "PluginError": "mbdkit.base.errors",
    "PreparedRun": "mbdkit_studies.prepared_run",
    "predict": "mbdkit_predict.prediction",
    "prepare": "mbdkit_studies.prepared_run",
    "ResourceError": "mbdkit.base.errors",
    "Run": "mbdkit.archive.run",
    "RunError": "mbdkit.base.errors",
    "RunSpec": "mbdkit.spec",
    "SpecError": "mbdkit.base.errors",
    "StepError": "mbdkit.base.errors",
    "Step": "mbdkit.methods.step_methods",
    "StepMethod": "mbdkit.methods.step_methods",
    "EquationsOfMotion": "mbdkit.engine.equations_of_motion",
    "StepState": "mbdkit.methods.step_methods",
    "Study": "mbdkit_studies.study",
    "StudyPlugin": "mbdkit.registry.items",
    "StudySpec": "mbdkit.spec",
    "equilibrium": "mbdkit_statics.equilibrium",
    "equilibrium_path": "mbdkit_statics.equilibrium_path",
    "explore": "mbdkit_explore.server",
    "gradient": "mbdkit_gradients.gradient",
    "hookimpl": "mbdkit.registry.hookspecs",
    "inverse": "mbdkit_biomech.inverse_dynamics.inverse_run",
    "inverse_gradient": "mbdkit_biomech.inverse_dynamics.inverse_gradient",
    "kinematics": "mbdkit_statics.kinematics",
    "linearize": "mbdkit_statics.modes",
    "load": "mbdkit.archive.reader",
    "ensemble": "mbdkit_studies.carry_out",
    "load_study": "mbdkit_studies.carry_out",
    "modes": "mbdkit_statics.modes",
    "resume": "mbdkit.runs.resuming",
    "run": "mbdkit.runs.simulation",
    "study": "mbdkit_studies.carry_out",
    "workload": "mbdkit_biomech.inverse_dynamics.workload",
    "Tolerances": "mbdkit.methods.kinds",
    "Workload": "mbdkit_biomech.inverse_dynamics.workload",
}


if not TYPE_CHECKING:  # type checkers see only the names above
    _lazy = lazy(globals(), _HOME)

    def __getattr__(name):
        if name == "__version__":
            from mbdkit.base.distributions import own_version

            return own_version()
        if name in ("plot", "spec"):
            return import_part("mbdkit_report.plot" if name == "plot" else "mbdkit.spec", f"mbdkit.{name}")
        return _lazy(name)


def __dir__() -> list[str]:
    return sorted(__all__)


def _of_higher_layer(module: str, name: str, wanted: str = "") -> Callable[..., Any]:
    """Return a function that, when called, imports a function of another module and calls it.

    `wanted` is what users call it; see `import_part`.
    """

    def imported(*arguments: Any, **named: Any) -> Any:
        return getattr(import_part(module, wanted or name), name)(*arguments, **named)

    return imported


# Importing any module of the package first runs this file, so that these functions are always available below.
higher_layers.elementary_functions = _of_higher_layer("mbdkit.engine.kernels.elementary_calls", "functions_of_numbers")
higher_layers.elementary_values = _of_higher_layer("mbdkit.engine.kernels.elementary_calls", "values_of")
higher_layers.installed_plugins = _of_higher_layer("mbdkit.spec.choices", "RegistryLookup")
higher_layers.names_of_mechanisms = _of_higher_layer("mbdkit.mechanism.mechanism", "own_names")
higher_layers.symbolic_system = _of_higher_layer(
    "mbdkit_statics.symbolic_equations", "build_system", "Mechanism.to_sympy"
)
higher_layers.state_program = _of_higher_layer("mbdkit.events.state_program", "state_program")
higher_layers.state_values = _of_higher_layer("mbdkit.events.state_program", "state_values")
higher_layers.check_gradients = _of_higher_layer("mbdkit_gradients.gradient", "check_gradients", "the key gradients")
higher_layers.gradients_json = _of_higher_layer("mbdkit_gradients.gradient", "gradients_json", "the key gradients")
higher_layers.run_summary = _of_higher_layer("mbdkit.archive.run_summary", "summary")
higher_layers.run_frame = _of_higher_layer("mbdkit_report.group_table", "to_frame", "Run.to_frame")
higher_layers.run_datatree = _of_higher_layer("mbdkit_report.xarray_tree", "to_datatree", "Run.to_xarray")
higher_layers.built_in_measures = _of_higher_layer("mbdkit_studies.measures", "built_in_measures")
higher_layers.html_of = _of_higher_layer("mbdkit_report.notebook.result_views", "html_of")
moved_modules.install()
