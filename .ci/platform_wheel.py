"""Machine code in wheels: a hook of Hatchling, which builds the wheels of mbdkit.

A wheel for one platform, which the environment variable ``MBDKIT_WHEEL`` names, has the machine code of this platform
only, uncompressed, so that it is loaded in place. Without the variable, as with ``pip install .``, a wheel has the
compressed machine code of all platforms.
"""

from __future__ import annotations

import lzma
import os
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TAGS = {
    "linux-aarch64": "manylinux2014_aarch64",
    "linux-x86_64": "manylinux2014_x86_64",
    "macos-arm64": "macosx_11_0_arm64",
    "macos-x86_64": "macosx_11_0_x86_64",
    "windows-x86_64": "win_amd64",
}
"""Tags of wheels by platform: the oldest systems for which `mbdkit_builder.libraries` links."""


class PlatformWheel(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the folders ``stored`` of all packages, which the configuration excludes."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Set the tag of the wheel and add its machine code."""
        if version == "editable":
            return
        name = os.environ.get("MBDKIT_WHEEL")
        if name is not None:
            build_data.update(pure_python=False, tag=f"py3-none-{TAGS[name]}")
        roots = [Path(self.root, package) for package in self.build_config.packages]
        if not any(file for root in roots for file in root.glob(f"**/stored/{name or '*'}/*")):
            raise FileNotFoundError(f"no machine code for {name or 'any platform'} is stored in {self.root}")
        self._unpacked = tempfile.TemporaryDirectory()
        for root in roots:
            for file in sorted(root.glob(f"**/stored/{name or '*'}/*")):
                inside = f"{root.name}/{file.relative_to(root).as_posix()}"
                if name is None or file.suffix != ".xz":
                    build_data["force_include"][str(file)] = inside
                    continue
                content = Path(self._unpacked.name, inside).with_suffix("")
                content.parent.mkdir(parents=True, exist_ok=True)
                content.write_bytes(lzma.decompress(file.read_bytes()))
                build_data["force_include"][str(content)] = inside.removesuffix(".xz")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the uncompressed files."""
        if version != "editable":
            self._unpacked.cleanup()
