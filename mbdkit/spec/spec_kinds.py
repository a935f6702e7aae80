"""Distinguishes run specs from specs of inverse dynamics, without importing the models of either."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbdkit.base.errors import SpecError


def is_inverse(data: Mapping[str, Any]) -> bool:
    """Return whether plain data are a spec of inverse dynamics; only such specs have a section `motion`."""
    return "motion" in data


def refused_as_inverse() -> SpecError:
    """Return the error for a run spec that is given in place of a spec of inverse dynamics."""
    return SpecError(
        "this is a run spec: run it with `mbdkit run`; a spec of inverse dynamics has a section `motion`, and neither "
        "`integrator` nor a step",
        key="integrator",
    )


def refused_as_run() -> SpecError:
    """Return the error for a spec of inverse dynamics that is given in place of a run spec."""
    return SpecError(
        "this is a spec of inverse dynamics, with a measured motion: compute it with `mbdkit inverse`", key="motion"
    )
