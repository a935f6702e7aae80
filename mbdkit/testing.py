"""The conformance kit, `mbdkit_testing`, under its stable name."""

import sys

import mbdkit_testing
from mbdkit_testing import *  # noqa: F403

sys.modules[__name__] = mbdkit_testing
