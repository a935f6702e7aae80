"""Objects that notebooks show as HTML; the room `notebook` writes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

html_of: Callable[[Any], str] = repr
"""Returns the HTML of an object. ``mbdkit/__init__.py`` assigns it, because the writer imports the classes it shows."""


class HtmlView:
    """Base class of what notebooks show as tables and pictures."""

    def _repr_html_(self) -> str:
        return html_of(self)
