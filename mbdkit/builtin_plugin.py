"""The plugin of mbdkit itself: its models, integrators and force laws are registered like those of any plugin."""

from __future__ import annotations

from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.items import ForceLawPlugin, IntegratorPlugin, ModelPlugin, StudyPlugin


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Return the models that mbdkit ships."""
    from mbdkit.models import MODELS

    return list(MODELS)


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Return the integrators that mbdkit ships."""
    from mbdkit.methods import INTEGRATORS

    return list(INTEGRATORS)


@hookimpl
def mbdkit_force_laws() -> list[ForceLawPlugin]:
    """Return the force laws that mbdkit ships."""
    from mbdkit.laws import LAWS

    return list(LAWS)


@hookimpl
def mbdkit_studies() -> list[StudyPlugin]:
    """Return the studies that mbdkit ships."""
    from mbdkit.studies.packaged import STUDIES

    return list(STUDIES)
