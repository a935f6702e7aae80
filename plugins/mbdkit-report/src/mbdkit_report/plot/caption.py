"""Heading of a picture: title, model, method, step size and status of the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbdkit.spec.formulation_choice import name_of
from mbdkit.spec.spec_kinds import kind_of

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


@dataclass(frozen=True)
class Caption:
    """Heading of a picture: the spec's title, or the model's name; model, integrator, step and status in one line; and
    status and reason of a run that is not complete, otherwise empty.
    """

    title: str
    settings: str
    alarm: str = ""


def caption(run: Run) -> Caption:
    """Return the heading of the pictures of `run`."""
    spec = run.spec
    model = str(spec.get("model", {}).get("name", "mechanism"))
    parts = [model, method(spec), *_departures(spec)]
    if (step := spec.get("time", {}).get("step")) is not None:
        first = "first step" if "rtol" in spec.get("integrator", {}) else "step"
        parts.append(f"{first} {step:g} s")
    parts.append(str(run.status))
    alarm = ""
    if run.status != "complete":
        end = f" at t = {float(run.time[-1]):.6g} s" if len(run.time) else ""
        alarm = f"{str(run.status).upper()}{end}" + (f": {run.status_reason}" if run.status_reason else "")
    title = " ".join(str(spec.get("title") or model).split())
    return Caption(title, " · ".join(part for part in parts if part), alarm)


def method(spec: Mapping[str, Any]) -> str:
    """Return the integrator of a spec with its main options, such as ``gauss, 2 stages``. For inverse dynamics, return
    the smoothing instead.
    """
    if kind_of(spec).run_kind == "inverse":
        smooth = spec["motion"].get("smooth", {})
        cutoff = f" {smooth['cutoff']:g} Hz" if "cutoff" in smooth else ""
        return f"inverse dynamics, smoothing {smooth.get('name', 'none')}{cutoff}"
    integrator = spec.get("integrator", {})
    words = [str(integrator.get("name", ""))]
    if integrator.get("stages") is not None:
        words.append(f"{integrator['stages']} stage{'s' if integrator['stages'] != 1 else ''}")
    words += [f"{key} {integrator[key]:g}" for key in ("rtol", "atol") if isinstance(integrator.get(key), float | int)]
    return ", ".join(words)


def plain_name(choice: object, default: str) -> str:
    """Return the name of a formulation or stabilization of a spec, such as ``symmetric projection``."""
    if not isinstance(choice, Mapping):
        return str(choice)
    if "loops" in choice:
        return name_of(choice)
    return f"{'symmetric ' * bool(choice.get('symmetric'))}{choice.get('name', default)}"


def _departures(spec: Mapping[str, object]) -> list[str]:
    defaults = {"formulation": "index-1", "stabilization": "none"}
    names = {key: plain_name(spec.get(key) or default, default) for key, default in defaults.items()}
    return [name for key, name in names.items() if name != defaults[key]]
