"""Code of items that fails, returns nonsense, or does not exist."""

from __future__ import annotations

from mbdkit.plugin import Finding, Target


def missing(*_):
    return {}.missing


def wrong(*_):
    return [3]


def failing(*_):
    raise ValueError("no such muscle")


def suspicious(spec, *_):
    return [f"{len(spec.mechanism().bodies)} bodies", Finding("acme-time", None, "a note", "time")]


def charts(run):
    return wrong(run)


chart = failing


def target(name):
    return Target(f"{__name__}:{name}")
