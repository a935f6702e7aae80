"""Specs of runs, studies and designs: reading from YAML, TOML, JSON, a dict or a Mechanism, and strict validation.

A module is imported when one of its names is first used, so that a run does not import the specs of studies and
designs.
"""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import lazy

if TYPE_CHECKING:
    from mbdkit.spec.loading import example_names, example_text, load_spec
    from mbdkit.spec.run_spec import RunSpec
    from mbdkit.spec.sections import Limits, Output, Time
    from mbdkit_biomech.inverse_dynamics.inverse_loading import load_inverse_spec
    from mbdkit_biomech.inverse_dynamics.inverse_spec import InverseSpec
    from mbdkit_design.design_loading import load_design_spec
    from mbdkit_design.design_spec import DesignSpec
    from mbdkit_studies.study_loading import load_study_spec, study_names
    from mbdkit_studies.study_spec import StudySpec

__all__ = [
    "DesignSpec",
    "InverseSpec",
    "Limits",
    "Output",
    "RunSpec",
    "StudySpec",
    "Time",
    "example_names",
    "example_text",
    "load_design_spec",
    "load_inverse_spec",
    "load_spec",
    "load_study_spec",
    "study_names",
]

if not TYPE_CHECKING:
    _HOMES = {
        "mbdkit_design.design_loading": ["load_design_spec"],
        "mbdkit_design.design_spec": ["DesignSpec"],
        "mbdkit_biomech.inverse_dynamics.inverse_loading": ["load_inverse_spec"],
        "mbdkit_biomech.inverse_dynamics.inverse_spec": ["InverseSpec"],
        "mbdkit.spec.loading": ["example_names", "example_text", "load_spec"],
        "mbdkit.spec.run_spec": ["RunSpec"],
        "mbdkit.spec.sections": ["Limits", "Output", "Time"],
        "mbdkit_studies.study_loading": ["load_study_spec", "study_names"],
        "mbdkit_studies.study_spec": ["StudySpec"],
    }
    __getattr__ = lazy(globals(), {name: module for module, names in _HOMES.items() for name in names})
