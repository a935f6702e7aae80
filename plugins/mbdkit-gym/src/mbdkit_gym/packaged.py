"""The packaged environments, each of which is a YAML file with the arguments of `mbdkit_gym.Environment`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gymnasium.envs.registration import register

from mbdkit.plugin.specs import read_source
from mbdkit_gym.environment import Environment
from mbdkit_gym.vector_environment import VectorEnvironment

_FOLDER = Path(__file__).parent / "environments"


def register_environments() -> None:
    """Register the packaged environments with Gymnasium, as ``mbdkit/NAME-v0``."""
    for file in sorted(_FOLDER.glob("*.yaml")):
        register(
            f"mbdkit/{file.stem}-v0",
            entry_point=f"{__name__}:environment",
            vector_entry_point=f"{__name__}:vector_environment",
            kwargs={"name": file.stem},
        )


def arguments(name: str) -> dict[str, Any]:
    """Return the arguments of a packaged environment."""
    return dict(read_source(_FOLDER / f"{name}.yaml").data)


def environment(name: str, **changed: Any) -> Environment:
    """Return a packaged environment, some arguments of which may be changed."""
    return Environment(**(arguments(name) | changed))


def vector_environment(name: str, num_envs: int, **changed: Any) -> VectorEnvironment:
    """Return `num_envs` packaged environments that advance together."""
    return VectorEnvironment(**(arguments(name) | changed), number=num_envs)
