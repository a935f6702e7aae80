"""Nothing is imported before it is used: items name their code by targets, and commands are found in the registry."""

from __future__ import annotations

import importlib
import inspect
import json
import math
import re
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import mbdkit
import mbdkit.plugin
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.lazy_names import homes_of
from mbdkit.cli import app
from mbdkit.plugin import Command, IntegratorPlugin, ModelPlugin, SpecKind, Target
from mbdkit.registry.item_options import named_options
from mbdkit.registry.manager import checked, load_registry, registry
from mbdkit.registry.policy import Policy
from tests.installing import install_module, python
from tests.public_door import FACES
from tests.registry.conftest import offering_items as offering

NUMERICAL = ("numpy", "scipy", "sympy", "h5py")


def hello(name: str = "you") -> None:
    """Say hello."""
    if name == "nobody":
        raise LookupError(name)
    print(f"hello {name}")


def greet(name="greet", **fields):
    return Command(**{"name": name, "summary": "Say hello.", "target": Target(f"{__name__}:hello"), **fields})


@pytest.fixture
def installed(monkeypatch, beside_ours):
    """Return a function that installs items of distributions beside mbdkit's own."""
    monkeypatch.setitem(sys.modules, __name__, sys.modules[hello.__module__])

    def install(**distributions):
        loaded = beside_ours(**distributions)
        monkeypatch.setattr("mbdkit.cli.registered_commands.installed", lambda: loaded)
        return loaded

    return install


def loaded_after(code, *path, cwd=Path()):
    done = python("-c", f"{code}\nimport sys, json\nprint(json.dumps(sorted(sys.modules)))", path=path, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_loading_the_registry_and_naming_what_plugins_import_needs_no_numerical_package():
    code = "import mbdkit.plugin as p\nfrom mbdkit.registry.manager import registry\nregistry()\np.Target, p.Command"
    modules = loaded_after(code)
    assert "mbdkit.builtin_plugin" in modules
    assert not modules & {*NUMERICAL, "pydantic", "typer", "mbdkit.models.pendulums", "mbdkit.methods.gauss"}


def test_help_imports_no_command():
    code = "from mbdkit.cli import app\ntry:\n    app(['--help'])\nexcept SystemExit:\n    pass"
    modules = loaded_after(code)
    needed = {f"mbdkit.cli.{name}" for name in ("common_options", "completion", "registered_commands")}
    assert not {name for name in modules if name.startswith("mbdkit.cli.")} - needed
    assert not modules & {*NUMERICAL, "pydantic"}


LIGHT = """
from mbdkit.plugin import ModelPlugin, Target, hookimpl

@hookimpl
def mbdkit_models():
    code = "heavy_code"
    return [ModelPlugin("heavy", "Heavy", Target(f"{code}:Options"), Target(f"{code}:build"))]
"""


def test_a_run_imports_no_code_that_its_spec_does_not_name(tmp_path):
    install_module(tmp_path, "heavy-kit", LIGHT)
    (tmp_path / "heavy_code.py").write_text("raise AssertionError('imported')")
    spec = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"}}
    spec["time"] = {"end": 0.01, "step": 0.01}
    code = f"import mbdkit\nmbdkit.run(mbdkit.RunSpec(**{spec!r}))"
    modules = loaded_after(code, tmp_path, cwd=tmp_path)
    assert {"heavy_kit", "mbdkit.methods.rk4", "mbdkit.models.pendulums"} <= modules
    assert not modules & {"heavy_code", "mbdkit_taylor.taylor", "mbdkit.methods.scipy_methods"}
    assert "mbdkit_biomech.models.leg" not in modules


def test_code_that_cannot_be_imported_is_the_error_of_its_distribution_when_it_is_used(tmp_path):
    install_module(tmp_path, "heavy-kit", LIGHT)
    (tmp_path / "heavy_code.py").write_text("import nowhere_at_all")
    done = python("-m", "mbdkit", "run", "pendulum", "--set", "model.name=heavy", path=(tmp_path,), cwd=tmp_path)
    assert done.returncode == 4
    assert "plugin 'heavy-kit:heavy' cannot be used: " in done.stderr
    assert "No module named 'nowhere_at_all'" in done.stderr
    doctor = python("-m", "mbdkit", "plugins", "doctor", path=(tmp_path,), cwd=tmp_path)
    assert doctor.returncode == 4
    assert "heavy-kit:heavy: error: " in doctor.stdout


def test_every_built_in_item_keeps_what_its_targets_promise():
    ours = registry().only("mbdkit")
    assert not checked(ours).failures
    assert len(ours.of_kind("command")) >= 30


@pytest.mark.parametrize("where", ["no colon", "a.b:", ":x", "a b:c", 5])
def test_a_target_of_another_form_is_refused(where):
    with pytest.raises(PluginError, match="is not of the form"):
        Target(where)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (Target("mbdkit.methods.nowhere:x"), "mbdkit does not provide 'mbdkit.methods.nowhere:x': ModuleNotFoundError"),
        (Target("mbdkit.methods.rk4:nothing"), "mbdkit does not provide 'mbdkit.methods.rk4:nothing': AttributeError"),
    ],
)
def test_a_target_names_its_distribution_when_it_fails(target, words):
    with pytest.raises(PluginError, match=words):
        target()


def test_items_of_every_kind_may_come_from_the_one_hook_and_fields_may_be_targets_or_objects(entry_point):
    code = "mbdkit.methods"
    method = IntegratorPlugin(
        "mine", "Mine", Target(f"{code}.method_options:ExplicitOptions"), Target(f"{code}.rk4:create"),
        lambda options: mbdkit.Claims(order=4),
    )  # fmt: skip
    loaded = load_registry([entry_point(lambda: offering(method, greet()))])
    assert [(item.kind, item.id) for item in loaded.items] == [("integrator", "acme:mine"), ("command", "acme:greet")]
    item = loaded.get("integrator", "mine")
    assert set(named_options(item).model_fields) == {"name", "step_control"}
    assert item.plugin.claims(item.plugin.options()).order == 4
    assert type(item.plugin.create(item.plugin.options())).__name__ == "ExplicitRungeKutta"


def test_items_are_sorted_by_order_and_those_of_one_order_stay_as_they_were(entry_point):
    loaded = load_registry([entry_point(lambda: offering(greet("a"), greet("b"), greet("c", order=3)))])
    assert loaded.names("command") == ["c", "a", "b"]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"name": "two words"}, "the name 'two words' is not made of letters"),
        ({"order": "first"}, "its order is an object of type str, not a whole number"),
        ({"target": hello}, "its target is an object of type function, not a Target"),
        ({"group": "a b"}, "its group 'a b' is not made of letters"),
        ({"summary": "Say goodbye."}, "its docstring begins with 'Say hello.'"),
    ],
)
def test_a_wrong_command_is_reported(fields, words, installed):
    (failure,) = checked(installed(acme=[greet(**fields)])).failures
    assert words in failure.error


def test_an_error_in_a_command_of_a_plugin_is_its_own(installed):
    installed(acme=[greet()])
    outcome = CliRunner().invoke(app, ["greet", "--name", "nobody"])
    assert outcome.exit_code == 4
    assert "the command 'acme:greet' failed: LookupError" in outcome.output


def test_a_plugin_adds_a_command_and_a_command_of_a_group(installed):
    installed(acme=[greet(), greet("praise", group="plugins")])
    call = CliRunner().invoke
    assert "  greet        Say hello.\n" in call(app, ["--help"]).stdout
    assert "Say hello." in call(app, ["greet", "--help"]).stdout
    assert "hello me" in call(app, ["greet", "--name", "me"]).output
    assert "  praise  Say hello." in call(app, ["plugins", "--help"]).stdout
    assert "hello you" in call(app, ["plugins", "praise"]).output
    assert "Did you mean 'greet'" in call(app, ["gret"]).output


def test_a_command_never_replaces_one_of_mbdkit_and_a_clash_names_both(installed):
    loaded = installed(acme=[greet("run"), greet()], bolt=[greet()])
    call = CliRunner().invoke
    assert "Run a spec and write its archive." in call(app, ["run", "--help"]).stdout
    assert "Say hello." in call(app, ["acme:run", "--help"]).stdout
    with pytest.raises(SpecError, match=r"'greet' is used by acme 2\.0 and bolt 2\.0; write 'acme:greet' or"):
        loaded.get("command", "greet")
    refused = call(app, ["greet"])
    assert refused.exit_code == 2
    assert "hello you" in call(app, ["bolt:greet"]).output
    clashes = {report.id: report.error for report in loaded.reports if report.status == "clash"}
    assert set(clashes) == {"acme:run", "acme:greet", "bolt:greet"}
    assert f"also used by mbdkit {mbdkit.__version__}" in clashes["acme:run"]


def test_a_clash_of_kinds_of_specs_names_both_also_for_their_schema(installed):
    target = Target("mbdkit.spec.run_spec:RunSpec")
    kind = SpecKind(name="jumps", summary="Jumps.", marker="jumps", load=target, model=target)
    installed(acme=[kind], bolt=[kind])
    refused = CliRunner().invoke(app, ["schema", "jumps"])
    assert refused.exit_code == 2
    assert "write 'acme:jumps' or" in refused.output
    assert '"anyOf"' in CliRunner().invoke(app, ["schema", "acme:jumps"]).output


@pytest.mark.parametrize("name", sorted(FACES))
def test_every_name_of_a_door_exists(name):
    door = importlib.import_module(name)
    assert set(door.__all__) - {"__version__"} == set(homes_of(FACES[name]))
    assert all(hasattr(door, one) for one in door.__all__)
    with pytest.raises(AttributeError):
        _ = door.nothing


NOT_FOR_PLUGINS = {"ActingContact", "Any", "Coefficients", "Dense", "None", "StepEvent", "Traits", "Unpack"}
"""Names in these signatures that a typed plugin need not write, such as those of protocols."""


@pytest.mark.parametrize("kind", [mbdkit.StepMethod, mbdkit.ExternalMethod, mbdkit.Step])
def test_types_of_what_methods_implement_are_offered_to_plugins(kind):
    signatures = [getattr(kind, "__annotations__", {})]
    for name, part in vars(kind).items():
        function = part.fget if isinstance(part, property) else getattr(part, "__func__", part)
        if not name.startswith("_") and inspect.isfunction(function):
            signatures.append(function.__annotations__)
    texts = [str(text) for signature in signatures for text in signature.values() if "Callable" not in str(text)]
    names = {name for text in texts for name in re.findall(r"\b[A-Z]\w+", text)} - NOT_FOR_PLUGINS
    assert names <= {*mbdkit.__all__, *mbdkit.plugin.__all__}


def test_one_entry_point_of_a_distribution_is_left_out(entry_point, swing):
    module = offering(ModelPlugin("a", "A", swing().options, print))
    points = [entry_point(lambda: module, "mbdkit", name="part"), entry_point(lambda: offering(greet()), "mbdkit")]
    policy = Policy.of({"MBDKIT_DISABLE_PLUGINS": "mbdkit/part, mbdkit/builtin"})
    loaded = load_registry(points, policy)
    assert [item.id for item in loaded.items] == ["mbdkit:greet"]
    assert [report.id for report in loaded.reports if report.status == "disabled"] == ["mbdkit:part"]
    assert policy.reason_against("mbdkit", "builtin") is None
    assert policy.unknown([("mbdkit", "builtin"), ("mbdkit", "part")]) is None
    assert "'mbdkit/part'" in policy.unknown([("mbdkit", "builtin")])


def test_a_name_that_is_gone_from_a_door_says_since_when_and_what_replaces_it(tmp_path, monkeypatch):
    file = tmp_path / "wear_door.py"
    code = "from mbdkit.base.lazy_names import Moved, door\nTYPE_CHECKING = False\nif TYPE_CHECKING:\n    "
    code += "from math import pi as pi\nelse:\n"
    code += "    __getattr__, __dir__ = door(globals(), moved={'tau': Moved('0.3', '2*pi')})\n"
    file.write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    import wear_door

    words = r"^wear_door\.tau is gone since mbdkit 0\.3: use 2\*pi$"
    with pytest.raises(AttributeError, match=words):
        _ = wear_door.tau
    with pytest.raises(ImportError, match=words):
        from wear_door import tau  # noqa: F401
    assert not hasattr(wear_door, "tau")
    assert dir(wear_door) == ["pi"]


def test_a_deprecated_name_of_a_door_works_and_says_once_when_it_ends_and_what_replaces_it(tmp_path, monkeypatch):
    file = tmp_path / "worn_door.py"
    code = "from mbdkit.base.lazy_names import Moved, door\nTYPE_CHECKING = False\nif TYPE_CHECKING:\n    "
    code += "from math import pi as pi, tau as tau\nelse:\n"
    code += "    __getattr__, __dir__ = door(globals(), moved={'tau': Moved('1.1', '2*pi', until='2.0')})\n"
    file.write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    import worn_door

    words = r"^worn_door\.tau is deprecated since mbdkit 1\.1, and ends with 2\.0: use 2\*pi$"
    with pytest.warns(DeprecationWarning, match=words) as warned:
        from worn_door import tau
    assert (tau, worn_door.tau) == (math.tau, math.tau)
    assert [Path(one.filename).name for one in warned] == ["test_lazy.py"]
    assert "pi" in dir(worn_door)
