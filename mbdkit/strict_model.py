"""The base of everything that a user may write: pydantic models without coercion, unknown keys or mutation."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
"""No unknown keys, no assignment, no coercion of text or booleans to numbers, no infinities and no NaN."""


class StrictModel(BaseModel):
    """Base of elements, options and sections of a spec; docstrings of attributes become descriptions in the schema."""

    model_config = ConfigDict(**STRICT, use_attribute_docstrings=True)
