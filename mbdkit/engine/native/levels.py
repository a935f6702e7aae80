"""Levels of processors for which machine code is stored, and the level of this processor.

A level fixes the instructions that compiled code may use, and the number of SIMD lanes: how many runs it advances
together (`mbdkit_builder.lane_types`). No level contracts multiplications and additions, so that results do not
depend on it.
"""

from __future__ import annotations

import os
import platform
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from mbdkit.base.errors import MbdkitError


@dataclass(frozen=True)
class Level:
    """A level of processors.

    Parameters
    ----------
    name
        Its name, as in the variable ``MBDKIT_PROCESSOR``.
    lanes
        Number of doubles in a vector register.
    needs
        Flags of a processor of this level, as Linux names them.
    processor, features
        The processor, and its additional features in code for lanes, as LLVM names them.
    shared
        Libraries of machine code that are not stored for this level, each with the level whose library is used instead.
    """

    name: str
    lanes: int
    needs: frozenset[str]
    processor: str
    features: str = ""
    shared: tuple[tuple[str, str], ...] = ()

    def of(self, library: str) -> str:
        """Return the name of the level whose code is used for a library, such as ``core`` or ``collocation``."""
        return dict(self.shared).get(library, self.name)


_V2 = frozenset(["cx16", "lahf_lm", "popcnt", "sse4_1", "sse4_2", "ssse3"])
_V3 = _V2 | frozenset(["avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "xsave"])
_V4 = _V3 | frozenset(["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"])

LEVELS = {
    "x86_64": (
        Level("x86-64-v4", 8, _V4, "x86-64-v4", "-prefer-256-bit", (("gradients", "x86-64-v3"),)),
        Level("x86-64-v3", 4, _V3, "x86-64-v3"),
        Level("x86-64-v2", 2, _V2, "x86-64-v2"),
    ),
    "aarch64": (Level("armv8", 2, frozenset(), "generic"),),
}
"""Levels by architecture, the best one first."""

_ARCHITECTURES = {"amd64": "x86_64", "x64": "x86_64", "arm64": "aarch64"}
_SYSTEMS = {"linux": "linux", "darwin": "macos", "win32": "windows"}


@dataclass(frozen=True)
class Platform:
    """An operating system and an architecture, such as ``linux-x86_64``."""

    system: str
    architecture: str

    def __str__(self) -> str:
        return f"{self.system}-{self.architecture}"

    @property
    def levels(self) -> tuple[Level, ...]:
        """Its levels, the best one first."""
        return LEVELS.get(self.architecture, ())


def this_platform() -> Platform:
    """Return the platform of this process."""
    machine = platform.machine().lower()
    return Platform(_SYSTEMS.get(sys.platform, sys.platform), _ARCHITECTURES.get(machine, machine))


def _flags_of_windows() -> frozenset[str]:
    import ctypes

    present = ctypes.windll.kernel32.IsProcessorFeaturePresent  # type: ignore[attr-defined]
    # The system reports AVX2 and AVX-512F; processors with these have the other instructions of the level.
    return (_V2 if present(38) else frozenset()) | (_V3 if present(40) else frozenset()) | (
        _V4 if present(41) else frozenset()
    )  # fmt: skip


@cache
def _flags() -> frozenset[str]:
    """Return the flags of the processor; empty if they are unknown."""
    if sys.platform == "win32":
        return _flags_of_windows()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return frozenset()
    line = next((line for line in text.splitlines() if line.startswith("flags")), "")
    return frozenset(line.partition(":")[2].split())


def is_able(level: Level) -> bool:
    """Return whether this processor has the instructions of a level."""
    return level.needs <= _flags()


@cache
def chosen_level() -> Level:
    """Return the level named by ``MBDKIT_PROCESSOR``, else the best one that this processor has.

    Raises
    ------
    MbdkitError
        If there is no such level.
    """
    levels = this_platform().levels or LEVELS["x86_64"]
    if name := os.environ.get("MBDKIT_PROCESSOR"):
        for level in (level for group in LEVELS.values() for level in group):
            if level.name == name:
                return level
        known = ", ".join(level.name for level in levels)
        raise MbdkitError(f"the environment variable MBDKIT_PROCESSOR should be one of {known}, not '{name}'")
    return next(filter(is_able, levels), levels[-1])


WIDTH = chosen_level().lanes
"""Number of lanes. The results of a run do not depend on it."""
