"""The hooks that a plugin may implement; a plugin is a module behind an entry point of the group ``mbdkit``.

A distribution declares a module as a plugin in its ``pyproject.toml``::

    [project.entry-points.mbdkit]
    anything = "my_package.my_module"

and the module implements some of the hooks below, marked with ``mbdkit.hookimpl``, each of which returns items with
different names::

    import mbdkit

    mbdkit_api = {"models": 1}  # the versions it is written for, see `mbdkit.plugin.API`

    @mbdkit.hookimpl
    def mbdkit_models():
        return [mbdkit.ModelPlugin(name="swing", summary="A swing", options=SwingOptions, build=build_swing)]
"""

from __future__ import annotations

from collections.abc import Iterable

import pluggy

from mbdkit.registry.item import Item
from mbdkit.registry.items import ForceLawPlugin, IntegratorPlugin, MeasurePlugin, ModelPlugin, StudyPlugin

PROJECT = "mbdkit"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def mbdkit_models() -> list[ModelPlugin]:  # type: ignore[empty-body]
    """Return the models of this plugin."""


@hookspec
def mbdkit_integrators() -> list[IntegratorPlugin]:  # type: ignore[empty-body]
    """Return the integrators of this plugin."""


@hookspec
def mbdkit_force_laws() -> list[ForceLawPlugin]:  # type: ignore[empty-body]
    """Return the force laws of this plugin, for elements of type ``law``.

    A law written in SymPy, from which its derivatives are computed::

        length, rate, k, k3, c = sympy.symbols("length rate stiffness cubic damping")
        law = mbdkit.ExpressionLaw(k*length + k3*length**3 + c*rate, k*length**2/2 + k3*length**4/4, passive=True)
        mbdkit.ForceLawPlugin("duffing", "A spring that hardens", DuffingOptions, law)

    and a law that Numba compiles::

        def magnet(length, rate, time, parameters):
            strength = parameters[0]
            return strength/length**2, -2*strength/length**3, 0.0, -strength/length

        mbdkit.ForceLawPlugin("magnet", "Attraction", MagnetOptions, mbdkit.FunctionLaw(magnet, potential=True))
    """


@hookspec
def mbdkit_studies() -> list[StudyPlugin]:  # type: ignore[empty-body]
    """Return the packaged studies of this plugin, which run by name: ``mbdkit study NAME``.

    The study spec is a file of the package, or a function that returns it. A function of the study returns the
    verdict::

        def verdict(study):
            from mbdkit_report import Verdict

            worst = max(point.values["misalignment_max"] for point in study.points)
            return Verdict("swings", "Swings", f"The joints come apart by {worst:.1e} m at most.")

        mbdkit.StudyPlugin("swings", "Steps of a swing", Path(__file__).parent / "swings.yaml", verdict)
    """


@hookspec
def mbdkit_measures() -> list[MeasurePlugin]:  # type: ignore[empty-body]
    """Return the measures of this plugin, which a study computes for each of its runs.

    A measure is a function of a run and of options::

        class JumpOptions(BaseModel):
            body: str = "trunk"

        def jump_height(run, options):
            height = run[options.body].position[:, 1]
            return height.max() - height[0]

        mbdkit.MeasurePlugin("jump-height", "Rise of a body above its start", JumpOptions, "m", jump_height)

    and a study names it: ``measures: {jump: {name: jump-height, body: pelvis}}``.
    """


@hookspec
def mbdkit_items() -> Iterable[Item]:  # type: ignore[empty-body]
    """Return items of any kind; the class of an item is its kind.

    Kinds without a hook of their own, such as commands, are registered here. Code is named by a target, which is
    imported when it is first used::

        from mbdkit.plugin import Command, Target, hookimpl

        @hookimpl
        def mbdkit_items():
            return [Command(name="rocket", summary="Launch a rocket.", target=Target("my_package.launch:rocket"))]
    """
