"""No command that reads an archive opens a file that the archive names: the calls of the system are traced.

The archives are of every packaged model and of every importer; the files of the importers still exist, so that opening
them would succeed. `strace` also sees files that HDF5's library opens.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import pytest

import mbdkit
from tests.installing import install_project, python

pytestmark = pytest.mark.end_to_end

ROOT = Path(mbdkit.__file__).parents[1]
PLUGINS = [ROOT / "plugins" / name for name in ("mbdkit-opensim", "mbdkit-robots", "mbdkit-walker")]
SECTIONS = {"integrator": {"name": "rk4"}, "time": {"end": 0.02, "step": 0.01}}

MAKE = """
import json, sys
import mbdkit
from mbdkit_report.figures.drawing_geometry import draw_mechanism
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit.spec import load_spec
drawings = {}
for name, spec in json.load(open("specs.json")).items():
    spec = (load_inverse_spec if "motion" in spec or spec == "walking" else load_spec)(spec)
    (mbdkit.inverse if hasattr(spec, "motion") else mbdkit.run)(spec, archive=f"archives/{name}.h5").close()
    drawing = draw_mechanism(spec.mechanism())
    drawings[name] = [drawing.local.tolist(), drawing.owner.tolist(), drawing.pins, drawing.springs]
axes = [{"time.step": [0.01, 0.005]}]
base = json.load(open("specs.json"))["mjcf"]
mbdkit.study({"mbdkit_study": 1, "base": base, "axes": axes, "store": "all"}, out="archives/study")
json.dump(drawings, open("drawings.json", "w"))
"""
READ = """
import json, sys
from pathlib import Path
from typer.testing import CliRunner
import mbdkit
from mbdkit.cli import app
specs = json.load(open("specs.json"))
for path in sorted(Path("archives").glob("*.h5")):
    calls = (["archive", "info", path], ["archive", "check", path], ["workload", path],
             ["archive", "export", path, "--to", "csv", "-o", f"out/{path.stem}"],
             ["plot", path, "-o", f"out/{path.stem}.svg"], ["report", path, "-o", f"out/{path.stem}-report.html"],
             ["animate", path, "-o", f"out/{path.stem}.html"], ["archive", "diff", path, path])
    # all archives are drawn by the other test, and those without names of files are equal for these commands
    for words in calls if "file" in json.dumps(specs[path.stem]) else calls[:1]:
        done = CliRunner().invoke(app, list(map(str, words)))
        assert done.exit_code == 0, (words, done.output, done.exception)
        assert "not drawn" not in done.output and "only points" not in done.output, (words, done.output)
    with mbdkit.load(path) as run:
        assert run.mechanism.bodies and run.summary()
study = mbdkit.load_study("archives/study")
study.run(1).mechanism
study.to_frame()
done = CliRunner().invoke(app, ["report", "archives/study", "--overwrite"])
assert done.exit_code == 0, done.output
"""
DRAW = """
import json
from pathlib import Path
import mbdkit
from mbdkit_report.figures.drawing_geometry import draw_run
from mbdkit.registry.manager import registry
assert {item.origin.distribution for item in registry().items} == {"mbdkit"}
def drawn(run):
    drawing = draw_run(run)
    assert not run.not_drawn
    return json.loads(json.dumps([drawing.local.tolist(), drawing.owner.tolist(), drawing.pins, drawing.springs]))
for name, expected in json.load(open("drawings.json")).items():
    with mbdkit.load(f"archives/{name}.h5") as run:
        assert drawn(run) == expected, name
assert drawn(mbdkit.load_study("archives/study").run(1)) == json.load(open("drawings.json"))["mjcf"]
"""


def specs(files: Path) -> dict[str, Any]:
    """Return specs by name, whose models are in the folder `files` unless mbdkit or a plugin has them."""
    robots = ROOT / "plugins" / "mbdkit-robots" / "src" / "mbdkit_robots"
    for name in ("arm.urdf", "four_bar.xml", "linkage.json"):
        shutil.copy(robots / name, files)
    # with friction, whose force law is of the plugin
    text = '<mujoco><default><joint axis="0 -1 0" frictionloss="0.1"/></default><worldbody><body name="arm">'
    text += '<joint name="j"/><geom type="capsule" size="0.02" fromto="0 0 0 0.4 0 0"/></body></worldbody></mujoco>'
    (files / "arm.xml").write_text(text)
    sys.path.insert(0, str(ROOT / "plugins" / "mbdkit-opensim" / "tests"))
    try:
        import osim_texts
    finally:
        sys.path.pop(0)
    (files / "leg.osim").write_text(osim_texts.leg())
    (files / "motion.csv").write_text("time,tilt\n" + "".join(f"{0.05 * k},{0.01 * k * k}\n" for k in range(21)))
    models: dict[str, dict[str, Any]] = {
        name: {"name": name}
        for name in ("single-pendulum", "double-pendulum", "four-bar-knee", "leg", "leg-four-bar", "walker")
    }
    models |= {name: {"name": name, "n": 2} for name in ("n-pendulum", "n-four-bar")}
    models["free-form"] = {
        "name": "mechanism",
        "bodies": {"rod": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {"pin": {"type": "revolute", "bodies": ["ground", "rod"], "at": [0, 0]}},
    }
    models |= {
        name: {"name": name, "file": str(files / file)}
        for name, file in (("urdf", "arm.urdf"), ("mjcf", "arm.xml"), ("pylinkage", "linkage.json"),
                           ("opensim", "leg.osim"))
    }  # fmt: skip
    models["mjcf-loop"] = {"name": "mjcf", "file": str(files / "four_bar.xml")}
    motion = {"file": str(files / "motion.csv"), "columns": {"J1.angle": "tilt"}}
    inverse = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "motion": motion}
    return {name: {"mbdkit": 1, "model": model, **SECTIONS} for name, model in models.items()} | {"inverse": inverse}


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with archives, whose models are in another folder."""
    pytest.importorskip("defusedxml")
    here = tmp_path_factory.mktemp("reading")
    (here / "archives").mkdir()
    (here / "out").mkdir()
    (here / "specs.json").write_text(json.dumps(specs(tmp_path_factory.mktemp("models"))))
    done = python("-c", MAKE, path=with_plugins(here), cwd=here)
    assert done.returncode == 0, done.stderr
    return here


def with_plugins(here: Path) -> tuple[Path, ...]:
    """Return the folders that make the plugins available."""
    site = here / "site"
    if not site.exists():
        for folder in PLUGINS:
            install_project(site, folder)
    return site, *(folder / "src" for folder in PLUGINS)


def allowed(here: Path) -> list[str]:
    """Return the prefixes of the paths that commands may open besides the archives."""
    installed = [*sysconfig.get_paths().values(), sys.prefix, sys.base_prefix, sys.exec_prefix]
    installed += [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    installed += filter(None, [os.environ.get("PYTHONPYCACHEPREFIX")])
    system = ["/etc/", "/proc/", "/sys/", "/dev/", "/usr/", "/lib", "/var/cache/", "/run/", "/bin/", "/opt/", "/snap/"]
    of_user = [str(Path.home() / folder) for folder in (".cache", ".config", ".fontconfig", ".fonts", ".local")]
    return [str(ROOT), str(here), *installed, *system, *of_user]


def named_in(archive: Path) -> set[str]:
    """Return the absolute paths that the attributes of an archive contain."""
    with mbdkit.load(archive) as run:
        texts = [value for value in run.file.attrs.values() if isinstance(value, str)]
    return {path for text in texts for path in re.findall(r'"(/[^"]+)"', text)}


def test_commands_open_nothing_that_an_archive_names(here: Path, tmp_path: Path) -> None:
    strace, trace = shutil.which("strace"), tmp_path / "trace"
    if strace is None or subprocess.run([strace, "-o", trace, "true"], capture_output=True, check=False).returncode:
        pytest.skip("strace is not installed, or this system refuses to trace processes")
    (here / "out").mkdir(exist_ok=True)
    command = [
        strace,
        "-f",
        "--seccomp-bpf",
        "-qq",
        "-s",
        "4096",
        "-e",
        "trace=open,openat,creat",
        "-o",
        str(trace),
        sys.executable,
    ]
    call = f"import subprocess, sys; sys.exit(subprocess.run({[*command, '-c', READ]!r}).returncode)"
    done = python("-c", call, path=with_plugins(here), cwd=here, MPLCONFIGDIR=str(here / "matplotlib"))
    assert done.returncode == 0, done.stderr
    opened = set(re.findall(r'(?:open|openat|creat)\([^"]*"((?:[^"\\]|\\.)*)"', trace.read_text(errors="replace")))
    archives = sorted((here / "archives").glob("*.h5"))
    assert {str(archive.relative_to(here)) for archive in archives} <= opened  # also those that HDF5 opens
    absolute = {path if path.startswith("/") else str(here / path) for path in opened}
    named = {path for archive in archives for path in named_in(archive)}
    assert len(named) >= 5  # the files of four importers, and the table
    assert all(Path(path).is_file() for path in named)
    assert sorted(absolute & named) == []
    strange = sorted(path for path in absolute if not path.startswith(tuple(allowed(here))))
    assert strange == []


def test_archives_are_drawn_after_their_plugins_were_removed(here: Path) -> None:
    disabled = ",".join(folder.name for folder in PLUGINS)
    done = python("-c", DRAW, path=(), cwd=here, MBDKIT_DISABLE_PLUGINS=disabled)
    assert done.returncode == 0, done.stderr
