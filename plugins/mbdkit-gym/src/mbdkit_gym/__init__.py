"""Environments of Gymnasium made of specs: for one simulation, and for many that advance together.

Importing this module registers the packaged environments ``mbdkit/NAME-v0``.
"""

from mbdkit.plugin import MbdkitError

try:
    import gymnasium as _gymnasium  # noqa: F401
except ImportError:
    raise MbdkitError("environments need the package gymnasium: install it with `pip install mbdkit[gym]`") from None

from mbdkit_gym.environment import Environment as Environment
from mbdkit_gym.packaged import register_environments
from mbdkit_gym.vector_environment import VectorEnvironment as VectorEnvironment

register_environments()
