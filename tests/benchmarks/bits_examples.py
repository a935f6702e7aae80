"""Every packaged example, as packaged and with each treatment of its contacts, designs and studies, for `bits`."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mbdkit
from mbdkit.spec import example_names, load_spec

COUNTERS = (
    "steps", "accepted", "rejected", "rhs_evaluations", "jacobian_evaluations", "factorizations",
    "newton_iterations", "projections",
)  # fmt: skip

INVERSE = ("walking", "walking-muscles", "walking-two-legs", "person-walking")
DESIGNS = ("exotendon", "gravity-balance")

STUDIES: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "pendulum": ("pendulum", "model.angle", (0.1, 0.2, 0.4, 0.8, 1.2, 1.5)),
    "elbow-curl": ("elbow-curl", "parameters.load", (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)),
    "bouncing-ball": ("bouncing-ball", "parameters.dissipation", (0.0, 0.02, 0.04, 0.06, 0.08, 0.1)),
}
"""Studies of six runs: the example, the key that varies, and its values."""

TREATMENTS: dict[str, dict[str, Any]] = {
    "compliant": {"contact": {"treatment": "compliant"}, "integrator": {"name": "dopri5", "adaptive": True}},
    "event-driven": {"contact": {"treatment": "event-driven"}, "integrator": {"name": "dop853"}},
    **{
        name: {"contact": {"treatment": "time-stepping"}, "integrator": {"name": name}}
        for name in ("moreau-jean", "nonsmooth-generalized-alpha")
    },
}

Job = tuple[str, str, str]
"""The kind of a job, the example, and the variant."""


def facts(begin: Callable[[], Any]) -> dict[str, Any]:
    """Carry out a run, and return what is compared of it."""
    try:
        run = begin()
    except mbdkit.MbdkitError as error:
        return {"refused": str(error)}
    with run:
        return {
            "status": run.status,
            "reason": run.status_reason,
            "sha": run.data_sha256,
            "counters": {name: int(run.stats[name]) for name in COUNTERS if name in run.stats},
            "verdict": run.verdict,
            "verdict_reasons": [str(reason) for reason in run.verdict_reasons],
            "warnings": [str(warning) for warning in run.warnings],
        }


def jobs() -> Iterator[Job]:
    """Yield all jobs."""
    for kind, examples in (("inverse", INVERSE), ("design", DESIGNS), ("study", tuple(STUDIES))):
        for example in examples:
            yield kind, example, "as packaged"
    for example in example_names():
        try:
            model = load_spec(example).model_dump(mode="json")["model"]
        except mbdkit.SpecError:  # a spec of another kind
            continue
        yield "run", example, "as packaged"
        if model.get("contacts"):
            for treatment in TREATMENTS:
                yield "contacts", example, treatment


def carried_out(job: tuple[Job, Path]) -> tuple[str, dict[str, Any]]:
    """Carry out a job, and return its name and what is compared of it."""
    (kind, example, variant), folder = job
    name = f"{kind} | {example} {variant}"
    archive = folder / f"{kind} {example} {variant}.h5"
    archive.unlink(missing_ok=True)
    match kind:
        case "run":
            return name, facts(lambda: mbdkit.run(example, archive=str(archive)))
        case "inverse":
            return name, facts(lambda: mbdkit.inverse(example, archive=str(archive)))
        case "contacts":
            return name, facts(lambda: mbdkit.run(with_treatment(example, variant), archive=str(archive)))
        case "design":
            return name, _design(example, archive.with_suffix(""))
        case _:
            return name, _study(*STUDIES[example])


def with_treatment(example: str, treatment: str) -> dict[str, Any]:
    """Return the spec of an example with a treatment of its contacts, over a short time."""
    spec = load_spec(example).model_dump(mode="json", exclude_none=True)
    spec = {key: value for key, value in spec.items() if key not in ("formulation", "stabilization", "output")}
    time = spec["time"]
    time |= {"end": min(time["end"], time.get("start", 0.0) + 0.6), "step": min(time.get("step") or 0.002, 0.002)}
    return spec | TREATMENTS[treatment] | {"limits": {"max_steps": 100_000}}


def _design(example: str, folder: Path) -> dict[str, Any]:
    """Evaluate a design at its start and at the point of the first iteration."""
    shutil.rmtree(folder, ignore_errors=True)
    try:
        mbdkit.design(
            example, out=folder, optimum_only=True, assignments=["optimizer.max_iterations=1"], notify=lambda text: None
        )
    except mbdkit.MbdkitError as error:
        return {"refused": str(error)}
    ends = {name: facts(lambda name=name: mbdkit.load(folder / f"{name}.h5")) for name in ("start", "best")}
    return {"points": (folder / "points.jsonl").read_text().splitlines(), **ends}


def _study(example: str, key: str, values: tuple[float, ...]) -> dict[str, Any]:
    try:
        study = mbdkit.ensemble(example, {key: list(values)}, store="hashes", notify=lambda text: None)
    except mbdkit.MbdkitError as error:
        return {"refused": str(error)}
    frame = study.to_frame()
    return {
        "sha": frame.data_sha256.tolist(),
        "table": [[str(value) for value in frame[name]] for name in frame if "elapsed" not in name],
    }
