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
from typing import Any

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
    processor, features, architecture
        The processor, its additional features in code for lanes, and its architecture, as LLVM names them.
    shared
        Libraries of machine code that are not stored for this level, each with the level whose library is used instead.
    """

    name: str
    lanes: int
    needs: frozenset[str]
    processor: str
    features: str = ""
    architecture: str = "x86_64"
    shared: tuple[tuple[str, str], ...] = ()

    def of(self, library: str) -> str:
        """Return the name of the level whose code is used for a library, such as ``core`` or ``collocation``."""
        return dict(self.shared).get(library, self.name)


_V2 = frozenset(["cx16", "lahf_lm", "popcnt", "sse4_1", "sse4_2", "ssse3"])
_V3 = _V2 | frozenset(["avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "xsave"])
_V4 = _V3 | frozenset(["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"])

_X86_64 = (Level("x86-64-v3", 4, _V3, "x86-64-v3"), Level("x86-64-v2", 2, _V2, "x86-64-v2"))


@dataclass(frozen=True)
class Platform:
    """An operating system and an architecture, such as ``linux-x86_64``, named as in the tags of wheels."""

    system: str
    architecture: str

    def __str__(self) -> str:
        return f"{self.system}-{self.architecture}"

    @property
    def levels(self) -> tuple[Level, ...]:
        """Its levels, the best one first; none if no machine code is built for it."""
        return PLATFORMS.get(self, ())


#: Levels by platform, the best one first.
PLATFORMS = {
    Platform("linux", "x86_64"): (
        Level("x86-64-v4", 8, _V4, "x86-64-v4", "-prefer-256-bit", shared=(("gradients", "x86-64-v3"),)),
        *_X86_64,
    ),
    Platform("linux", "aarch64"): (Level("armv8", 2, frozenset(), "generic", architecture="aarch64"),),
    Platform("macos", "arm64"): (Level("apple", 2, frozenset(), "apple-m1", architecture="aarch64"),),
    # Few Intel Macs and few laptops with Windows have AVX-512, which only advances ensembles faster.
    Platform("macos", "x86_64"): _X86_64,
    Platform("windows", "x86_64"): _X86_64,
}

_SYSTEMS = {"linux": "linux", "darwin": "macos", "win32": "windows"}
_ARCHITECTURES = {"amd64": "x86_64", "x64": "x86_64", "arm64": "aarch64"}


def this_platform() -> Platform:
    """Return the platform of this process."""
    system, machine = _SYSTEMS.get(sys.platform, sys.platform), platform.machine().lower()
    return Platform(system, machine if system == "macos" else _ARCHITECTURES.get(machine, machine))


def _flags_of_windows() -> frozenset[str]:
    import ctypes

    system: Any = sys
    present = ctypes.windll.kernel32.IsProcessorFeaturePresent  # type: ignore[attr-defined]
    # The system reports SSE4.2 and AVX2; processors with these have the other instructions of the level. Versions
    # before Windows 10 2004 report neither.
    is_silent = system.getwindowsversion().build < 19041
    return _V3 if present(40) else _V2 if present(38) or is_silent else frozenset()


def _flags_of_macos() -> frozenset[str]:
    import ctypes

    library, text = ctypes.CDLL(None), ""
    for name in (b"machdep.cpu.features", b"machdep.cpu.leaf7_features", b"machdep.cpu.extfeatures"):
        buffer = ctypes.create_string_buffer(4096)
        if (
            library.sysctlbyname(name, buffer, ctypes.byref(ctypes.c_size_t(len(buffer))), None, ctypes.c_size_t(0))
            == 0
        ):
            text += buffer.value.decode().lower() + " "
    return flags_in(text.replace(".", "_"))


def flags_in(text: str) -> frozenset[str]:
    """Return the flags in a list of flags, some of which macOS names otherwise than Linux."""
    named = {"avx1_0": "avx", "lzcnt": "abm", "lahf": "lahf_lm"}
    return frozenset(named.get(flag, flag) for flag in text.split())


@cache
def _flags() -> frozenset[str]:
    """Return the flags of the processor; empty if they are unknown, as on other architectures than x86-64."""
    if sys.platform == "win32":
        return _flags_of_windows()
    if sys.platform == "darwin":
        return _flags_of_macos()
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
    levels = this_platform().levels or _X86_64
    if name := os.environ.get("MBDKIT_PROCESSOR"):
        for level in (level for group in PLATFORMS.values() for level in group):
            if level.name == name:
                return level
        known = ", ".join(level.name for level in levels)
        raise MbdkitError(f"the environment variable MBDKIT_PROCESSOR should be one of {known}, not '{name}'")
    return next(filter(is_able, levels), levels[-1])


WIDTH = chosen_level().lanes  #: Number of lanes. The results of a run do not depend on it.
