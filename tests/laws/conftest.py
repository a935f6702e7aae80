"""Installs the plugin of this folder in the process of the tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from mbdkit.registry import manager

from . import plugin


@pytest.fixture(scope="package", autouse=True)
def acme() -> Iterator[None]:
    """Let the registry find an entry point of distribution `acme`, version 2.0, whose module is `plugin`."""
    points, unusable = manager.entry_points("mbdkit")
    module = sys.modules[plugin.__name__]
    entry = SimpleNamespace(
        name="laws", value="acme.laws", dist=SimpleNamespace(name="acme", version="2.0"), load=lambda: module
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(manager, "entry_points", lambda group: ([*points, entry], unusable))
        manager.forget()
        yield
    manager.forget()
