"""The packaged studies: one folder each, with study.yaml and, if the study has its own verdict, verdict.py."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mbdkit.registry.items import StudyPlugin
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent


def _methods(quick: bool) -> dict[str, object]:
    """Return the spec of the study `methods`, whose runs depend on what is installed."""
    from mbdkit_paper.methods.study import study

    return study(quick)


def _study(
    name: str,
    summary: str,
    spec: Callable[[bool], dict[str, object]] | None = None,
    references: Target | tuple[str, ...] = (),
) -> StudyPlugin:
    """Return the item of a study, whose folder has its name. `spec`: function that returns its spec, if not a file."""
    folder = _HERE / name.replace("-", "_")
    has_verdict = (folder / "verdict.py").is_file()
    verdict = Target(f"mbdkit_paper.{folder.name}.verdict:verdict") if has_verdict else None
    return StudyPlugin(name, summary, spec or folder / "study.yaml", verdict, references)


STUDIES = (
    _study(
        "paper",
        "Results, claims and predictions of the source paper on RK-Gill and Gauss methods, recomputed and tested.",
        references=Target("mbdkit_paper.paper.source_paper:REFERENCES"),
    ),
    _study("contact", "Error, work, penetration and creep of compliant, event-driven and time-stepping contact."),
    _study("convergence", "Error and misalignment of the double pendulum against the step, for six methods."),
    _study("drift", "Order, drift, energy and cost of formulations and stabilizations."),
    _study(
        "flexible-slider-crank",
        "Joint forces and misalignment of a slider-crank with a flexible rod, by explicit and implicit methods.",
    ),
    _study("knee-spring", "Sobol indices of the knee force for stiffness and ends of a support, and body mass."),
    _study(
        "methods",
        "Error, drift, forces and cost of all installed integrators on problems with published results.",
        spec=_methods,
    ),
    _study("no-drift", "Misalignment over 100,000 steps with projected methods and index-reduced formulations."),
    _study(
        "textbook-four-bar",
        "The four-bar linkage of a textbook: published loop residuals, and those of mbdkit's methods.",
    ),
)
