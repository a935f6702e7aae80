"""The rule on code of other distributions: formulas of numbers stand for it, and results of it are kept, only if it is
`pure`.

A kind of items that is not known here counts as one that takes part in every run.
"""

from __future__ import annotations

from typing import Any

from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.item_options import item_of
from mbdkit.registry.manager import registry

#: Kinds of items whose code is called with results, or for other purposes than runs.
_OF_RESULTS = frozenset({
    "accessor", "command", "example", "file-format", "guide-page", "headline", "measure", "plot-kind", "report-section",
    "study", "summary-line", "table-format", "view",
})  # fmt: skip

#: Kinds of items that a spec chooses, or that examine it.
_OF_SPECS = frozenset({"model", "integrator", "step-control", "spec-kind", "model-key", "criterion"})


def acts_in(item: Registered, mechanism: Mechanism) -> bool:
    """Return whether the code of an item may take part in what follows from a mechanism as data."""
    plugin: Any = item.plugin
    match item.kind:
        case "joint-kind":
            return any(getattr(joint, "type", "") == plugin.name for joint in mechanism.joints.values())
        case "force-law":
            return any(isinstance(force, Law) and item_of(force).id == item.id for force in mechanism.forces.values())
        case "element-kind":
            return bool(mechanism.elements.get(plugin.key_in_model))
        case "quantity":
            return bool(getattr(mechanism, plugin.of, None))
        case "treatment":
            return any(chosen.key == plugin.of for chosen in mechanism.treatments)
    return item.kind not in _OF_RESULTS | _OF_SPECS


def impure_item_in(mechanism: Mechanism) -> Registered | None:
    """Return an item that is not pure and whose code acts in a mechanism; None if there is none."""
    return next((item for item in registry().impure if acts_in(item, mechanism)), None)


def impure_item_of(spec: Any) -> Registered | None:
    """Return an item that is not pure and whose code takes part in the runs of a spec; None if there is none.

    The mechanism is not built if the model is such an item, which comes first.
    """

    def takes_part(item: Registered) -> bool:
        plugin: Any = item.plugin
        match item.kind:
            case "model":
                return bool(item.id == spec.model_item.id)
            case "integrator" | "step-control":
                chosen = spec.integrator_item, spec.step_control_item
                return any(own is not None and (own.kind, own.id) == (item.kind, item.id) for own in chosen)
            case "spec-kind":
                return plugin is spec.spec_kind
            case "model-key":
                return bool(getattr(spec.model, plugin.name, None))
            case "criterion":
                return "run" in plugin.of and bool(plugin.examines(spec.mechanism().elements))
        return item.kind not in _OF_RESULTS and acts_in(item, spec.mechanism())

    return next((item for item in registry().impure if takes_part(item)), None)
