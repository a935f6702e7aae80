"""The conformance kit: named checks of plugins, for Python, pytest and ``mbdkit plugins verify``."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit_testing.kit import (
        check_element as check_element, check_force_law as check_force_law, check_integrator as check_integrator,
        check_joint as check_joint, check_model as check_model, verify as verify,
    )
    from mbdkit_testing.pytest_suite import Case as Case, conformance as conformance
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
