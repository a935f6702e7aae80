"""The packaged studies: one folder each, with study.yaml and, if the study has its own verdict, verdict.py."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING

from mbdkit.registry.items import StudyPlugin
from mbdkit.studies.packaged.paper.source_paper import BIBTEX

if TYPE_CHECKING:
    from mbdkit.analysis.verdict import Verdict
    from mbdkit.studies.study import Study


def _packaged(name: str, summary: str, *references: str) -> StudyPlugin:
    """Return the study in the folder of this name, with hyphens as underscores."""
    folder = Path(__file__).parent / name.replace("-", "_")

    def verdict(
        study: Study,
    ) -> Verdict:  # imported at the call: verdicts need SciPy, and loading plugins should be fast
        module = importlib.import_module(f"{__name__}.{folder.name}.verdict")
        judged: Verdict = module.verdict(study)
        return judged

    has_verdict = (folder / "verdict.py").is_file()
    return StudyPlugin(name, summary, folder / "study.yaml", verdict if has_verdict else None, references)


STUDIES = (
    _packaged(
        "paper",
        "Results, claims and predictions of the source paper on RK-Gill and Gauss methods, recomputed and tested.",
        BIBTEX,
    ),
    _packaged("contact", "Error, work, penetration and creep of compliant, event-driven and time-stepping contact."),
    _packaged("convergence", "Error and misalignment of the double pendulum against the step, for six methods."),
    _packaged("drift", "Order, drift, energy and cost of formulations and stabilizations."),
    _packaged(
        "flexible-slider-crank",
        "Joint forces and misalignment of a slider-crank with a flexible rod, by explicit and implicit methods.",
    ),
    _packaged("knee-spring", "Sobol indices of the knee force for stiffness and ends of a support, and body mass."),
    _packaged("no-drift", "Misalignment over 100,000 steps with projected methods and index-reduced formulations."),
    _packaged(
        "textbook-four-bar",
        "The four-bar linkage of a textbook: published loop residuals, and those of mbdkit's methods.",
    ),
)
