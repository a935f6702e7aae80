"""Checkpoints made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.archive.checkpoint import Checkpoint, StoredRows


def checkpoint_of(state: Any) -> Checkpoint:
    head = {"spec": "{}", "run_id": "a", "created_utc": "now", "provenance": {"mbdkit": "1"}}
    arrays = {"energy/total": StoredRows((), 4, np.array([8, 99]), ()), "events/name": StoredRows((), 1, NONE, ("up",))}
    return Checkpoint(head, 7, {"time": 5}, ("line",), arrays, state)


NONE = np.zeros(0, np.int64)
