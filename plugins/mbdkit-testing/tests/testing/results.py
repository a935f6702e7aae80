"""Results of the conformance kit."""

from __future__ import annotations

from tests.testing import corpus

from mbdkit_testing.check_result import Result
from mbdkit_testing.kit import checks_of, plugin_under_test


def one(name: str, kind: str, installed: corpus.Registry) -> Result:
    """Run one check of the plugin ``mine``."""
    check = next(check for check in checks_of(kind) if check.name == name)
    return check.run(plugin_under_test(kind, "mine", {}, installed))
