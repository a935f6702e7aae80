"""Studies with measures of their own: columns and units, refusals before the first run, plugins, and the guide."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from pydantic import BaseModel

import mbdkit
from mbdkit import SpecError
from mbdkit.measures.measured_quantities import ATTRIBUTES
from mbdkit.measures.take import SpecMeasure
from mbdkit.registry.catalogue import Origin, Registered, Registry
from mbdkit.registry.item_options import named_options
from mbdkit.spec import load_spec
from mbdkit.spec.reading import read_text
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit_studies.compute.study_plan import plan_study
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_testing import verify
from tests.installing import install_module, python

FALL: dict[str, Any] = {
    "mbdkit_study": 1,
    "base": {
        "model": {"name": "mechanism", "bodies": {"ball": {"mass": 1.0, "position": [0.0, 0.0]}}, "joints": {}},
        "integrator": {"name": "rk4"},
        "time": {"end": 1.0, "step": 0.1},
    },
    "axes": [{"model.gravity": [[0.0, -1.0], [0.0, -4.0]]}],
    "measures": {"depth": {"value": "-final(ball.y)", "unit": "mm"}, "a_speed": "max(abs(ball.velocity))"},
}


@pytest.fixture(scope="module")
def fallen(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """The study of two falls."""
    return mbdkit.study(FALL, out=tmp_path_factory.mktemp("studies") / "falls")


def test_the_columns_hold_the_values_of_the_closed_form(fallen: mbdkit.Study) -> None:
    frame = fallen.to_frame()
    assert list(frame["depth"]) == pytest.approx([500.0, 2000.0])
    assert list(frame["a_speed"]) == pytest.approx([1.0, 4.0])
    assert "misalignment_max" in frame  # a mapping comes in addition to the built-in measures


def test_units_stand_in_the_index_the_frame_and_the_dataset(fallen: mbdkit.Study) -> None:
    with h5py.File(fallen.folder / "index.h5") as file:
        column = file["runs/depth"]
        assert (column.attrs["units"], column.attrs["long_name"]) == ("mm", "-final(ball.y)")
        assert list(column[:]) == pytest.approx([500.0, 2000.0])
    assert fallen.to_frame().attrs["units"]["depth"] == "mm"
    assert fallen.to_xarray()["a_speed"].attrs["units"] == "m/s"
    assert [(name, column.units) for name, column in fallen.measures.items()] == [("depth", "mm"), ("a_speed", "m/s")]


def test_a_list_takes_only_what_it_contains(tmp_path: Path) -> None:
    chosen = mbdkit.study(FALL | {"measures": ["duration", {"depth": "-final(ball.y)"}]}, out=tmp_path / "s")
    values = chosen.points[0].values
    assert (values["duration"], values["depth"]) == pytest.approx((1.0, 0.5))
    assert "misalignment_max" not in values


REFUSED: dict[str, tuple[Any, str, str]] = {
    "an unknown body": ({"a": "final(bal.x)"}, "measures.a", "there is no body or joint 'bal' (did you mean 'ball'?)"),
    "a unit of another quantity": ({"a": {"value": "final(ball.x)", "unit": "N"}}, "measures.a.unit", "the unit m"),
    "no unit": ({"a": {"value": "final(ball.x)", "unit": "metre"}}, "measures.a.unit", "not a known unit"),
    "a misspelled key": ({"a": {"value": "final(ball.x)", "units": "m"}}, "measures.a.units", "did you mean 'unit'"),
    "a number": ({"a": 3}, "measures.a", "should be an expression such as"),
    "a column": ({"status": "final(ball.x)"}, "measures.status", "is a column of the index of every study"),
    "a built-in one": ({"duration": "final(t)"}, "measures.duration", "is a built-in measure"),
    "a name with a blank": ({"a b": "final(t)"}, "measures.a b", "letters, digits"),
    "the same name twice": ([{"a": "final(t)"}, {"a": "final(t)"}], "measures[1].a", "defined twice"),
    "an axis": ({"model.gravity": "final(t)"}, 'measures."model.gravity"', "is also a measure"),
    "an unknown plugin": ({"a": {"name": "jump"}}, "measures.a", "there is no measure 'jump'"),
    "a built-in name": ({"a": {"name": "duration"}}, "measures.a", "selected by its name alone"),
    "neither": ("some", "measures", "should be 'all', a list of measures, or a mapping"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_refused_before_the_first_run(case: str, tmp_path: Path) -> None:
    measures, key, message = REFUSED[case]
    with pytest.raises(SpecError) as error:
        mbdkit.study(FALL | {"measures": measures}, out=tmp_path / "s")
    assert error.value.key == key
    assert message in error.value.message
    assert not (tmp_path / "s").exists()


def test_a_measure_has_one_unit_in_all_runs(tmp_path: Path) -> None:
    slide = {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "x", "motion": "t"}
    turn = slide | {"coordinate": "angle"}
    base = FALL["base"] | {"model": {"name": "mechanism", "bodies": {"rod": {"mass": 1.0, "inertia": 1.0}}}}
    given = FALL | {"base": base, "axes": [{"model.joints.D": [turn, slide]}], "measures": {"a": "max(joints.D.angle)"}}
    with pytest.raises(SpecError, match=r"its unit is rad in run 1 and m in run 2; a column of the index has one unit"):
        mbdkit.study(given, out=tmp_path / "s")


PLUGIN = '''
import numpy as np
from pydantic import BaseModel, ConfigDict

import mbdkit


class DropOptions(BaseModel):
    model_config = ConfigDict(use_attribute_docstrings=True)

    body: str = "ball"
    """Body to follow."""


def drop(run, options):
    height = run[options.body].position[:, 1]
    return np.float64(height[0] - height[-1])


def broken(run, options):
    return helper(run)


def helper(run):
    return {}["nothing"]


@mbdkit.hookimpl
def mbdkit_measures():
    return [
        mbdkit.MeasurePlugin("drop", "Height lost by a body", DropOptions, "m", drop),
        mbdkit.MeasurePlugin("broken", "Fails", BaseModel, "m", broken),
        mbdkit.MeasurePlugin("wordy", "No number", BaseModel, "m", lambda run, options: "much"),
        mbdkit.MeasurePlugin("unknown-unit", "Has no unit", BaseModel, "metres", drop),
    ]
'''


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a distribution that offers measures."""
    folder = tmp_path_factory.mktemp("site")
    install_module(folder, "acme-measures", PLUGIN)
    return folder


def study_of(folder: Path, measures: Any, site: Path) -> Any:
    """Run a study with these measures in a process that sees the plugin."""
    (folder / "s.json").write_text(json.dumps(FALL | {"measures": measures}))
    return python("-m", "mbdkit", "study", "s.json", "-o", "s", "--workers", "1", path=(site,), cwd=folder)


def test_a_plugin_registers_a_measure_by_name(site: Path, tmp_path: Path) -> None:
    done = study_of(tmp_path, ["drop", {"fall": {"name": "acme-measures:drop", "body": "ball"}}], site)
    assert done.returncode == 0, done.stderr
    assert "'acme-measures:unknown-unit' was not loaded: its units: 'metres' is not a known unit" in done.stderr
    with h5py.File(tmp_path / "s" / "index.h5") as file:
        assert np.array_equal(file["runs/drop"], file["runs/fall"])
        assert list(file["runs/drop"]) == pytest.approx([0.5, 2.0])
        assert file["runs/drop"].attrs["units"] == "m"


def test_a_measure_of_a_plugin_has_no_error_and_says_so(site: Path, tmp_path: Path) -> None:
    base = {"mbdkit": 1} | FALL["base"] | {"measures": {"fall": {"name": "drop", "body": "ball"}}, "check": True}
    (tmp_path / "s.json").write_text(json.dumps(base | {"time": {"end": 0.1, "step": 0.01}}))
    done = python("-m", "mbdkit", "run", "s.json", path=(site,), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "m (its error is unknown: errors of measures of plugins are not estimated)" in done.stdout


def test_a_measure_that_fails_is_told_with_its_line(site: Path, tmp_path: Path) -> None:
    done = study_of(tmp_path, ["broken"], site)
    assert done.returncode == 4
    line = PLUGIN.splitlines().index('    return {}["nothing"]') + 1
    assert "measure acme-measures:broken failed for run " in done.stderr
    assert f"KeyError: 'nothing' ({site / 'acme_measures.py'}, line {line})" in done.stderr
    assert len(list((tmp_path / "s" / "runs").glob("*.h5"))) == 2  # the runs are not lost


def test_options_of_a_measure_are_checked_before_the_first_run(site: Path, tmp_path: Path) -> None:
    done = study_of(tmp_path, {"a": {"name": "drop", "boddy": "ball"}}, site)
    assert done.returncode == 2
    assert "measures.a.boddy: unknown key (did you mean 'body'?)" in done.stderr
    assert not (tmp_path / "s").exists()


def test_what_is_not_a_number_is_the_fault_of_the_plugin(fallen: mbdkit.Study) -> None:
    plugin = mbdkit.MeasurePlugin("wordy", "No number", BaseModel, "m", lambda run, options: "much")
    item = Registered("measure", plugin, Origin("acme", "1.0", "main = acme"))
    installed = Registry([item])
    assert verify("measure", "wordy", installed=installed)["measure.value"].outcome == "fail"
    point = fallen.points[0]
    with fallen.run(point) as run, pytest.raises(mbdkit.PluginError, match="acme:wordy returned an object of type str"):
        SpecMeasure(DefinedMeasure("a", ("a",), item=item, options=named_options(item)(name="wordy")), point.spec).take(
            run
        )


def of_base(**sections: Any) -> dict[str, Any]:
    """Return a study of falls with the measures in its base."""
    study = copy.deepcopy(FALL)
    study["base"]["measures"] = study.pop("measures")
    return study | sections


@pytest.mark.parametrize("store", ["files", "all", "histories", "summary", "hashes"])
def test_measures_of_the_base_are_columns_and_values_of_its_runs(store: Any, tmp_path: Path) -> None:
    study = mbdkit.study(of_base(), out=tmp_path / "falls", store=store)
    frame = study.to_frame()
    assert list(frame["depth"]) == pytest.approx([500.0, 2000.0])
    assert {name: one.units for name, one in study.measures.items()} == {"depth": "mm", "a_speed": "m/s"}
    run = study.run(study.points[1])
    assert run is not None
    assert run.measures == {"depth": frame["depth"][1], "a_speed": frame["a_speed"][1]}
    assert run.measures.units == {"depth": "mm", "a_speed": "m/s"}
    if store in ("files", "all", "histories"):
        assert "measures      depth 2000 mm\n" in run.summary()
    if store == "all":
        run.save(tmp_path / "run.h5")
        assert mbdkit.load(tmp_path / "run.h5").measures == run.measures


def test_a_measure_of_one_base_is_not_taken_of_the_runs_of_another(tmp_path: Path) -> None:
    families = {
        "falls": {"axes": [{"model.gravity": [[0.0, -1.0]]}]},
        "swings": {"base": "pendulum", "overrides": {"time.end": 0.1}, "axes": [{"time.step": [0.01]}]},
    }
    study = of_base(families=families)
    del study["axes"]
    for store in ("files", "hashes"):
        found = mbdkit.study(study, out=tmp_path / store, store=store)
        assert list(found.to_frame()["depth"]) == pytest.approx([500.0, np.nan], nan_ok=True)


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"measures": {"depth": "final(ball.y)"}}, "base.measures.depth: 'depth' is defined differently in measures"),
        ({"overrides": {"measures.depth": "final(bal.y)"}}, "overrides.measures.depth: there is no body or joint"),
        ({"axes": [{"measures.depth": ["a", "b"]}]}, 'axes[0]."measures.depth"[0]: a measure is a column of the study'),
        ({"base": {**FALL["base"], "measures": {"x": 3}}}, "base.measures.x: should be an expression such as"),
    ],
)
@pytest.mark.parametrize("store", ["files", "summary"])
def test_wrong_measures_of_a_base_are_refused_where_they_stand(
    sections: dict[str, Any], message: str, store: Any, tmp_path: Path
) -> None:
    with pytest.raises(SpecError) as caught:
        mbdkit.study(of_base(**sections), out=tmp_path / "falls", store=store)
    assert message in str(caught.value)
    assert not (tmp_path / "falls").exists()


GUIDE = (Path(mbdkit.__file__).parent / "guide" / "measures.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", GUIDE, flags=re.MULTILINE | re.DOTALL)


def test_the_study_is_valid_and_has_the_units_that_it_says() -> None:
    text, _ = (text for language, text in BLOCKS if language == "yaml")
    plan = plan_study(load_study_spec(read_text(text, "guide").data))
    units = {name: column.units for name, column in plan.defined.items()}
    assert units == {"peak_B": "N", "mean_B": "kN", "bend": "deg", "spring_work": "J"}


def test_the_measures_of_beams_are_valid() -> None:
    _, text = (text for language, text in BLOCKS if language == "yaml")
    spec = load_spec("leaf-spring", measures=read_text(text, "guide").data["measures"])
    units = {one.name: SpecMeasure(one, spec).describe()[0] for one in spec.defined_measures()}
    assert units == {
        "largest_moment": "N m", "stress_in_the_middle": "MPa", "stress_at_the_clamp": "MPa",
        "moment_at_the_end": "N m", "moment_near_a": "N m", "moment_at_a": "N m",
    }  # fmt: skip


def test_every_quantity_is_listed() -> None:
    for kind, names in ATTRIBUTES.items():
        row = next(line for line in GUIDE.splitlines() if line.startswith(f"| `{kind}"))
        missing = [name for name in names if f"`{name}`" not in row and not re.match(r"force_\w*[xy]$", name)]
        assert missing == []
