"""The keys `accuracy` and `choose` of a run spec: what they imply for its other keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbdkit.base.errors import SpecError

SMALLEST, LARGEST = 1e-12, 0.1
"""Limits of `accuracy`: rounding errors dominate below the first, and no digit is right above the second."""

EXPLICIT: Mapping[str, Any] = {"name": "dop853", "adaptive": True}
"""Method of a spec that names none; stiff mechanisms are given another one when it is chosen."""

IMPLICIT: Mapping[str, Any] = {"name": "radau-iia", "stages": 5, "adaptive": True}
"""The same for formulations other than index-1, which explicit methods do not support."""

SYMMETRIC: Mapping[str, Any] = {"name": "gauss", "stages": 3}
"""The same for symmetric projection, which needs fixed steps."""


def asked(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data of a run spec with the keys that follow from `accuracy`.

    Raises
    ------
    SpecError
        If `choose` is given without `accuracy`.
    """
    data = dict(data)
    if data.get("accuracy") is None:
        if data.get("choose") is not None:
            raise SpecError("takes effect only with `accuracy`; leave it out", key="choose")
        return data
    if data.get("choose") is None:
        data["choose"] = "step" if data.get("integrator") is not None else "method"
    if data["choose"] == "method":
        data["integrator"] = dict(_first_method(data))
    return data


def _first_method(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the method that is tried first."""
    stabilization = data.get("stabilization")
    if getattr(stabilization, "symmetric", False) or (
        isinstance(stabilization, Mapping) and stabilization.get("symmetric")
    ):
        return SYMMETRIC
    return EXPLICIT if data.get("formulation", "index-1") == "index-1" else IMPLICIT
