"""The script of the guide that is mbdkit in small does what mbdkit does."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import mbdkit
from mbdkit.guide.pages import pages
from tests.first_party import PARTS
from tests.printed_code import fenced_blocks

LENGTHS, MASSES, ANGLES = [1.0, 0.7], [1.0, 2.0], [0.3, -0.8]


def mini() -> SimpleNamespace:
    code = next(block.code for block in fenced_blocks(pages()["mini"].text) if block.saved_as == "mini.py")
    assert code.count("\n") <= 300
    names: dict[str, object] = {"__name__": "mini"}
    exec(compile(code, "mini.py", "exec", dont_inherit=True), names)
    return SimpleNamespace(**names)


@pytest.mark.parametrize(
    ("tableau", "integrator"),
    [("RK4", {"name": "rk4"}), ("RK_GILL", {"name": "rk-gill"}), ("GAUSS2", {"name": "gauss", "stages": 2})],
)
def test_states_misalignment_and_forces_of_the_mini_agree_with_mbdkit(tableau, integrator):
    small = mini()
    rods = [small.Rod(m, length, angle) for m, length, angle in zip(MASSES, LENGTHS, ANGLES, strict=True)]
    states, gaps, forces = small.simulate(rods, getattr(small, tableau), 0.5, 0.01)
    model = {"name": "double-pendulum", "lengths": LENGTHS, "masses": MASSES, "angles": ANGLES}
    run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 0.5, "step": 0.01}})
    for k, rod in enumerate(("rod1", "rod2")):
        expected = np.column_stack([states[:, 3 * k : 3 * k + 2], states[:, 3 * k + 2]])
        np.testing.assert_allclose(np.column_stack([run[rod].position, run[rod].angle]), expected, rtol=0, atol=1e-10)
        joint = run.joints[f"J{k + 1}"]
        np.testing.assert_allclose(joint.misalignment, gaps[:, k], rtol=0, atol=1e-11)
        np.testing.assert_allclose(joint.reaction_force, forces[:, k], rtol=1e-8, atol=1e-8)
    assert gaps.max() > 1e-10  # otherwise this would compare zeros


@pytest.mark.skipif(not PARTS, reason="the page names files of parts too")
def test_the_page_names_files_that_exist():
    folder = Path(mbdkit.__file__).parent
    table = pages()["mini"].text.partition("## The same in mbdkit")[2]
    names = [name for name in table.split("`")[1::2] if name.endswith((".py", "/")) or "/" in name]
    assert names
    missing = [name for name in names if not (folder / name).exists() and not (folder.parent / name).exists()]
    assert not missing
