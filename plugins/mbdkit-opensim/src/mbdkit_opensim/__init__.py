"""Planar OpenSim models for mbdkit: the model `opensim` reads an `.osim` file."""

from __future__ import annotations

from mbdkit.plugin import ModelPlugin, Target, hookimpl

mbdkit_api = {"models": 1}


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Register the model, whose code is imported when a spec names it."""
    return [
        ModelPlugin(
            "opensim",
            "The sagittal plane of an OpenSim model: pins, slides, welds, moving centres, muscles.",
            options=Target("mbdkit_opensim.model:OpenSimOptions"),
            build=Target("mbdkit_opensim.model:build"),
            references=Target("mbdkit_opensim.model:REFERENCES"),
        )
    ]
