"""Imports of modules under their old names, which work for one version with a warning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType

from mbdkit.base.lazy_names import import_part

MOVED = {
    "mbdkit.analysis.cost": "mbdkit_studies.cost",
    "mbdkit.analysis.sample_statistics": "mbdkit_studies.sample_statistics",
    "mbdkit.analysis.sobol_indices": "mbdkit_studies.sobol_indices",
    "mbdkit.analysis.cycles": "mbdkit_biomech.inverse_dynamics.cycles",
    "mbdkit.analysis.workload": "mbdkit_biomech.inverse_dynamics.workload",
    "mbdkit.analysis": "mbdkit_report.analysis",
    "mbdkit.archive.block_writer": "mbdkit_studies.block_writer",
    "mbdkit.archive.blocks": "mbdkit_studies.blocks",
    "mbdkit.archive.columns": "mbdkit_studies.columns",
    "mbdkit.archive.history_columns": "mbdkit_testing.history_columns",
    "mbdkit.archive.inverse_summary": "mbdkit_biomech.inverse_dynamics.inverse_summary",
    "mbdkit.archive.layout_document": "mbdkit_testing.layout_document",
    "mbdkit.designs": "mbdkit_design",
    "mbdkit.engine.compiler": "mbdkit_builder",
    "mbdkit.engine.contact_forces": "mbdkit_contact.acting_contacts",
    "mbdkit.engine.ground_reactions": "mbdkit_contact.ground_reactions",
    "mbdkit.exploration": "mbdkit_explore",
    "mbdkit.figures": "mbdkit_report.figures",
    "mbdkit.engine.kernels.contact_laws": "mbdkit_contact.kernels.contact_laws",
    "mbdkit.engine.kernels.uneven_ground": "mbdkit_contact.kernels.uneven_ground",
    "mbdkit.integrators.closed_contacts": "mbdkit_contact.closed_contacts",
    "mbdkit.integrators.complementarity": "mbdkit_contact.complementarity",
    "mbdkit.integrators.contact_impacts": "mbdkit_contact.contact_impacts",
    "mbdkit.integrators.contact_kinematics": "mbdkit_contact.contact_kinematics",
    "mbdkit.integrators.contact_state": "mbdkit_contact.contact_state",
    "mbdkit.integrators.event_driven": "mbdkit_contact.event_driven",
    "mbdkit.integrators.event_step": "mbdkit_contact.event_step",
    "mbdkit.integrators.forced_equations": "mbdkit_contact.forced_equations",
    "mbdkit.integrators.generalized_alpha": "mbdkit_contact.stepping",
    "mbdkit.integrators.rigid_contacts": "mbdkit_contact.rigid_contacts",
    "mbdkit.integrators.step_impulses": "mbdkit_contact.stepping",
    "mbdkit.integrators.time_stepping": "mbdkit_contact.stepping",
    "mbdkit.integrators.lane_stepper": "mbdkit_studies.lane_stepper",
    "mbdkit.inverse_dynamics": "mbdkit_biomech.inverse_dynamics",
    "mbdkit.mechanics.source": "mbdkit_statics.prepared_mechanism",
    "mbdkit.mechanics": "mbdkit_statics",
    "mbdkit.mechanism.contacts": "mbdkit_contact.modes",
    "mbdkit.mechanism.polylines": "mbdkit_contact.polylines",
    "mbdkit.mechanism.symbolic_system": "mbdkit_statics.symbolic_system",
    "mbdkit.mechanism.unit_of_use": "mbdkit_explore.unit_of_use",
    "mbdkit.methods.moreau_jean": "mbdkit_contact.time_stepping_methods",
    "mbdkit.models.leg": "mbdkit_biomech.models.leg",
    "mbdkit.muscles.fibers": "mbdkit_biomech.inverse_dynamics.fibers",
    "mbdkit.muscles": "mbdkit_biomech.muscles",
    "mbdkit.mechanism.muscles": "mbdkit_biomech.muscles.muscle",
    "mbdkit.notebook.example_notebooks": "mbdkit.spec.example_notebooks",
    "mbdkit.notebook": "mbdkit_report.notebook",
    "mbdkit.plot.equilibrium_plot": "mbdkit_statics.equilibrium_plot",
    "mbdkit.plot.mode_shapes": "mbdkit_statics.mode_shapes",
    "mbdkit.plot": "mbdkit_report.plot",
    "mbdkit.report.design_charts": "mbdkit_design.design_charts",
    "mbdkit.report.design_report": "mbdkit_design.design_report",
    "mbdkit.report.design_verdict": "mbdkit_design.design_verdict",
    "mbdkit.report.sensitivity_bars": "mbdkit_design.sensitivity_bars",
    "mbdkit.report.sample_figures": "mbdkit_studies.sample_figures",
    "mbdkit.report.study_figures": "mbdkit_studies.study_figures",
    "mbdkit.report.study_report": "mbdkit_studies.study_report",
    "mbdkit.report.load_frames": "mbdkit_biomech.inverse_dynamics.load_frames",
    "mbdkit.report.load_sections": "mbdkit_biomech.inverse_dynamics.load_sections",
    "mbdkit.report": "mbdkit_report.pages",
    "mbdkit.runs.batch": "mbdkit_studies.batch",
    "mbdkit.runs.deep_overlaps": "mbdkit_contact.deep_overlaps",
    "mbdkit.runs.given_start": "mbdkit_studies.given_start",
    "mbdkit.runs.lane_runs": "mbdkit_studies.lane_runs",
    "mbdkit.runs.prepared_run": "mbdkit_studies.prepared_run",
    "mbdkit.scaffold": "mbdkit_testing.scaffold",
    "mbdkit.spec.design_loading": "mbdkit_design.design_loading",
    "mbdkit.spec.design_spec": "mbdkit_design.design_spec",
    "mbdkit.spec.inverse_loading": "mbdkit_biomech.inverse_dynamics.inverse_loading",
    "mbdkit.spec.inverse_sections": "mbdkit_biomech.inverse_dynamics.inverse_sections",
    "mbdkit.spec.inverse_spec": "mbdkit_biomech.inverse_dynamics.inverse_spec",
    "mbdkit.spec.key_words": "mbdkit_report.key_words",
    "mbdkit.spec.named_actuators": "mbdkit_biomech.inverse_dynamics.named_actuators",
    "mbdkit.spec.polyline_files": "mbdkit_contact.polyline_files",
    "mbdkit.spec.sample_section": "mbdkit_studies.sample_section",
    "mbdkit.spec.spec_page": "mbdkit_testing.spec_page",
    "mbdkit.spec.study_loading": "mbdkit_studies.study_loading",
    "mbdkit.spec.study_spec": "mbdkit_studies.study_spec",
    "mbdkit.spec.value_sets": "mbdkit_studies.value_sets",
    "mbdkit.studies.packaged": "mbdkit_paper",
    "mbdkit.stepping": "mbdkit.integrators",
    "mbdkit.studies": "mbdkit_studies",
    "mbdkit.symbolic.__main__": "mbdkit_builder.element_kernels",
    "mbdkit.symbolic.build": "mbdkit_statics.symbolic_equations",
    "mbdkit.symbolic.definitions": "mbdkit_statics.element_definitions",
    "mbdkit.symbolic.generate": "mbdkit_builder.element_kernels",
    "mbdkit.testing": "mbdkit_testing",
}
"""New names of modules and packages; the first prefix that fits counts."""

STABLE = ("mbdkit.plot", "mbdkit.testing")
"""Names that stay: they are documented as names of mbdkit."""


def current_name(name: str) -> str | None:
    """Return the current name of a module that was moved, or None if it was not."""
    if not name.startswith("mbdkit."):
        return None
    for old, new in MOVED.items():
        if name == old or name.startswith(f"{old}."):
            return new + name.removeprefix(old)
    return None


class _MovedModules:
    """Finder (PEP 451) of modules under their old names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to import the module of this old name, or None if no module was moved from it."""
        current = current_name(fullname)
        if current is None:
            return None
        if not fullname.startswith(STABLE):
            message = f"{fullname} is now {current}; its old name works until mbdkit 0.4"
            warnings.warn(message, DeprecationWarning, stacklevel=2)
        loader = _SameModule(fullname, current)
        is_package = hasattr(loader.module, "__path__")
        return ModuleSpec(fullname, loader, is_package=is_package)  # type: ignore[arg-type]


class _SameModule:
    """Loader that imports the module under its current name. It derives from no class of `importlib.abc`, whose import
    would take a tenth of the time of ``mbdkit --help``.
    """

    def __init__(self, old: str, name: str) -> None:
        self.module = import_part(name, old)
        self.spec = self.module.__spec__

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module under its current name."""
        return self.module

    def get_code(self, fullname: str) -> CodeType | None:
        """Return the code of the module, for ``python -m``."""
        code: CodeType | None = self.spec.loader.get_code(self.module.__name__)  # type: ignore[union-attr]
        return code

    def get_source(self, fullname: str) -> str | None:
        """Return no source: tracebacks read that of the module under its current name."""
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own spec, which the import system has replaced by that of the old name."""
        module.__spec__ = self.spec


def install() -> None:
    """Let old names be imported."""
    if not any(isinstance(finder, _MovedModules) for finder in sys.meta_path):
        # before the finder of paths, which would load a second copy
        sys.meta_path.insert(0, _MovedModules())
