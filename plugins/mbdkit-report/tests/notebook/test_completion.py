"""Names complete on Tab, as IPython's own completer sees them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

import mbdkit

pytestmark = pytest.mark.end_to_end

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


def test_names_of_a_run_complete(knee: mbdkit.Run, complete: Callable[[str, object], set[str]]) -> None:
    for group in ("bodies", "joints", "forces", "constraints", "stats", "provenance"):
        names = set(getattr(knee, group))
        assert len(names) > 1
        assert complete(f'it.{group}["', knee) == names
    assert complete('it["', knee) == {"acl", "pcl", "shank"}


def test_markers_complete(complete: Callable[[str, object], set[str]]) -> None:
    m = mbdkit.Mechanism()
    foot = m.body("foot", mass=1.0, inertia=0.1)
    m.marker("toe", foot, point=(0.1, 0.0))
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.05}) as run:
        assert complete('it.markers["', run) == {"toe"}


def test_bodies_of_an_equilibrium_complete(complete: Callable[[str, object], set[str]]) -> None:
    assert complete('it["', mbdkit.equilibrium("knee")) == {"acl", "pcl", "shank"}


def test_histories_energies_and_plots_complete(knee: mbdkit.Run, complete: Callable[[str, object], set[str]]) -> None:
    for line, names in {
        "it.energy.": {"kinetic", "potential", "total", "work"},
        "it.plot.": {"reactions", "torques", "drift"},
        'it.joints["A"].': {"reaction_force", "misalignment", "angle"},
        'it.bodies["shank"].': {"position", "angular_velocity"},
        f'it.forces["{next(iter(knee.forces))}"].': {"value", "power"},
    }.items():
        assert names <= complete(line, knee)
    assert {"reaction_force", "misalignment"} <= complete("it.", knee.joints["A"])
