"""HTML pages made from the templates in this folder. Texts are escaped, and all files are inlined."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from mbdkit.base.text import shown


def render(
    template: str, values: Mapping[str, object], filters: Mapping[str, Callable[..., object]] | None = None
) -> str:
    """Return a page with values that the template uses. Texts among them are escaped for HTML. Control characters are
    escaped on the whole page; this does not change the meaning of JSON.
    """
    environment = _environment()
    environment.filters.update(filters or {})
    return shown(environment.get_template(template).render(values), lines=True)


def script_json(value: object) -> Markup:
    """Return compact JSON for a script element. It is escaped so that no text in it can end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def inline(name: str) -> Markup:
    """Return the text of a style sheet or script in this folder, not escaped."""
    return Markup(files("mbdkit_report.pages").joinpath("templates", name).read_text(encoding="utf-8"))


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("mbdkit_report.pages", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(inline=inline, script_json=script_json)
    return environment
