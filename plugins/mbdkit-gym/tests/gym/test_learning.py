"""The script of the guide for Stable-Baselines3 learns to swing up and balance the pole of the packaged environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.printed_code import fenced_blocks

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed: pip install mbdkit[learn]")

GUIDE = Path(mbdkit.__file__).parent / "guide" / "environments.md"
EPISODES = 20
UPRIGHT = 0.95
"""Sine of the angle of the pole, which has to be larger during the last two seconds of ten."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ppo_swings_up_and_balances_the_pole(seed: int) -> None:
    import gymnasium
    import torch

    torch.set_num_threads(1)
    (script,) = (block.code for block in fenced_blocks(GUIDE.read_text(encoding="utf-8")) if "PPO(" in block.code)
    assert "seed = 0\n" in script
    names: dict[str, Any] = {}
    exec(script.replace("seed = 0\n", f"seed = {seed}\n"), names)
    model = names["model"]
    assert model.num_timesteps <= 1_000_000
    environment = gymnasium.make("mbdkit/CartPole-v0")
    balanced = 0
    for episode in range(EPISODES):
        observation, _ = environment.reset(seed=1000 + episode)
        sines: list[float] = []
        terminated = truncated = False
        while not (terminated or truncated):
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, _ = environment.step(action)
            sines.append(float(observation[2]))
        balanced += truncated and np.min(sines[-50:]) > UPRIGHT
    assert balanced == EPISODES
