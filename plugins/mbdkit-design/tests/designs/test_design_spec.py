"""Wrong design specs are refused with file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from mbdkit import SpecError
from mbdkit.cli import app
from mbdkit.spec import load_spec
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.evaluation import Evaluator, ScenarioRuns
from mbdkit_studies.spec.study_loading import load_study_spec

TEXT = """mbdkit_design: 1
base:
  mbdkit: 1
  parameters: {long: 1.5}
  model: {name: single-pendulum, length: long}
  integrator: {name: rk4}
  time: {end: 1.0, step: 0.01}
variables:
  long: {bounds: [1.0, 2.0]}
  model.mass: {bounds: [0.5, 2.0], start: 1.0}
minimize: max(abs(J1.force))
subject_to:
  height: {value: "max(rod1.y)", max: 0.1}
optimizer: {name: slsqp}
"""


def written(folder: Path, text: str) -> str:
    file = folder / "design.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


def test_variables_are_parameters_or_keys(tmp_path: Path) -> None:
    spec = load_design_spec(written(tmp_path, TEXT), ["optimizer.starts=4"])
    assert spec.specs[""].mechanism().bodies["rod1"].mass == 1.0
    assert spec.specs[""].numbers == {"long": 1.5}
    assert spec.optimizer.starts == 4
    assert list(spec.specs[""].measures) == ["goal", "height"]
    Evaluator(spec)


def test_a_variable_may_be_an_item_of_a_list_that_the_base_leaves_at_its_default(tmp_path: Path) -> None:
    text = TEXT.replace(
        "model.mass: {bounds: [0.5, 2.0], start: 1.0}", "model.gravity.1: {bounds: [-9, -1], start: -3}"
    )
    spec = load_design_spec(written(tmp_path, text))
    assert spec.specs[""].mechanism().gravity == (0.0, -3.0)
    at = ScenarioRuns(spec.specs[""]).at
    assert [at([(("model", "gravity", "1"), y)]).mechanism().gravity for y in (-2.0, -1.0)] == [
        (0.0, -2.0),
        (0.0, -1.0),
    ]


WRONG = {
    "unknown key": ("minimize:", "minimise:", 11, "minimise", "did you mean 'minimize'?"),
    "no variable": ("variables:\n  long: {bounds: [1.0, 2.0]}\n  model.mass: {bounds: [0.5, 2.0], start: 1.0}\n",
                    "variables: {}\n", 8, "variables", "needs at least one variable"),
    "bounds reversed": ("[1.0, 2.0]", "[2.0, 1.0]", 9, "variables.long.bounds", "should be less than the upper bound"),
    "start outside": ("start: 1.0", "start: 3.0", 10, 'variables."model.mass".start', "within the bounds 0.5 and 2"),
    "unknown parameter": ("  long: {b", "  lang: {b", 9, "variables.lang", "the base has no parameter 'lang' (did you"),
    "unknown option": ("model.mass", "model.mas", 10, 'variables."model.mas"', "did you mean 'mass'?"),
    "unknown list": ("model.mass", "model.gravty.1", 10, 'variables."model.gravty.1"', "did you mean 'gravity'?"),
    "unknown element": ("model.mass", "model.forces.s.stiffness", 10, 'variables."model.forces.s.stiffness"',
                        "the base has no 'model.forces'"),
    "value refused": ("[0.5, 2.0], start: 1.0", "[-2.0, 2.0], start: -1.0", 10, 'variables."model.mass"', "greater"),
    "goal of nothing": ("max(abs(J1.force))", "max(abs(J7.force))", 11, "minimize", "J7"),
    "limit of nothing": ("max(rod1.y)", "max(rod7.y)", 13, "subject_to.height", "rod7"),
    "limit without a number": (", max: 0.1}", "}", 13, "subject_to.height.max", "give `max`, `min` or both"),
    "four goals": ("max(abs(J1.force))", "{a: final(rod1.y), b: final(rod1.x), c: final(rod1.vx), d: final(rod1.vy)}",
                   11, "minimize", "has 4 goals"),
    "unknown optimizer": ("slsqp", "slspq", 14, "optimizer.name", "slsqp"),
    "wrong base": ("{name: rk4}", "{name: rk5}", 6, "base.integrator.name", "rk4"),
    "no base": (TEXT[TEXT.index("base:"):TEXT.index("variables:")], "", None, "base", "is missing"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_design_is_refused_with_line_and_key(case: str, tmp_path: Path) -> None:
    old, new, line, key, words = WRONG[case]
    assert old in TEXT
    with pytest.raises(SpecError) as caught:
        Evaluator(load_design_spec(written(tmp_path, TEXT.replace(old, new))))
    place = "design.yaml:" if line is None else f"design.yaml:{line}: {key}"
    assert place in str(caught.value)
    assert key in str(caught.value)
    assert words in str(caught.value)


LIMITS = {
    "number": ("max(rod1.angle)", "70", True), "below a turn": ("max(rod1.angle)", "6", False),
    "degrees": ("max(rod1.angle)", "70 deg", False), "radians": ("max(rod1.angle)", "70 rad", False),
    "converted measure": ("max(rod1.angle)*180/pi", "70", False),
    "no angle": ("max(rod1.angular_velocity)", "70", False),
}  # fmt: skip


@pytest.mark.parametrize(("measure", "most", "warns"), LIMITS.values(), ids=LIMITS)
def test_limits_of_angles_above_a_turn_are_probably_degrees(
    measure: str, most: str, warns: bool, tmp_path: Path
) -> None:
    file = written(tmp_path, TEXT.replace('"max(rod1.y)", max: 0.1', f'"{measure}", max: {most}'))
    told = CliRunner().invoke(app, ["validate", file], prog_name="mbdkit").stderr
    advice = "warning: the angle of 70 rad at subject_to.height.max is more than a full rotation; if degrees are "
    assert told.startswith(f"{advice}intended, write `max: 70 deg`") == warns
    assert ("rotation" in told) == warns


def test_a_base_in_a_file_is_blamed_at_its_own_line(tmp_path: Path) -> None:
    (tmp_path / "pendulum.yaml").write_text(
        "mbdkit: 1\nmodel: {name: single-pendulum}\nintegrator: {name: rk5}\ntime: {end: 1, step: 0.1}\n"
    )
    text = "mbdkit_design: 1\nbase: pendulum.yaml\nvariables: {model.mass: {bounds: [1, 2]}}\nminimize: final(rod1.y)\n"
    with pytest.raises(SpecError, match=r"pendulum\.yaml:3: integrator"):
        load_design_spec(written(tmp_path, text))
    with pytest.raises(SpecError, match=r"design\.yaml:2: base: there is no file 'nowhere' in the folder of the"):
        load_design_spec(written(tmp_path, text.replace("pendulum.yaml", "nowhere")))


def test_each_kind_of_spec_names_the_command_of_another(tmp_path: Path) -> None:
    file = written(tmp_path, TEXT)
    with pytest.raises(SpecError, match=r"design\.yaml:1: mbdkit_design: this is a design spec, which `mbdkit design`"):
        load_spec(file)
    with pytest.raises(SpecError, match=r"run\.yaml:3: integrator: this is the spec of a run"):
        load_design_spec(run_spec(tmp_path))
    with pytest.raises(SpecError, match="mbdkit_design"):
        load_study_spec(file)


def run_spec(folder: Path) -> str:
    file = folder / "run.yaml"
    file.write_text("mbdkit: 1\nmodel: {name: single-pendulum}\nintegrator: {name: rk4}\ntime: {end: 1, step: 0.1}\n")
    return str(file)


def test_scenarios_whose_archives_would_be_one_file_are_refused(tmp_path: Path) -> None:
    """On file systems that ignore case, which Windows and macOS use by default."""
    scenarios = "".join(f"  {name}: {{base: knee}}\n" for name in ("walk", "Walk"))
    with pytest.raises(SpecError, match="scenarios: 'walk' and 'Walk' differ in case only"):
        load_design_spec(written(tmp_path, f"{TEXT}scenarios:\n{scenarios}"))


def test_too_many_scenarios_are_refused_before_their_specs_are_read(tmp_path: Path) -> None:
    scenarios = "".join(f"  s{number}: {{base: no-such-example}}\n" for number in range(1001))
    with pytest.raises(SpecError, match=r"scenarios: has 1001 scenarios; a design has at most 1000"):
        load_design_spec(written(tmp_path, f"{TEXT}scenarios:\n{scenarios}"))
