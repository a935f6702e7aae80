"""Compiles all kernels once per installation, while other processes wait.

The step of the collocation methods takes a third of the time. If the computer has several cores, another process
compiles it into the cache meanwhile.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from mbdkit.base.interrupts import interrupts_noted
from mbdkit.engine.jit.bundle import JIT_DISABLED
from mbdkit.engine.jit.cache import FOLDER, compiling, is_shared, is_warm


def to_stderr(message: str) -> None:
    """Print a message to stderr, like progress."""
    print(message, file=sys.stderr, flush=True)


def ensure_compiled(notify: Callable[[str], None] = to_stderr) -> None:
    """Compile all kernels into the cache unless that has been done.

    Parameters
    ----------
    notify
        Called with a message before and after compilation.
    """
    if is_warm():
        return
    notify("mbdkit compiles its kernels; this happens once per installation and takes a minute or two ...")
    begin = time.perf_counter()
    with compiling() as cold:
        if cold:
            with _interrupts_kept() as check, _collocation_compiled_apart() as is_done:
                _run_everything(check, is_done)
            notify(f"... compiled in {time.perf_counter() - begin:.0f} s; the cache is {FOLDER}")


@contextmanager
def _interrupts_kept() -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C while the compiler runs, which would ignore it; yields a function that raises KeyboardInterrupt."""
    noted: list[bool] = []

    def check() -> None:
        if noted:
            raise KeyboardInterrupt

    with interrupts_noted(lambda: noted.append(True)):
        yield check
        check()


@contextmanager
def _collocation_compiled_apart() -> Iterator[Callable[[], bool]]:
    """Compile the step of the collocation methods in another process; yield a function that returns whether it has
    ended.

    If that process fails, the step is not in the cache, and this process compiles it.
    """
    process: subprocess.Popen[bytes] | None = None
    if sys.executable and (os.cpu_count() or 1) > 1 and is_shared() and not JIT_DISABLED:
        code = "from mbdkit.stepping.collocation_index1 import EQUATIONS; EQUATIONS.attempt.address"
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        none = subprocess.DEVNULL
        with suppress(OSError):
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", code], stdin=none, stdout=none, stderr=none, env=environment,
                start_new_session=True,
            )  # fmt: skip
    if process is None:
        yield lambda: True
        return
    running = process
    try:
        yield lambda: running.poll() is not None
    finally:
        running.kill()
        running.wait()


def _run_everything(check: Callable[[], None], is_done: Callable[[], bool]) -> None:
    """Run a small mechanism through the kernels; the argument types of a kernel are the same for all mechanisms.

    The methods for index 2, index 3 and GGL are left out; they are compiled in the first run that uses them.

    Parameters
    ----------
    check
        Raises KeyboardInterrupt if Ctrl-C was pressed.
    is_done
        Whether the step of the collocation methods has been compiled by another process.
    """
    from mbdkit.engine.consistent_start import workspace_at_start
    from mbdkit.engine.equations_of_motion import EquationsOfMotion, call_everything
    from mbdkit.engine.kernels.observe import baumgarte_at, observe_joints
    from mbdkit.engine.observed_states import StateObserver
    from mbdkit.engine.singularity import nearest_singularity
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.methods import gauss, rk4
    from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Method, SciPySolver
    from mbdkit.stepping.interface import Timetable
    from mbdkit.stepping.start import start_method

    m = Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.55, 0.05))
    m.revolute("A", m.ground, rod, points=((0.0, 0.0), (-0.5, 0.0)))
    at_start, _ = workspace_at_start(m)
    check()
    table = Timetable(0.0, 0.2, step=0.1, steps=2, single=True)
    methods: tuple[Method, ...] = (
        ExplicitRungeKutta(rk4.tableau()),
        SciPySolver("Radau", 1e-3, 1e-3, needs_jacobian=True),
        ImplicitRungeKutta(gauss.tableau(3)),
    )
    call_everything(EquationsOfMotion(replace(at_start)), check)
    for method in methods:
        check()
        if method.traits.family == "collocation":
            nearest_singularity(at_start, 0.0, at_start.q0)
            while not is_done():
                check()
                time.sleep(0.05)
        workspace = replace(at_start)  # with arrays and a solver of its own
        baumgarte_at(workspace.engine, 0.0, workspace.q0, workspace.v0)
        stepper = start_method(method, workspace, table)
        stretch = stepper.advance()
        stepper.inside(0.5)
        stepper.within(0.5)
        observer = StateObserver(workspace)
        observed = observer.arrays(len(stretch.time))
        observer.observe(stretch.time, stretch.q, stretch.v, observed)
        observe_joints(workspace.engine, stretch.time, stretch.q, observed)
