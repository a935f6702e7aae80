"""Stand-ins for installed plugins: entry points that hand over whatever a test wants."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import BaseModel

from mbdkit import Claims, IntegratorPlugin, ModelPlugin, hookimpl
from mbdkit.registry import manager
from mbdkit.registry.manager import Registry, load_registry


class SwingOptions(BaseModel):
    length: float = 1.0


class EulerOptions(BaseModel):
    damping: float = 0.0


@dataclass
class FakeEntryPoint:
    """An entry point whose `load` calls `loader`."""

    loader: Callable[[], Any]
    distribution: str = "acme"
    version: str = "2.0"
    name: str = "plugin"
    value: str = "acme.plugin"

    @property
    def dist(self) -> Any:
        return SimpleNamespace(name=self.distribution, version=self.version)

    def load(self) -> Any:
        return self.loader()


@pytest.fixture
def entry_point() -> type[FakeEntryPoint]:
    return FakeEntryPoint


@pytest.fixture
def swing() -> Callable[..., ModelPlugin]:
    """Make a model plugin; keywords replace what it is made of."""

    def make(**changes: Any) -> ModelPlugin:
        return ModelPlugin(**{"name": "swing", "summary": "A swing", "options": SwingOptions, "build": print} | changes)

    return make


@pytest.fixture
def euler() -> Callable[..., IntegratorPlugin]:
    """Make an integrator plugin; keywords replace what it is made of."""

    def make(**changes: Any) -> IntegratorPlugin:
        made = {"name": "euler", "summary": "Euler", "options": EulerOptions, "create": print}
        made["claims"] = claim_order_one
        return IntegratorPlugin(**made | changes)

    return make


@pytest.fixture
def offering() -> Callable[..., SimpleNamespace]:
    """Make a plugin module that offers the given models and integrators."""

    def make(models: Any = (), integrators: Any = ()) -> SimpleNamespace:
        @hookimpl
        def mbdkit_models() -> Any:
            return models

        @hookimpl
        def mbdkit_integrators() -> Any:
            return integrators

        return SimpleNamespace(mbdkit_models=mbdkit_models, mbdkit_integrators=mbdkit_integrators)

    return make


def claim_order_one(options: BaseModel) -> Claims:
    return Claims(order=1)


def offering_items(*items: Any) -> SimpleNamespace:
    """Return a plugin module that offers items of any kind by one hook."""
    return SimpleNamespace(mbdkit_items=hookimpl(specname="mbdkit_items")(lambda: iter(items)))


@pytest.fixture
def beside_ours(entry_point: type[FakeEntryPoint]) -> Callable[..., Registry]:
    """Return a function that loads items of distributions beside mbdkit's own."""
    ours = [point for point in entry_points(group="mbdkit") if point.dist and point.dist.name == "mbdkit"]

    def load(**distributions: Any) -> Registry:
        made = [entry_point(lambda items=items: offering_items(*items), name) for name, items in distributions.items()]
        return load_registry([*ours, *made])

    return load


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch, beside_ours: Callable[..., Registry]) -> Callable[..., Registry]:
    """Return a function that installs items of distributions beside mbdkit's own in this process."""

    def install(**distributions: Any) -> Registry:
        loaded = beside_ours(**distributions)
        for user in list(sys.modules.values()):
            if getattr(user, "registry", None) is manager.registry and user is not manager:
                monkeypatch.setattr(user, "registry", lambda: loaded)
        return loaded

    return install
