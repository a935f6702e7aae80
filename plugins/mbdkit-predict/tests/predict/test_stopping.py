"""Predictions that are stopped by Ctrl-C or by their limit of time."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbdkit
from mbdkit import RunError
from mbdkit.cli import app
from mbdkit_predict.processes import GRACE, Stop, results_of
from predict.chains import chain

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="solutions have processes of their own on Linux only")


@pytest.mark.parametrize("count", [2, pytest.param(40, marks=pytest.mark.slow)])
def test_stopped_predictions_end_in_time_with_the_best_iterate(count: int, tmp_path: Path) -> None:
    random, spec = np.random.default_rng(73), chain(10)
    mbdkit.predict(chain(1))  # imports what predictions need
    for k in range(count):
        path, limit = tmp_path / f"{k}.h5", float(random.uniform(0.5, 3.0))
        begin = time.perf_counter()
        if k % 2:
            timer = threading.Timer(limit, signal.raise_signal, [signal.SIGINT])
            timer.start()
            mbdkit.predict(spec, archive=path)
        else:
            mbdkit.predict(spec, archive=path, limits={"wall_time": limit})
        late = time.perf_counter() - begin - limit
        assert late < 1.0, (k, limit, late)
        with mbdkit.load(path) as run:
            code = run.status_reason.partition(":")[0]
            assert (code, run.verdict in ("bad", "doubtful")) == ("interrupted" if k % 2 else "wall-time", True)
            assert np.isfinite(run.objective)


def test_an_interrupted_command_writes_the_best_motion(tmp_path: Path) -> None:
    mbdkit.predict(chain(1))
    spec, path = tmp_path / "chain.json", tmp_path / "chain.h5"
    spec.write_text(json.dumps(chain(10)))
    threading.Timer(1.5, signal.raise_signal, [signal.SIGINT]).start()
    assert CliRunner().invoke(app, ["predict", str(spec), "-o", str(path)]).exit_code == 130
    with mbdkit.load(path) as run:
        assert (run.status, run.verdict in ("doubtful", "bad")) == ("interrupted", True)


def test_processes_return_results_errors_and_what_they_sent_last() -> None:
    def squared(x: int) -> Any:
        return lambda report: x * x

    assert results_of([squared(x) for x in range(5)], Stop()) == [0, 1, 4, 9, 16]

    def endless(report: Any) -> int:
        for k in range(1000):
            report(k)
            time.sleep(0.05)
        return 1000

    begin = time.perf_counter()
    (last, *rest) = results_of([endless] * 9, Stop(begin + 0.5))
    assert last is not None
    assert 0 < last < 20
    assert None in rest  # of tasks that have not begun
    assert time.perf_counter() - begin < 0.5 + GRACE + 0.5

    def wrong(report: Any) -> int:
        raise RunError("this is wrong")

    with pytest.raises(RunError, match="this is wrong"):
        results_of([wrong], Stop())

    def killed(report: Any) -> int:
        signal.raise_signal(signal.SIGKILL)
        return 0

    with pytest.raises(RunError, match="ended without a result"):
        results_of([killed], Stop())
