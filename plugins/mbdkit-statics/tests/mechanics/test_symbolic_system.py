"""`Mechanism.to_sympy`: the system of equations printed, differentiated anew, and evaluated against the engine."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import sympy as sp

from mbdkit.base.errors import SpecError
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.kernels.observe import constraints_at
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec
from mbdkit_statics.symbolic_system import SymbolicSystem
from tests.engine.random_mechanisms import flexible

T = 0.7
STATES = (1,)


def every_element() -> Mechanism:
    """Return a mechanism with each kind of joint and force, ground on either side, tilted gravity and a point mass."""
    m = Mechanism(gravity=(0.3, -9.7))
    m.body("arm", mass=1.3, inertia=0.21, position=(0.4, 0.1), angle=0.3)
    m.body("long rod", mass=0.7, inertia=0.1, position=(1.2, 0.3), angle=-0.4)
    m.body("disc_2", mass=2.0, inertia=0.5, position=(1.9, -0.4), angle=0.1)
    m.body("point", mass=0.4, position=(0.5, 1.0))
    m.revolute("pin", "arm", "long rod", points=((0.4, 0.1), (-0.45, 0.05)))
    m.revolute("ground pin", "arm", m.ground, points=((-0.4, 0.0), (0.1, -0.05)))
    m.distance("link", "long rod", "disc_2", points=((0.5, 0.1), (-0.1, 0.2)), length=0.55)
    m.distance("tether", m.ground, "point", points=((0.2, 0.1), (0.0, 0.0)), length=1.0)
    m.driver("motor", m.ground, "disc_2", coordinate="angle", motion="0.1 + atan2(sin(2*pi*t), 3) + max(t, 1 - t)**2")
    m.driver("lift", "arm", "point", coordinate="y", motion="0.8 + 0.1*abs(sin(3*t + 4))")
    m.driver("slide", "arm", "disc_2", coordinate="x", motion="1.5 + t**3/7", points=((0, 0), (0.1, 0.3)))
    m.body("plate", mass=1.0, inertia=0.3, position=(2.6, 0.5), angle=0.2)
    m.weld("bolts", "disc_2", "plate", points=((0.4, 0.5), (-0.3, 0.1)), angle=0.15)
    m.body("slider", mass=0.6, inertia=0.02, position=(3.0, 1.0), angle=-0.1)
    m.prismatic("rail", "plate", "slider", points=((0.1, 0.2), (-0.1, 0.3)), axis=(0.6, 0.7))
    m.body("roller", mass=0.3, inertia=0.01, position=(2.2, 1.1), angle=0.7)
    m.point_on_line("slot", "plate", "roller", points=((0.2, 0.1), (0.04, -0.1)), axis=(-0.3, 0.8))
    m.driver("cam", "plate", "slider", coordinate="x", motion={"table": [[0, 0.5, 1, 2, 3], [0.4, 0.5, 0.3, 0.2, 0.1]]})
    m.spring_damper(
        "s", "arm", "disc_2", points=((0.1, 0.2), (0.2, -0.3)), stiffness=31.0, damping=1.7, free_length=0.4
    )
    m.spring_damper("band", m.ground, "point", points=((1, 2), (0, 0)), stiffness=12.5)
    m.torsion_spring("twist", "long rod", "arm", stiffness=3.1, damping=0.3, free_angle=0.2)
    m.torsion_spring("clock", "disc_2", m.ground, stiffness=1.1)
    m.torque("drive", "arm", value="0.5*cos(4*t)", reaction_body="long rod")
    m.torque("brake", "disc_2", value=-0.3)
    m.law(
        "rope", "arm", "disc_2", law="one-sided", points=((0.0, 0.2), (0.1, 0.0)), stiffness=9.0, damping=0.4,
        free_length=0.6, acts="tension",
    )  # fmt: skip
    m.law("bush", "arm", "disc_2", law="table", along="y", table=[[-2.0, 0.1, 1.5], [-3.0, 0.2, 4.0]], damping=0.7)
    m.law("coil %1", "arm", "long rod", law="table", along="angle", table=[[-2.0, 0.1, 1.5], [-3.0, 0.2, 4.0]])
    m.law("cart", "disc_2", "point", law="linear", along="x", stiffness=3.0, damping=0.2, free_length=-0.3)
    m.force("thrust", "disc_2", value=[1.2, "0.3 + t"], point=(-0.3, 0.1), frame="body")
    m.force("push", "long rod", value=[1.5, "tanh(t) - min(t, 0.2)"], point=(0.3, -0.1))
    return m


MECHANISMS: dict[str, Callable[[], Mechanism]] = {
    "double pendulum": lambda: load_spec("double-pendulum").mechanism(), "knee": lambda: load_spec("knee").mechanism(),
    "slider-crank": lambda: load_spec("slider-crank").mechanism(), "every element": every_element,
}  # fmt: skip
mechanisms = pytest.mark.parametrize("name", ["slider-crank", "every element"])
forms = pytest.mark.parametrize("numbers", [True, False], ids=["numbers", "symbols"])


@cache
def system(name: str, numbers: bool) -> SymbolicSystem:
    """Return the equations of a mechanism, derived once for all tests."""
    return MECHANISMS[name]().to_sympy(numbers=numbers)


def random_state(m: Mechanism, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates near the given start, and velocities, with ground's three zeros at the end."""
    rng = np.random.default_rng(seed)
    given = np.array([(*body.position, body.angle) for body in m.bodies.values()])
    q, v = given.ravel() + rng.normal(scale=0.1, size=given.size), rng.normal(size=given.size)
    return with_ground(q), with_ground(v)


def engine(m: Mechanism, t: float, q: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
    """Return what the compiled engine has for each of the arrays of `SymbolicSystem.evaluate`."""
    compiled = compile_mechanism(m)
    top, n = compiled.topology, len(q) - 3
    workspace = Workspace(compiled, t, q, v)
    w = workspace.scratch
    constraints_at(top, w, t, q, v)
    workspace.use_pivots()
    observer = StateObserver(workspace)
    found = observer.arrays(1)
    assert observer.observe(np.array([t]), q[None], v[None], found) is None
    acc, lam = found.acc, found.lam
    rows = [(row.pair, row.place) for row in compiled.rows]
    jacobian = np.zeros((len(rows), n + 3))
    for i, (pair, place) in enumerate(rows):
        for side in range(2):
            columns = 3 * top.pairs[pair, 1 + side] + np.arange(3)
            jacobian[i, columns] += w.jac[pair, 6 * place + 3 * side :][:3]
    mass = top.mass[:-1].ravel()
    return {
        "mass_matrix": np.diag(mass), "constraints": np.array([w.phi[row] for row in rows]),
        "constraint_jacobian": jacobian[:, :n], "gamma": np.array([w.gamma[row] for row in rows]),
        "forces": w.force[:n] * bool(m.forces or m.beams) + mass * np.tile([*m.gravity, 0.0], len(m.bodies)),
        "accelerations": acc[0, :n], "multipliers": np.array([lam[0][row] for row in rows]),
    }  # fmt: skip


@mechanisms
@forms
@pytest.mark.parametrize("seed", STATES)
def test_the_numbers_of_the_system_are_those_of_the_compiled_engine(name: str, numbers: bool, seed: int) -> None:
    assert_same_numbers(MECHANISMS[name](), system(name, numbers), seed)


def assert_same_numbers(m: Mechanism, symbolic: SymbolicSystem, seed: int) -> None:
    q, v = random_state(m, seed)
    found, expected = symbolic.evaluate(T, q[:-3], v[:-3]), engine(m, T, q, v)
    assert found.keys() == expected.keys()
    for array, value in expected.items():
        scale = np.max(np.abs(value))
        np.testing.assert_allclose(found[array], value, rtol=0, atol=1e-13 * scale, err_msg=array)


@pytest.mark.slow
@forms
def test_beams_are_those_of_the_compiled_engine(numbers: bool) -> None:
    m = flexible(np.random.default_rng(5), elements=1)
    s = m.to_sympy(numbers=numbers)
    assert_same_numbers(m, s, seed=1)
    if not numbers:
        check_latex(s.latex())


@forms
def test_moving_centers_are_those_of_the_compiled_engine(numbers: bool) -> None:
    m = Mechanism()
    m.body("plate", mass=1.0, inertia=0.3, position=(0.6, 0.5), angle=0.2)
    m.body("wheel", mass=0.5, inertia=0.03, position=(0.5, 0.4), angle=0.4)
    m.revolute("pivot", m.ground, "plate", points=((0, 0), (-0.5, -0.4)), center={"y": "0.1*angle**2 + 0.2"})
    heights = {"table": [[-1.0, 0.2, 1.1, 2.0], [0.1, -0.2, 0.3, 0.1]]}
    center = {"x": "0.3*sin(2*angle)", "y": heights}
    m.revolute("rolls", "plate", "wheel", points=((0.1, 0.9), (0.05, -0.1)), center=center)
    m.driver("lift", m.ground, m.body("weight", mass=1.0), coordinate="y", motion="0.1*sin(t)")
    for seed in STATES:
        assert_same_numbers(m, m.to_sympy(numbers=numbers), seed)


def test_the_double_pendulum_prints_the_index_1_system_of_two_rods_on_pins() -> None:
    # expected: Phi = (x1 - l/2 c1, y1 - l/2 s1, x2 - l/2 c2 - x1 - l/2 c1, ...) differentiated by hand
    m = MECHANISMS["double pendulum"]()
    s = m.to_sympy()
    matrix, right = s.kkt()
    x1, y1, th1, x2, y2, th2 = s.q
    half = sp.Rational(1, 2) * sp.Integer(20)  # the packaged example's rods are 20 m long
    c1, s1, c2, s2 = (half * f(th) for th in (th1, th2) for f in (sp.cos, sp.sin))
    phi = sp.Matrix([x1 - c1, y1 - s1, x2 - c2 - x1 - c1, y2 - s2 - y1 - s1])
    phi_q = sp.Matrix([[1, 0, s1, 0, 0, 0], [0, 1, -c1, 0, 0, 0], [-1, 0, s1, 1, 0, s2], [0, -1, -c1, 0, 1, -c2]])
    w1, w2 = s.v[2] ** 2, s.v[5] ** 2
    gamma = sp.Matrix([-c1 * w1, -s1 * w1, -c1 * w1 - c2 * w2, -s1 * w1 - s2 * w2])
    assert matrix.shape == (10, 10)
    assert right.shape == (10, 1)
    assert matrix == matrix.T
    assert s.constraints == phi
    assert matrix[6:, :6] == phi_q
    assert matrix[:6, 6:] == phi_q.T
    assert matrix[6:, 6:] == sp.zeros(4, 4)
    np.testing.assert_array_equal(np.array(matrix[:6, :6], dtype=float), np.diag([1, 1, 400 / 12] * 2))
    np.testing.assert_array_equal(np.array(right[:6, 0], dtype=float).ravel(), [0, -9.81, 0] * 2)
    assert (right[6:, 0] - gamma).expand() == sp.zeros(4, 1)
    tex = s.latex()
    assert tex.count(r"\begin{array}") == 3
    assert tex.startswith(r"\left[\begin{array}{cccccc|cccc}" + "\n1 & 0 & 0 & 0 & 0 & 0 & 1 & 0 & -1 & 0 \\\\\n")
    assert tex.splitlines()[5].startswith(r"0 & 0 & 0 & 0 & 1 & 0 & 0 & 0 & 0 & 1 \\")
    assert r"\ddot{\theta}_{\text{rod1}} \\" in tex
    assert r"\lambda_{\text{J2},y} \\" in tex


def test_symbols_are_named_by_body_and_joint() -> None:
    s = MECHANISMS["double pendulum"]().to_sympy(numbers=False)
    assert [str(x) for x in s.q[:3]] == ["x_rod1", "y_rod1", "theta_rod1"]
    assert [str(x) for x in s.v[3:]] == ["xdot_rod2", "ydot_rod2", "thetadot_rod2"]
    assert str(s.accelerations[2]) == "thetaddot_rod1"
    assert [str(x) for x in s.multipliers] == ["lambda_J1_x", "lambda_J1_y", "lambda_J2_x", "lambda_J2_y"]
    values = {str(symbol): value for symbol, value in s.parameters.items()}
    inertia = 400 / 12
    assert values == {
        "g": 9.81, "m_rod1": 1, "m_rod2": 1, "J_rod1": inertia, "J_rod2": inertia,
        "xi_J1_rod1": -10, "xi_J2_rod1": 10, "xi_J2_rod2": -10,
    }  # fmt: skip


def by_time(s: SymbolicSystem, expr: sp.Matrix) -> sp.Matrix:
    """Return the derivative of an expression of t, q and v by time at constant v."""
    return expr.jacobian(s.q) * s.v + expr.diff(s.t)


def numbers_of(s: SymbolicSystem, expr: sp.Matrix, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.array(sp.lambdify([s.t, list(s.q), list(s.v)], expr, "numpy", cse=True)(T, q, v), dtype=float)


@mechanisms
def test_jacobian_and_gamma_are_the_derivatives_of_the_whole_systems_constraints(name: str) -> None:
    m = MECHANISMS[name]()
    s = system(name, True)
    phi = s.constraints.applyfunc(lambda x: x.rewrite(sp.Piecewise))  # |x|, min and max without their corners
    q, v = (x[:-3] for x in random_state(m, 1))
    gamma = -by_time(s, by_time(s, phi))
    for found, expected in ((s.constraint_jacobian, phi.jacobian(s.q)), (s.gamma, gamma)):
        expected = numbers_of(s, expected, q, v)
        size = max(1.0, np.max(np.abs(expected)))
        np.testing.assert_allclose(numbers_of(s, found, q, v), expected, rtol=0, atol=1e-12 * size)


@mechanisms
def test_symbols_and_numbers_say_the_same_and_leave_no_symbol_without_a_value(name: str) -> None:
    with_numbers, with_symbols = system(name, True), system(name, False)
    state = {with_numbers.t, *with_numbers.q, *with_numbers.v}
    assert not with_numbers.parameters
    assert with_symbols.parameters
    for field in ("mass_matrix", "constraints", "constraint_jacobian", "gamma", "forces"):
        assert getattr(with_numbers, field).free_symbols <= state
        assert getattr(with_symbols, field).free_symbols <= state | set(with_symbols.parameters)
    assert not sp.Matrix(with_symbols.constraint_jacobian).atoms(sp.Float)


def test_numbers_stay_as_they_were_written() -> None:
    m = Mechanism()
    m.body("b", mass=0.1, inertia=1 / 3)
    m.driver("d", m.ground, "b", coordinate="angle", motion="0.3*sin(2*pi*t) + pi/2")
    s = m.to_sympy()
    assert sp.latex(s.mass_matrix[0, 0]) == "0.1"
    assert float(s.mass_matrix[2, 2]) == 1 / 3
    assert sp.latex(s.constraints[0]) == r"\theta_{b} - 0.3 \sin{\left(2 \pi t \right)} - \frac{\pi}{2}"


def test_names_that_run_together_make_different_symbols() -> None:
    m = Mechanism()
    for name in ("a", "b_c", "c"):
        m.body(name, mass=1.0, inertia=1.0)
    m.revolute("A", "a", "b_c", points=((0.1, 0.2), (0.3, 0.4)))
    m.revolute("A_b", "a", "c", points=((0.5, 0.6), (0.7, 0.8)))
    s = m.to_sympy(numbers=False)
    q, v = random_state(m, 0)
    found, expected = s.evaluate(0.0, q[:-3], v[:-3]), engine(m, 0.0, q, v)
    np.testing.assert_allclose(found["constraints"], expected["constraints"], rtol=0, atol=1e-14)
    assert len(set(s.names.values())) == len(s.names)


def test_a_mechanism_without_joints_has_a_system_without_constraints() -> None:
    m = Mechanism()
    m.body("ball", mass=0.2)
    s = m.to_sympy()
    found = s.evaluate(0.0, np.zeros((1, 3)), np.zeros((1, 3)))
    np.testing.assert_array_equal(found["accelerations"], [0, -9.81, 0])
    assert found["multipliers"].shape == (0,)
    assert found["constraint_jacobian"].shape == (0, 3)
    assert r"\hline" not in s.latex()
    assert check_latex(s.latex()) is None


def test_redundant_joints_have_accelerations_all_the_same() -> None:
    # expected: a rod on two pins at one place moves as on one, and its pins share the load evenly
    m = Mechanism()
    m.body("rod", mass=2.0, inertia=0.5, position=(0.5, 0.0))
    m.revolute("A", m.ground, "rod", at=(0, 0))
    alone = m.to_sympy().evaluate(0.0, [0.5, 0, 0], np.zeros(3))
    m.revolute("B", m.ground, "rod", at=(0, 0))
    both = m.to_sympy().evaluate(0.0, [0.5, 0, 0], np.zeros(3))
    np.testing.assert_allclose(both["accelerations"], alone["accelerations"], rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(both["multipliers"], np.tile(alone["multipliers"] / 2, 2), rtol=1e-13, atol=1e-13)


def test_a_state_that_is_not_one_is_refused() -> None:
    s = system("every element", True)
    with pytest.raises(ValueError, match="v should have 21 numbers, 3 for each of 7 bodies, not 2"):
        s.evaluate(0.0, np.zeros(21), [0.0, 1.0])
    m = Mechanism()
    m.body("b", mass=1.0, inertia=1.0)
    m.distance("d", m.ground, "b", points=((0, 0), (0, 0)), length=1.0)
    with pytest.raises(ValueError, match="not finite at this state"):
        m.to_sympy().evaluate(0.0, np.zeros(3), np.zeros(3))


def test_a_mechanism_that_is_not_valid_is_refused() -> None:
    with pytest.raises(SpecError, match="at least one body"):
        Mechanism().to_sympy()


FIELDS = {
    "spring-damper": {"type", "bodies", "points", "from_", "to", "stiffness", "damping", "free_length"},
    "torsion-spring": {"type", "bodies", "stiffness", "damping", "free_angle"},
    "torque": {"type", "body", "value", "reaction_body"},
    "force": {"type", "body", "point", "at", "value", "frame"},
    "law": {"type", "law", "pathway"},
}
"""What `mbdkit_statics.symbolic_equations` reads of each force element; once it is placed, `at`, `from_` and `to` are
None."""


def test_every_force_element_has_a_symbolic_form_and_no_key_of_one_is_left_out() -> None:
    kinds = get_args(get_args(Force)[0])
    assert {kind.model_fields["type"].default: set(kind.model_fields) for kind in kinds} == FIELDS
    present = [*every_element().joints.values(), *every_element().forces.values()]
    joints = {"revolute", "distance", "driver", "prismatic", "point-on-line", "weld"}
    assert {one.type for one in present} >= FIELDS.keys() | joints


# ---- LaTeX --------------------------------------------------------------------------------------------------------

COMMANDS = re.compile(
    "begin|end|left|right|hline|text|(text(backslash|asciitilde|asciicircum))|operatorname|sin|cos|tan|tanh|atan"
    "|max|min|frac|sqrt|wedge|cdot|pi|lambda|tau|theta|d?dot|xi|eta|ell|varphi|geq|leq|quad"
)


def check_latex(tex: str) -> None:
    """Assert that braces and environments close, rows of an array are equally long, and every command is known."""
    bare = re.sub(r"\\[\\{}$&#_%|]", " ", tex.replace(r"\\", "\n"))
    assert bare.count("{") == bare.count("}")
    assert bare.count(r"\left") == bare.count(r"\right")
    assert re.findall(r"\\begin\{(\w+)\}", bare).count("array") == re.findall(r"\\end\{(\w+)\}", bare).count("array")
    assert not [command for command in re.findall(r"\\([a-zA-Z]+)", bare) if not COMMANDS.fullmatch(command)]
    assert not re.search(r"nan|zoo|Derivative|Subs|Dirac|Heaviside", bare)
    for layout, rows in re.findall(r"\\begin\{array\}\{([c|]+)\}\n(.*?)\\end\{array\}", tex, flags=re.DOTALL):
        lines = [line for line in rows.splitlines() if line and line != r"\hline"]
        assert {len(re.findall(r"(?<!\\)&", re.sub(r"\\begin\{cases\}.*?\\end\{cases\}", "", x))) for x in lines} == {
            layout.count("c") - 1
        }


def awkward() -> Mechanism:
    """Return a mechanism whose names are full of what LaTeX reads as commands."""
    m = Mechanism()
    m.body("50% of_rod^2 & {co} #1 ~$x$ \\alpha", mass=1.0, inertia=1.0)
    m.revolute("gelenk_ä {", m.ground, next(iter(m.bodies)), points=((0, 1), (0.5, 0)))
    return m


PRINTED = {**MECHANISMS, "awkward names": awkward}


@pytest.mark.parametrize("name", ["every element", "awkward names"])
@forms
def test_the_latex_is_well_formed(name: str, numbers: bool) -> None:
    check_latex((system(name, numbers) if name in MECHANISMS else awkward().to_sympy(numbers=numbers)).latex())


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex, which compiles the print, is not installed")
@pytest.mark.parametrize("name", PRINTED)
def test_the_latex_compiles(name: str, tmp_path: Path) -> None:
    m = PRINTED[name]()
    shown: list[Any] = [rf"\[ {m.to_sympy(numbers=numbers).latex()} \]" for numbers in (True, False)]
    page = r"\documentclass{article}\usepackage{amsmath}\begin{document}" + "\n".join(shown) + r"\end{document}"
    (tmp_path / "system.tex").write_text(page, encoding="utf-8")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "system.tex"],
        cwd=tmp_path, capture_output=True, text=True, errors="replace", timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:]
