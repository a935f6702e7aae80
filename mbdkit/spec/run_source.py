"""Types of what a run, a study or a computation is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict

from mbdkit.engine.formulation import FormulationName
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec.inverse_spec import InverseSpec
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.study_spec import StudySpec

Section: TypeAlias = Mapping[str, object]
"""A section of a spec, such as ``{"name": "gauss", "stages": 2}``."""

RunSource: TypeAlias = str | Path | Mapping[str, object] | RunSpec | Mechanism
"""A file, the name of a packaged example, a mapping, a validated spec, or a mechanism."""

InverseSource: TypeAlias = str | Path | Mapping[str, object] | InverseSpec
"""A file, the name of a packaged example, a mapping, or a validated spec of inverse dynamics."""

StudySource: TypeAlias = str | Path | Mapping[str, object] | StudySpec
"""A file, the name of a packaged study, a mapping, or a validated spec."""


class Sections(TypedDict, total=False):
    """Top-level keys of a run spec as keyword arguments; see `mbdkit.RunSpec` for their meaning."""

    mbdkit: Literal[1]
    title: str
    parameters: Mapping[str, float | str]
    model: Section
    formulation: FormulationName
    stabilization: Section
    integrator: Section
    time: Section
    output: Section
    events: Mapping[str, Section]
    measures: Mapping[str, str | Mapping[str, Any]]
    gradients: Sequence[str]
    limits: Section
    check: bool
    accuracy: float | None
    choose: Literal["method", "step", "nothing"] | None
    impacts: Literal["refuse", "allow"]
