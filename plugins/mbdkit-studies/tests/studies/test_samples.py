"""Studies with samples: reproducible members, values in specs and index, sensitivities, errors, quantiles over time."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
from tests.analysis.ishigami import FIRST, TOTAL, ishigami

import mbdkit
from mbdkit import MbdkitError, RunSpec, SpecError
from mbdkit.spec.reading import read_file
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_studies.compute.study_plan import plan_study
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.points import sampled_values as module
from mbdkit_studies.points.sampled_values import sampled_values
from mbdkit_studies.report.study_headlines import headlines
from mbdkit_studies.results.study_notes import notes
from mbdkit_studies.spec.sample_section import Sample
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.statistics.sobol_indices import sensitivity, sobol_indices
from tests import identified
from tests.identified import COVARIANCE, STIFFNESS, sliding, write_fit
from tests.margins import assert_within
from tests.runs.oscillator import oscillator

BODY = {"mass": 1.0, "inertia": 1.0, "position": [0.0, 0.0], "angle": 0.0}
SPEED, MASS = "model.bodies.ball.velocity.0", "model.bodies.ball.mass"


def base(end: float, **bodies: Any) -> dict[str, Any]:
    """Return a run spec of bodies that nothing acts on."""
    model = {"name": "mechanism", "gravity": [0.0, 0.0], "bodies": bodies, "joints": {}}
    return {"model": model, "integrator": {"name": "rk4"}, "time": {"end": end, "step": 0.1}}


THROW: dict[str, Any] = {
    "mbdkit_study": 1,
    "base": base(0.4, ball=BODY | {"velocity": [0.0, 0.0]}),
    "sample": {
        "n": 16, "seed": 3, "variables": {SPEED: {"uniform": [1, 3]}, MASS: {"lognorm": {"s": 0.2, "scale": 2.0}}},
    },
    "measures": {"distance": "final(ball.x)", "work": "max(energy.kinetic)"},
}  # fmt: skip


@pytest.fixture
def throw() -> dict[str, Any]:
    """A study of 16 throws with random speed and mass, for a test to change."""
    return copy.deepcopy(THROW)


@pytest.fixture(scope="module")
def thrown(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """The study of throws, run; not to be changed."""
    return mbdkit.study(THROW, out=tmp_path_factory.mktemp("samples") / "throws")


def _sample(**keys: Any) -> Sample:
    return Sample(**({"n": 64, "seed": 1, "variables": {"a": {"uniform": [0, 1]}, "b": {"norm": []}}} | keys))


def _values(**keys: Any) -> np.ndarray:
    return np.array(list(sampled_values(_sample(**keys)).values()))


@pytest.mark.parametrize("method", ["sobol", "halton", "random"])
@pytest.mark.parametrize("design", ["plain", "saltelli"])
def test_a_larger_sample_keeps_the_members_of_a_smaller_one(method: str, design: str) -> None:
    few, many = (_values(n=n, method=method, design=design) for n in (11, 50))
    assert np.array_equal(few, many[:, : few.shape[1]])


@pytest.mark.parametrize("method", ["sobol", "halton", "latin-hypercube", "random"])
def test_the_seed_alone_decides_the_values(method: str) -> None:
    assert np.array_equal(_values(method=method), _values(method=method))
    assert not np.any(_values(method=method) == _values(method=method, seed=2))


@pytest.mark.parametrize("method", ["sobol", "halton", "latin-hypercube", "random"])
def test_values_have_the_distributions_of_scipy(method: str) -> None:
    variables = {"a": {"triang": [0.3, 1, 2]}, "b": {"truncnorm": [-1, 3, 5, 2]}}
    found = sampled_values(_sample(n=1024, method=method, variables=variables))
    wanted = {"a": scipy.stats.triang(0.3, 1, 2), "b": scipy.stats.truncnorm(-1, 3, 5, 2)}
    for values, expected in ((found[name], wanted[name]) for name in "ab"):
        test = scipy.stats.kstest(values, expected.cdf)
        # One value in each of n classes, of equal probability, has at most 1/n.
        assert test.pvalue > 1e-3 if method in ("random", "halton") else test.statistic <= 1.001 / 1024


def test_the_runs_of_a_saltelli_design_mix_two_points() -> None:
    runs = _values(n=8, design="saltelli").T.reshape(8, 4, 2)
    first, second = runs[:, 0], runs[:, 1]
    assert np.array_equal(runs[:, 2], np.stack([second[:, 0], first[:, 1]], axis=1))
    assert np.array_equal(runs[:, 3], np.stack([first[:, 0], second[:, 1]], axis=1))
    assert len(np.unique(runs[:, :2, 0])) == 16


def test_values_stand_in_specs_and_index_as_plain_floats(thrown: mbdkit.Study) -> None:
    expected = sampled_values(Sample(**THROW["sample"]))
    frame = thrown.to_frame()
    assert np.array_equal(frame[SPEED], expected[SPEED])
    assert np.array_equal(frame[MASS], expected[MASS])
    assert frame["distance"].to_numpy() == pytest.approx(0.4 * expected[SPEED])
    assert frame["work"].to_numpy() == pytest.approx(expected[MASS] * expected[SPEED] ** 2 / 2)
    run = thrown.run(5)
    assert run is not None
    speed = run.spec["model"]["bodies"]["ball"]["velocity"][0]
    assert type(speed) is float
    assert speed == expected[SPEED][5]
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256
    assert thrown.remake(5).data_sha256 == run.data_sha256
    assert list(thrown.select(f"{SPEED} > 2")["number"]) == list(1 + np.flatnonzero(expected[SPEED] > 2))


def test_results_do_not_depend_on_workers_or_shards(
    thrown: mbdkit.Study, throw: dict[str, Any], tmp_path: Path
) -> None:
    hashes = list(thrown.to_frame()["data_sha256"])
    assert len(set(hashes)) == 16
    throw["block"] = 6
    for number in (2, 1):
        parts = mbdkit.study(throw, out=tmp_path / "shards", shard=Shard(number, 2))
    assert list(parts.to_frame()["data_sha256"]) == hashes
    assert list(mbdkit.study(throw, out=tmp_path / "workers", workers=2).to_frame()["data_sha256"]) == hashes


def test_a_study_goes_on_with_the_values_in_its_folder(
    throw: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    throw |= {"block": 4, "store": "hashes"}
    made = mbdkit.study(throw, out=tmp_path / "s")
    before = list(made.to_frame()[SPEED])
    (tmp_path / "s" / "runs" / "block-000001.h5").unlink()
    monkeypatch.setattr(module, "unit_points", lambda sample, d: np.full((sample.n, d), 0.5))  # as another SciPy might
    again = mbdkit.study(throw, out=tmp_path / "s")
    assert again.computed == 4
    assert list(again.to_frame()[SPEED]) == before
    throw["sample"]["seed"] = 4
    with pytest.raises(SpecError, match="this folder belongs to another study"):
        mbdkit.study(throw, out=tmp_path / "s")


def test_axes_repeat_the_sample(throw: dict[str, Any], tmp_path: Path) -> None:
    throw |= {"axes": [{"time.end": [0.2, 0.4]}], "store": "histories"}
    throw["sample"] |= {"n": 4, "design": "saltelli"}
    study = mbdkit.study(throw, out=tmp_path / "s")
    frame = study.to_frame()
    assert list(frame["time.end"]) == [0.2] * 16 + [0.4] * 16
    assert list(frame[SPEED][:16]) == list(frame[SPEED][16:])
    dataset = study.to_xarray()
    assert dataset["distance"].shape == (2, 16)
    assert np.allclose(dataset["distance"], np.outer([0.2, 0.4], dataset[SPEED]))
    with pytest.raises(MbdkitError, match=r"has 2 samples; choose one by `where`, such as where=\{'time.end': 0.2\}"):
        study.sensitivity("distance")
    with pytest.raises(MbdkitError, match="the study has no runs with these labels"):
        study.sensitivity("distance", where={"time.end": 3})
    one, other = (study.sensitivity("distance", where={"time.end": end}) for end in (0.2, 0.4))
    assert one.total == pytest.approx(other.total, nan_ok=True)  # from 4 members, an interval may cover 0 to 1
    assert one.total[1] == pytest.approx(0, abs=1e-12)  # the mass has no influence
    assert study.quantiles("ball.x", where={"time.end": 0.2}).time[-1] == 0.2


@pytest.fixture(scope="module")
def of_ishigami(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """The Ishigami function of the angles of three bodies at rest, as a measure of runs."""
    value = "sin(final(a.angle)) + 7*sin(final(b.angle))**2 + 0.1*final(c.angle)**4*sin(final(a.angle))"
    angles = {f"model.bodies.{name}.angle": {"uniform": [-np.pi, np.pi]} for name in "abc"}
    spec = {
        "mbdkit_study": 1, "base": base(0.1, **dict.fromkeys("abc", BODY)),
        "sample": {"n": 128, "seed": 1, "design": "saltelli", "variables": angles}, "store": "histories",
        "measures": {"y": {"value": value, "unit": "1"}},
    }  # fmt: skip
    return mbdkit.study(spec, out=tmp_path_factory.mktemp("samples") / "ishigami")


def test_the_indices_of_the_ishigami_function_come_from_its_runs(of_ishigami: mbdkit.Study) -> None:
    assert of_ishigami.spec.sample is not None
    points = np.array(list(sampled_values(of_ishigami.spec.sample).values()))
    found = of_ishigami.sensitivity("y")
    expected = sobol_indices(ishigami(points).reshape(-1, 5), seed=1)
    assert found.first == pytest.approx(expected.first, abs=1e-12)
    assert found.indices.total_high == pytest.approx(expected.total_high, abs=1e-12)
    assert np.all(found.indices.first_low <= FIRST)
    assert np.all(found.indices.first_high >= FIRST)
    assert np.all(found.indices.total_low <= TOTAL)
    assert np.all(found.indices.total_high >= TOTAL)
    few = of_ishigami.sensitivity("y", members=16)
    assert np.max(np.abs(few.total - TOTAL)) > 3 * np.max(np.abs(found.total - TOTAL))
    assert few.members == 16
    frame = found.to_frame()
    assert list(frame.index) == [f"model.bodies.{name}.angle" for name in "abc"]
    assert list(frame["total"]) == list(found.total)


def test_a_run_is_opened_by_the_number_that_answers_give(of_ishigami: mbdkit.Study) -> None:
    frame = of_ishigami.to_frame()
    number = int(headlines(of_ishigami)[0][1].rpartition("largest ")[2].partition("in run ")[2].split()[0])
    assert frame["y"].max() == frame["y"][number - 1]
    for run in (of_ishigami.run(number=number), of_ishigami.remake(number=number), of_ishigami.run(number - 1)):
        assert run is not None
        with run:
            assert run["a"].angle[0] == frame["model.bodies.a.angle"][number - 1]
            assert run.measures["y"] == frame["y"].max()  # a measure that the study defines, not the run
    with pytest.raises(MbdkitError, match="the study has no run number 0; its runs have the numbers 1 to 640"):
        of_ishigami.run(number=0)
    with pytest.raises(MbdkitError, match=r"no run with index 640; .*study\.run\(number=640\) is the last run"):
        of_ishigami.run(640)
    with pytest.raises(MbdkitError, match="give a run by its index from 0"):
        of_ishigami.run(1, number=2)
    with pytest.raises(SpecError, match=r"there is no column 'angle'; write model\.bodies\.a\.angle, model\.bodies\.b"):
        of_ishigami.select("angle > 1")


@pytest.mark.slow
def test_the_report_shows_the_sample(of_ishigami: mbdkit.Study) -> None:
    from mbdkit_studies.report.study_report import study_report

    verdict = study_report(of_ishigami).verdict
    counts = verdict.figure("histogram-y").lines[0].y
    assert counts[1:-1:2].sum() == 640
    total = verdict.figure("sobol-total-y")
    assert [line.x[-1] for line in total.lines] == [128] * 3
    assert sorted(line.y[-1] for line in total.lines) == sorted(of_ishigami.sensitivity("y").total)
    scatter = verdict.figure("over-model-bodies-a-angle-y").lines[0]
    assert scatter.y == pytest.approx(of_ishigami.to_frame()["y"].to_numpy())
    rows = verdict.table("sobol").rows
    assert [row[5] for row in rows] == pytest.approx(of_ishigami.sensitivity("y").total, abs=1e-3)
    bands = verdict.figure("quantiles-a-angle")
    assert bands.lines[0].y[-1] == pytest.approx(np.median(of_ishigami.to_frame()["model.bodies.a.angle"]))
    assert len(verdict.table("runs").rows) == 500


def test_members_with_failed_runs_are_left_out(throw: dict[str, Any], tmp_path: Path) -> None:
    throw["sample"] |= {"n": 32, "design": "saltelli"}
    throw["sample"]["variables"][MASS] = {"uniform": [-0.1, 1.0]}
    study = mbdkit.study(throw, out=tmp_path / "s")
    frame = study.to_frame()
    failed = (frame[MASS] < 0).to_numpy().reshape(32, 4).any(axis=1)
    assert 0 < failed.sum() < 32
    assert list(frame["status"][frame[MASS] < 0].unique()) == ["failed"]
    found = study.sensitivity("work")
    assert (found.members, found.left_out) == (32 - failed.sum(), failed.sum())
    good = frame["work"].to_numpy().reshape(32, 4)[~failed]
    assert found.total == pytest.approx(sobol_indices(good, resamples=1).total)


def test_bad_runs_are_left_out_of_statistics_and_named(tmp_path: Path) -> None:
    spec = {
        "mbdkit_study": 1,
        "base": {"model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.1}},
        "sample": {"n": 24, "method": "random", "seed": 1, "variables": {"time.step": {"uniform": [0.001, 0.14]}}},
        "measures": {"peak": "max(abs(joints.J1.force))"},
        "store": "histories",
    }
    study = mbdkit.study(spec, out=tmp_path / "s")
    frame = study.to_frame()
    is_bad = (frame["verdict"] == "bad").to_numpy()
    assert 4 < is_bad.sum() < 20
    good = frame["peak"][~is_bad]
    found = study.statistics("peak")
    assert (found.runs, found.bad) == (len(good), is_bad.sum())
    assert found.mean.value == pytest.approx(good.mean())
    assert found.std.value == pytest.approx(good.std())
    assert found.mean_with_bad == pytest.approx(frame["peak"].mean())
    half = scipy.stats.t.ppf(0.975, len(good) - 1) * good.std() / np.sqrt(len(good))
    assert found.mean.high - found.mean.value == pytest.approx(half)
    assert study.quantiles("rod1.angle", 0.5, times=[0.0]).count == len(good)
    ((_, told),) = headlines(study)
    assert f"N in run {good.idxmax() + 1} (" in told
    labels = dict(notes(study))
    assert labels["based on"].startswith(f"{len(good)} of 24 runs, without {is_bad.sum()} bad")
    first = ", ".join(map(str, 1 + np.flatnonzero(is_bad)[:6]))
    begin = f"{is_bad.sum()} runs ({first}, ...), not used in answers; The energy balance is violated by up to"
    assert labels["bad"].startswith(begin)
    assert f" (run {1 + np.argmax(is_bad)}: time.step " in labels["bad"]
    spec["sample"]["variables"] = {"time.step": {"uniform": [0.11, 0.14]}}
    all_bad = mbdkit.study(spec, out=tmp_path / "all")
    assert headlines(all_bad) == [("peak", "unknown, because all 24 runs with a value are rated bad")]
    with pytest.raises(MbdkitError, match="from at least 3 complete runs that are not rated bad"):
        all_bad.statistics("peak")


def test_quantiles_over_time_are_those_of_the_closed_form(thrown: mbdkit.Study) -> None:
    bands = thrown.quantiles("ball.x", [0.1, 0.5])
    speeds = thrown.to_frame()[SPEED]
    assert bands.time == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert bands.values == pytest.approx(np.outer(np.quantile(speeds, [0.1, 0.5]), bands.time))
    assert bands.unit == "m"
    assert list(bands.to_frame().columns) == [0.1, 0.5]
    assert thrown.quantiles("abs(ball.velocity)", 0.5, times=[0.05, 1.0]).values[0, 0] == pytest.approx(speeds.median())


def test_quantiles_are_of_the_runs_that_reach_a_time(throw: dict[str, Any], tmp_path: Path) -> None:
    throw["sample"]["variables"] = {SPEED: {"uniform": [1, 3]}, "time.end": {"uniform": [0.1, 0.5]}}
    throw |= {"block": 5, "store": "histories"}
    study = mbdkit.study(throw, out=tmp_path / "s")
    frame = study.to_frame()
    bands = study.quantiles("ball.x", [0.25, 0.75])
    for place in (10, 100, 190):
        speeds = frame[SPEED][frame["time.end"] >= bands.time[place]]
        assert bands.count[place] == len(speeds)
        assert bands.values[:, place] == pytest.approx(np.quantile(speeds, [0.25, 0.75]) * bands.time[place])
    assert np.isnan(study.quantiles("ball.x", 0.5, times=[9.0]).values[0, 0])


def test_quantiles_of_runs_with_rows_of_their_own_are_as_near_to_the_closed_form_as_they_tell(tmp_path: Path) -> None:
    """Oscillators x = cos(w t) with steps of an adaptive method; lines between their rows are off by up to 0.04."""
    own = oscillator({"name": "dop853", "adaptive": True, "rtol": 1e-9, "atol": 1e-9}, None)
    spec = {
        "mbdkit_study": 1, "base": own, "store": "histories", "measures": {"last": "final(slider.x)"},
        "sample": {"n": 8, "seed": 3, "variables": {"model.forces.spring.stiffness": {"uniform": [3, 5]}}},
    }  # fmt: skip
    study = mbdkit.study(spec, out=tmp_path / "s")
    bands = study.quantiles("slider.x", [0.25, 0.5, 0.75])
    frequency = np.sqrt(study.to_frame()["model.forces.spring.stiffness"].to_numpy())
    off = np.abs(bands.values - np.quantile(np.cos(np.outer(frequency, bands.time)), bands.q, axis=0))
    assert np.max(off) < 0.5 * np.max(bands.error)
    assert f"by up to {np.max(bands.error):.2g} m. `output: {{interval: SECONDS}}`" in bands.told
    spec["base"] = own | {"output": {"interval": 0.05}}
    common = mbdkit.study(spec, out=tmp_path / "common").quantiles("slider.x", [0.25, 0.5, 0.75])
    assert common.told == ""
    exact = np.quantile(np.cos(np.outer(frequency, common.time)), common.q, axis=0)
    np.testing.assert_allclose(common.values, exact, rtol=0, atol=1e-7)


def test_studies_in_files_have_quantiles_as_well(throw: dict[str, Any], tmp_path: Path) -> None:
    del throw["sample"]
    throw["axes"] = [{SPEED: [1.0, 2.0, 3.0]}]
    study = mbdkit.study(throw, out=tmp_path / "s")
    assert study.quantiles("ball.x", 0.5).values[0] == pytest.approx([0, 0.2, 0.4, 0.6, 0.8])
    assert study.quantiles("ball.x", 0.5, where={SPEED: 3.0}).values[0] == pytest.approx([0, 0.3, 0.6, 0.9, 1.2])


ASKED: dict[str, tuple[str, tuple[Any, ...], dict[str, Any], str]] = {
    "plain sample": ("sensitivity", ("distance",), {}, "need a sample with `design: saltelli`"),
    "vector": ("quantiles", ("ball.velocity",), {}, "is a vector, which has no quantiles"),
    "one number": ("quantiles", ("max(ball.x)",), {}, "functions that reduce values over time"),
    "constant": ("quantiles", ("3",), {}, "does not change over time"),
    "unknown body": ("quantiles", ("bal.x",), {}, "did you mean 'ball'?"),
    "probability": ("quantiles", ("ball.x", 5), {}, "numbers from 0 to 1"),
    "times": ("quantiles", ("ball.x",), {"times": []}, "the times should be an array"),
    "where": ("quantiles", ("ball.x",), {"where": {"time.end": 1}}, "leave out `where`"),
}


@pytest.mark.parametrize(("name", "arguments", "options", "message"), ASKED.values(), ids=ASKED)
def test_wrong_questions_are_refused(
    thrown: mbdkit.Study, name: str, arguments: tuple[Any, ...], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(MbdkitError) as error:
        getattr(thrown, name)(*arguments, **options)
    assert message in str(error.value)


def test_questions_about_indices_are_checked(of_ishigami: mbdkit.Study) -> None:
    with pytest.raises(MbdkitError, match="the study has no measure 'z'"):
        of_ishigami.sensitivity("z")
    with pytest.raises(MbdkitError, match="choose from 2 to 128 of them, not 500"):
        of_ishigami.sensitivity("y", members=500)
    with pytest.raises(MbdkitError, match="a probability between 0 and 1"):
        of_ishigami.sensitivity("y", confidence=95)


def test_what_is_not_stored_has_no_quantiles(throw: dict[str, Any], tmp_path: Path) -> None:
    study = mbdkit.study(throw | {"store": "summary"}, out=tmp_path / "s")
    with pytest.raises(MbdkitError, match=r"keeps no values over time \(store: summary\)"):
        study.quantiles("ball.x")


def test_a_key_of_the_sample_is_set_by_an_assignment(throw: dict[str, Any], tmp_path: Path) -> None:
    study = mbdkit.study(throw, assignments=["sample.n=4", "time.end=0.2"], out=tmp_path / "study")
    assert len(study.points) == 4
    with study.run(3) as run:
        assert run.time[-1] == 0.2
    with pytest.raises(SpecError, match=r"--set sample\.m=4.*unknown key; known here: n, method"):
        mbdkit.study(throw, assignments=["sample.m=4"], out=tmp_path / "other")


@pytest.mark.slow
def test_indices_of_errors_are_not_shown(tmp_path: Path) -> None:
    # the total energy does not depend on the phase: its values differ by their errors only
    base = oscillator({"name": "rk4"}, 0.2, check=True, parameters={"phase": 0.0, "level": 0.0})
    base["model"]["bodies"]["slider"] |= {"position": ["cos(phase)", 0], "velocity": ["-2*sin(phase)", 0]}
    variables = {"parameters.phase": {"uniform": [0.0, 3.0]}, "parameters.level": {"uniform": [0.0, 1.0]}}
    sample = {"n": 4, "method": "sobol", "design": "saltelli", "seed": 1, "variables": variables}
    measures = {"noise": "max(energy.total) - 2 + 2", "swing": {"value": "final(slider.x)*(1 + level)", "unit": "m"}}
    study = mbdkit.study(
        {"mbdkit_study": 1, "base": base, "sample": sample, "measures": measures}, out=tmp_path / "study"
    )
    found = sensitivity(study, "noise")
    assert np.all(np.isnan(found.first))
    assert np.all(np.isnan(found.total))
    assert "within their estimated errors" in str(found)
    wide = sensitivity(study, "swing")
    assert not wide.reason
    covers = (wide.indices.first_low <= 0) & (wide.indices.first_high >= 1)
    assert np.array_equal(np.isnan(wide.first), covers)
    told = dict(headlines(study))
    assert "of the standard deviation: THE SPREAD MAY BE NUMERICAL" in told["noise"]
    assert "no variable explains it: the values of noise differ by" in told["noise"]
    assert "NUMERICAL" not in told["swing"]
    assert "error of a run" in told["swing"]


@pytest.fixture
def estimated(tmp_path: Path) -> Path:
    """A study of a base with estimated stiffness and mass, which draws them."""
    write_fit(tmp_path)
    (tmp_path / "base.yaml").write_text(write_yaml(sliding()), "utf-8")
    study = {"mbdkit_study": 1, "base": "base.yaml", "sample": {"n": 1024, "estimates": True, "seed": 4}}
    path = tmp_path / "study.yaml"
    path.write_text(write_yaml(study | {"measures": {"end": "final(block.x)"}}), "utf-8")
    return path


@pytest.mark.parametrize("method", ["sobol", "halton", "latin-hypercube", "random"])
def test_drawn_estimates_have_their_means_and_covariances(estimated: Path, method: str) -> None:
    # expected: errors of means and covariances of independent Gaussian members, of which 4 deviations are allowed
    n = 4096
    spec = load_study_spec(estimated, [f"sample.n={n}", f"sample.method={method}"])
    columns = module.values_of(spec)
    assert list(columns) == ["parameters.stiffness", "parameters.mass"]
    drawn = np.array([*columns.values()])
    variances = np.diagonal(COVARIANCE)
    assert_within(drawn.mean(axis=1) - [STIFFNESS, identified.MASS], 4.0 * np.sqrt(variances / n))
    spread = np.sqrt((np.outer(variances, variances) + COVARIANCE**2) / n)
    assert_within(np.cov(drawn) - COVARIANCE, 4.0 * spread)
    assert scipy.stats.kstest(drawn[1], "norm", (identified.MASS, np.sqrt(variances[1]))).pvalue > 1e-3


def test_a_study_of_estimates_needs_no_file_and_draws_what_a_check_estimates(estimated: Path, tmp_path: Path) -> None:
    study = mbdkit.study(estimated, out=tmp_path / "out", assignments=["sample.n=64"])
    (tmp_path / "fit.h5").unlink()
    (tmp_path / "base.yaml").unlink()
    again = mbdkit.study(tmp_path / "out" / "study.yaml", out=tmp_path / "again")
    np.testing.assert_array_equal(study.to_frame()["end"], again.to_frame()["end"])
    checked = mbdkit.run(study.spec.base, check=True, measures={"end": "final(block.x)"})
    deviation = checked.measures.parameter_errors["end"] / 1.96
    assert study.to_frame()["end"].std() == pytest.approx(deviation, rel=0.1)
    member = study.remake(1)
    assert member.spec["parameters"]["mass"] != identified.MASS
    assert RunSpec(**member.spec).estimated is None  # its values are given


@pytest.mark.parametrize(
    ("assignments", "drawn"),
    [
        (["parameters.mass=2.5"], ["parameters.stiffness"]),
        (["sample.variables={parameters.mass: {uniform: [1, 2]}}"], ["parameters.mass", "parameters.stiffness"]),
        (["sample.variables={model.bodies.block.inertia: {uniform: [1, 2]}}"],
         ["model.bodies.block.inertia", "parameters.stiffness", "parameters.mass"]),
    ],
)  # fmt: skip
def test_estimates_that_the_study_sets_are_not_drawn(estimated: Path, assignments: list[str], drawn: list[str]) -> None:
    columns = module.values_of(load_study_spec(estimated, assignments))
    assert list(columns) == drawn
    assert columns["parameters.stiffness"].std() == pytest.approx(0.2, rel=0.05)


def test_an_axis_of_an_estimate_takes_precedence(estimated: Path) -> None:
    data = read_file(estimated).data | {"axes": [{"parameters.mass": [1.0, 2.0]}]}
    (estimated.parent / "axes.yaml").write_text(write_yaml(data), "utf-8")
    assert list(module.values_of(load_study_spec(estimated.parent / "axes.yaml"))) == ["parameters.stiffness"]


@pytest.mark.parametrize(
    ("changes", "key", "message"),
    [
        ({"sample": {"n": 4}}, "sample.variables", "needs at least one key of a run spec"),
        ({"sample": {"n": 4, "estimates": True, "design": "saltelli"}}, "sample.design", "estimates are correlated"),
        ({"base": "double-pendulum"}, "sample.estimates", "draws nothing: the base takes no parameters"),
        ({"overrides": {"parameters": {"stiffness": 1, "mass": 1}}}, "sample.estimates", "draws nothing"),
        ({"overrides": {"parameters.from": "fit.h5"}}, "overrides.\"parameters.from\"", "cannot be set here"),
        ({"base": sliding(parameters={"from": "no.h5"})}, "base", "No such file"),
        ({"base": sliding(parameters={"from": 3})}, "base.parameters.from", "should be the file of an identification"),
        ({"base": sliding(parameters={}, estimates={"values": {"a": 1.0}, "covariance": [[-1.0]]})},
         "base.estimates.covariance", "should be symmetric"),
        ({"base": None, "axes": [], "families": {
            "a": {"base": "base.yaml"}, "b": {"base": sliding(parameters={"from": "fit.h5", "mass": 1.0})}}},
         "sample.estimates", "draws different parameters for the families"),
    ],
)  # fmt: skip
def test_wrong_samples_of_estimates_are_refused(estimated: Path, changes: Any, key: str, message: str) -> None:
    path = estimated.parent / "wrong.yaml"
    data = {name: value for name, value in (read_file(estimated).data | changes).items() if value is not None}
    path.write_text(write_yaml(data), "utf-8")
    with pytest.raises(SpecError, match=message) as caught:
        plan_study(load_study_spec(path))
    assert caught.value.key == key
