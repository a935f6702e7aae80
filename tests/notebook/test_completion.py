"""Names complete on Tab, as IPython's own completer sees them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

import mbdkit

completer = pytest.importorskip("IPython.core.completer", reason="completion is tested with IPython")


@pytest.fixture(scope="module")
def complete() -> Iterator[Callable[[str, object], set[str]]]:
    """Return the completions of a line in which `it` is an object."""
    from IPython.core.interactiveshell import InteractiveShell

    shell = InteractiveShell()

    def completions(line: str, it: object) -> set[str]:
        shell.user_ns["it"] = it
        with completer.provisionalcompleter():
            return {found.text for found in shell.Completer.completions(line, len(line))}

    yield completions
    shell.history_manager.end_session()


@pytest.mark.parametrize("group", ["bodies", "joints", "forces", "constraints"])
def test_names_of_a_run_complete(group: str, knee: mbdkit.Run, complete: Callable[[str, object], set[str]]) -> None:
    names = set(getattr(knee, group))
    assert len(names) > 1
    assert complete(f'it.{group}["', knee) == names


def test_a_run_completes_its_bodies(knee: mbdkit.Run, complete: Callable[[str, object], set[str]]) -> None:
    assert complete('it["', knee) == {"acl", "pcl", "shank"}


def test_markers_complete(complete: Callable[[str, object], set[str]]) -> None:
    m = mbdkit.Mechanism()
    foot = m.body("foot", mass=1.0, inertia=0.1)
    m.marker("toe", foot, point=(0.1, 0.0))
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.05}) as run:
        assert complete('it.markers["', run) == {"toe"}


def test_bodies_of_an_equilibrium_complete(complete: Callable[[str, object], set[str]]) -> None:
    assert complete('it["', mbdkit.equilibrium("knee")) == {"acl", "pcl", "shank"}


def test_energies_and_plots_complete(knee: mbdkit.Run, complete: Callable[[str, object], set[str]]) -> None:
    assert {"kinetic", "potential", "total", "work"} <= complete("it.energy.", knee)
    assert {"reactions", "torques", "drift"} <= complete("it.plot.", knee)


def test_kinds_of_history_complete(knee: mbdkit.Run, complete: Callable[[str, object], set[str]]) -> None:
    assert {"reaction_force", "misalignment"} <= complete("it.", knee.joints["A"])
