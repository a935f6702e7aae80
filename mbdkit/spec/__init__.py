"""Specs of runs, studies and designs: reading from YAML, TOML, JSON, a dict or a Mechanism, and strict validation."""

from mbdkit.spec.design_loading import load_design_spec
from mbdkit.spec.design_spec import DesignSpec
from mbdkit.spec.inverse_spec import InverseSpec
from mbdkit.spec.loading import example_names, example_text, load_inverse_spec, load_spec
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.sections import Limits, Output, Time
from mbdkit.spec.study_loading import load_study_spec, study_names
from mbdkit.spec.study_spec import StudySpec

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
