"""The check of a gradient in tests."""

from __future__ import annotations

from mbdkit_gradients.measure_gradients import Gradient


def assert_passed(found: Gradient) -> None:
    """Assert that a gradient has passed its check."""
    assert found.check is not None
    assert found.check.is_passed, str(found)
