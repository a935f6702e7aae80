"""Results and texts compared bit by bit between two versions.

``python -m tests.benchmarks.bits FOLDER`` runs packaged examples with every built-in method, every packaged example
as it is and with each treatment of its contacts, inverse runs, designs and studies (`bits_examples`), and asks for
help, JSON and errors of every command (`bits_texts`). It writes the archives and ``hashes.json``. With ``--drawn
400 --seed 1`` it draws that many runs instead: models (pendulums, random mechanisms with springs, loads, drivers,
beams and closed loops, muscles, contacts, examples), methods, formulations, stabilizations and events at random;
some are computed in blocks of a study, in lanes where possible, some are killed and resumed. ``--against OTHER``
then lists everything that differs, of runs with the largest relative difference of positions over the first ten
recorded steps and over the whole run.

``--settings`` computes the results several times, with the code that libraries have for other processors
(`bits_settings`), and prints which of them change: ``python -m tests.benchmarks.bits FOLDER --only "as packaged"
--settings`` takes six minutes.

Only the public interface is used, so that the same files run under another version: copy ``tests/benchmarks/bits*.py``
into a clone of it.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import json
import os
import signal
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.spec import load_spec
from tests.benchmarks import bits_examples, bits_settings, bits_texts
from tests.benchmarks.bits_examples import COUNTERS, TREATMENTS, facts

EXAMPLES = (
    "car-axis", "chain", "crank-press", "double-pendulum", "double-wishbone", "four-bar", "gravity-balanced-arm",
    "knee", "limit-stop", "n-four-bar", "pendulum", "slider-crank", "spring-pendulum", "watt-six-bar",
)  # fmt: skip

ADAPTIVE = {"adaptive": True, "rtol": 1e-7}
SYMMETRIC = {"name": "projection", "symmetric": True}

VARIANTS: dict[str, dict[str, Any]] = {
    "rk-gill": {"integrator": {"name": "rk-gill"}},
    "rk4": {"integrator": {"name": "rk4"}},
    "rk4 baumgarte": {"integrator": {"name": "rk4"}, "stabilization": "baumgarte"},
    "rk4 projection": {"integrator": {"name": "rk4"}, "stabilization": "projection"},
    "rk4 symmetric": {"integrator": {"name": "rk4"}, "stabilization": SYMMETRIC},
    "dopri5": {"integrator": {"name": "dopri5"}},
    "dopri5 adaptive": {"integrator": {"name": "dopri5", **ADAPTIVE}},
    "dopri5 adaptive projection": {"integrator": {"name": "dopri5", **ADAPTIVE}, "stabilization": "projection"},
    "dop853": {"integrator": {"name": "dop853"}},
    "dop853 adaptive": {"integrator": {"name": "dop853", **ADAPTIVE}},
    **{f"gauss {s}": {"integrator": {"name": "gauss", "stages": s}} for s in range(1, 7)},
    "gauss 2 fixed-point": {"integrator": {"name": "gauss", "stages": 2, "stage_solver": "fixed-point"}},
    "gauss 3 adaptive": {"integrator": {"name": "gauss", "stages": 3, **ADAPTIVE}},
    "gauss 2 baumgarte": {"integrator": {"name": "gauss", "stages": 2}, "stabilization": "baumgarte"},
    "gauss 3 projection": {"integrator": {"name": "gauss", "stages": 3}, "stabilization": "projection"},
    "gauss 2 symmetric": {"integrator": {"name": "gauss", "stages": 2}, "stabilization": SYMMETRIC},
    **{f"radau-iia {s}": {"integrator": {"name": "radau-iia", "stages": s}} for s in (2, 3, 5)},
    "radau-iia 3 adaptive": {"integrator": {"name": "radau-iia", "stages": 3, **ADAPTIVE}},
    **{
        f"radau-iia 3 {f}": {"integrator": {"name": "radau-iia", "stages": 3}, "formulation": f}
        for f in ("index-2", "index-3", "ggl")
    },
    "radau-iia 2 ggl adaptive": {"integrator": {"name": "radau-iia", "stages": 2, **ADAPTIVE}, "formulation": "ggl"},
    "rattle": {"integrator": {"name": "rattle"}, "formulation": "index-3"},
    "lobatto-pair 3": {"integrator": {"name": "lobatto-pair", "stages": 3}, "formulation": "index-3"},
    "scipy-radau": {"integrator": {"name": "scipy-radau"}},
    "scipy-dop853": {"integrator": {"name": "scipy-dop853"}},
    "scipy-lsoda": {"integrator": {"name": "scipy-lsoda"}},
}

STEP = {"limit-stop": 0.001}
"""Steps of the examples that have none of their own [s]."""


def _spec(example: str, variant: str) -> dict[str, Any]:
    spec = load_spec(example).model_dump(mode="json")
    spec.update({key: spec.get(key) for key in ("formulation", "stabilization")})
    spec = {key: value for key, value in spec.items() if value is not None and key != "events"}
    spec.update(VARIANTS[variant])
    fixed = not VARIANTS[variant]["integrator"].get("adaptive") and not variant.startswith("scipy")
    if fixed and spec["time"].get("step") is None:
        spec["time"]["step"] = STEP[example]
    if fixed and (spec.get("output") or {}).get("interval") is not None:
        spec["output"] = {"every": 5}
    spec["limits"] = {"max_steps": 200_000, "wall_time": 120.0}
    return spec


IN_BLOCK = 5
"""Runs of a study in blocks that one draw stands for."""

WITH_CONTACTS = ("belt", "bouncing-ball")
"""Examples of contacts that are drawn with any treatment."""

LARGE = ("chain", "double-wishbone", "watt-six-bar")
"""Examples that are not drawn, because their runs take long."""


def _mechanism(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a mechanism: a tree of bodies on revolute joints, with forces, and perhaps a driver, a loop or a beam."""
    bodies: dict[str, Any] = {}
    joints: dict[str, Any] = {}
    forces: dict[str, Any] = {}
    where = {"ground": np.zeros(2)}
    for number in range(int(rng.integers(1, 5))):
        name, parent = f"b{number}", str(rng.choice(list(where)))
        joint = where[parent] + rng.uniform(-0.4, 0.4, 2)
        where[name] = joint + rng.uniform(0.2, 0.5, 2) * rng.choice([-1, 1], 2)
        bodies[name] = {
            "mass": float(rng.uniform(0.2, 3.0)),
            "inertia": float(rng.uniform(0.01, 0.2)),
            "position": where[name].tolist(),
            "angular_velocity": float(rng.uniform(-2.0, 2.0)),
        }
        joints[f"J{number}"] = {"type": "revolute", "bodies": [parent, name], "at": joint.tolist()}
    last = list(bodies)[-1]
    if rng.random() < 0.6:
        forces["spring"] = {
            "type": "spring-damper", "bodies": ["ground", last], "points": [[0.3, 1.0], [0.1, 0.0]],
            "stiffness": float(rng.uniform(5.0, 200.0)), "damping": float(rng.uniform(0.0, 2.0)), "free_length": 0.4,
        }  # fmt: skip
    if rng.random() < 0.4:
        forces["twist"] = {"type": "torsion-spring", "bodies": ["ground", "b0"], "stiffness": 4.0, "damping": 0.05}
    if rng.random() < 0.4:
        forces["load"] = {"type": "force", "body": last, "point": [0.1, 0.05], "value": [1.0, "2*cos(3*t)"]}
    if rng.random() < 0.3:
        joints["drive"] = {
            "type": "driver", "bodies": joints["J0"]["bodies"], "coordinate": "angle", "motion": "0.4*sin(2*t)",
        }  # fmt: skip
    if len(bodies) > 2 and rng.random() < 0.4:
        reach = float(np.hypot(*(where[last] - [0.9, -0.7])))
        joints["rod"] = {
            "type": "distance", "bodies": ["ground", last], "points": [[0.9, -0.7], [0.0, 0.0]], "length": reach,
        }  # fmt: skip
    model = {"name": "mechanism", "bodies": bodies, "joints": joints, "forces": forces}
    if rng.random() < 0.25:
        end = [float(where[last][0]) + 0.6, float(where[last][1])]
        model["beams"] = {
            "beam": {
                "a": where[last].tolist(), "b": end, "elements": int(rng.integers(2, 4)),
                "stiffness": {"axial": 4e3, "shear": 2e3, "bending": 2.0}, "mass_per_length": 0.5, "damping": 1e-3,
            }
        }  # fmt: skip
        joints["clamp"] = {"type": "weld", "bodies": [last, "beam.0"], "at": where[last].tolist()}
    return model


def _drawn_model(rng: np.random.Generator) -> tuple[str, dict[str, Any], str, str]:
    """Draw a model; return what it is, the model, an angle that a study may vary, and a quantity for events."""
    kind = rng.choice(["pendulum", "mechanism", "example", "muscles", "contacts"], p=[0.25, 0.35, 0.1, 0.15, 0.15])
    if kind == "muscles":
        spec = load_spec("elbow-curl").model_dump(mode="json")
        spec["parameters"] |= {"load": float(rng.uniform(0.5, 4.0)), "flexion": float(rng.uniform(0.1, 0.6))}
        return "muscles", spec, "parameters.load", "hand.y"
    if kind == "contacts":
        example = str(rng.choice(WITH_CONTACTS))
        spec = load_spec(example).model_dump(mode="json")
        body = next(iter(spec["model"]["bodies"]))
        spec["model"]["bodies"][body]["angular_velocity"] = float(rng.uniform(-3.0, 3.0))
        return f"contacts of {example}", spec, "", f"{body}.angle - 0.1"
    if kind == "example":
        example = str(rng.choice([name for name in EXAMPLES if name not in LARGE]))
        spec = load_spec(example).model_dump(mode="json")
        return example, spec, "", ""
    if kind == "mechanism":
        model = _mechanism(rng)
        return f"{len(model['bodies'])} bodies", {"model": model}, "model.bodies.b0.mass", "b0.angle - 0.02"
    n = int(rng.integers(1, 7))
    model = {
        "name": "n-pendulum", "n": n, "lengths": rng.uniform(0.3, 1.2, n).tolist(),
        "masses": rng.uniform(0.3, 2.0, n).tolist(), "angles": rng.uniform(-2.0, 2.0, n).tolist(),
        "rates": rng.uniform(-2.0, 2.0, n).tolist(),
    }  # fmt: skip
    return f"{n} rods", {"model": model}, "model.angles.0", f"rod{n}.y"


def _drawn_spec(rng: np.random.Generator) -> tuple[str, dict[str, Any], str]:
    """Draw a spec; return its description, the spec, and the key of it that a study may vary."""
    what, spec, key, quantity = _drawn_model(rng)
    variant = str(rng.choice(list(VARIANTS)))
    settings = VARIANTS[variant]
    if what.startswith("contacts"):
        variant = str(rng.choice(list(TREATMENTS)))
        settings = TREATMENTS[variant]
    step = float(rng.choice([0.001, 0.002, 0.005]))
    drawn = {
        "mbdkit": 1,
        **{name: spec[name] for name in ("model", "parameters") if spec.get(name)},
        **json.loads(json.dumps(settings)),
        "time": {"start": 0.0, "end": float(rng.choice([0.3, 0.7])), "step": step},
        "output": {"every": int(rng.choice([1, 3]))},
        "limits": {"max_steps": 100_000},
    }
    if quantity and rng.random() < 0.3:
        drawn["events"] = {"crossing": {"when": quantity, "action": str(rng.choice(["note", "stop"]))}}
        variant += ", event"
    return f"{what}, {variant}", drawn, key


def _drawn(job: tuple[int, int, Path]) -> tuple[str, dict[str, Any]]:
    """Draw a run by seed and number, and carry it out."""
    seed, number, folder = job
    rng = np.random.default_rng([seed, number])
    what, spec, key = _drawn_spec(rng)
    path = folder / f"drawn {seed}-{number}.h5"
    how = rng.choice(["alone", "block", "resumed"], p=[0.7, 0.15, 0.15])
    if how == "block" and key:
        return f"drawn {seed}-{number} | {what}, block", _in_block(spec, key, rng)
    if how == "resumed":
        share = float(rng.uniform(0.1, 0.9))
        spec["time"]["end"] = 8.0
        return f"drawn {seed}-{number} | {what}, resumed", facts(lambda: _resumed(spec, path, share))
    return f"drawn {seed}-{number} | {what}", facts(lambda: _alone(spec, path))


def _alone(spec: dict[str, Any], path: Path) -> Any:
    import mbdkit

    path.unlink(missing_ok=True)
    return mbdkit.run(spec, archive=str(path))


def _in_block(spec: dict[str, Any], key: str, rng: np.random.Generator) -> dict[str, Any]:
    """Carry out some runs in a block of a study, in lanes if the method has them."""
    import mbdkit

    values = rng.uniform(0.5, 1.0, IN_BLOCK)
    try:
        frame = mbdkit.ensemble(spec, {key: values}, store="hashes", measures="all").to_frame()
    except mbdkit.SpecError as error:
        return {"refused": str(error).splitlines()[0]}
    counted = [name for name in (*COUNTERS, "misalignment_max") if name in frame]
    return {
        "status": frame.status.tolist(),
        "sha": frame.data_sha256.tolist(),
        "counters": [[str(value) for value in frame[name]] for name in counted],
    }


_WITHOUT_CHECKPOINT = ("its checkpoint ", "before it wrote any rows", "cannot be stored", "SciPy offers no way")


def _resumed(spec: dict[str, Any], path: Path, share: float) -> Any:
    """Kill a run after a share of its time, and resume it; run it again if it has left no checkpoint."""
    import mbdkit

    part = path.with_name(f"{path.name}.part")
    for old in path.parent.glob(f"{path.name}*"):
        old.unlink()
    child = os.fork()
    if child == 0:
        _checkpoint_often()

        def kill(reached: float, end: float) -> None:
            if reached >= share * end:
                os.kill(os.getpid(), signal.SIGKILL)

        try:
            mbdkit.run(spec, archive=str(path), progress=kill)
        except mbdkit.SpecError:
            pass
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    if path.exists():
        return mbdkit.load(path)
    try:
        return mbdkit.resume(part) if part.exists() else mbdkit.run(spec, archive=str(path))
    except mbdkit.SpecError as error:
        if not any(reason in str(error) for reason in _WITHOUT_CHECKPOINT):
            raise
        return mbdkit.run(spec, archive=str(path), overwrite=True)


def _checkpoint_often() -> None:
    """Let runs of this process write a checkpoint every few milliseconds, in whichever module the version has it."""
    for name, values in (
        ("mbdkit.runs.run_checkpoint", {"INTERVAL": 0.01, "SHARE": 1e9}),
        ("mbdkit.run_checkpoint", {"INTERVAL": 0.01, "SHARE": 1e9}),
        ("mbdkit.integrators.interface", {"STRETCH": 0.002}),
    ):
        try:
            module = importlib.import_module(name)
        except ModuleNotFoundError:
            continue
        for constant, value in values.items():
            setattr(module, constant, value)


def _run(job: tuple[str, str, Path]) -> tuple[str, dict[str, Any]]:
    example, variant, folder = job
    path = folder / f"{example} {variant}.h5"
    return f"{example} | {variant}", facts(lambda: _alone(_spec(example, variant), path))


def _difference(one: Path, other: Path) -> str:
    import h5py

    with h5py.File(one) as a, h5py.File(other) as b:
        p, q = (x["trajectory/position"][...] for x in (a, b))
        if p.shape != q.shape:
            return f"{len(p)} rows against {len(q)}"
        scale = max(1e-300, float(np.nanmax(np.abs(q))))
        first, whole = (float(np.nanmax(np.abs(p[:n] - q[:n]))) / scale for n in (11, len(p)))
        names: list[str] = []

        def look(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind == "f" and name in b and "elapsed" not in name:
                x, y = item[...], b[name][...]
                if x.shape != y.shape or not np.array_equal(x, y, equal_nan=True):
                    names.append(name)

        a.visititems(look)
    return f"positions differ by {first:.1e} in ten steps, {whole:.1e} in all; arrays: {', '.join(names)}"


def _all(folder: Path, only: str, pool: ProcessPoolExecutor) -> dict[str, Any]:
    combined = [(e, v, folder) for e in EXAMPLES for v in VARIANTS if only in f"{e} | {v}"]
    packaged = [(job, folder) for job in bits_examples.jobs() if only in f"{job[0]} | {job[1]} {job[2]}"]
    results = dict(pool.map(bits_examples.carried_out, packaged)) | dict(pool.map(_run, combined))
    return results | bits_texts.texts(folder, pool, only)


def _compare(results: dict[str, Any], other: dict[str, Any], folders: tuple[Path, Path], *, whole: bool) -> int:
    """Print each difference, and return their number."""
    differing = [name for name, value in results.items() if json.loads(json.dumps(value)) != other.get(name)] + (
        [name for name in other if name not in results and not name.startswith("drawn")] if whole else []
    )
    for name in differing:
        before, after = other.get(name) or {}, results.get(name) or {}
        print(f"{name}:{'' if before else ' is new'}{'' if after else ' is gone'}")
        for key in sorted(before.keys() & after.keys()):
            if before[key] != json.loads(json.dumps(after[key])):
                _print_difference(key, before[key], after[key])
        file = (name.partition(" | ")[0] if name.startswith("drawn") else name.replace(" | ", " ")) + ".h5"
        if before.get("sha") != after.get("sha") and all((folder / file).exists() for folder in folders):
            print(f"    {_difference(*(folder / file for folder in folders))}")
    print(f"{len(results) - len(differing)} equal, {len(differing)} differ")
    return len(differing)


def _print_difference(key: str, before: Any, after: Any) -> None:
    texts = [text if isinstance(text, str) else json.dumps(text, indent=1) for text in (before, after)]
    for line in difflib.unified_diff(*(text.splitlines() for text in texts), "before", "after", n=0, lineterm=""):
        print(f"    {key}: {line}")


def main() -> None:
    """Run every combination, and compare with another folder if one is named."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.bits", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--against", type=Path, help="a folder that this command has written with another version")
    parser.add_argument("--only", default="", help="a part of the names of the combinations to run")
    parser.add_argument("--drawn", type=int, default=0, metavar="N", help="draw N runs instead of the combinations")
    parser.add_argument("--seed", type=int, default=1, help="of the runs that are drawn")
    parser.add_argument(
        "--settings", nargs="*", metavar="NAME", help=f"compare settings: {', '.join(bits_settings.settings())}; or all"
    )
    asked = parser.parse_args()
    folder = asked.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["MBDKIT_PLUGINS"] = ""  # what else is installed has no part in the comparison
    if asked.settings is not None:
        sys.exit(bool(bits_settings.compare_settings(folder, asked.only, asked.settings)))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        if asked.drawn:
            drawn = [(asked.seed, number, folder) for number in range(asked.drawn)]
            results = dict(pool.map(_drawn, drawn))
        else:
            results = _all(folder, asked.only, pool)
    file = folder / "hashes.json"
    other = json.loads((asked.against / "hashes.json").read_text()) if asked.against else None
    known = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps(known | results, indent=1))
    print(f"{len(results)} results, {sum('refused' in value for value in results.values())} refused")
    if other is not None:
        whole = not asked.drawn and not asked.only
        sys.exit(bool(_compare(results, other, (folder, asked.against), whole=whole)))


if __name__ == "__main__":
    main()
