"""Base class of all user input: strict, frozen pydantic models that reject unknown keys."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
"""Reject unknown keys, infinities and NaN; do not allow assignment; do not convert text or booleans to numbers."""


class StrictModel(BaseModel):
    """Base class of elements, options and sections of a spec; attribute docstrings are descriptions in the schema."""

    model_config = ConfigDict(**STRICT, use_attribute_docstrings=True)
