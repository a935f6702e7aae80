"""Create the project of a new plugin from templates."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shutil
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal, get_args

import mbdkit
from mbdkit.plugin import SpecError
from mbdkit.registry.catalogue import Kind
from mbdkit.registry.manager import load_installed
from mbdkit.registry.policy import API

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


@dataclass(frozen=True)
class _Flavour:
    """Values in the templates that differ between the kinds of project."""

    kind: Kind
    what: str
    dependencies: tuple[str, ...]
    example: str
    command: str
    todo: tuple[str, ...]
    words: Mapping[str, object] = field(default_factory=dict)


_RUN = "example.yaml", "mbdkit run {name}/example.yaml"


def _item(kind: Kind, what: str, command: str, todo: str) -> _Flavour:
    """Return a project without an example, whose code is in a module beside the table of contents."""
    return _Flavour(kind, what, ("numpy>=1.26",), "", command, (todo,))


def _integrator(
    what: str, summary: str, create: str, todo: str, *needs: str, accuracy: float = 1e-6, controlled: bool = False
) -> _Flavour:
    """Return the project of an integrator; the accuracy is that of the tests."""
    return _Flavour(
        "integrator",
        what,
        ("numpy>=1.26", "pydantic>=2.7", *needs),
        "study.yaml",
        "mbdkit study {name}/study.yaml   # beside built-in methods",
        (todo, "the claims, each of which `mbdkit plugins verify` checks;"),
        {"summary": summary, "create": create, "accuracy": accuracy, "is_controlled": controlled},
    )


_INTEGRATORS: dict[Like, _Flavour] = {
    "tableau": _integrator(
        "A Runge-Kutta method given by its tableau",
        "Kutta's method: explicit, 3 stages, order 3, fixed steps.",
        "method",
        'the tableau: exact coefficients as numbers or text such as `"1/4 - sqrt(3)/6"`, whose order mbdkit checks '
        "(`mbdkit.ImplicitRungeKutta(tableau())` for an implicit one);",
        accuracy=1e-4,
    ),
    "adaptive": _integrator(
        "An explicit method with controlled steps",
        "Dormand-Prince: explicit, order 5, controlled steps.",
        "DormandPrince",
        "the coefficients, `error_order`, and the dense output;",
        controlled=True,
    ),
    "multistep": _integrator(
        "A multistep method",
        "Adams-Bashforth-Moulton: explicit, 4 points, order 4, fixed steps.",
        "method",
        "the formula; the memory holds numbers, texts, arrays, lists, tuples and mappings, not changed in place;",
        accuracy=1e-5,
    ),
    "dae": _integrator(
        "An implicit method on the differential-algebraic equations",
        "BDF2 on the equations of Gear, Gupta and Leimkuhler: implicit, order 2, fixed steps.",
        "Bdf2",
        "the formula, its iteration, and the formulation in the claims and in `study.yaml`;",
        accuracy=1e-3,
    ),
    "rosenbrock": _integrator(
        "A Rosenbrock method with controlled steps",
        "RODAS3: linearly implicit, order 3, L-stable, controlled steps.",
        "Rodas3",
        "the coefficients, `error_order`, and the dense output;",
        "scipy>=1.13",
        accuracy=1e-5,
        controlled=True,
    ),
    "external": _integrator(
        "A solver of a library with a loop of its own",
        "RK45 of SciPy: explicit, order 5, controlled steps.",
        "SciPyRK45",
        "the library; a method without `save` and `restore` cannot be resumed, and claims `restartable=False`;",
        "scipy>=1.13",
        controlled=True,
    ),
}
_FLAVOURS: dict[NewKind, _Flavour] = {
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
    "element": _Flavour(
        "element-kind",
        "A kind of elements",
        ("numpy>=1.26", "sympy>=1.12"),
        "src/{package}/{item}.yaml",
        "mbdkit run {item}",
        (
            "the class of the elements and its force law, their quantities, and the criterion;",
            "the example, on which `mbdkit plugins verify` checks the kind;",
        ),
    ),
    "joint": _Flavour(
        "joint-kind",
        "A kind of joints",
        ("numpy>=1.26", "pydantic>=2.7"),
        "src/{package}/{item}.yaml",
        "mbdkit run {item}",
        (
            "the class of the joints: its keys, rows and units, and the function of the pose of each row;",
            "the example, on which `mbdkit plugins verify` checks the kind;",
        ),
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
    sort: Like = "tableau" if kind == "tableau" else like or "adaptive"
    flavour = _FLAVOURS.get(kind) or _INTEGRATORS[sort]
    _check_free(name, package, item, flavour.kind)
    with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=target.parent) as work:
        made = Path(work) / name
        for path, text in _files(name, package, item, kind if kind in _FLAVOURS else sort, flavour).items():
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
    words: dict[str, object] = {
        "name": name,
        "package": package,
        "item": item,
        "template": template,
        "what": flavour.what,
        **flavour.words,
        "formulation": "ggl" if template == "dae" else "index-1",
        "api": API,
        "mbdkit_version": ".".join(mbdkit.__version__.split(".")[:2]),
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
