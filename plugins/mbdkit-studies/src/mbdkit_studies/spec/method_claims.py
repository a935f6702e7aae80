"""What the method in the spec of a run claims, before the spec is validated."""

from __future__ import annotations

import json
from collections.abc import Mapping

from pydantic import ValidationError

from mbdkit.base.errors import SpecError, blaming
from mbdkit.base.plain_data import plain
from mbdkit.registry.item_options import named_options
from mbdkit.registry.items import Claims, IntegratorPlugin
from mbdkit.registry.manager import registry

METHOD = "integrator"  #: Key of the method in a run spec.


def claims_of(integrator: object) -> Claims:
    """Return what a method claims with its options.

    Parameters
    ----------
    integrator
        The name of the method, or a mapping of its name and options.

    Raises
    ------
    SpecError
        If there is no such method.
    ValidationError
        If its options are not valid, or if there is no name.
    PluginError
        If its claims cannot be computed.
    """
    chosen = {"name": integrator} if isinstance(integrator, str) else integrator
    if not isinstance(chosen, Mapping):
        raise SpecError("an integrator is a name, or a mapping with `name`", key="integrator")
    item = registry().get("integrator", str(chosen.get("name")))
    plugin, model = item.plugin, named_options(item)
    assert isinstance(plugin, IntegratorPlugin)
    with blaming(f"{item.id} failed to return its claims", ValidationError):
        return plugin.claims(model.model_validate_json(json.dumps(plain(chosen))))
