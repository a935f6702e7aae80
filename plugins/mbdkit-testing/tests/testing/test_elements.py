"""The kit verifies muscles, contacts and the template of elements, and finds what is wrong with copies of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import mbdkit
import mbdkit.testing
from mbdkit.base.errors import SpecError
from mbdkit.registry.manager import forget
from mbdkit_testing.kit import checks_of, plugin_under_test
from mbdkit_testing.scaffold.new_plugin import new_project
from tests.installing import install_project

STATES = 'rates={"pressure": (sympy.Integer(0), "Pa")}'
NUMBERS = 'parameters=lambda cylinder: {"area"'
LAW = f"""ExpressionLaw(
        -AREA * PRESSURE,  # a positive force pulls
        {STATES},"""
TRACED = """plugin.TracedLaw(
        lambda length, rate, time, p: 4e4 * (length - 0.8) - p["area"] * p["pressure"],
        states=(plugin.LawState("pressure", plugin.TracedLaw(lambda *x: 0.0 * x[3]["area"], numbers), "Pa"),),
        has_derivatives=False,"""
CLASS = "class Cylinder(plugin.LineForce):"
METHOD = "    def rate("
WRONG: dict[str, tuple[str, str, dict[str, str]]] = {
    "power": ("element.columns", "is not the power in the equations", {'"power": power}': '"power": -power}'}),
    "derivative": (
        "derivatives.tangents", "with respect to a position differs from differences",
        {LAW: TRACED, CLASS: f'def numbers(c): return {{"area": c.area, "pressure": c.pressure}}\n\n\n{CLASS}'},
    ),
    "unit": (
        "element.states", "of the state 'lift.pressure' is N, that of its key or column Pa", {', "Pa")},': ', "N")},'},
    ),
    "order": (
        "element.states",
        "announce the states lift.level, lift.pressure, but have lift.pressure, lift.level",
        {
            STATES: STATES.replace('"Pa")', '"Pa"), "level": (sympy.Integer(0), "1")'),
            NUMBERS: NUMBERS.replace('{"area"', '{"level": 0.0, "area"'),
            METHOD: f"    state_names: ClassVar[tuple[str, ...]] = ('level', 'pressure')\n\n{METHOD}",
        },
    ),
    "body": (
        "drawing.lines",
        "'lift' is drawn on 'boot', which is not a body of the mechanism",
        {
            ' example="wrong': ' draw=Target("mbdkit_wrong_body.code:lines"), example="wrong',
            CLASS: "@seams.element_lines\n"
            f"def lines(one, mechanism): return [[('ground', (0, 0)), ('boot', (0, 0))]]\n\n\n{CLASS}",
        },
    ),
    "scale": ("element.spec", "its numbers change if they are written with units", {"piston [m^2]": "piston [mm^2]"}),
    "places": ("element.bodies", "lists no bodies", {METHOD: f"    def places(self): return []\n\n{METHOD}"}),
    "rate": ("order.states", "instead of 4", {"({self.flow})": "({self.flow} + 0.01*sin(1e6*t))"}),
    "balance": (
        "element.balance", "of 'lift' on its bodies, or their moments, are not in balance",
        {
            "    return acting\n": """    for one in acting:
        turn = [lowering.expression("model", one.name, f"{x}*wrong_balances.{one.name}.length") for x in (0, 0, 9)]
        lowering.wrench(one.name, lowering.number("boom"), turn)
    return acting
""",
        },
    ),
    "force": (
        "energy.balance", "does not converge",
        {"-AREA * PRESSURE,": "-AREA * PRESSURE + 1e3 * sympy.sin(1e7 * sympy.Symbol('time', real=True)),"},
    ),
    "checkpoint": (
        "restart.checkpoint", "cannot be stored in a checkpoint", {'"lowest": self.lowest}': '"lowest": self}'},
    ),
    "support": ("support.computations", "no computation asks whether elements", {'"statics": ': '"lanes": '}),
    "example": ("energy.balance", "has no wrong_examples", {'example="wrong-example"': 'example="pendulum"'}),
}  # fmt: skip
"""Faults in copies of the template: the check that finds it, part of the cause, and texts and what replaces them."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Install the template and all wrong copies in this process, and remove them at the end."""
    folder, before = tmp_path_factory.mktemp("elements"), list(sys.path)
    for name in ("right", *WRONG):
        project = new_project(f"mbdkit-wrong-{name}", "element", folder)
        install_project(folder / "site", project)
        sys.path.append(str(project / "src"))
        files = [project / "src" / f"mbdkit_wrong_{name}" / file for file in ("__init__.py", "code.py")]
        for old, new in WRONG[name][2].items() if name in WRONG else ():
            assert any(old in file.read_text() for file in files), old
            for file in files:
                file.write_text(file.read_text().replace(old, new))
    sys.path.append(str(folder / "site"))
    forget()
    yield folder
    sys.path[:] = before
    for name in [name for name in sys.modules if name.startswith("mbdkit_wrong_")]:
        del sys.modules[name]  # parallel tests may use this fixture twice in a process
    forget()


@pytest.mark.parametrize(
    "name", ["wrong-right", *(pytest.param(x, marks=pytest.mark.slow) for x in ("mbdkit:muscle", "mbdkit:contact"))]
)
def test_muscles_contacts_and_the_template_are_verified(name: str, site: Path) -> None:
    report = mbdkit.testing.check_element(name)
    assert report.verified, report.text()
    ran = {result.name for result in report.results if result.outcome == "pass"}
    assert {"energy.balance", "derivatives.tangents", "restart.checkpoint", "support.computations"} <= ran


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_a_copy_of_the_template_is_found(name: str, site: Path) -> None:
    check, cause, _ = WRONG[name]
    kind = plugin_under_test("element-kind", f"wrong-{name}", {})
    (result,) = (one.run(kind) for one in checks_of("element-kind") if one.name == check)
    assert result.outcome == "fail", result
    assert cause in result.cause


def test_kinds_of_elements_have_no_options() -> None:
    with pytest.raises(SpecError, match="has no options"):
        plugin_under_test("element-kind", "muscle", {"area": 1.0})
