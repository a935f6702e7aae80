"""Two functions of higher layers that mechanisms call; ``mbdkit/__init__.py`` assigns them.

This package cannot import the plugin registry or the symbolic definitions, because both import it. It needs the
registry to look up the options of plugins, and the definitions for `Mechanism.to_sympy`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

installed_plugins: Callable[[], Any]
"""Returns the `PluginLookup` of the installed plugins."""

symbolic_system: Callable[[Any, bool], Any]
"""Returns the `SymbolicSystem` of a mechanism; the flag selects numbers instead of symbols for its parameters."""
