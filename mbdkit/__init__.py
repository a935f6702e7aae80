"""mbdkit: simulation of planar multibody systems with constraints.

Public names are imported on first use, which keeps ``import mbdkit`` fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mbdkit import html_view
from mbdkit.mechanism import higher_layers

if TYPE_CHECKING:
    from mbdkit import plot
    from mbdkit.analysis.workload import Workload, workload
    from mbdkit.archive.reader import load
    from mbdkit.archive.run import Run
    from mbdkit.designs.design import Design
    from mbdkit.designs.solve_design import design, load_design
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.errors import MbdkitError, PluginError, ResourceError, RunError, SpecError, StepError
    from mbdkit.gradients.gradient import Gradient, gradient
    from mbdkit.inverse_dynamics.inverse_gradient import inverse_gradient
    from mbdkit.inverse_dynamics.inverse_run import inverse
    from mbdkit.mechanics.equilibrium import Equilibrium, equilibrium
    from mbdkit.mechanics.equilibrium_path import EquilibriumPath, equilibrium_path
    from mbdkit.mechanics.kinematics import Kinematics, kinematics
    from mbdkit.mechanics.modes import Linearization, Modes, linearize, modes
    from mbdkit.mechanism.force_law import ExpressionLaw, FunctionLaw
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta
    from mbdkit.methods.step_method import StepMethod, StepState
    from mbdkit.methods.tableau import ButcherTableau
    from mbdkit.registry.hookspecs import hookimpl
    from mbdkit.registry.items import Claims, ForceLawPlugin, IntegratorPlugin, MeasurePlugin, ModelPlugin, StudyPlugin
    from mbdkit.resuming import resume
    from mbdkit.simulation import run
    from mbdkit.spec import DesignSpec, InverseSpec, RunSpec, StudySpec
    from mbdkit.studies.carry_out import ensemble, load_study, study
    from mbdkit.studies.study import Study

    __version__: str

__all__ = [
    "ButcherTableau",
    "Claims",
    "Design",
    "DesignSpec",
    "EquationsOfMotion",
    "Equilibrium",
    "EquilibriumPath",
    "ExplicitRungeKutta",
    "ExpressionLaw",
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
    "ResourceError",
    "Run",
    "RunError",
    "RunSpec",
    "SpecError",
    "StepError",
    "StepMethod",
    "StepState",
    "Study",
    "StudyPlugin",
    "StudySpec",
    "Workload",
    "__version__",
    "design",
    "ensemble",
    "equilibrium",
    "equilibrium_path",
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
    "resume",
    "run",
    "study",
    "workload",
]

_HOME = {
    "ButcherTableau": "mbdkit.methods.tableau",
    "Claims": "mbdkit.registry.items",
    "Design": "mbdkit.designs.design",
    "DesignSpec": "mbdkit.spec",
    "design": "mbdkit.designs.solve_design",
    "load_design": "mbdkit.designs.solve_design",
    "Equilibrium": "mbdkit.mechanics.equilibrium",
    "EquilibriumPath": "mbdkit.mechanics.equilibrium_path",
    "ExplicitRungeKutta": "mbdkit.methods.kinds",
    "ExpressionLaw": "mbdkit.mechanism.force_law",
    "ForceLawPlugin": "mbdkit.registry.items",
    "FunctionLaw": "mbdkit.mechanism.force_law",
    "Gradient": "mbdkit.gradients.gradient",
    "ImplicitRungeKutta": "mbdkit.methods.kinds",
    "IntegratorPlugin": "mbdkit.registry.items",
    "InverseSpec": "mbdkit.spec",
    "Kinematics": "mbdkit.mechanics.kinematics",
    "Linearization": "mbdkit.mechanics.modes",
    "MbdkitError": "mbdkit.errors",
    "MeasurePlugin": "mbdkit.registry.items",
    "Mechanism": "mbdkit.mechanism.mechanism",
    "ModelPlugin": "mbdkit.registry.items",
    "Modes": "mbdkit.mechanics.modes",
    "PluginError": "mbdkit.errors",
    "ResourceError": "mbdkit.errors",
    "Run": "mbdkit.archive.run",
    "RunError": "mbdkit.errors",
    "RunSpec": "mbdkit.spec",
    "SpecError": "mbdkit.errors",
    "StepError": "mbdkit.errors",
    "StepMethod": "mbdkit.methods.step_method",
    "EquationsOfMotion": "mbdkit.engine.equations_of_motion",
    "StepState": "mbdkit.methods.step_method",
    "Study": "mbdkit.studies.study",
    "StudyPlugin": "mbdkit.registry.items",
    "StudySpec": "mbdkit.spec",
    "equilibrium": "mbdkit.mechanics.equilibrium",
    "equilibrium_path": "mbdkit.mechanics.equilibrium_path",
    "gradient": "mbdkit.gradients.gradient",
    "hookimpl": "mbdkit.registry.hookspecs",
    "inverse": "mbdkit.inverse_dynamics.inverse_run",
    "inverse_gradient": "mbdkit.inverse_dynamics.inverse_gradient",
    "kinematics": "mbdkit.mechanics.kinematics",
    "linearize": "mbdkit.mechanics.modes",
    "load": "mbdkit.archive.reader",
    "ensemble": "mbdkit.studies.carry_out",
    "load_study": "mbdkit.studies.carry_out",
    "modes": "mbdkit.mechanics.modes",
    "resume": "mbdkit.resuming",
    "run": "mbdkit.simulation",
    "study": "mbdkit.studies.carry_out",
    "workload": "mbdkit.analysis.workload",
    "Workload": "mbdkit.analysis.workload",
}


if not TYPE_CHECKING:  # type checkers know the names above, and nothing else

    def __getattr__(name):
        if name == "__version__":
            from importlib.metadata import version

            value = version("mbdkit")
        elif name == "plot":
            value = importlib.import_module("mbdkit.plot")
        elif name in _HOME:
            value = getattr(importlib.import_module(_HOME[name]), name)
        else:
            raise AttributeError(f"module 'mbdkit' has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted(__all__)


def _installed_plugins() -> Any:
    from mbdkit.spec.registry_lookup import RegistryLookup

    return RegistryLookup()


def _symbolic_system(mechanism: Any, numbers: bool) -> Any:
    from mbdkit.symbolic.build import build_system

    return build_system(mechanism, numbers=numbers)


def _html_of(thing: Any) -> str:
    return str(importlib.import_module("mbdkit.notebook.result_views").html_of(thing))


# Importing any module of the package runs this file first, so these functions are always available below.
higher_layers.installed_plugins = _installed_plugins
higher_layers.symbolic_system = _symbolic_system
html_view.html_of = _html_of
