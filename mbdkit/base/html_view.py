"""Base class of objects that notebooks show as HTML; a part generates the HTML."""

from __future__ import annotations

from mbdkit.base import higher_layers
from mbdkit.base.errors import MissingPartError


class HtmlView:
    """Base class of objects that notebooks show as tables and pictures."""

    def _repr_html_(self) -> str | None:
        try:
            return higher_layers.html_of(self)
        except MissingPartError:
            return None  # notebooks show the text
