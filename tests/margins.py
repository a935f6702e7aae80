"""How near comparisons of tests come to their limits.

A plugin of pytest, loaded by `addopts` of pyproject.toml. It records the largest ratio of deviation and tolerance of
every `numpy.testing.assert_allclose`, `pytest.approx`, and `assert_within`. `python -m tests.margins` prints the ratios
of the last run that are above 0.4, the worst first; a number as argument replaces 0.4.
"""

from __future__ import annotations

import ast
import json
import linecache
import numbers
import sys
from collections.abc import Generator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing
import pytest

ROOT = Path(__file__).resolve().parent.parent
RECORDED, PRINTED = 0.1, 0.4
"""Smallest ratios that are recorded, and that are printed."""

MARK = "# margin: "
_STORE = "mbdkit/margins"
_near: dict[tuple[str, int], float] = {}
_rows: list[tuple[float, str, str, str]] = []


def assert_within(deviation: Any, limit: Any, note: Any = "") -> None:
    """Assert that no entry of `deviation` exceeds `limit` in size; both may be arrays, which are broadcast."""
    __tracebackhide__ = True
    size, limits = np.broadcast_arrays(np.abs(np.asarray(deviation)), limit)
    wrong = ~(size <= limits)
    if wrong.any() or not size.size:
        index = np.unravel_index(np.argmax(wrong), size.shape) if size.size else None
        of = f"{size[index]} exceeds {limits[index]}" if size.size else "nothing was compared"
        where = f", first at {tuple(map(int, index))} of {size.shape}" if size.ndim and size.size else ""
        raise AssertionError(f"{of}{where}{': ' if note else ''}{note}")
    _record(size, limits)


def _record(deviation: Any, limit: Any) -> None:
    """Keep the largest ratio with the place of the comparison, the innermost outside of this file and of packages."""
    with np.errstate(all="ignore"):
        ratios = np.asarray(deviation / limit, float)
    ratio = float(np.max(ratios, initial=0.0, where=np.isfinite(ratios)))
    if not RECORDED <= ratio <= 1.0:
        return
    frame = sys._getframe(1)
    while frame.f_code.co_filename == __file__ or "site-packages" in frame.f_code.co_filename:
        if frame.f_back is None:
            return
        frame = frame.f_back
    place = frame.f_code.co_filename, frame.f_lineno
    _near[place] = max(ratio, _near.get(place, 0.0))


_assert_allclose = numpy.testing.assert_allclose
_Approx: Any = type(pytest.approx(1.0))
_equals = _Approx.__eq__


def assert_allclose(actual: Any, desired: Any, rtol: float = 1e-7, atol: float = 0, *rest: Any, **more: Any) -> None:
    """Compare as `numpy.testing.assert_allclose`, and record how near it was."""
    __tracebackhide__ = True
    _assert_allclose(actual, desired, rtol, atol, *rest, **more)
    x, y = np.asarray(actual), np.asarray(desired)
    if x.dtype.kind in "iufc" and y.dtype.kind in "iufc":
        with np.errstate(all="ignore"):
            _record(np.abs(x - y), atol + rtol * np.abs(y))


def _approx_equals(self: Any, actual: Any) -> bool:
    equal: bool = _equals(self, actual)
    if equal and isinstance(actual, numbers.Number) and actual != self.expected and self.tolerance:
        _record(float(abs(actual - self.expected)), float(self.tolerance))  # type: ignore[operator]
    return equal


numpy.testing.assert_allclose = np.testing.assert_allclose = assert_allclose
_Approx.__eq__ = _approx_equals


@cache
def _statements(file: str) -> list[tuple[int, int]]:
    """Return first and last lines of all statements that contain no others."""
    nodes = ast.walk(ast.parse("".join(linecache.getlines(file))))
    return [(n.lineno, n.end_lineno or 0) for n in nodes if isinstance(n, ast.stmt) and not hasattr(n, "body")]


def _reason(file: str, line: int) -> str:
    """Return the reason that a comment of the statement, or above it, gives for a small margin; empty without one."""
    lines = linecache.getlines(file)
    first, last = next((span for span in _statements(file) if span[0] <= line <= span[1]), (line, line))
    while first > 1 and lines[first - 2].lstrip().startswith("#"):
        first -= 1
    comments = [text.strip() for text in lines[first - 1 : last] if "#" in text]
    index = next((i for i, text in enumerate(comments) if MARK in text), len(comments))
    parts = [text.partition(MARK)[2] if i == 0 else text for i, text in enumerate(comments[index:])]
    return " ".join(text.lstrip("# ") for i, text in enumerate(parts) if i == 0 or text.startswith("#"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Hand the ratios of a test to its report."""
    try:
        result = yield
        near = [(ratio, f"{_relative(file)}:{line}", _reason(file, line)) for (file, line), ratio in _near.items()]
    finally:
        _near.clear()
    item.user_properties.append((_STORE, near))
    return result


def _relative(file: str) -> str:
    path = Path(file)
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else file


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Collect the ratios of a test, which another process may have run."""
    if report.when == "call":
        for name, near in report.user_properties:
            if name == _STORE:
                _rows.extend((ratio, place, report.nodeid, reason) for ratio, place, reason in near)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep the ratios for `python -m tests.margins`."""
    if _rows and not hasattr(session.config, "workerinput") and (store := getattr(session.config, "cache", None)):
        store.set(_STORE, sorted(_rows, reverse=True))


def _main(least: float) -> None:
    """Print the largest ratio of every comparison of the last run with its test, and the reason given for it."""
    worst: dict[str, list[str]] = {}
    for ratio, place, test, reason in json.loads((ROOT / ".pytest_cache" / "v" / _STORE).read_text("utf-8")):
        if ratio >= least:
            worst.setdefault(place, [f"{ratio:.3f}", place, test.rpartition("::")[2], reason])
    for row in worst.values():
        print("  ".join(row).rstrip())


if __name__ == "__main__":
    _main(float(sys.argv[1]) if sys.argv[1:] else PRINTED)
