"""Create the project of a new plugin from templates."""

from __future__ import annotations

import importlib.util
import json
import keyword
import re
import shutil
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal, get_args

import yaml
from pydantic import BaseModel

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.registry.catalogue import Kind
from mbdkit.registry.manager import load_installed
from mbdkit.registry.policy import FAMILIES

NewKind = Literal[
    "integrator",
    "tableau",
    "model",
    "force-law",
    "measure",
    "element",
    "joint",
    "spec-kind",
    "plot-kind",
    "report-section",
    "table-format",
    "accessor",
    "summary-line",
    "criterion",
    "data-criterion",
]
KINDS: tuple[NewKind, ...] = get_args(NewKind)
Like = Literal["tableau", "adaptive", "multistep", "dae", "rosenbrock", "external"]
LIKE: tuple[Like, ...] = get_args(Like)

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


class _Flavour(BaseModel):
    """Values in the templates that differ between the kinds of project, from ``flavours.yaml``."""

    kind: Kind
    what: str
    dependencies: list[str]
    example: str = ""
    command: str
    todo: list[str]
    further: list[Kind] = []
    words: dict[str, object] = {}


def _flavour(name: NewKind | Like) -> _Flavour:
    """Return the flavour of a kind of project, or of a sort of integrator."""
    text = Path(__file__).with_name("flavours.yaml").read_text(encoding="utf-8")
    return _Flavour(**yaml.safe_load(text)[name])


def new_project(name: str, kind: NewKind, folder: Path | None = None, like: Like | None = None) -> Path:
    """Create the project of a new plugin, and return its folder.

    Parameters
    ----------
    name
        Name of the distribution and of its folder. The name of the plugin is the same without a leading ``mbdkit-``.
    folder
        Parent folder; by default the working directory.
    like
        Sort of integrator; by default ``adaptive``, and ``tableau`` for the kind of that name.

    Raises
    ------
    SpecError
        If the name is invalid or in use, or if a kind other than ``integrator`` is combined with `like`.
    """
    if like is not None and kind != "integrator":
        raise SpecError(f"--like is for --kind integrator, not for --kind {kind}")
    target = (folder or Path()) / name
    package, item = name.replace("-", "_"), name.removeprefix("mbdkit-")
    if not (_NAME.fullmatch(name) and _NAME.fullmatch(item)):
        raise SpecError(
            f"'{name}' cannot be the name of a new plugin: use small letters, digits and single hyphens, with a "
            f"letter first, such as mbdkit-rocket"
        )
    if target.exists() or target.is_symlink():
        raise SpecError("this exists already; choose another name", file=target)
    template = (like or "adaptive") if kind == "integrator" else kind
    flavour = _flavour(template)
    _check_free(name, package, item, flavour.kind)
    with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=target.parent) as work:
        made = Path(work) / name
        for path, text in _files(name, package, item, template, flavour).items():
            (made / path).parent.mkdir(parents=True, exist_ok=True)
            (made / path).write_text(text, encoding="utf-8", newline="\n")
        shutil.move(made, target)
    return target


def _check_free(name: str, package: str, item: str, kind: Kind) -> None:
    """Raise SpecError if the name of the distribution, package or plugin is in use."""
    if keyword.iskeyword(package) or package in sys.stdlib_module_names:
        raise SpecError(
            f"'{name}' cannot be the name of a new plugin, because Python itself uses it; choose mbdkit-{name}, for "
            f"example"
        )
    try:
        raise SpecError(f"the distribution {name} {version(name)} is installed already; choose another name")
    except PackageNotFoundError:
        pass
    if importlib.util.find_spec(package) is not None:
        raise SpecError(f"there is a Python package {package} already; choose another name")
    for other in load_installed().of_kind(kind):
        if other.name == item:
            raise SpecError(f"'{item}' is taken by the {kind.replace('-', ' ')} {other.id}; choose another name")


def _files(name: str, package: str, item: str, template: str, flavour: _Flavour) -> dict[str, str]:
    """Return the text of each file of the project by its path."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("mbdkit_testing.scaffold"), undefined=StrictUndefined, keep_trailing_newline=True
    )
    used = {
        name: family.version for name, family in FAMILIES.items() if {flavour.kind, *flavour.further} & {*family.kinds}
    }
    words: dict[str, object] = {
        "name": name,
        "package": package,
        "item": item,
        "template": template,
        "what": flavour.what,
        **flavour.words,
        "formulation": "ggl" if template == "dae" else "index-1",
        "api": json.dumps(used),
        "versions": f">={mbdkit.__version__},<{int(mbdkit.__version__.split('.')[0]) + 1}",
        "dependencies": flavour.dependencies,
        "attribute": (attribute := item.replace("-", "_")),
        "command": flavour.command.format(name=name, item=item, attribute=attribute),
        "todo": "\n".join(f"* {line}" for line in flavour.todo),
    }
    is_integrator = flavour.kind == "integrator"
    words["is_verified"] = is_integrator or (bool(flavour.example) and flavour.kind != "spec-kind")
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        f"src/{package}/__init__.py": f"{'integrator' if is_integrator else template}.py",
        f"src/{package}/code.py": f"code_{template}.py",
        f"tests/test_{package}.py": f"test_{'integrator' if is_integrator else template}.py",
    }
    if flavour.example:
        path = flavour.example.format(package=package, item=item)
        templates[path] = "study.yaml" if is_integrator else f"{template}.yaml"
    texts = {path: environment.get_template(f"{file}.jinja").render(words) for path, file in templates.items()}
    return texts | {f"src/{package}/py.typed": ""}
