"""The conformance kit, `mbdkit_testing`, under its stable name."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbdkit_testing import *  # noqa: F403
else:
    import sys

    import mbdkit_testing

    sys.modules[__name__] = mbdkit_testing
