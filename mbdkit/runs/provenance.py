"""Provenance of a run: the attributes of ``/provenance`` in its archive."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, cast

from mbdkit.archive import layout
from mbdkit.base.distributions import MBDKIT, own_version, version_of
from mbdkit.base.terminal import command_line
from mbdkit.engine.native.machine_code import code_id
from mbdkit.mechanism.joint_kinds import joint_kinds
from mbdkit.quantities.registered_kinds import kinds_of_others
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.element_items import ElementKind
from mbdkit.registry.feature_items import SpecKind
from mbdkit.registry.manager import registry
from mbdkit.runs.method_evidence import code_digest, evidence_of
from mbdkit.spec import RunSpec
from mbdkit.spec.model_spec import ModelSpec


@cache
def _versions() -> dict[str, str]:
    packages = ("numpy", "scipy", "h5py", "pydantic", "pluggy")
    return {"mbdkit": own_version(), **{name: version_of(name) for name in packages}, "machine_code": code_id()}


#: Entries of the provenance, besides plugins, that must be equal for results to be bitwise identical.
DECIDE_LAST_BITS = ("mbdkit", "numpy", "scipy", "machine_code", "processor")

#: Environment variables that make libraries use code for another processor.
_EMULATING = ("NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE", "NUMBA_CPU_NAME")


@cache
def _processor() -> str:
    """Return instruction set, model and extensions of the processor, and environment variables that emulate another
    one.

    Linear algebra libraries and compilers select their code accordingly, so that rounding errors of results depend on
    them.
    """
    content = {}
    with suppress(OSError):  # only Linux has this file
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").partition("\n\n")[0].splitlines()
        content = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    flags = content.get("flags", "").split()
    extensions = [name for name in ("fma", "avx2", "avx512f") if name in flags]
    model = content.get("model name") or _brand_on_macos() or platform.processor()
    numbers = [f"{key} {content[key]}" for key in ("cpu family", "model") if key in content]
    emulated = [f"{name}={os.environ[name]}" for name in _EMULATING if os.environ.get(name)]
    return ", ".join(filter(None, (platform.machine(), model, *numbers, *extensions, *emulated)))


def _brand_on_macos() -> str:
    """Return the model of the processor, for which `platform.processor` returns only ``arm`` or ``i386`` on macOS."""
    if platform.system() != "Darwin":
        return ""
    command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
    with suppress(OSError):
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    return ""


def provenance(spec: RunSpec) -> dict[str, str | int | float]:
    """Return the versions, platform, command and plugins of a run."""
    return {**surroundings(), **plugins_of(spec)}


def surroundings() -> dict[str, str | int | float]:
    """Return the versions, platform and command, which are the same for all runs of a process."""
    return {
        **_versions(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _processor(),
        "cpu_count": os.cpu_count() or 0,
        "command": command_line(),
    }


def model_provenance(spec: ModelSpec) -> dict[str, str | int | float]:
    """Return the versions, platform, command and plugins of a computation without an integrator."""
    return {**surroundings(), **_plugins({"model": spec.model_item}, spec)}


def plugins_of(spec: RunSpec) -> dict[str, str]:
    """Return the plugins of a run and their versions; the kind of the spec only if a plugin defines it."""
    kinds = registry().of_kind("spec-kind") if type(spec) is not RunSpec else ()
    own = [("spec_kind", kind) for kind in kinds if kind.origin.distribution != MBDKIT and _is_of(spec, kind)]
    own += [] if spec.step_control_item is None else [("step_control", spec.step_control_item)]
    items = {"model": spec.model_item, "integrator": spec.integrator_item, **dict(own)}
    return _plugins(items, spec) | _of_elements(spec) | _of_method(spec)


def _of_method(spec: RunSpec) -> dict[str, str]:
    """Return the digest of the code of the integrator, and what is known of its verification."""
    evidence = evidence_of(spec.integrator_item, spec.integrator)
    return {"integrator_digest": evidence.digest, layout.EVIDENCE: str(evidence)}


def _is_of(spec: RunSpec, kind: Registered) -> bool:
    """Return whether a kind of specs has a class of its own for a run spec; sections of plugins do not matter."""
    target = cast(SpecKind, kind.plugin).model
    model: Any = None if target is None else target()
    return model not in (None, RunSpec) and isinstance(spec, model)


def _plugins(items: dict[str, Registered], spec: ModelSpec) -> dict[str, str]:
    versions: dict[str, str] = {}
    for kind, item in items.items():
        versions |= _entries(kind, [item])
    return versions | _entries("force_laws", spec.force_law_items)


def _entries(key: str, items: Sequence[Registered]) -> dict[str, str]:
    """Return the names and origins of items under keys that begin with `key`; nothing without items."""
    names = {key: ", ".join(item.id for item in items)}
    for part in ("distribution", "version", "entry_point"):
        names[f"{key}_{part}"] = ", ".join(getattr(item.origin, part) for item in items)
    # versions of mbdkit and its machine code are known
    if others := [item for item in items if item.origin.distribution != MBDKIT]:
        names[f"{key}_digest"] = ", ".join(dict.fromkeys(code_digest(item.origin) for item in others))
    return names if items else {}


def _of_elements(spec: RunSpec) -> dict[str, str]:
    """Return the plugins of other distributions whose elements, joints and quantities a run has, and their versions."""
    mechanism = spec.mechanism()
    types = {getattr(joint, "type", "") for joint in mechanism.joints.values()}
    joints = [item for name, item in joint_kinds().items() if name in types and item.origin.distribution != MBDKIT]
    kinds = [item for item in registry().of_kind("element-kind") if item.origin.distribution != MBDKIT]
    kinds = [item for item in kinds if mechanism.elements.get(cast(ElementKind, item.plugin).key_in_model)]
    quantities = kinds_of_others(spec.mechanism)
    groups = {"quantities_group": ", ".join(quantities)} if quantities else {}
    recorded = _entries("quantities", list(quantities.values()))
    return _entries("joint_kinds", joints) | _entries("element_kinds", kinds) | recorded | groups
