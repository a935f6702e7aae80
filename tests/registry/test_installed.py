"""Plugins as they are installed: distributions with metadata, in a process of its own."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.installing import install_module, python

pytestmark = pytest.mark.end_to_end

GOOD = """
import mbdkit
from pydantic import BaseModel

class SwingOptions(BaseModel):
    length: float = 1.0

def build(options):
    mechanism = mbdkit.Mechanism()
    mechanism.body("seat", mass=1.0, position=(0.0, -options.length))
    return mechanism

@mbdkit.hookimpl
def mbdkit_models():
    return [mbdkit.ModelPlugin("swing", "A swing", SwingOptions, build)]
"""


SPEC = {"mbdkit": 1, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.1}}


def mbdkit(site: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return python("-m", "mbdkit", *arguments, path=(site,), cwd=site, **environment)


def test_a_good_plugin_beside_a_broken_one(tmp_path):
    install_module(tmp_path, "swing-kit", GOOD)
    install_module(tmp_path, "bad-kit", "print('noise')\nimport sys\nsys.exit(7)\n")
    listed = mbdkit(tmp_path, "plugins", "list", "--json")
    assert listed.returncode == 0
    plugins = {entry["id"]: entry for entry in json.loads(listed.stdout)["plugins"]}
    assert plugins["swing-kit:swing"]["status"] == "ok"
    assert plugins["bad-kit:main"]["status"] == "error"
    assert plugins["mbdkit:rk4"]["status"] == "ok"
    warnings = [line for line in listed.stderr.splitlines() if "warning" in line]
    assert len(warnings) == 1
    assert "bad-kit:main" in warnings[0]
    assert "Traceback" not in listed.stderr
    assert mbdkit(tmp_path, "plugins", "doctor").returncode == 4


WRONG = {
    "a BaseException": ("class Boom(BaseException): ...\nraise Boom('loud')", "Boom: loud"),
    "another API": (GOOD.replace("@mbdkit", "mbdkit_api = {'kernels': 99}\n@mbdkit"), "version 99 of kernels"),
    "a hook that raises": (GOOD.replace("return [", "return [1 / 0, "), "ZeroDivisionError"),
}


def test_whatever_a_plugin_does_the_commands_live_and_say_so_in_one_line(tmp_path):
    words = {}
    for number, (code, expected) in enumerate(WRONG.values()):
        install_module(tmp_path, f"bad-kit{number}", code)
        words[f"mbdkit: warning: plugin 'bad-kit{number}:main' was not loaded: "] = expected
    done = mbdkit(tmp_path, "plugins", "list")
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == len(words)
    for begin, expected in words.items():
        (line,) = (line for line in lines if line.startswith(begin))
        assert expected in line
    strict = mbdkit(tmp_path, "validate", "pendulum", MBDKIT_STRICT_PLUGINS="1")
    assert strict.returncode == 4
    assert strict.stderr.splitlines()[-1].startswith("error: plugin 'bad-kit")


def test_what_doctor_refuses_is_said_by_list_too(tmp_path):
    """Another version of mbdkit or of a family, a name that is on no door, and a function that does not exist."""
    refused = {
        "later-kit": (f"from mbdkit.plugin import Later\n{GOOD}", "cannot import name 'Later' from 'mbdkit.plugin'"),
        "old-kit": (GOOD, "it requires mbdkit<0.2, and mbdkit "),
        "next-kit": (GOOD.replace("@mbdkit", "mbdkit_api = {'models': 99}\n@mbdkit"), "version 99 of models"),
        "wheel-kit": (
            GOOD.replace("SwingOptions, build", "mbdkit.plugin.Target('wheel_kit:none'), build"),
            "no attrib",
        ),
    }
    for name, (code, _) in refused.items():
        install_module(
            tmp_path, name, code, requires=("mbdkit<0.2; python_version > '3'",) if name == "old-kit" else ()
        )
    install_module(tmp_path, "swing-kit", GOOD, requires=("mbdkit>=0.2", "mbdkit[numba] <99", "mbdkit-walker<0.1"))
    for command in ("list", "doctor"):
        done = mbdkit(tmp_path, "plugins", command, "--json")
        plugins = {plugin["distribution"]: plugin for plugin in json.loads(done.stdout)["plugins"]}
        assert plugins["swing-kit"]["error"] is None
        for name, (_, words) in refused.items():
            assert plugins[name]["status"] == "error"
            assert words in plugins[name]["error"]


def test_verify_tells_which_imports_are_on_no_door(tmp_path):
    inner = "from mbdkit.mechanism.mechanism import Mechanism\nfrom mbdkit.plugin import hookimpl, seams\n"
    install_module(tmp_path, "swing-kit", inner + GOOD)
    done = mbdkit(tmp_path, "plugins", "verify", "swing", "--quick", "--json")
    (report,) = json.loads(done.stdout)["reports"]
    (check,) = (check for check in report["checks"] if check["name"] == "contract.imports")
    assert check["outcome"] == "warn"
    assert check["cause"].endswith("at any time: mbdkit.mechanism.mechanism.Mechanism (swing_kit.py)")


def test_a_model_of_a_plugin_goes_into_specs_and_schema(tmp_path):
    install_module(tmp_path, "swing-kit", GOOD)
    (tmp_path / "spec.json").write_text(json.dumps({**SPEC, "model": {"name": "swing", "lenght": 2.0}}))
    refused = mbdkit(tmp_path, "validate", "spec.json")
    assert refused.returncode == 2
    assert "model.lenght: unknown key (did you mean 'length'?)" in refused.stderr
    schema = mbdkit(tmp_path, "schema", "run")
    assert "swing-kit:swing" in schema.stdout


def test_a_model_that_fails_to_build_is_the_plugins_fault(tmp_path):
    install_module(tmp_path, "swing-kit", GOOD.replace("return mechanism", "return 1 / 0"))
    (tmp_path / "spec.json").write_text(json.dumps(SPEC | {"model": {"name": "swing"}}))
    failed = mbdkit(tmp_path, "run", "spec.json")
    assert failed.returncode == 4
    assert "swing-kit:swing failed to build: ZeroDivisionError" in failed.stderr
    assert "Traceback" not in failed.stderr
    assert not (tmp_path / "spec.h5").exists()


LAW = """
import mbdkit
from pydantic import BaseModel

class RubberOptions(BaseModel):
    stiffness: float

def rubber(length, rate, time, p):
    return p[0] * length, p[0], 0.0, p[0] * length**2 / 2

@mbdkit.hookimpl
def mbdkit_force_laws():
    return [mbdkit.ForceLawPlugin("rubber", "Rubber", RubberOptions, mbdkit.FunctionLaw(rubber, potential=True))]
"""

BETWEEN = {"type": "two-points", "bodies": ["ground", "ball"], "points": [[0, 0], [0, 0]]}
BAND = {"type": "law", "law": "rubber", "stiffness": 4.0, "pathway": BETWEEN}
BALL = {"ball": {"mass": 1.0, "position": [1.0, 0.0]}}
BOUNCE = SPEC | {"model": {"name": "mechanism", "bodies": BALL, "forces": {"band": BAND}}}


def test_a_force_law_of_a_plugin_runs_and_one_without_derivatives_is_the_plugins_fault(tmp_path):
    install_module(tmp_path, "rubber-kit", LAW)
    (tmp_path / "spec.json").write_text(json.dumps(BOUNCE))
    done = mbdkit(tmp_path, "run", "spec.json", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"] == "complete"
    code = (tmp_path / "rubber_kit.py").read_text()
    (tmp_path / "rubber_kit.py").write_text(code.replace(", p[0], 0.0, p[0] * length**2 / 2", ""))
    for command in (("run", "spec.json", "--overwrite"), ("validate", "spec.json")):
        failed = mbdkit(tmp_path, *command)
        assert failed.returncode == 4
        assert failed.stderr.startswith("error: force law rubber-kit:rubber: its function returns one value, not the")
        assert "Traceback" not in failed.stderr
        assert len(failed.stderr.splitlines()) == 1
