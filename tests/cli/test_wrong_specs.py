"""Wrong specs: exit status 2, one message with file, line and key, no traceback, no file left behind."""

from __future__ import annotations

import functools
import os

import pytest

from mbdkit import run as from_python
from mbdkit.base.errors import SpecError
from tests.spec_texts import SMALL, changed, mechanism, place

FREE = mechanism("""\
    crank: {mass: 1, inertia: 0.1, position: [0.5, 0]}
    rod: {mass: 1, inertia: 0.1, position: [1.5, 0]}
  joints:
    A: {type: revolute, bodies: [ground, crank], points: [[0, 0], [-0.5, 0]]}
    B: {type: revolute, bodies: [crank, rod], points: [[0.5, 0], [-0.5, 0]]}
  forces:
    m: {type: torque, body: crank, value: "0.1*cos(t)"}
""")

ENERGY = "measures: {a: final(energy.total)}"

small = functools.partial(changed, SMALL)
free = functools.partial(changed, FREE)


def spring(bodies: str, points: str) -> str:
    of = f"bodies: {bodies}, points: {points}, stiffness: 1, free_length: 0.3"
    return free("  forces:\n", f"  forces:\n    s: {{type: spring-damper, {of}}}\n")


def solved_by(integrator: str) -> str:
    return small("{name: gauss, stages: 2}", integrator)


def rods(count: int) -> str:
    return small("double-pendulum\n  masses: [1.0, 1.0]", f"n-pendulum\n  n: {count}")


def table(columns: str) -> str:
    return free('"0.1*cos(t)"', f"{{table: {columns}}}")


def driver(motion: str) -> str:
    bodies = "bodies: [ground, crank], coordinate: angle"
    return free("  forces:\n", f"    D: {{type: driver, {bodies}, motion: {motion}}}\n  forces:\n")


#: What is wrong: the spec, the line of the message (None where it names none), the key, and words of the message.
WRONG = {
    "a driver with a corner": (driver('"min(t, 0.5)"'), 12, "model.joints.D.motion", "smooth the motion"),
    "a point at 1e200 m": (
        free("points: [[0.5, 0], [-0.5, 0]]", "at: [1.0e+200, 0]"),
        4,
        "model",
        "cannot be computed in double precision",
    ),
    "a driver that wraps": (driver('"atan2(sin(7*t), cos(7*t))"'), 12, "model.joints.D.motion", "no driver can follow"),
    "a gradient by no parameter": (
        f"{SMALL}{ENERGY}\ngradients: [model.masses.0, model.mases.0]\n",
        10,
        "gradients[1]",
        "'masses'?",
    ),
    "a gradient without measures": (f"{SMALL}gradients: [model.masses.0]\n", 9, "gradients", "has no `measures`"),
    "a gradient of a misalignment": (
        f"{SMALL}measures: {{gap: max(joints.J1.misalignment)}}\ngradients: [model.masses.0]\n",
        9,
        "measures.gap",
        "has no derivative",
    ),
    "a gradient of a method of SciPy": (
        solved_by("{name: scipy-dop853}").replace("  step: 0.01\n", "") + f"{ENERGY}\ngradients: [model.masses.0]\n",
        5,
        "integrator",
        "has no derivatives",
    ),
    "unknown key below": (small("step:", "stpe:"), 8, "time.stpe", "did you mean 'step'?"),
    "recursive alias": (SMALL + "title: &a [*a]\n", 9, "title[0]", "contains the alias"),
    "code in an expression": (free("0.1*cos(t)", "__import__('os')"), 13, "model.forces.m.value", "__import__"),
    "more rods than memory": (rods(1_000_000_000), 4, "model.n", "1,000,000,000 rods need about 9,313 GiB of memory"),
}

UNMEETABLE = free(
    "  forces:", "    C: {type: distance, bodies: [ground, rod], points: [[9, 0], [0.5, 0]], length: 0.1}\n  forces:"
)


@pytest.mark.parametrize("command", ["run", "validate"])
@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_spec_is_refused_with_file_line_and_key(case, command, refusal, in_tmp_path):
    text, line, key, words = WRONG[case]
    (in_tmp_path / "spec.yaml").write_text(text)
    message = refusal(command, "spec.yaml")
    assert message.startswith(place("spec.yaml", line, key))
    assert words in message


def test_the_name_of_a_parameter_is_refused_with_its_key(mbdkit, small, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small + "parameters: {share: 0.5}\n")
    result = mbdkit("validate", "spec.yaml", "--set", "share=0.7")
    assert result.exit_code == 2
    assert "share: unknown key; the parameter of this name has the key parameters.share" in result.stderr


def test_a_wrong_choice_is_told_without_words_of_libraries(mbdkit):
    for words in (("study", "paper", "--store", "disk"), ("plugins", "new", "x", "--kind", "disk", "--json")):
        result = mbdkit(*words)
        assert result.exit_code == 2
        assert "': 'disk' is not one of '" in result.stderr
        assert "Value error" not in result.stdout + result.stderr


def test_a_driver_with_a_corner_is_valid_if_impacts_are_allowed(mbdkit, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(driver('"min(t, 0.5)"'))
    assert mbdkit("validate", "spec.yaml", "--set", "impacts=allow").exit_code == 0


@pytest.mark.parametrize("command", ["run", "validate"])
def test_joints_that_cannot_meet_are_named(command, refusal, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(UNMEETABLE)
    message = refusal(command, "spec.yaml")
    assert "C" in message


MANY_ROWS = """\
mbdkit: 1
model: {name: n-pendulum, n: 300}
integrator: {name: rk4}
time: {start: 0, end: 1.0e9, step: 1.0e-6}
limits: {max_steps: 1.0e15}
output:
  every: 2
"""


ROWS = "1,000,000,000,000,001 rows of "


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            MANY_ROWS,
            "spec.yaml:7: output.every: 500,000,000,000,001 rows of 64,944 bytes take 30,241,906,642 GiB, but ",
        ),
        (MANY_ROWS.replace("output:\n  every: 2\n", ""), f"spec.yaml: output.every: {ROWS}"),
        (
            MANY_ROWS.replace("every: 2", "interval: 1.0e-6").replace("rk4", "scipy-dop853"),
            f"spec.yaml:7: output.interval: {ROWS}",
        ),
    ],
    ids=["every other step", "every step", "interval"],
)
def test_an_archive_larger_than_the_disk_is_refused_before_the_run(text, words, refusal, in_tmp_path):
    # expected: 300 x 9 numbers of bodies, 300 x 12 of joints, 600 x 3 of constraint rows, the time in four groups and
    # on the clock, 6 energies, and 7 numbers of the steps, of 8 bytes each
    (in_tmp_path / "spec.yaml").write_text(text)
    message = refusal("run", "spec.yaml")
    assert message.startswith(words)
    assert f"free in {in_tmp_path.resolve()}: record less often, such as " in message


def test_a_run_larger_than_memory_is_refused_before_it(in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(MANY_ROWS)
    with pytest.raises(SpecError, match=r"output\.every: 500,000,000,000,001 rows .* are available in memory: "):
        from_python("spec.yaml")


@pytest.mark.parametrize("name", ["missing.yaml", "pendulm", "folder", "archive.h5"])
def test_a_source_that_is_no_spec_is_refused(name, refusal, in_tmp_path):
    (in_tmp_path / "folder").mkdir()
    (in_tmp_path / "archive.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    message = refusal("run", name, "-o", "out.h5")
    assert message.startswith(f"{name}: ")
    assert refusal("run", name) == message  # also where the archive would be named like the source


def test_an_empty_name_of_a_spec_is_refused(refusal, in_tmp_path):
    assert refusal("run", "").startswith("the name of the spec is empty: give a file or an example")


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("there.h5", "--overwrite"),
        ("folder", "name a file in it, such as folder/results.h5"),
        ("/dev/null", "this is not a regular file and is not replaced"),
        ("missing/out.h5", "does not exist"),
        ("spec.yaml", "this file is the input, which is not overwritten"),
        ("out.yaml", ".h5"),
        ("spec.yaml/out.h5", "not a folder"),
    ],
)
def test_an_output_that_cannot_be_is_refused_before_any_work(output, words, refusal, in_tmp_path):
    (in_tmp_path / "there.h5").write_bytes(b"precious")
    (in_tmp_path / "folder").mkdir()
    (in_tmp_path / "spec.yaml").write_text(SMALL)
    message = refusal("run", "spec.yaml", "-o", output)
    assert words in message
    assert (in_tmp_path / "there.h5").read_bytes() == b"precious"


def test_stdin_is_named_in_messages(refusal, in_tmp_path):
    assert refusal("run", "-", stdin=small("step:", "stpe:")).startswith("<stdin>:8: time.stpe: ")


def test_a_process_of_its_own_says_the_same(mbdkit_process, in_tmp_path):
    text, line, key, words = WRONG["unknown key below"]
    (in_tmp_path / "spec.yaml").write_text(text)
    result = mbdkit_process("run", "spec.yaml")
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"error: spec.yaml:{line}: {key}: ")
    assert words in result.stderr
    assert "Traceback" not in result.stderr
    assert os.listdir(in_tmp_path) == ["spec.yaml"]


def test_debug_shows_the_traceback(mbdkit_process, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(small("step:", "stpe:"))
    result = mbdkit_process("--debug", "run", "spec.yaml")
    assert result.returncode == 2
    assert "Traceback" in result.stderr
    assert "SpecError" in result.stderr
