"""The conformance kit, `mbdkit_testing`, under its stable name."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbdkit_testing import *  # noqa: F403
else:
    import sys

    from mbdkit.base.lazy_names import import_part

    sys.modules[__name__] = import_part("mbdkit_testing", "mbdkit.testing")
