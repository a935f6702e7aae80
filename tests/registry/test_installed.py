"""Plugins as they are installed: distributions with metadata, in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

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


def install(site: Path, distribution: str, code: str) -> None:
    module = distribution.replace("-", "_")
    (site / f"{module}.py").write_text(code)
    info = site / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[mbdkit]\nmain = {module}\n")


def mbdkit(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mbdkit", *arguments],
        env=os.environ | {"PYTHONPATH": str(site)},
        cwd=site,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_good_plugin_beside_a_broken_one(tmp_path):
    install(tmp_path, "swing-kit", GOOD)
    install(tmp_path, "bad-kit", "print('noise')\nimport sys\nsys.exit(7)\n")
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


def test_a_model_of_a_plugin_goes_into_specs_and_schema(tmp_path):
    install(tmp_path, "swing-kit", GOOD)
    spec = tmp_path / "spec.json"
    spec.write_text(
        json.dumps(
            {
                "mbdkit": 1,
                "model": {"name": "swing", "lenght": 2.0},
                "integrator": {"name": "rk4"},
                "time": {"end": 1.0, "step": 0.1},
            }
        )
    )
    refused = mbdkit(tmp_path, "validate", "spec.json")
    assert refused.returncode == 2
    assert "model.lenght: unknown key (did you mean 'length'?)" in refused.stderr
    schema = mbdkit(tmp_path, "schema", "run")
    assert "swing-kit:swing" in schema.stdout


def test_a_model_that_fails_to_build_is_the_plugins_fault(tmp_path):
    install(tmp_path, "swing-kit", GOOD.replace("return mechanism", "return 1 / 0"))
    spec = '{"mbdkit": 1, "model": {"name": "swing"}, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.1}}'
    (tmp_path / "spec.json").write_text(spec)
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

BOUNCE = {
    "mbdkit": 1,
    "model": {
        "name": "mechanism",
        "bodies": {"ball": {"mass": 1.0, "position": [1.0, 0.0]}},
        "forces": {
            "band": {
                "type": "law",
                "law": "rubber",
                "stiffness": 4.0,
                "pathway": {"type": "two-points", "bodies": ["ground", "ball"], "points": [[0, 0], [0, 0]]},
            }
        },
    },
    "integrator": {"name": "rk4"},
    "time": {"end": 0.1, "step": 0.01},
}


def test_a_force_law_of_a_plugin_runs_and_one_without_derivatives_is_the_plugins_fault(tmp_path):
    install(tmp_path, "rubber-kit", LAW)
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
