"""How a run treats elements of kinds that have a section in run specs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.registry.feature_items import Treatment
from mbdkit.registry.manager import registry


class ChosenTreatment(NamedTuple):
    """The treatment of the elements of a kind in a run.

    `key`: key of the elements in the model. `section`: the section of the run spec, see
    `mbdkit.plugin.ElementKind.section_model`.
    """

    key: str
    section: Any

    @property
    def item(self) -> Treatment:
        """The treatment; raises SpecError if it is not installed."""
        return cast(Treatment, registry().get(Treatment.kind, self.section.treatment).plugin)

    @property
    def section_key(self) -> str:
        """Key of the section in run specs."""
        return element_kinds()[self.key].section

    @property
    def content(self) -> tuple[object, ...]:
        """The values of the section."""
        return tuple(value for _, value in self.section)

    def replaced(self, name: str) -> ChosenTreatment:
        """Return the same section with another treatment."""
        return self._replace(section=self.section.model_copy(update={"treatment": name}))


def reacting_among(treatments: Sequence[ChosenTreatment]) -> ChosenTreatment | None:
    """Return the treatment of elements whose reactions the steps determine; None if there is none."""
    return next((chosen for chosen in treatments if chosen.item.reacting), None)
