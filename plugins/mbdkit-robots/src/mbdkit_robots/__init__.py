"""Planar mechanisms of robots and linkages for mbdkit: the models `urdf`, `mjcf` and `pylinkage` read files."""

from __future__ import annotations

from mbdkit.plugin import ForceLawPlugin, ModelPlugin, Target, hookimpl

mbdkit_api = {"models": 1, "laws": 1}


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Register the models, whose code is imported when a spec names them."""
    return [
        ModelPlugin(
            "urdf",
            "The planar motion of a robot in a URDF file.",
            options=Target("mbdkit_robots.models:UrdfOptions"),
            build=Target("mbdkit_robots.models:of_urdf"),
        ),
        ModelPlugin(
            "mjcf",
            "The planar motion of a model in an MJCF file of MuJoCo.",
            options=Target("mbdkit_robots.models:MjcfOptions"),
            build=Target("mbdkit_robots.models:of_mjcf"),
        ),
        ModelPlugin(
            "pylinkage",
            "A linkage of pins that pylinkage wrote as JSON.",
            options=Target("mbdkit_robots.models:LinkageOptions"),
            build=Target("mbdkit_robots.models:of_linkage"),
        ),
    ]


@hookimpl
def mbdkit_force_laws() -> list[ForceLawPlugin]:
    """Register the force law."""
    return [
        ForceLawPlugin(
            "dry-friction",
            "Dry friction of constant magnitude, as of joints in URDF and MJCF files.",
            options=Target("mbdkit_robots.models:DryFrictionOptions"),
            law=Target("mbdkit_robots.models:LAW"),
        )
    ]
