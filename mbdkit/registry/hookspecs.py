"""The hooks a plugin may implement; a plugin is a module behind an entry point of the group ``mbdkit``.

A distribution offers a module as a plugin in its ``pyproject.toml``::

    [project.entry-points.mbdkit]
    anything = "my_package.my_module"

and the module implements any of the hooks below, marked with ``mbdkit.hookimpl``::

    import mbdkit

    @mbdkit.hookimpl
    def mbdkit_models():
        return [mbdkit.ModelPlugin(name="swing", summary="A swing", options=SwingOptions, build=build_swing)]
"""

from __future__ import annotations

import pluggy

from mbdkit.registry.items import IntegratorPlugin, ModelPlugin

PROJECT = "mbdkit"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def mbdkit_models() -> list[ModelPlugin]:  # type: ignore[empty-body]
    """Return the models of this plugin.

    Returns
    -------
    list of ModelPlugin
        Each name once.
    """


@hookspec
def mbdkit_integrators() -> list[IntegratorPlugin]:  # type: ignore[empty-body]
    """Return the integrators of this plugin.

    Returns
    -------
    list of IntegratorPlugin
        Each name once.
    """
