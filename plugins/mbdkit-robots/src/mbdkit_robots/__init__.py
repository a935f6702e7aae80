"""Planar mechanisms of robots and linkages for mbdkit: the models `urdf`, `mjcf` and `pylinkage` read files."""

from __future__ import annotations

from typing import Any

from mbdkit.plugin import ForceLawPlugin, ModelPlugin, Target, hookimpl

mbdkit_api = 1


def _model(name: str, summary: str, options: str, build: str) -> ModelPlugin:
    home = "mbdkit_robots.models"
    return ModelPlugin(name, summary, Target(f"{home}:{options}", type), Target(f"{home}:{build}"))


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Register the models, whose code is imported when a spec names them."""
    return [
        _model("urdf", "The planar motion of a robot in a URDF file.", "UrdfOptions", "of_urdf"),
        _model("mjcf", "The planar motion of a model in an MJCF file of MuJoCo.", "MjcfOptions", "of_mjcf"),
        _model("pylinkage", "A linkage of pins that pylinkage wrote as JSON.", "LinkageOptions", "of_linkage"),
    ]


@hookimpl
def mbdkit_force_laws() -> list[ForceLawPlugin]:
    """Register the force law."""
    return [
        ForceLawPlugin(
            "dry-friction",
            "Dry friction of constant magnitude, as of joints in URDF and MJCF files.",
            options=Target("mbdkit_robots.models:DryFrictionOptions", type),
            law=Target("mbdkit_robots.models:LAW"),
        )
    ]


def __getattr__(name: str) -> Any:
    if name == "to_pylinkage":
        from mbdkit_robots.linkages import to_pylinkage

        return to_pylinkage
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
