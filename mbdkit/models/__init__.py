"""The built-in models; each builds a mechanism from a few parameters."""

from __future__ import annotations

from typing import Any

from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.target import Target


def _target(module: str, name: str, kind: Any = None) -> Any:
    return Target(f"{__name__}.{module}:{name}", kind)


def _model(
    order: int, name: str, summary: str, module: str, options: str, build: str = "build", references: str = ""
) -> ModelPlugin:
    sources = _target(module, references, tuple) if references else ()
    return ModelPlugin(name, summary, _target(module, options, type), _target(module, build), sources, order)


MODELS = (
    _model(
        10,
        "single-pendulum",
        "One rod attached to the ground by a revolute joint.",
        "pendulums",
        "SinglePendulumOptions",
        "build_single",
    ),
    _model(20, "double-pendulum", "Two rods in a chain.", "pendulums", "DoublePendulumOptions", "build_double"),
    _model(
        30,
        "n-pendulum",
        "A chain of n rods, with equal or individual parameters.",
        "pendulums",
        "NPendulumOptions",
        "build_n",
    ),
    _model(
        40,
        "n-four-bar",
        "N four-bar windows in a row, with two singular positions per turn (IFToMM benchmark A02).",
        "n_four_bar",
        "NFourBarOptions",
        references="REFERENCES",
    ),
    _model(
        80, "mechanism", "Any mechanism of named bodies, joints, drivers and forces.", "free_form", "MechanismOptions"
    ),
)
"""The built-in models, in the order in which `mbdkit plugins list` shows them."""
