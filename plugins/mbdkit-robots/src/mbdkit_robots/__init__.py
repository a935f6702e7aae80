"""Planar mechanisms of robots and linkages for mbdkit: the models `urdf`, `mjcf` and `pylinkage` read files."""

from __future__ import annotations

from mbdkit.plugin import ForceLawPlugin, ModelPlugin, Target, hookimpl

mbdkit_api = {"models": 1, "laws": 1}

#: Models: name, class of the options, function that builds it, and summary.
MODELS = (
    ("urdf", "UrdfOptions", "of_urdf", "The planar motion of a robot in a URDF file."),
    ("mjcf", "MjcfOptions", "of_mjcf", "The planar motion of a model in an MJCF file of MuJoCo."),
    ("pylinkage", "LinkageOptions", "of_linkage", "A linkage of pins that pylinkage wrote as JSON."),
)


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Register the models, whose code is imported when a spec names them."""
    return [
        ModelPlugin(
            name,
            summary,
            options=Target(f"mbdkit_robots.models:{options}"),
            build=Target(f"mbdkit_robots.models:{build}"),
        )
        for name, options, build, summary in MODELS
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
