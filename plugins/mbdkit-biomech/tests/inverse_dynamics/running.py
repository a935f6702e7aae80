"""The simulated running step with published joint loads, in the shared reference data of the ISB.

The tables lie beside the repository, in ``../shared/reference``; without them, the tests that need them are skipped.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit

REFERENCE = Path(mbdkit.__file__).resolve().parents[2] / "shared" / "reference"
JOINTS = ("hip", "knee", "ankle")
SEGMENTS = {
    "thigh": (6.85, 0.145361267, 0.451, 0.4323725),
    "shank": (2.86, 0.042996389, 0.406, 0.4334975),
    "foot": (1.00, 0.0200, 0.1619415, 0.0),
}
"""Mass [kg], inertia [kg m^2], length [m], and centre of mass from the proximal joint as a share of the length."""


def reference(name: str) -> Path:
    """Return a table of the reference data; skip the test if it is absent."""
    if not (REFERENCE / name).is_file():
        pytest.skip(f"the reference data are absent: {REFERENCE / name}")
    return REFERENCE / name


def table(path: Path) -> Any:
    """Return the columns of a table by name."""
    return table_of(path.read_text(encoding="utf-8"))


def table_of(text: str) -> Any:
    """Return the columns of the text of a table by name."""
    rows = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    return np.genfromtxt(io.StringIO(rows), delimiter=",", names=True)


def running_spec(path: Path, smooth: Any = "none") -> dict[str, Any]:
    """Return the spec of inverse dynamics of the step: a leg whose hip is a point mass that moves freely."""
    m = mbdkit.Mechanism(gravity=(0.0, -9.80665))
    m.body("pelvis", mass=1e-9, position=(-0.254, 0.909))
    place = {"thigh": (-0.17, 0.733), "shank": (-0.027, 0.33), "foot": (0.015, 0.103)}
    angle = {"thigh": -1.12, "shank": -1.39, "foot": -0.06}
    for name, (mass, inertia, _, _) in SEGMENTS.items():
        m.body(name, mass=mass, inertia=inertia, position=place[name], angle=angle[name])
    ends = {name: (-share * length, (1 - share) * length) for name, (_, _, length, share) in SEGMENTS.items()}
    m.revolute("hip", "pelvis", "thigh", points=((0, 0), (ends["thigh"][0], 0)))
    m.revolute("knee", "thigh", "shank", points=((ends["thigh"][1], 0), (ends["shank"][0], 0)))
    m.revolute("ankle", "shank", "foot", points=((ends["shank"][1], 0), (ends["foot"][0], 0)))
    m.marker("hip", "pelvis", point=(0, 0))
    m.marker("knee", "shank", point=(ends["shank"][0], 0))
    m.marker("ankle", "foot", point=(ends["foot"][0], 0))
    m.marker("toe", "foot", point=(ends["foot"][1], 0))
    markers = ("hip", "knee", "ankle", "toe")
    columns = {f"{name}.{axis}": f"{name}_{axis}" for name in markers for axis in "xy"}
    ground = {"body": "foot", "force": ["ground_force_x", "ground_force_y"], "point": ["cop_x", 0.0]}
    hip = {"body": "thigh", "coordinate": "angle"}
    actuators = {"hip": hip, "knee": {"joint": "knee"}, "ankle": {"joint": "ankle"}}
    motion = {"file": str(path), "columns": columns, "smooth": smooth}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": {"ground": ground}, "actuators": actuators}


def differences(run: mbdkit.Run, truth: Any, rows: slice) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the differences of force [N] and moment [N m] of each joint from the published ones."""
    found = {}
    for name in JOINTS:
        force = np.linalg.norm(run.joints[name].reaction_force, axis=1) - truth[f"force_{name}"]
        moment = run.actuators[name].value - truth[f"moment_{name}"]
        found[name] = np.abs(force)[rows], np.abs(moment)[rows]
    return found
