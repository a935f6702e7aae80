"""Archives of every packaged example under every built-in method, compared bit by bit between two versions.

``python -m tests.benchmarks.bits FOLDER`` writes one archive per combination and ``hashes.json``;
``python -m tests.benchmarks.bits FOLDER --against OTHER`` then lists every combination whose ``data_sha256`` differs,
with the largest relative difference of positions over the first ten recorded steps and over the whole run. Only the
public interface is used, so that the same file runs under an older version (``PYTHONPATH``).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

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
    from mbdkit.spec.loading import load_spec

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


def _run(job: tuple[str, str, Path]) -> tuple[str, dict[str, Any]]:
    example, variant, folder = job
    import h5py

    import mbdkit
    from mbdkit.base.errors import SpecError

    path = folder / f"{example} {variant}.h5"
    key = f"{example} | {variant}"
    path.unlink(missing_ok=True)
    try:
        run = mbdkit.run(_spec(example, variant), archive=str(path))
    except SpecError as error:
        return key, {"refused": str(error).splitlines()[0]}
    with h5py.File(path) as file:
        found = {"status": run.status, "reason": str(file.attrs["status_reason"]), "sha": file.attrs["data_sha256"]}
    run.close()
    return key, found


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


def main() -> None:
    """Run every combination, and compare with another folder if one is named."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.bits", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--against", type=Path, help="a folder that this command has written with another version")
    parser.add_argument("--only", default="", help="a part of the names of the combinations to run")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    jobs = [(e, v, asked.folder) for e in EXAMPLES for v in VARIANTS if asked.only in f"{e} | {v}"]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = dict(pool.map(_run, jobs))
    file = asked.folder / "hashes.json"
    known = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps(known | found, indent=1))
    print(f"{len(found)} combinations, {sum('refused' in x for x in found.values())} refused")
    if asked.against is None:
        return
    other = json.loads((asked.against / "hashes.json").read_text())
    differing = [
        key
        for key, value in found.items()
        if key in other and any(other[key].get(what) != value.get(what) for what in ("status", "sha"))
    ]
    for key in differing:
        name = key.replace(" | ", " ") + ".h5"
        print(f"{key}: {other[key]} -> {found[key]}")
        if "sha" in found[key] and "sha" in other[key]:
            print(f"    {_difference(asked.folder / name, asked.against / name)}")
    print(f"{len(found) - len(differing)} equal, {len(differing)} differ")
    sys.exit(bool(differing))


if __name__ == "__main__":
    main()
