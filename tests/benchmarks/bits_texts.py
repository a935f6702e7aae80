"""What mbdkit says, for `bits`: public names, help, JSON of commands, and errors of wrong inputs."""

from __future__ import annotations

import importlib
import json
import os
import re
import runpy
import shlex
import sys
import traceback
from concurrent.futures import Executor
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NoReturn

import mbdkit

PUBLIC = ("mbdkit", "mbdkit.spec", "mbdkit.testing")

COMMANDS = {
    "run": "run pendulum -o FOLDER/pendulum.h5 --overwrite --json",
    "run bouncing-ball": "run bouncing-ball -o FOLDER/ball.h5 --overwrite --json --set time.end=0.6",
    "run elbow-curl": "run elbow-curl -o FOLDER/elbow.h5 --overwrite --json --set time.end=0.2",
    "inverse": "inverse walking -o FOLDER/walking.h5 --overwrite --json",
    "equilibrium": "equilibrium leaf-spring --json",
    "modes": "modes leaf-spring --json",
    "kinematics": "kinematics squat --json",
    "study": "study FOLDER/six.yaml -o FOLDER/six --overwrite --json --workers 1 --report",
    "plugins list": "plugins list --json",
    "plugins doctor": "plugins doctor --json",
    "plugins show": "plugins show gauss --json",
    "schema": "schema run",
}
AFTER = {
    "info": "archive info FOLDER/elbow.h5 --json",
    "info of an inverse run": "archive info FOLDER/walking.h5 --json",
    "diff": "archive diff FOLDER/elbow.h5 FOLDER/ball.h5 --json",
    "check": "archive check FOLDER/elbow.h5 FOLDER/walking.h5",
    "workload": "workload FOLDER/walking.h5 --json",
    "rerun": "rerun FOLDER/pendulum.h5",
    "validate": "validate squat",
    "examples": "examples",
}
"""Commands that read what the others have written."""

SIX = {
    "mbdkit_study": 1,
    "base": "double-pendulum",
    "overrides": {"time": {"end": 1.0, "step": 0.1}},
    "axes": [
        {"integrator": [{"name": "rk-gill"}, {"name": "gauss", "stages": 2}]},
        {"time.step": [0.1, 0.05, 0.025]},
    ],
    "reference": {"integrator": {"name": "gauss", "stages": 6}, "time.step": 0.0125},
}
"""A study of six runs."""

WRONG = {
    "no such example": "run pendulun",
    "no such file": "run nothing.yaml",
    "unknown key": "run pendulum --set model.lenght=1",
    "unknown section": "run pendulum --set tiem.end=1",
    "no such integrator": "run pendulum --set integrator.name=gaus",
    "no such option of an integrator": "run pendulum --set 'integrator={name: gauss, stage: 2}'",
    "no such model": "run pendulum --set model.name=pendulun",
    "no such formulation": "run pendulum --set formulation=index-4",
    "no such stabilization": "run knee --set stabilization=baumgart",
    "a wrong unit": "run pendulum --set time.end=3kg",
    "no unit": "run pendulum --set time.end=3parsec",
    "a negative time": "run pendulum --set time.end=-1",
    "a text for a number": "run pendulum --set time.step=small",
    "no such muscle": "run elbow-curl --set model.muscles.bicep.max_force=1",
    "no such body of a muscle": "run elbow-curl --set model.muscles.biceps.path.0.body=hand",
    "a wrong excitation": "run elbow-curl --set model.muscles.biceps.excitation=tones",
    "no such contact": "run bouncing-ball --set model.contacts.flor.friction=1",
    "no such treatment": "run bouncing-ball --set contact.treatment=event-drive",
    "a method that does not fit": "run bouncing-ball --set contact.treatment=time-stepping",
    "no such quantity of an event": "run bouncing-ball --set events.touch.when=contacts.floor.gapp",
    "no such quantity of a measure": "run bouncing-ball --set measures.spin=final(ball.spin)",
    "no such key of a motion": "inverse walking --set motion.smoth=1",
    "no such column": "inverse walking --set motion.time=seconds",
    "a run for inverse": "inverse pendulum",
    "no such study": "study drifft",
    "no such key of a study": "study drift --set runs=3",
    "no such optimizer": "design exotendon --set optimizer.name=slsq",
    "no such goal": "design exotendon --set minimize=mean(knee.power)",
    "no such archive": "archive info nothing.h5",
    "no such plugin": "plugins show gaus",
    "no such page": "guide contacs",
}

VOLATILE = re.compile(r"elapsed|created_utc|_s$")
"""Keys of JSON whose values are times of computation, and dates."""


def public_names() -> dict[str, Any]:
    """Return the public names of each public module."""
    names = {module: sorted(importlib.import_module(module).__all__) for module in PUBLIC}
    return {f"names | {module}": {"names": listed} for module, listed in names.items()}


def said(arguments: str, folder: Path) -> dict[str, Any]:
    """Return what a command prints, without timings and paths, and its exit status.

    It is called in a fork of this process, which has the modules that most commands import.
    """
    words = [word.replace("FOLDER", str(folder)) for word in shlex.split(arguments)]
    with TemporaryFile("w+") as out, TemporaryFile("w+") as err:
        child = os.fork()
        if child == 0:
            _call(words, folder, out.fileno(), err.fileno())
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        for file in (out, err):
            file.seek(0)
        return {"exit": status, "out": _settled(out.read(), folder), "err": _settled(err.read(), folder)}


def _call(words: list[str], folder: Path, out: int, err: int) -> NoReturn:
    status: Any = 1
    try:
        os.chdir(folder)
        os.dup2(out, 1)
        os.dup2(err, 2)
        os.environ.update(COLUMNS="80", NO_COLOR="1")
        sys.argv = ["mbdkit", *words]
        runpy.run_module("mbdkit", run_name="__main__")
        status = 0
    except SystemExit as end:
        status = end.code or 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status if isinstance(status, int) else 1)


def _settled(text: str, folder: Path) -> Any:
    text = text.replace(str(folder), "FOLDER").replace(str(Path(mbdkit.__file__).parents[1]), "ROOT")
    try:
        return _without_volatile(json.loads(text))
    except ValueError:
        return re.sub(r"\b\d+(\.\d+)? (ms|s|min|kB|MB)\b", "N", text)


def _without_volatile(data: Any) -> Any:
    match data:
        case dict():
            return {key: _without_volatile(value) for key, value in data.items() if not VOLATILE.search(key)}
        case list():
            return [_without_volatile(value) for value in data]
    return data


def _subcommands(text: str) -> list[str]:
    return re.findall(r"^  ([a-z]+)  ", text.partition("Commands:\n")[2], re.MULTILINE)


def texts(folder: Path, pool: Executor, only: str) -> dict[str, Any]:
    """Return all that is compared of texts: by names, as of runs."""
    results = public_names()
    (folder / "six.yaml").write_text(json.dumps(SIX))
    if not only or "help" in only:
        results |= _helps(folder, pool)
    for kind, calls in (("json", COMMANDS), ("json", AFTER), ("wrong", WRONG)):
        chosen = {f"{kind} | {name}": call for name, call in calls.items() if only in f"{kind} | {name}"}
        answers = pool.map(said, chosen.values(), [folder] * len(chosen))
        results |= dict(zip(chosen, answers, strict=True))
    return {name: value for name, value in results.items() if only in name}


def _helps(folder: Path, pool: Executor) -> dict[str, Any]:
    top = said("--help", folder)
    commands = _subcommands(top["out"])
    helps = dict(zip(commands, pool.map(_help, commands, [folder] * len(commands)), strict=True))
    below = [f"{command} {sub}" for command, text in helps.items() for sub in _subcommands(text["out"])]
    helps |= dict(zip(below, pool.map(_help, below, [folder] * len(below)), strict=True))
    return {"help | mbdkit": top, **{f"help | {command}": text for command, text in helps.items()}}


def _help(command: str, folder: Path) -> dict[str, Any]:
    return said(f"{command} --help", folder)
