"""mbdkit: simulation of planar multibody systems with constraints.

Public names are imported on first use, which keeps ``import mbdkit`` fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.archive.reader import load as load
    from mbdkit.archive.run import Run as Run
    from mbdkit.base.errors import (
        ArchiveError as ArchiveError, MbdkitError as MbdkitError, PluginError as PluginError,
        ResourceError as ResourceError, RunError as RunError, SpecError as SpecError, StepError as StepError,
    )
    from mbdkit.engine.equations_of_motion import EquationsOfMotion as EquationsOfMotion
    from mbdkit.mechanism.force_law import ExpressionLaw as ExpressionLaw, FunctionLaw as FunctionLaw
    from mbdkit.mechanism.mechanism import Mechanism as Mechanism
    from mbdkit.methods.kinds import (
        ExplicitRungeKutta as ExplicitRungeKutta, ImplicitRungeKutta as ImplicitRungeKutta, Tolerances as Tolerances,
    )
    from mbdkit.methods.step_methods import (
        ExternalMethod as ExternalMethod, Step as Step, StepMethod as StepMethod, StepState as StepState,
    )
    from mbdkit.methods.tableau import ButcherTableau as ButcherTableau, EmbeddedPair as EmbeddedPair
    from mbdkit.registry.hookspecs import hookimpl as hookimpl
    from mbdkit.registry.items import (
        Claims as Claims, ForceLawPlugin as ForceLawPlugin, IntegratorPlugin as IntegratorPlugin,
        MeasurePlugin as MeasurePlugin, ModelPlugin as ModelPlugin, StudyPlugin as StudyPlugin,
    )
    from mbdkit.runs.resuming import resume as resume
    from mbdkit.runs.simulation import run as run
    from mbdkit.runs.stepping.open_simulation import open as open
    from mbdkit.runs.stepping.simulation_state import SimulationState as SimulationState
    from mbdkit.spec import RunSpec as RunSpec
    from mbdkit.spec.loading import load_spec as load_spec
    from mbdkit_biomech.inverse_dynamics.gradient.inverse_gradient import inverse_gradient as inverse_gradient
    from mbdkit_biomech.inverse_dynamics.results.inverse_run import inverse as inverse
    from mbdkit_biomech.inverse_dynamics.results.workload import workload as workload
    from mbdkit_design.solve_design import design as design, load_design as load_design
    from mbdkit_explore.server import explore as explore
    from mbdkit_gradients.measure_gradients import gradient as gradient
    from mbdkit_gradients.sensitivities import sensitivities as sensitivities
    from mbdkit_identify.archive import load_identification as load_identification
    from mbdkit_identify.identify import identify as identify
    from mbdkit_predict.prediction import predict as predict
    from mbdkit_report import plot as plot
    from mbdkit_statics.equilibrium import equilibrium as equilibrium
    from mbdkit_statics.equilibrium_path import equilibrium_path as equilibrium_path
    from mbdkit_statics.kinematics import kinematics as kinematics
    from mbdkit_statics.modes import linearize as linearize, modes as modes
    from mbdkit_studies.compute.carry_out import ensemble as ensemble, load_study as load_study, study as study
    from mbdkit_studies.lanes.prepared_run import prepare as prepare
    from mbdkit_studies.study import Study as Study
    # fmt: on

    __version__: str
else:
    _names, _dir = door(globals())
    __all__ = ["__version__", *_dir()]

    def __getattr__(name):
        if name == "__version__":
            from mbdkit.base.distributions import own_version

            return own_version()
        if name in ("kernels", "plugin", "testing"):  # modules for authors, which `import *` does not import
            return import_module(f"mbdkit.{name}")
        return _names(name)

    def __dir__():
        return sorted(__all__)
