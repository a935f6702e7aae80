"""The program of a force law belongs to this law, however much it looks like another one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """\
import ctypes
from pydantic import BaseModel
from mbdkit import ExpressionLaw
from mbdkit.engine.force_laws import bind_law
from acme.laws import FORCES

class Options(BaseModel):
    stiffness: float = 1.0

Options.law_options = Options
real, pointer = ctypes.c_double, ctypes.POINTER(ctypes.c_double)
for force in FORCES:
    compiled, values = bind_law(ExpressionLaw(force), Options(), "acme")
    results = (real * 4)()
    function = ctypes.CFUNCTYPE(None, ctypes.c_int64, real, real, real, pointer, pointer)(compiled.address)
    function(compiled.program, 2.0, 0.0, 0.0, (real * len(values))(*values), results)
    print(results[0])
"""

FORCE = """\
from sympy import symbols
{head}
length, stiffness = symbols("length stiffness")

def force():
    return stiffness * length**{power}
"""
LOOP = """\
from sympy import symbols
length, stiffness = symbols("length stiffness")
FORCES = []
for n in (1, 3):
    def force(n=n):
        return stiffness * length**n
    FORCES.append(force)
"""
METHOD = """\
from sympy import symbols

class Power:
    def __init__(self, n):
        self.n = n

    def force(self):
        length, stiffness = symbols("length stiffness")
        return stiffness * length**self.n

FORCES = [Power(1).force, Power(3).force]
"""
LAMBDAS = """\
from sympy import symbols
length, stiffness = symbols("length stiffness")
FORCES = [lambda: stiffness * length, lambda: stiffness * length**3]
"""
LIKE = {
    "linear.py": FORCE.format(head="", power=1),
    "cubic.py": FORCE.format(head="", power=3),
    "defaults.py": LOOP,
    "methods.py": METHOD,
    "lambdas.py": LAMBDAS,
    "laws.py": "from acme import cubic, defaults, lambdas, linear, methods\n\n"
    "FORCES = [linear.force, cubic.force, *defaults.FORCES, *methods.FORCES, *lambdas.FORCES]\n",
}
"""Pairs of functions that differ in module, default value, bound object, or nothing but their place in a line."""


def forces(folder: Path, files: dict[str, str]) -> list[float]:
    """Return the forces at length 2 of the laws of package `acme` with these files, in a new process."""
    for name, text in files.items():
        path = folder / "acme" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    environment = os.environ | {"PYTHONPATH": str(folder)}
    command = [sys.executable, "-B", "-c", PROGRAM]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [float(line) for line in done.stdout.split()]


def test_laws_that_look_alike_keep_their_own_forces(tmp_path: Path) -> None:
    assert forces(tmp_path, LIKE) == [2.0, 8.0] * 4  # s and s^3 at s = 2
