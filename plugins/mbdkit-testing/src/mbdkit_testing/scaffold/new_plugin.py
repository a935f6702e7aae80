"""Create the project of a new plugin from templates."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal, get_args

from mbdkit.base.errors import SpecError
from mbdkit.registry.catalogue import Kind
from mbdkit.registry.manager import load_installed
from mbdkit.registry.policy import API

NewKind = Literal[
    "integrator",
    "tableau",
    "model",
    "force-law",
    "measure",
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

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


@dataclass(frozen=True)
class _Flavour:
    """Values in the templates that differ between the kinds of project."""

    kind: Kind
    what: str
    dependencies: tuple[str, ...]
    example: str
    command: str
    todo: tuple[str, ...]


_STUDY = "study.yaml", "mbdkit study {name}/study.yaml   # beside the built-in methods"
_RUN = "example.yaml", "mbdkit run {name}/example.yaml"


def _item(kind: Kind, what: str, command: str, todo: str) -> _Flavour:
    """Return a project without an example, whose code is in a module beside the table of contents."""
    return _Flavour(kind, what, ("numpy>=1.26",), "", command, (todo,))


_FLAVOURS: dict[NewKind, _Flavour] = {
    "integrator": _Flavour(
        "integrator",
        "An integrator written in NumPy",
        ("pydantic>=2.7",),
        *_STUDY,
        (
            (
                "`step`: keep data of earlier steps in `StepState.memory`; raise `mbdkit.StepError(code, sentence)` "
                'with a code such as "newton-failed" if a step cannot be taken;'
            ),
            'the claims, and with another formulation `formulations=("index-3",)`;',
        ),
    ),
    "tableau": _Flavour(
        "integrator",
        "A Runge-Kutta method given by its tableau",
        ("pydantic>=2.7",),
        *_STUDY,
        (
            'the tableau: exact coefficients as numbers or text such as `"1/4 - sqrt(3)/6"`; mbdkit checks its order;',
            "the claims; use `mbdkit.ImplicitRungeKutta(tableau())` for an implicit tableau;",
        ),
    ),
    "model": _Flavour(
        "model",
        "A model",
        ("pydantic>=2.7",),
        *_RUN,
        ("the options and `build`, which turns them into bodies, joints, drivers and forces;",),
    ),
    "force-law": _Flavour(
        "force-law",
        "A force law",
        ("pydantic>=2.7", "sympy>=1.12"),
        *_RUN,
        (
            (
                "`law`: a SymPy expression of `length`, `rate`, `time` and the options, or an "
                "`mbdkit.FunctionLaw` that Numba compiles;"
            ),
        ),
    ),
    "measure": _Flavour(
        "measure",
        "A measure of studies",
        ("numpy>=1.26", "pydantic>=2.7"),
        "study.yaml",
        "mbdkit study {name}/study.yaml",
        ("the options and `take`, which computes one number from a run (nan if that is not possible);",),
    ),
    "spec-kind": _Flavour(
        "spec-kind",
        "A kind of specs",
        ("pydantic>=2.7", "typer"),
        "example.yaml",
        "mbdkit {item} {name}/example.yaml",
        ("the class of the spec, its marker, and the functions that load, check and repeat it;",),
    ),
    "plot-kind": _item(
        "plot-kind", "A kind of plot", "mbdkit plot run.h5 --kind {attribute}", "`charts` and `chart`, and its options;"
    ),
    "report-section": _item(
        "report-section", "A section of reports", "mbdkit report run.h5", "`sections`, and the charts, if any;"
    ),
    "table-format": _item(
        "table-format", "A format of tables", "mbdkit archive export run.h5 --to {item}", "the suffix and `write`;"
    ),
    "accessor": _item(
        "accessor",
        "An attribute of runs",
        "python -c 'import mbdkit; print(mbdkit.run(\"pendulum\").{attribute})'",
        "the function that computes the attribute;",
    ),
    "summary-line": _item(
        "summary-line", "A line of summaries", "mbdkit run pendulum", "`lines`, which returns labels and texts;"
    ),
    "criterion": _item(
        "criterion", "A criterion of verdicts on runs", "mbdkit run pendulum", "what rows are watched for;"
    ),
    "data-criterion": _item(
        "criterion", "A criterion of verdicts on measured data", "mbdkit inverse walking", "the doubts about a result;"
    ),
}


def new_project(name: str, kind: NewKind, folder: Path | None = None) -> Path:
    """Create the project of a new plugin, and return its folder.

    Parameters
    ----------
    name
        Name of the distribution and of its folder. The name of the plugin is the same without a leading ``mbdkit-``.
    folder
        Parent folder; by default the working directory.

    Raises
    ------
    SpecError
        If the name is invalid or in use.
    """
    target = (folder or Path()) / name
    package, item = name.replace("-", "_"), name.removeprefix("mbdkit-")
    if not (_NAME.fullmatch(name) and _NAME.fullmatch(item)):
        raise SpecError(
            f"'{name}' cannot be the name of a new plugin: use small letters, digits and single hyphens, with a "
            f"letter first, such as mbdkit-rocket"
        )
    if target.exists() or target.is_symlink():
        raise SpecError("this exists already; choose another name", file=target)
    _check_free(name, package, item, _FLAVOURS[kind].kind)
    with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=target.parent) as work:
        made = Path(work) / name
        for path, text in _files(name, package, item, kind).items():
            (made / path).parent.mkdir(parents=True, exist_ok=True)
            (made / path).write_text(text, encoding="utf-8")
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


def _files(name: str, package: str, item: str, kind: NewKind) -> dict[str, str]:
    """Return the text of each file of the project by its path."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    flavour = _FLAVOURS[kind]
    environment = Environment(
        loader=PackageLoader("mbdkit_testing.scaffold"), undefined=StrictUndefined, keep_trailing_newline=True
    )
    words: dict[str, object] = {
        "name": name,
        "package": package,
        "item": item,
        "what": flavour.what,
        "api": API,
        "mbdkit_version": ".".join(version("mbdkit").split(".")[:2]),
        "dependencies": flavour.dependencies,
        "attribute": (attribute := item.replace("-", "_")),
        "command": flavour.command.format(name=name, item=item, attribute=attribute),
        "todo": "\n".join(f"* {line}" for line in flavour.todo),
    }
    words["is_verified"] = KINDS.index(kind) < KINDS.index("spec-kind")
    example = "study.yaml" if flavour.kind == "integrator" else f"{kind}.yaml"
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        f"src/{package}/__init__.py": f"{kind}.py",
        f"src/{package}/code.py": f"code_{kind}.py",
        f"tests/test_{package}.py": f"test_{kind}.py",
    }
    if flavour.example:
        templates[flavour.example] = example
    texts = {path: environment.get_template(f"{file}.jinja").render(words) for path, file in templates.items()}
    return texts | {f"src/{package}/py.typed": ""}
