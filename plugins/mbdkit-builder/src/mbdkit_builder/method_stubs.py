"""Generate ``mbdkit/mechanism/element_methods.pyi``: methods that are made from models at run time, for type checkers.

Run by ``python -m mbdkit_builder methods``.
"""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
from pathlib import Path
from typing import Any, cast

from mbdkit.engine.native import machine_code
from mbdkit.mechanism.element_methods import ElementMethods
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.element_items import ElementKind, JointKind
from mbdkit.registry.manager import built_in

TARGET = machine_code.PACKAGE / "mechanism/element_methods.pyi"

_HEADER = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")


def generated() -> str:
    """Return the text of the stub."""
    kinds = [cast(ElementKind, item.plugin) for item in built_in().of_kind("element-kind")]
    methods = {name: one for name, one in vars(ElementMethods).items() if not name.startswith("_")}
    joints = [cast(JointKind, item.plugin) for item in built_in().of_kind("joint-kind")]
    both: list[ElementKind | JointKind] = [*kinds, *joints]
    of_kinds = [kind.builder for kind in both if kind.builder]
    methods |= {name: getattr(Mechanism(), name).__func__ for name in of_kinds}
    text = "\n".join(f"    {kind.key_in_model}: dict[str, {cast(type, kind.model()).__name__}]" for kind in kinds)
    text += "\n\n" + "\n\n".join(_method(name, one) for name, one in methods.items())
    modules = {cast(type, kind.model()).__module__ for kind in both}
    rooms = [vars(one) for name, one in sys.modules.items() if name.startswith("mbdkit.mechanism.") or name in modules]
    places = {name: one.__module__ for room in rooms for name, one in room.items() if isinstance(one, type)}
    # classes that are made by a function have no name to import
    text = re.sub(r"(\bMapping\[str, Any\]) \| (\w+)", lambda one: one[0] if one[2] in places else one[1], text)
    used = [name for pair in re.findall(r"\bMapping\[str, Any\] \| (\w+)|: dict\[str, (\w+)\]", text) for name in pair]
    classes = ["NamedElements", *filter(None, used)]
    imports = "\n".join(sorted({f"from {places[name]} import {name}" for name in classes}))
    return _HEADER.format(imports=imports, about=ElementMethods.__doc__) + text + "\n"


def _method(name: str, method: Any) -> str:
    signature = inspect.signature(method)
    arguments = [str(one) for one in signature.parameters.values()]
    kinds = [one.kind for one in signature.parameters.values()]
    if inspect.Parameter.KEYWORD_ONLY in kinds:
        arguments.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
    joined = ", ".join(one.replace(" ", "\0") for one in arguments)  # lines end between arguments only
    filled = textwrap.fill(joined, 108, break_long_words=False, break_on_hyphens=False).replace("\0", " ")
    head = f"def {name}(\n{textwrap.indent(filled, '    ')}\n) -> {signature.return_annotation}:"
    about = method.__doc__.partition("\n\nExamples\n")[0]  # `help` shows the examples
    return textwrap.indent(f'{head}\n    """{textwrap.indent(about, "    ").strip()}\n    """', "    ")
