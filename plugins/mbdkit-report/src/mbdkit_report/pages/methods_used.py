"""The methods section of a report: formulation, models and integrators of the run specs, with references."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.items import Claims, IntegratorPlugin
from mbdkit.registry.manager import registry
from mbdkit.spec.spec_kinds import kind_of
from mbdkit_report.plot.caption import plain_name

_EQUATIONS = (
    "Planar motion in absolute coordinates: x, y and the angle of every body. The equations of motion are solved in "
    "their index-1 form, M q'' + \u03a6_q\u1d40 \u03bb = Q and \u03a6_q q'' = \u03b3, at every evaluation."
)
_UNSTABILIZED = (
    "No stabilization is used: the constraints hold at acceleration level only, so integration errors appear as "
    "misalignment, the distance between the two points of a joint."
)
_INVERSE = (
    "Inverse dynamics: in each frame of the measured motion, the mechanism is fitted to the observed quantities by "
    "weighted least squares with all constraints satisfied; independent coordinates of the fitted motion are smoothed "
    "and differentiated, and velocities and accelerations of all bodies follow from the constraints. The equations of "
    "motion are then solved for the values of the actuators and the multipliers."
)


@dataclass(frozen=True)
class Methods:
    """A methods section: paragraphs of text, and the BibTeX entries of the methods used."""

    paragraphs: tuple[str, ...]
    bibtex: tuple[str, ...]


def methods(specs: Iterable[Mapping[str, object]], sources: Iterable[str] = ()) -> Methods:
    """Return the methods section of some run specs.

    Parameters
    ----------
    specs
        Specs of runs or of inverse dynamics, as plain mappings.
    sources
        Further BibTeX entries, such as those of a packaged study.
    """
    specs = [_with_control_apart(spec) for spec in specs]
    forward = [spec for spec in specs if "integrator" in spec]
    paragraphs = [_EQUATIONS, _stabilization(forward)] if forward else []
    if any(kind_of(spec).run_kind == "inverse" for spec in specs):
        paragraphs.append(_INVERSE)
    references = [_own_reference(), *sources]
    for kind in ("model", "integrator", "step-control"):
        for name, options in _used(specs, kind).items():
            try:
                item = registry().get(kind, name)
            except SpecError:
                paragraphs.append(f"The {kind} {name} is not installed here, so its references are missing.")
                continue
            paragraphs.append(_paragraph(item, options))
            references += item.plugin.references
    return Methods(tuple(paragraphs), tuple(dict.fromkeys(entry.strip() for entry in references)))


def _with_control_apart(spec: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a spec in which the controller of adaptive steps stands beside the integrator."""
    integrator = dict(spec.get("integrator", {}))
    if "step_control" not in integrator:
        return spec
    control = integrator.pop("step_control")
    return {**spec, "integrator": integrator, **({} if control is None else {"step-control": control})}


def _used(specs: Iterable[Mapping[str, Any]], kind: str) -> dict[str, list[dict[str, Any]]]:
    """Return the distinct options of each model, integrator or controller (`kind`) in the specs, by its name. The
    options of models are left out.
    """
    results: dict[str, dict[str, dict[str, Any]]] = {}
    for spec in specs:
        if kind not in spec:  # inverse dynamics has no integrator
            continue
        options = {key: value for key, value in spec[kind].items() if key != "name"} if kind != "model" else {}
        results.setdefault(str(spec[kind]["name"]), {}).setdefault(json.dumps(options, sort_keys=True), options)
    return {name: list(options.values()) for name, options in results.items()}


def _paragraph(item: Registered, used: list[dict[str, object]]) -> str:
    values: dict[str, dict[str, None]] = {}
    for options in used:
        for key, value in options.items():
            if value is not None:
                text = f"{value:g}" if isinstance(value, float) else str(value)
                values.setdefault(key.replace("_", " "), {})[text] = None
    settings = "; ".join(f"{key} {listed(value, 'and')}" for key, value in values.items())
    origin = f"{item.origin.distribution} {item.origin.version}"
    parts = [
        f"{item.plugin.label().capitalize()} {item.name} ({origin}): {item.plugin.summary}",
        f"Settings: {settings}." if settings else "",
    ]
    if isinstance(item.plugin, IntegratorPlugin):
        parts += dict.fromkeys(_claims(item.plugin, options, alone=len(used) == 1) for options in used)
    return " ".join(filter(None, parts))


def _claims(plugin: IntegratorPlugin, options: Mapping[str, object], *, alone: bool) -> str:
    """Return the claims of an integrator with these options, as text; empty if they are not available. The order is
    included only if it applies to all runs, because they have the same options (`alone`).
    """
    try:
        claims = plugin.claims(plugin.options.model_validate_json(json.dumps(options)))
    except (Exception, SystemExit):  # another version of a plugin may refuse the options, or fail in any way
        return ""
    return _claim_words(claims, alone) if isinstance(claims, Claims) else ""


def _claim_words(claims: Claims, alone: bool) -> str:
    told = [f"order {claims.order:g}"] if alone and claims.order is not None else []
    told += [word for word, held in (("symmetric", claims.symmetric), ("symplectic", claims.symplectic)) if held]
    text = f"As used here: {listed(told, 'and')}." if told else ""
    return f"{text} Drift: {claims.drift}.".strip() if claims.drift else text


def _stabilization(specs: Iterable[Mapping[str, object]]) -> str:
    names = {plain_name(spec.get("stabilization") or "none", "none") for spec in specs}
    if names == {"none"}:
        return _UNSTABILIZED
    return f"Stabilization of the constraints: {listed(sorted(names), 'and')}; statements about drift apply without it."


def _own_reference() -> str:
    return (
        "@software{mbdkit,\n  author = {{The mbdkit authors}},\n  title = {mbdkit: planar multibody dynamics with "
        f"constraints}},\n  version = {{{version('mbdkit')}}}\n}}"
    )
