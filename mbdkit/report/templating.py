"""HTML pages from the templates in this folder, with texts escaped and all files inlined."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from mbdkit.base.text import shown


def render(template: str, values: Mapping[str, Any], filters: Mapping[str, Callable[..., Any]] | None = None) -> str:
    """Return a page.

    Parameters
    ----------
    values
        Values that it shows; texts are escaped. So are control characters, on the whole page: in JSON, this does not
        change their meaning.
    """
    environment = _environment()
    environment.filters.update(filters or {})
    return shown(environment.get_template(template).render(values), lines=True)


def script_json(value: Any) -> Markup:
    """Return compact JSON for a script element, escaped so that it cannot end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def inline(name: str) -> Markup:
    """Return a style sheet or script of this folder, unescaped."""
    return Markup(files("mbdkit.report").joinpath("templates", name).read_text(encoding="utf-8"))


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("mbdkit.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(inline=inline, script_json=script_json)
    return environment
