"""The built-in models; each builds a mechanism from a few parameters."""

from __future__ import annotations

from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.target import Target

# fmt: off
#: The built-in models, in the order in which `mbdkit plugins list` shows them.
MODELS = (
    ModelPlugin(
        name="single-pendulum", summary="One rod attached to the ground by a revolute joint.",
        options=Target("mbdkit.models.pendulums:SinglePendulumOptions"),
        build=Target("mbdkit.models.pendulums:build_single"), order=10,
    ),
    ModelPlugin(
        name="double-pendulum", summary="Two rods in a chain.",
        options=Target("mbdkit.models.pendulums:DoublePendulumOptions"),
        build=Target("mbdkit.models.pendulums:build_double"), order=20,
    ),
    ModelPlugin(
        name="n-pendulum", summary="A chain of n rods, with equal or individual parameters.",
        options=Target("mbdkit.models.pendulums:NPendulumOptions"), build=Target("mbdkit.models.pendulums:build_n"),
        order=30,
    ),
    ModelPlugin(
        name="n-four-bar",
        summary="N four-bar windows in a row, with two singular positions per turn (IFToMM benchmark A02).",
        options=Target("mbdkit.models.n_four_bar:NFourBarOptions"), build=Target("mbdkit.models.n_four_bar:build"),
        references=Target("mbdkit.models.n_four_bar:REFERENCES"), order=40,
    ),
    ModelPlugin(
        name="mechanism", summary="Any mechanism of named bodies, joints, drivers and forces.",
        options=Target("mbdkit.models.free_form:MechanismOptions"), build=Target("mbdkit.models.free_form:build"),
        order=80,
    ),
)
# fmt: on
