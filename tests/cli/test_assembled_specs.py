"""`mbdkit validate SPEC --assembled FILE` writes a spec whose start is consistent, in the words of the user."""

from __future__ import annotations

import difflib
from pathlib import Path

import numpy as np
import pytest

from mbdkit.runs.findings import findings
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec

SPEC = """\
# two rods that do not meet
mbdkit: 1
parameters: {L: 0.5}          # half a length
model:
  name: mechanism
  bodies:
    a: {mass: 1, inertia: 0.1, position: [0.5, 0]}   # hangs on the ground
    b:
      # drawn from a sketch
      mass: 2
      inertia: 0.1
      position: [1.7, 0.3]
      angle: 30 deg
  joints:
    A: {type: revolute, bodies: [ground, a], points: [[0, 0], [-L, 0]]}
    B: {type: revolute, bodies: [a, b], points: [[0.5, 0], [-0.5, 0]]}
  forces:
    s: {type: spring-damper, bodies: [ground, b], from: [0, 1], to: [1.7, 0.3], stiffness: 10, free_length: 1}
time: {end: 0.2, step: 0.01}
integrator: {name: rk4}
"""


def _assembled(mbdkit, text: str, *options: str) -> tuple[str, str]:
    Path("spec.yaml").write_text(text)
    result = mbdkit("validate", "spec.yaml", "--assembled", "new.yaml", *options)
    assert result.exit_code == 0, result.output
    return Path("new.yaml").read_text(), result.stdout


def test_the_text_is_kept_and_the_start_is_consistent(mbdkit, in_tmp_path):
    new, said = _assembled(mbdkit, SPEC)
    assert "with the text of the spec" in said
    changed = [line[2:].split("#")[0] for line in difflib.ndiff(SPEC.splitlines(), new.splitlines()) if line[0] == "+"]
    assert len(changed) == 4  # a, position and angle of b, and the end of the spring in the global frame
    assert all(comment in new for comment in ("# two rods", "# half a length", "# hangs on", "# drawn from"))
    before, after = load_spec("spec.yaml"), load_spec("new.yaml")
    start = build(before)[1]
    again = build(after)[1]
    assert not again.changed
    np.testing.assert_array_equal(again.q, start.q)
    assert findings("start", before, start)
    assert not findings("start", after, again)
    old, now = (spec.mechanism().to_spec()["forces"]["s"]["points"] for spec in (before, after))
    np.testing.assert_allclose(now, old, atol=1e-12)  # the spring is attached to the same point of the body


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (SPEC, ("--set", "parameters.L=0.4")),
        (
            SPEC.replace("a: {mass", "a: &a {mass").replace("    b:\n", "    b: *a\n    c:\n").replace(", b]", ", c]"),
            (),
        ),
    ],
    ids=["set", "alias"],
)
def test_a_text_that_cannot_be_kept_is_replaced_by_the_mechanism(mbdkit, in_tmp_path, text, options):
    _, said = _assembled(mbdkit, text, *options)
    assert "with the mechanism in full" in said
    assert not findings("start", load_spec("new.yaml"), build(load_spec("new.yaml"))[1])


def test_velocities_after_assembly_are_written(mbdkit, in_tmp_path):
    """Expected: the rod turns about its end at the given angular velocity, so that its center moves at w l / 2."""
    text = SPEC[: SPEC.index("    b:\n")] + "  joints:" + SPEC[SPEC.index("  joints:") + 9 :]
    text = text.replace(SPEC[SPEC.index("    B: {") : SPEC.index("time:")], "")
    text = text.replace("position: [0.5, 0]}", "position: [0.5, 0], velocity: [0, 2.0]}")
    new, _ = _assembled(mbdkit, text)
    body = load_spec("new.yaml").mechanism().bodies["a"]
    assert body.velocity[1] == pytest.approx(0.5 * body.angular_velocity, rel=1e-12)
    assert "position: [0.5, 0]" in new


@pytest.mark.parametrize(
    ("spec", "message"), [("pendulum", "the start is consistent"), ("walking", "--assembled writes specs of runs")]
)
def test_there_may_be_nothing_to_write(mbdkit, in_tmp_path, spec, message):
    result = mbdkit("validate", spec, "--assembled", "new.yaml")
    assert result.exit_code == 2
    assert message in result.stderr
    assert not Path("new.yaml").exists()


@pytest.mark.parametrize("criterion", ["moved-start", "changed-velocities"])
def test_warnings_about_the_start_name_what_accepts_them(criterion, in_tmp_path):
    text = SPEC if criterion == "moved-start" else SPEC.replace("[1.7, 0.3]\n", "[1.5, 0]\n      velocity: [1, 5]\n")
    text = text if criterion == "moved-start" else text.replace("angle: 30 deg", "angle: 0")
    Path("spec.yaml").write_text(text)
    spec = load_spec("spec.yaml")
    found = [one for one in findings("start", spec, build(spec)[1]) if one.criterion == criterion]
    assert [f"accept: [{criterion}]" in str(one) for one in found] == [True]
