"""The packaged studies: one folder each, with study.yaml and, if the study has its own verdict, verdict.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbdkit.plugin import StudyPlugin, Target


def _packaged(name: str, summary: str, references: Any = ()) -> StudyPlugin:
    folder = Path(__file__).parent / name.replace("-", "_")
    has_verdict = (folder / "verdict.py").is_file()
    verdict = Target[Any](f"{__name__}.{folder.name}.verdict:verdict") if has_verdict else None
    return StudyPlugin(name, summary, folder / "study.yaml", verdict, references)


STUDIES = (
    _packaged(
        "paper",
        "Results, claims and predictions of the source paper on RK-Gill and Gauss methods, recomputed and tested.",
        Target(f"{__name__}.paper.source_paper:REFERENCES", tuple),
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
