"""Plugins that print, end the program, raise anything, or change what is not theirs: only they are blamed."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from tests.installing import install_module

from .attack import LONGEST_MESSAGE, Attack, command
from .specs import pendulum

HEAD = """\
import os, sys, time
import numpy as np
from pydantic import BaseModel, field_validator
import mbdkit
from mbdkit import Claims, FunctionLaw, StepMethod, StepState, hookimpl
from mbdkit.base.errors import PluginError, RunError, SpecError, StepError

class Nasty(Exception):
    def __str__(self):
        raise RuntimeError("no message")

class Outside(BaseException):
    pass

def recurse():
    return recurse()

def act():
    {act}

def at(place):
    if place == {place!r}:
        act()

at("import")

class Options(BaseModel):
    gain: float = 1.0
    @field_validator("gain", mode="before")
    @classmethod
    def check(cls, value):
        at("options")
        return value

class Method(StepMethod):
    def step(self, equations, t, state, h):
        if t > 0.05:
            at("step")
        a, _ = equations.accelerations(t, state.q, state.v)
        return state.moved(h * state.v, h * a)

def create(options):
    at("create")
    return Method()

def claims(options):
    at("claims")
    return Claims(order=1)

def build(options):
    at("build")
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("A", m.ground, rod, points=((0.0, 0.0), (-0.5, 0.0)))
    return m

@hookimpl
def mbdkit_models():
    at("models")
    return [mbdkit.ModelPlugin(name="swing", summary="A swing", options=Options, build=build)]

@hookimpl
def mbdkit_integrators():
    at("integrators")
    return [mbdkit.IntegratorPlugin(name="euler", summary="Euler", options=Options, create=create, claims=claims)]
"""

PLACES = ("import", "models", "integrators", "options", "create", "claims", "build", "step")

HARMLESS = {
    "print": 'print("noise")',
    "write to file descriptor 1": 'os.write(1, b"noise")',
    "print from a child process": 'os.system("echo noise")',
    "close stdout": "sys.stdout = None",
    "change the folder": 'os.chdir("/")',
    "change the locale": "import locale; locale.setlocale(locale.LC_ALL, 'C.UTF-8')",
    "raise floating-point errors": 'np.seterr(all="raise")',
    "turn warnings into errors": "import warnings; warnings.simplefilter('error')",
    "seed the random state": "import random; np.random.seed(0); random.seed(0)",
    "ignore SIGTERM": "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)",
    "fork a child that ends at once": "child = os.fork() or os._exit(0); os.waitpid(child, 0)",
    "fork a child that outlives it": "os.fork() or (time.sleep(0.3), os._exit(0))",
    "fork a child that raises": "child = os.fork() or sys.exit(1); os.waitpid(child, 0)",
    "fork a child that goes on": "os.fork()",
    "use processes": "import subprocess; subprocess.run(['true'])",
    "leave a thread behind": "import threading; threading.Thread(target=time.sleep, args=(1e6,), daemon=True).start()",
    "keep files open": "globals().setdefault('files', []).extend(open(os.devnull) for _ in range(50))",
    "keep memory": "globals().setdefault('kept', []).append(bytearray(10_000_000))",
    "change the environment": "os.environ.clear()",
    "set the recursion limit": "sys.setrecursionlimit(200)",
    "collect no garbage": "import gc; gc.disable()",
}
ACTS = {
    "exit": "sys.exit(0)",
    "exit with a text": 'sys.exit("bye")',
    "an exception without a message": "raise Nasty",
    "an exception outside of Exception": 'raise Outside("out")',
    "NUL in a message": 'raise ValueError("a\\0b\\x1b[31m\\ud800")',
    "a message of a megabyte": 'raise ValueError("x" * 1_000_000)',
    "SpecError": 'raise SpecError("my own", key="time.step")',
    "RunError": 'raise RunError("not complete")',
    "PluginError": 'raise PluginError("mine")',
    "StepError with NUL": 'raise StepError("odd\\0code", "why\\0not")',
    "endless recursion": "recurse()",
    "StopIteration": "raise StopIteration",
    "GeneratorExit": "raise GeneratorExit",
    "MemoryError": "raise MemoryError",
    "OSError": 'raise OSError(28, "No space left on device")',
    "BrokenPipeError": "raise BrokenPipeError",
    "an assertion": "assert False",
}

CASES = [(place, name, act) for place in PLACES for name, act in (HARMLESS | ACTS).items()]


def _case(random: np.random.Generator, folder: Path) -> list[str]:
    place, name, act = CASES[random.integers(len(CASES))]
    return [f"{name} in {place}: {problem}" for problem in hostile(place, name, act, folder)]


def hostile(place: str, name: str, act: str, folder: Path) -> list[str]:
    """Return what did not hold when a plugin misbehaves in a place while a run prints JSON."""
    install_module(folder / "site", "acme-hostile", HEAD.format(act=act, place=place))
    spec = pendulum()
    spec["model"], spec["integrator"] = {"name": "swing", "gain": 1.0}, {"name": "euler", "gain": 1.0}
    (folder / "spec.json").write_text(json.dumps(spec))
    paths = [str(folder / "site"), *filter(None, [os.environ.get("PYTHONPATH")])]
    run = "run", "spec.json", "-o", "out.h5", "--json", "--overwrite"
    env = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    ending = command(*run, folder=folder, env=env)
    if "compiles" in ending.errors:  # measured without compilation
        ending = command(*run, folder=folder, env=env)
    harmless = name in HARMLESS
    status = 0 if harmless else 4
    if not harmless and place in ("import", "models", "integrators"):
        status = 2  # the plugin is left out, so the spec names what is not there
    if name == "StepError with NUL" and place == "step":
        status = 3  # an ordinary failure of a step
    if name == "SpecError" and place in ("options", "build", "claims"):
        status = 2  # the plugin refuses its options
    if name in ("a message of a megabyte", "an assertion") and place == "options":
        status = 2  # ValueError and AssertionError are how a validator of pydantic refuses a value
    found = ending.problems(allowed=(status,))
    if len(ending.errors) > LONGEST_MESSAGE:
        found.append(f"its messages have {len(ending.errors)} characters")
    try:
        told = json.loads(ending.output)
    except ValueError:
        return [*found, f"stdout is not one JSON object: {ending.output[:200]!r}"]
    if place == "step" and not harmless:
        if not (folder / "out.h5").exists() or told.get("status") != "failed":
            found.append(f"the archive is lost: {told}")
        elif status == 4 and not told["status_reason"].startswith("plugin-error"):
            found.append(f"the reason is {told['status_reason'][:200]!r}")
    elif status and "error" not in told:
        found.append(f"the JSON object has no error: {told}")
    return found


ATTACKS = (Attack("plugins", "hostile plugins are blamed, and do not spoil JSON", 300, _case),)
