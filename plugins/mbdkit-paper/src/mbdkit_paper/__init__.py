"""The packaged studies: one folder each, with study.yaml and, if the study has its own verdict, verdict.py."""

from __future__ import annotations

from pathlib import Path

from mbdkit.registry.items import StudyPlugin
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent


def _methods(quick: bool) -> dict[str, object]:
    """Return the spec of the study `methods`, whose runs depend on what is installed."""
    from mbdkit_paper.methods.study import study

    return study(quick)


STUDIES = (
    StudyPlugin(
        "paper",
        "Results, claims and predictions of the source paper on RK-Gill and Gauss methods, recomputed and tested.",
        _HERE / "paper" / "study.yaml",
        Target("mbdkit_paper.paper.verdict:verdict"),
        Target("mbdkit_paper.paper.source_paper:REFERENCES"),
    ),
    StudyPlugin(
        "contact",
        "Error, work, penetration and creep of compliant, event-driven and time-stepping contact.",
        _HERE / "contact" / "study.yaml",
        Target("mbdkit_paper.contact.verdict:verdict"),
    ),
    StudyPlugin(
        "convergence",
        "Error and misalignment of the double pendulum against the step, for six methods.",
        _HERE / "convergence" / "study.yaml",
    ),
    StudyPlugin(
        "drift",
        "Order, drift, energy and cost of formulations and stabilizations.",
        _HERE / "drift" / "study.yaml",
        Target("mbdkit_paper.drift.verdict:verdict"),
    ),
    StudyPlugin(
        "flexible-slider-crank",
        "Joint forces and misalignment of a slider-crank with a flexible rod, by explicit and implicit methods.",
        _HERE / "flexible_slider_crank" / "study.yaml",
        Target("mbdkit_paper.flexible_slider_crank.verdict:verdict"),
    ),
    StudyPlugin(
        "knee-spring",
        "Sobol indices of the knee force for stiffness and ends of a support, and body mass.",
        _HERE / "knee_spring" / "study.yaml",
    ),
    StudyPlugin(
        "methods",
        "Error, drift, forces and cost of all installed integrators on problems with published results.",
        _methods,
        Target("mbdkit_paper.methods.verdict:verdict"),
    ),
    StudyPlugin(
        "no-drift",
        "Misalignment over 100,000 steps with projected methods and index-reduced formulations.",
        _HERE / "no_drift" / "study.yaml",
        Target("mbdkit_paper.no_drift.verdict:verdict"),
    ),
    StudyPlugin(
        "textbook-four-bar",
        "The four-bar linkage of a textbook: published loop residuals, and those of mbdkit's methods.",
        _HERE / "textbook_four_bar" / "study.yaml",
        Target("mbdkit_paper.textbook_four_bar.verdict:verdict"),
    ),
)
