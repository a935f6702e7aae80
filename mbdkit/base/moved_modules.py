"""Imports of modules under their old names, which work for one version with a warning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType

from mbdkit.base.lazy_names import import_part

_SAME_NAME = {
    "mbdkit.spec": "notebook.example_notebooks",
    "mbdkit_biomech": "inverse_dynamics muscles",
    "mbdkit_biomech.inverse_dynamics": """
        analysis.cycles analysis.workload archive.inverse_summary engine.interpolating_splines muscles.fibers
        report.load_frames report.load_sections spec.inverse_loading spec.inverse_sections spec.inverse_spec
        spec.named_actuators""",
    "mbdkit_biomech.models": "models.four_bar_knee models.leg",
    "mbdkit_contact": """
        engine.ground_reactions integrators.closed_contacts integrators.complementarity
        integrators.contact_impacts integrators.contact_kinematics integrators.contact_state
        integrators.event_driven integrators.event_step integrators.forced_equations integrators.rigid_contacts
        mechanism.polylines runs.deep_overlaps spec.polyline_files""",
    "mbdkit_contact.kernels": "engine.kernels.contact_laws engine.kernels.uneven_ground",
    "mbdkit_design": """
        report.design_charts report.design_report report.design_verdict report.sensitivity_bars
        spec.design_loading spec.design_spec""",
    "mbdkit_gradients": """
        integrators.differentiated_laws integrators.differentiated_sampling integrators.differentiated_stepper""",
    "mbdkit_report": """
        analysis archive.export archive.group_table archive.table_formats archive.xarray_tree figures notebook plot
        mechanism.unit_of_use spec.key_words""",
    "mbdkit_statics": "mechanism.symbolic_system plot.equilibrium_plot plot.mode_shapes",
    "mbdkit_studies": """
        analysis.cost analysis.sample_statistics analysis.sobol_indices archive.block_writer archive.blocks
        archive.columns integrators.lane_stepper report.sample_figures report.study_figures report.study_report
        runs.batch runs.given_start runs.lane_runs runs.prepared_run spec.sample_section spec.study_loading
        spec.study_spec spec.value_sets""",
    "mbdkit_taylor": "engine.known_series methods.taylor",
    "mbdkit_taylor.kernels": "engine.kernels.power_series engine.kernels.tree_series integrators.taylor_series",
    "mbdkit_testing": """
        archive.history_columns archive.layout_document guide.item_places registry.describe scaffold spec.spec_page""",
}
"""Modules, without the prefix ``mbdkit.``, that kept the last part of their name, by their new packages."""

_OTHER_NAME = {
    "cli.plugins": "mbdkit_testing.commands",
    "designs": "mbdkit_design",
    "engine.compiler": "mbdkit_builder",
    "engine.contact_forces": "mbdkit_contact.acting_contacts",
    "exploration": "mbdkit_explore",
    "gradients": "mbdkit_gradients",
    "integrators.generalized_alpha": "mbdkit_contact.stepping",
    "integrators.step_impulses": "mbdkit_contact.stepping",
    "integrators.time_stepping": "mbdkit_contact.stepping",
    "mechanics": "mbdkit_statics",
    "mechanics.source": "mbdkit_statics.prepared_mechanism",
    "mechanism.contacts": "mbdkit_contact.modes",
    "mechanism.muscles": "mbdkit_biomech.muscles.muscle",
    "methods.moreau_jean": "mbdkit_contact.time_stepping_methods",
    "registry.whereabouts": "mbdkit_testing.item_places",
    "report": "mbdkit_report.pages",
    "stepping": "mbdkit.integrators",
    "studies": "mbdkit_studies",
    "studies.packaged": "mbdkit_paper",
    "symbolic.__main__": "mbdkit_builder.element_kernels",
    "symbolic.build": "mbdkit_statics.symbolic_equations",
    "symbolic.definitions": "mbdkit_statics.element_definitions",
    "symbolic.generate": "mbdkit_builder.element_kernels",
    "testing": "mbdkit_testing",
}
"""New names of other modules and packages, by their old names without the prefix ``mbdkit.``."""

MOVED = {
    f"mbdkit.{old}": f"{new}.{old.rpartition('.')[2]}" for new, several in _SAME_NAME.items() for old in several.split()
}
MOVED |= {f"mbdkit.{old}": new for old, new in _OTHER_NAME.items()}
MOVED = dict(sorted(MOVED.items(), reverse=True))
"""New names of modules and packages; the first prefix that fits counts, and longer ones come first."""

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
