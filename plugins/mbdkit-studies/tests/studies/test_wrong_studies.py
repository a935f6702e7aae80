"""Wrong study specs, drawn ones too, end with exit status 2 and one message that names file, line and key."""

from __future__ import annotations

import copy
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbdkit.base.errors import SpecError
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.spec_texts import place

STUDY = """\
mbdkit_study: 1
base:
  model: {name: double-pendulum}
  time: {end: 1.0, step: 0.01}
overrides:
  output.every: 2
axes:
  - integrator:
      - {name: rk4}
      - {name: gauss, stages: 2}
  - time.step: [0.1, 0.05]
reference:
  integrator: {name: gauss, stages: 4}
"""


def study(old: str, new: str) -> str:
    assert old in STUDY
    return STUDY.replace(old, new)


STEPS, RK4, GAUSS = "time.step: [0.1, 0.05]", "{name: rk4}", "{name: gauss, stages: 2}"
START = "mbdkit_study: 1\nbase: pendulum\nfamilies:\n  a:\n"
WITHOUT_REFERENCE = STUDY[: STUDY.index("reference:")]


def several(entry: str, name: str = "name") -> str:
    """Return the study with an axis whose only value sets several keys."""
    return study(STEPS, f"{name}: [{{label: x, {entry}}}]")


def called(name: str) -> str:
    """Return the study with an axis of this name."""
    text = study("  - integrator:", f"  - {name}:").replace(RK4, "{label: a, set: {time.end: 1.0}}")
    return text.replace(GAUSS, "{label: b, set: {time.end: 2.0}}")


COLUMNS = """status status_reason run run_id reference steps wall_s misalignment_max family verdict file_sha256 number
    wall_median_s repeat known_until reversibility_defect"""

#: What is wrong: the spec, the line, the key, words of the message.
WRONG = {
    "unknown key": (study("axes:", "axis:"), 7, "axis", "did you mean 'axes'?"),
    "no version": (study("mbdkit_study: 1\n", ""), None, "mbdkit_study", "write `mbdkit_study: 1`"),
    "a version to come": (study("mbdkit_study: 1", "mbdkit_study: 2"), 1, "mbdkit_study", "should be 1"),
    "a run spec": (study("mbdkit_study: 1", "mbdkit: 1"), 1, "mbdkit", "`mbdkit run` runs"),
    "no base": ("mbdkit_study: 1\naxes: [{time.step: [1]}]\n", None, "base", "is missing"),
    "nothing that varies": (STUDY[: STUDY.index("axes:")], None, "", "needs `axes`"),
    "no such example": ("mbdkit_study: 1\nbase: knnee\naxes: [{time.step: [1]}]\n", 2, "base", "mean 'knee'?"),
    "axes that are no list": (study("  - integrator", "    integrator"), 11, "", "not valid YAML"),
    "an axis that is a list": (study(f"  - {STEPS}", "  - [time.step, 0.1]"), 11, "axes[1]", "should be a mapping"),
    "an axis of nothing": (study(STEPS, "{}"), 11, "axes[1]", "at least one key"),
    "a mistyped spacing": (study("[0.1, 0.05]", "{geomspce: [1]}"), 11, 'axes[1]."time.step".geomspce', "'geomspace'"),
    "different lengths": (study("0.05]", "0.05]\n    time.end: [1.0]"), 11, "axes[1]", "'time.end' has 1"),
    "a key twice": (study("0.05]", "0.2]\n  - time.step: [0.2]"), 12, 'axes[2]."time.step"', "is already in axes[1]"),
    "a key under one that comes later": (
        study("  - integrator:", "  - integrator.stages: [1]\n  - integrator:"), 9, "axes[1].integrator",
        "as 'integrator.stages'",
    ),
    "no key at all": (study("  - time.step:", "  - .step:"), 11, 'axes[1].".step"', "dotted key"),
    "a mistyped key of the run": (study("time.step: [", "time.stpe: ["), 11, 'axes[1]."time.stpe"[0]', "mean 'step'?"),
    "a value that a run refuses": (study("0.05]", "-0.05]"), 11, 'axes[1]."time.step"[1]', "not -0.05 (in run 2: rk4;"),
    "an unknown integrator": (study(RK4, "{name: rk5}"), 9, "axes[0].integrator[0].name", "did you mean 'rk4'?"),
    "an option of a labelled object": (
        study(RK4, "{label: x, value: {name: gauss, stages: 9}}"), 9, "axes[0].integrator[0].value.stages",
        "should be at most 6",
    ),
    "a mistake in the base": (study("double-pendulum", "duoble-pendulum"), 3, "base.model.name", "'double-pendulum'"),
    "a mistake in the overrides": (study("output.every", "output.evry"), 6, 'overrides."output.evry"', "mean 'every'?"),
    "no such keys": (study("output.every", "time.step.small"), 6, 'overrides."time.step.small"', "has no 'small'"),
    "a combination that a run refuses": (
        study("output.every: 2", "output: {interval: 0.1}"), 6, "overrides.output.interval", "no dense output",
    ),
    "wrong together": (study(STEPS, "time.steps: [10]"), 11, 'axes[1]."time.steps"[0]', "time: takes exactly one of"),
    "a number as reference": (f"{WITHOUT_REFERENCE}reference: 5\n", 12, "reference", "should be 'none' or a mapping"),
    "a wrong reference": (study("stages: 4", "stages: 7"), 13, "reference.integrator.stages", "the reference of run 1"),
    "a reference of another length": (
        f"{STUDY}  time.end: 2.0\n", 12, "reference", "goes from 0 s to 2 s, the run from",
    ),
    "a reference of other bodies": (
        f"{STUDY}  model: {{name: single-pendulum}}\n", 12, "reference", "has the bodies rod1",
    ),
    "an unknown measure": (f"{STUDY}measures: [end_eror]\n", 14, "measures[0]", "did you mean 'end_error'?"),
    "no reference": (f"{WITHOUT_REFERENCE}measures: [end_error]\n", 12, "measures[0]", "needs a `reference`"),
    "no repeats": (f"{STUDY}repeats: 0\n", 14, "repeats", "at least 1"),
    "several keys beside one": (
        study("[0.1, 0.05]", "[0.1, {label: x, set: {time.end: 0.1}}]"), 11, 'axes[1]."time.step"[1]',
        "a `set` beside values of 'time.step' should also set 'time.step'",
    ),
    "no key of several": (several("set: {.step: 0.1}"), 11, 'axes[1].name[0].set.".step"', "dotted key"),
    "several keys of which one is set by another axis": (
        study(STEPS, "name: [{label: x, set: {time.step: 1, integrator.name: rk4}}]\n  - time: [{}]"), 12,
        "axes[2].time", "would replace a key that is set in axes[1], as 'time.step'",
    ),
    "one name twice": (several("set: {time.step: 1}", "integrator"), 11, "axes[1].integrator", "is already in axes[0]"),
    "a mistake in several keys": (
        several("set: {time.stpe: 2}"), 11, 'axes[1].name[0].set."time.stpe"', "mean 'step'?",
    ),
    "an unknown integrator of a distribution that is installed": (
        study(RK4, "{label: x, value: {name: rk5}, if_installed: mbdkit}"), 9, "axes[0].integrator[0].value.name",
        "did you mean 'rk4'?",
    ),
    "axes beside families": (f"{STUDY}families: {{a: {{}}}}\n", 7, "axes", "give each family its own axes"),
    "a mistyped key of a family": (f"{START}    axs: []\n", 5, "families.a.axs", "did you mean 'axes'?"),
    "a mistake in a family": (
        f"{START}    axes:\n      - time.step: [0]\n", 6, 'families.a.axes[0]."time.step"[0]',
        "should be greater than 0",
    ),
    "a family without base": (
        START.replace("base: pendulum\n", "") + "    axes: []\n", 3, "families.a.base", "is missing",
    ),
    "too many runs": (study("[0.1, 0.05]", "{linspace: [0.1, 0.2, 9000]}"), 7, "axes", "makes 18000 runs"),
    **{name: (called(name), 8, f"axes[0].{name}", "is a column of the index") for name in COLUMNS.split()},
    "axes of the same name in the index": (
        study(
            f"  - {STEPS}", "  - a/b: [{label: x, set: {time.step: 0.1}}]\n  - a|b: [{label: y, set: {time.end: 2}}]",
        ),
        12, "axes[2].a|b", "'a|b' and 'a/b' would be one column",
    ),
    "a zero in a name": (
        several("set: {time.step: 0.1}", '"a\\0b"'), 11, "axes[1].a?b", r"contains the character '\x00'",
    ),
    "a zero in a label": (
        study(STEPS, 'a: [{label: "x\\0", set: {time.step: 0.1}}]'), 11, "axes[1].a[0].set",
        r"contains the character '\x00'",
    ),
    "a blank name": (several("set: {time.step: 0.1}", '"  "'), 11, 'axes[1]."  "', "is blank"),
    "a long name": (
        several("set: {time.step: 0.1}", "a" * 300), 11, f"axes[1].{'a' * 289}...", "longer than 255 bytes",
    ),
    "not finite": (study("[0.1, 0.05]", "[.nan]"), 11, 'axes[1]."time.step"[0]', "finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_study_is_refused_with_file_line_and_key(case, refusal, in_tmp_path):
    text, line, key, words = WRONG[case]
    (in_tmp_path / "spec.yaml").write_text(text)
    message = refusal("study", "spec.yaml")
    assert message.startswith(place("spec.yaml", line, key))
    assert words in message


def test_the_study_that_all_of_these_are_made_from_is_right(in_tmp_path):
    from mbdkit_studies.points.planned_points import PlannedPoints
    from mbdkit_studies.spec.study_loading import load_study_spec

    (in_tmp_path / "spec.yaml").write_text(STUDY)
    assert [point.spec.time.step for point in PlannedPoints(load_study_spec("spec.yaml"))] == [0.1, 0.05, 0.1, 0.05]


def test_a_mistake_in_the_file_of_the_base_is_placed_there(refusal, in_tmp_path):
    (in_tmp_path / "base.yaml").write_text("mbdkit: 1\nmodel:\n  name: double-pendulum\n  lenghts: [1, 1]\n")
    (in_tmp_path / "spec.yaml").write_text("mbdkit_study: 1\nbase: base.yaml\naxes: [{integrator: [{name: rk4}]}]\n")
    message = refusal("study", "spec.yaml")
    assert message.startswith("base.yaml:4: model.lenghts: unknown key (did you mean 'lengths'?)")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nonsense",), "no packaged study with this name"),
        (("convergnce",), "did you mean 'convergence'?"),
        (("spec.yaml", "--shard", "3/2"), "given as NUMBER/COUNT"),
        (("spec.yaml", "--shard", "half"), "given as NUMBER/COUNT"),
        (("spec.yaml", "-o", "missing/out"), "does not exist; create it first"),
        (("spec.yaml", "-o", "file"), "this is not a folder"),
        (("spec.yaml", "-o", "other"), "contains other files and no study.yaml"),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(arguments, words, refusal, in_tmp_path):
    (in_tmp_path / "spec.yaml").write_text(STUDY)
    (in_tmp_path / "file").write_text("precious")
    (in_tmp_path / "other").mkdir()
    (in_tmp_path / "other" / "file").write_text("precious")
    message = refusal("study", *arguments)
    assert words in message
    assert os.listdir(in_tmp_path / "other") == ["file"]


CHANGED = {
    "mbdkit_study": 1, "title": "t",
    "base": {"mbdkit": 1, "model": {"name": "double-pendulum"}, "time": {"end": 1.0, "step": 0.1}},
    "overrides": {"output.every": 2},
    "families": {
        "a": {"axes": [{"integrator": [{"name": "rk4"}, {"label": "x", "value": {"name": "gauss"}}]}], "repeats": 2},
        "b": {"axes": [{"time.step": {"geomspace": [0.1, 0.01, 3]}}], "overrides": {"integrator": {"name": "rk4"}}},
    },
    "reference": {"integrator": {"name": "gauss", "stages": 3}}, "measures": ["end_error"],
}  # fmt: skip

ODD = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.floats(), st.text(max_size=5),
    st.sampled_from(["none", "all", "knee", "gauss", "-", "a.b", "a[0]", "[0]", "time.step", "\ud800", "..", "a/b"]),
    st.lists(st.integers(0, 2), max_size=3),
    st.dictionaries(st.sampled_from(["geomspace", "label", "value", "time.step", "x[0]", "", "."]), st.just([1, 2, 3])),
)  # fmt: skip


def places(data, path=()):
    """Every key path of the study."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def attempt(study):
    """Return the ids of all runs of a study, or none and the sentence by which it is refused."""
    try:
        return [(point.run_id, point.reference_id) for point in PlannedPoints(load_study_spec(study))], ""
    except SpecError as error:
        return [], str(error)


PLACES = list(places(CHANGED))


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(PLACES), ODD, st.sampled_from(["replace", "rename", "remove", "add"]))
def test_a_changed_study_is_planned_or_refused_in_a_sentence(path, odd, how):
    study = copy.deepcopy(CHANGED)
    place = study
    for key in path[:-1]:
        place = place[key]
    if how == "replace" or isinstance(place, list):
        place[path[-1]] = odd
    elif how == "rename":
        place[str(odd)] = place.pop(path[-1])
    elif how == "remove":
        del place[path[-1]]
    else:
        place[str(odd)] = odd
    runs, refusal = attempt(study)
    assert bool(runs) != bool(refusal)
    assert "pydantic" not in refusal
