"""Contacts in functions of symbols, for optimal control; see `mbdkit_predict.exported_elements.SymbolicElements`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit_contact.acting_contacts import ActingContact, contact_law, pairs_of_shapes
from mbdkit_contact.kernels import contact_laws, uneven_ground


class SymbolicContacts:
    """The contacts of a mechanism, executed with symbols."""

    searching = (contact_laws.__name__, uneven_ground.__name__)
    kinds = ("contacts", "ground_reactions")
    attributes = ("gap", "normal_force", "friction_force", "slip")

    def __init__(self, contacts: Sequence[ActingContact]):
        self._contacts = contacts

    def check(self) -> None:
        """Raise SpecError for a rigid contact."""
        for contact in self._contacts:
            if contact.first_state >= 0:
                why = "is rigid, so that its force is not a function of the state; give it a `compliance`"
                raise SpecError(f"contact '{contact.pair.name}' {why}", key=contact.pair.key)

    def forms(self, tools: Any) -> Mapping[Callable[..., object], Callable[..., object]]:
        """Return the functions that search segments of uneven ground in their form for symbols: not by bisection, and
        among all segments if the first search was not enough.
        """

        def segment_at(x: np.ndarray, ground: int, count: int, px: Any) -> object:
            last: Any = 0
            for j in range(1, count):
                last = tools.select(x[ground + uneven_ground.SEGMENT * j] <= px, j, last)
            return last

        def bounded(window: Callable[..., Any]) -> Callable[..., object]:
            run = tools.run(window)

            def segments(x: np.ndarray, at: int, sizes: tuple[int, int], *others: Any) -> Any:
                # the distance that is searched is a number at first; it depends on the state once it is increased
                return (0, sizes[1] - 1) if tools.is_unknown(others[-1]) else run(x, at, sizes, *others)

            return segments

        windows = (uneven_ground.window_around, uneven_ground.corners_window)
        return {uneven_ground.segment_at: segment_at, **{window: bounded(window) for window in windows}}

    def values(self, call_law: Callable[..., None], top: Topology, law_values: np.ndarray) -> dict[str, Sequence[Any]]:
        """Return the quantities `attributes` of each contact by its name."""
        by_name: dict[str, Sequence[object]] = {}
        for k, rows in enumerate(pairs_of_shapes(self._contacts)):
            law, begin = contact_law(rows, contact_laws.VALUES), top.laws[top.interactions[k, 2], 1]
            out = np.full((len(rows), contact_laws.VALUE), 0.0, dtype=object)
            call_law(law.address, law.program, 0.0, 0.0, 0.0, law_values, begin, out, 0, contact_laws.VALUE)
            by_name |= {row.pair.name: values for row, values in zip(rows, out.tolist(), strict=True)}
        return by_name
