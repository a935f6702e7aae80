"""The package as a whole: documented, light to import, and its face complete."""

from __future__ import annotations

import importlib
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mbdkit
from tests.first_party import modules

MODULES = sorted(
    name
    for name, path in modules().items()
    if path.name != "__main__.py" and name != "mbdkit.engine.kernels.element_kernels" and path.parent.name != "examples"
)


def public_things(module):
    for name, thing in list(vars(module).items()):  # a lazy module grows while it is looked at
        if not name.startswith("_") and getattr(thing, "__module__", None) == module.__name__:
            yield f"{module.__name__}.{name}", thing


def test_every_public_thing_is_documented():
    missing = []
    for name in MODULES:
        module = importlib.import_module(name)
        missing += [] if (module.__doc__ or "").strip() else [name]
        for path, thing in public_things(module):
            if inspect.isfunction(thing) or inspect.isclass(thing):
                missing += [] if (thing.__doc__ or "").strip() else [path]
            if inspect.isclass(thing):
                missing += [f"{path}.{member}" for member, inner in list(vars(thing).items()) if is_bare(member, inner)]
    assert not missing


def is_bare(name, member):
    function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
    ours = inspect.isfunction(function) and function.__module__.startswith("mbdkit")  # pydantic puts some in
    return ours and not name.startswith("_") and not (function.__doc__ or "").strip()


def test_every_module_says_in_its_first_line_what_it_is_for():
    first = {name: (importlib.import_module(name).__doc__ or "").strip().partition("\n")[0] for name in MODULES}
    assert [name for name, line in first.items() if len(line) <= 20] == []


def test_the_face_offers_what_it_lists():
    offered = dir(mbdkit)
    assert [name for name in mbdkit.__all__ if getattr(mbdkit, name, None) is None or name not in offered] == []


def test_the_face_has_nothing_else():
    with pytest.raises(AttributeError, match="no attribute 'integrate'"):
        mbdkit.integrate  # noqa: B018


def test_the_version_is_that_of_the_distribution():
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", mbdkit.__version__)


def imported_by(code: str) -> set[str]:
    script = f"{code}\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(json.loads(result.stdout.splitlines()[-1]))


def test_the_modules_for_authors_are_attributes_that_are_imported_when_they_are_used():
    assert imported_by("import mbdkit; mbdkit.plugin.hookimpl") >= {"mbdkit.plugin"}
    assert imported_by("import mbdkit; mbdkit.testing") >= {"mbdkit.testing"}
    assert not {"mbdkit.kernels", "mbdkit.plugin", "mbdkit.testing"} & imported_by("import mbdkit")


HEAVY = {"numpy", "scipy", "sympy", "numba", "h5py", "matplotlib", "pydantic", "typer", "rich", "yaml", "pluggy"}


def test_importing_the_package_imports_nothing_heavy():
    assert not imported_by("import mbdkit") & HEAVY


def test_asking_for_help_imports_nothing_heavy():
    code = "import contextlib, io\nfrom mbdkit.cli import app\n"
    code += "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n    app(['--help'])"
    assert not imported_by(code) & (HEAVY - {"typer", "pluggy"})  # plugins may add commands


def test_checking_a_spec_compiles_nothing():
    imported = imported_by("from mbdkit.spec import load_spec; load_spec('pendulum')")
    assert not imported & {"numba", "scipy", "sympy", "matplotlib"}


def test_a_run_imports_what_it_needs():
    imported = imported_by("import mbdkit; mbdkit.run('pendulum').close()")
    assert not imported & {"sympy", "matplotlib", "numba", "scipy.linalg", "scipy.optimize", "scipy.interpolate"}
    # only joints that are functions of the pose, and laws that are expressions, need these
    assert not imported & {"mbdkit.engine.function_laws", "mbdkit.engine.law_compiler", "mbdkit.expressions.recorded"}


@pytest.mark.parametrize("name", ["quick.txt", "slow.txt"])
def test_lists_of_tests_name_tests_that_exist(name):
    root = Path(__file__).parent.parent
    lines = (root / "tests" / name).read_text("utf-8").splitlines()
    for line in (line for line in lines if line[0] != "#"):
        file, _, test = line.partition(" ")[0].partition("::")
        assert (root / file).exists(), line
        assert f"def {test.partition('[')[0]}" in (root / file).read_text("utf-8") if test else True, line
