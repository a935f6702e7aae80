"""Writes the golden files of format 1: ``python -m tests.golden.write [--overwrite]``, which takes about a minute.

No file that a release contains is ever written again: a change of a format adds files of its new version.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.golden.plain import numbers
from tests.golden.schema_keys import every_key
from tests.golden.spec_hashes import spec_hash

HERE = Path(__file__).parent
ARCHIVES, SPECS = HERE / "archives", HERE / "specs"
COMMANDS = {
    **{f"{name}.h5": ("run", name) for name in ("run", "failed", "contact", "impact", "muscles")},
    **{f"{kind}.h5": (kind, kind) for kind in ("inverse", "identify", "predict")},
    **{name: (kind, name) for name, kind in {"study": "study", "sample": "study", "design": "design"}.items()},
}
"""Command and spec of each file or folder; a crate is added to these."""


def write(folder: Path) -> None:
    """Write all golden archives into an empty folder, and the numbers that a plain reader finds in them."""
    (folder / "site").mkdir()
    (folder / "site" / "sitecustomize.py").write_text("import platform\nplatform.platform = lambda *_, **__: 'Linux'\n")
    for name, (command, spec) in COMMANDS.items():
        mbdkit(folder, command, str(SPECS / f"{spec}.yaml"), "-o", name)
    mbdkit(folder, "archive", "crate", "failed.h5", "-o", "crate")
    drop_pages(folder / "crate")
    shutil.rmtree(folder / "site")
    found = {path.name: numbers(path) for path in sorted(folder.iterdir())}
    write_json(folder / "numbers.json", found)


def golden_specs() -> list[Path]:
    """Return all golden specs: those of the folder, and those in the folders of studies and designs."""
    return [*sorted(SPECS.glob("*.yaml")), *sorted(ARCHIVES.glob("*/*.yaml"))]


def mbdkit(folder: Path, *arguments: str) -> None:
    command = [sys.executable, "-m", "mbdkit", *arguments]
    done = subprocess.run(command, cwd=folder, env=os.environ | {"PYTHONPATH": str(folder / "site")}, check=False)
    if done.returncode not in (0, 3):  # 3: the run that fails
        sys.exit(done.returncode)


def drop_pages(crate: Path) -> None:
    """Remove the reports of a crate, which are twenty times as large as all the rest, from its folder and its list."""
    path = crate / "ro-crate-metadata.json"
    data = json.loads(path.read_text("utf-8"))
    pages = {page.name for page in crate.glob("*.html")}
    for entity in data["@graph"]:
        for key in ("hasPart", "result"):
            if isinstance(entity.get(key), list):
                entity[key] = [part for part in entity[key] if part["@id"] not in pages]
    data["@graph"] = [entity for entity in data["@graph"] if entity["@id"] not in pages]
    write_json(path, data)
    for page in pages:
        (crate / page).unlink()


def write_json(path: Path, data: object) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    if ARCHIVES.exists() and "--overwrite" not in sys.argv:
        sys.exit(f"{ARCHIVES} exists; only files that no release contains may be written again, with --overwrite")
    with tempfile.TemporaryDirectory() as work:
        write(Path(work))
        shutil.rmtree(ARCHIVES, ignore_errors=True)
        shutil.copytree(work, ARCHIVES)
    write_json(HERE / "spec_sha256.json", {str(path.relative_to(HERE)): spec_hash(path) for path in golden_specs()})
    (HERE / "spec_keys.txt").write_text("\n".join([*sorted(every_key()), ""]), encoding="utf-8", newline="\n")
