"""The templates of integrators, installed for benchmarks."""

from __future__ import annotations

import sys
from pathlib import Path

from mbdkit.registry.manager import forget
from mbdkit_testing.scaffold.new_plugin import LIKE, new_project
from tests.installing import install_project


def install_templates(folder: Path) -> dict[str, str]:
    """Generate the templates of integrators in a folder, and put them on the path of this process.

    Returns
    -------
    dict
        Name of each integrator, by the kind of its template.
    """
    sys.path.append(str(folder / "site"))
    for like in LIKE:
        project = new_project(f"mbdkit-new-{like}", "integrator", folder, like)
        install_project(folder / "site", project)
        sys.path.append(str(project / "src"))
    forget()
    return {like: f"new-{like}" for like in LIKE}
