"""How near comparisons of tests come to their limits.

A plugin of pytest, loaded by `addopts` of pyproject.toml. It records the largest ratio of deviation and tolerance of
every `numpy.testing.assert_allclose`, `pytest.approx`, and `assert_within`. `python -m tests.margins` prints the ratios
of the last run that are above 0.4, the worst first; `python -m tests.margins 0.2 FILE ...` prints those above 0.2 of
several runs, with their range. FILE is a copy of `.pytest_cache/v/mbdkit/margins`. The processors of other machines
are had by `MBDKIT_PROCESSOR`, and for NumPy and SciPy by `OPENBLAS_CORETYPE` (Haswell, Nehalem, Prescott) and
`NPY_DISABLE_CPU_FEATURES`.

A test that passes with a ratio above 0.8 fails nevertheless: the rounding of another processor, or another release of
what it compares with, may exceed the limit. It needs a better reference, or a limit of at least 3 times the largest
deviation measured on several processors. Where both sides are the same on every machine, such as digits of a
publication and results of mbdkit, a comment `# margin: REASON` in the statement or above it says so. It is printed
beside the ratio.
"""

from __future__ import annotations

import ast
import json
import linecache
import numbers
import sys
from collections.abc import Generator
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing
import pytest

ROOT = Path(__file__).resolve().parent.parent
RECORDED, PRINTED, REFUSED = 0.1, 0.4, 0.8
"""Smallest ratios that are recorded, that are printed, and that make a test fail."""

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
    if equal and isinstance(actual, numbers.Number) and actual == actual and actual != self.expected:
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
    block = [text.strip() for text in lines[first - 1 : last]]
    for i, text in enumerate(block):
        if MARK in text:
            further = takewhile(lambda text: text.startswith("#"), block[i + 1 :])
            return " ".join([text.partition(MARK)[2], *(text.lstrip("# ") for text in further)])
    return ""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Hand the ratios of a test to its report, and let the test fail if one of them is too large without a reason."""
    try:
        result = yield
        near = [
            (ratio, f"{_relative(file)}:{line}", _reason(file, line) if ratio > PRINTED else "")
            for (file, line), ratio in _near.items()
        ]
    finally:
        _near.clear()
    item.user_properties.append((_STORE, near))
    if refused := [f"{place}: {ratio:.2f}" for ratio, place, reason in near if ratio > REFUSED and not reason]:
        pytest.fail(
            f"Another machine may exceed a limit, of which the deviation is more than {REFUSED} here"
            f" ({', '.join(refused)}). tests/margins.py says what to do.",
            pytrace=False,
        )
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


def print_margins(least: float, *files: str) -> None:
    """Print the largest ratio of every comparison with its test and reason, for several files its range over them."""
    tables: list[dict[str, list[Any]]] = []
    for file in map(Path, files or [ROOT / ".pytest_cache" / "v" / _STORE]):
        if not file.exists():
            sys.exit(f"There is no record of margins in {file}; pytest writes it.")
        worst: dict[str, list[Any]] = {}
        for ratio, place, test, reason in json.loads(file.read_text("utf-8")):
            worst.setdefault(place, [ratio, test.rpartition("::")[2], reason])
        tables.append(worst)
    places = dict.fromkeys(place for table in tables for place in table)
    ranges = {place: [table[place][0] if place in table else 0.0 for table in tables] for place in places}
    for place in sorted(places, key=lambda place: -max(ranges[place])):
        small, large = min(ranges[place]), max(ranges[place])
        if large >= least:
            _, test, reason = next(table[place] for table in tables if place in table)
            span = f"{small:.3f} to {large:.3f}" if files else f"{large:.3f}"
            print("  ".join((span, place, test, reason)).rstrip())


if __name__ == "__main__":
    print_margins(float(sys.argv[1]) if sys.argv[1:] else PRINTED, *sys.argv[2:])
