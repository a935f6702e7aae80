"""A pair of walking legs for mbdkit: an example of a model with drivers."""

from __future__ import annotations

from mbdkit.plugin import ModelPlugin, Target, hookimpl

mbdkit_api = {"models": 1}


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Register the model, whose code is imported when a spec names it."""
    return [
        ModelPlugin(
            "walker",
            "A pair of legs on a treadmill: hips, and if wanted knees, driven by measured angles.",
            options=Target("mbdkit_walker.walker:WalkerOptions"),
            build=Target("mbdkit_walker.walker:build"),
            references=Target("mbdkit_walker.walker:REFERENCES"),
        )
    ]
