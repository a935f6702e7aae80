"""The study that executors compute."""

from __future__ import annotations

from typing import Any

RUN = {"integrator": {"name": "rk4"}, "time": {"end": 0.2, "step": 0.01}}


BASE: dict[str, Any] = {"mbdkit": 1, "model": {"name": "double-pendulum"}, **RUN}
