from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from tests.report.page_elements import Elements

import mbdkit
from mbdkit.archive.fingerprint import seal
from mbdkit.base.errors import SpecError
from mbdkit.spec import example_names, load_spec
from mbdkit.spec.yaml_reader import read_yaml
from mbdkit_report import Answer, Claim, Column, Table, Verdict, json_values, methods, report, run_report, terminal_text
from mbdkit_report.pages import run_verdict as module
from mbdkit_report.pages.run_charts import run_charts
from mbdkit_report.pages.run_report import yaml_text
from mbdkit_report.pages.run_verdict import run_verdict
from mbdkit_report.pages.verdict_text import headlines, markdown
from mbdkit_report.plot.plot_kinds import plot_kinds
from mbdkit_report.plot.save_plot import plot
from tests.trust.mechanisms import spec

EVIL = "</script><script>alert('x')</script><img src=https://evil.example/x.png onerror=alert(1)> & \"q\""


def test_a_page_is_whole_and_names_no_address_outside_of_itself(make_run):
    elements = Elements(run_report(make_run()).html())
    assert [link for link in elements.links if not link.startswith(("#", "data:"))] == []
    assert {link[1:] for link in elements.links if link.startswith("#")} <= set(elements.ids)
    assert len(set(elements.ids)) == len(elements.ids)
    assert {"link", "img", "iframe"} & set(elements.tags) <= {"link"}


def test_a_page_says_what_the_browser_may_do():
    with mbdkit.run("pendulum") as run:
        text = run_report(run).html()
    assert "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:" in text
    assert len(text) < 4_000_000


def test_hostile_text_adds_no_element(make_run):
    tame, evil = (
        run_report(
            make_run(
                title=text, bodies=[text, "b"], joints=[text, "J2"], model={"name": "acme:crane"},
                status="failed", reason=f"singular: {text}",
            )
        ).html()
        for text in ("tame", EVIL)
    )  # fmt: skip
    assert Elements(tame).tags == Elements(evil).tags


def test_the_spec_of_a_report_is_the_spec_of_the_run():
    for name in example_names("run"):
        spec = load_spec(name)
        text = yaml_text(json.loads(spec.canonical_json()))
        assert load_spec(read_yaml(text)[0]).canonical_json() == spec.canonical_json()


def test_charts_and_tables_of_rounding_errors_are_left_out():
    shown = {"misalignment", "velocity-misalignment", "balance"}
    names = []
    for step in (0.005, 0.1):  # the joints of the knee stay closed to round-off with small steps only
        with mbdkit.run("knee", time={"end": 0.4, "step": step}) as run:
            verdict = run_report(run).verdict
        names.append({one.name for one in (*verdict.figures, *verdict.tables)} & shown)
    assert names == [set(), shown]


def test_the_references_are_those_of_the_methods_used_and_of_no_others():
    gauss = methods([load_spec("knee").model_dump(mode="json")])
    keys = {re.match(r"@\w+\{([^,]+),", entry)[1] for entry in gauss.bibtex}
    assert keys == {"mbdkit", "butcher1964", "group3exoskeleton", "winter2009", "gaitanalysistoolkit", "gait2d"}
    assert any("order 6, symmetric and symplectic" in paragraph for paragraph in gauss.paragraphs)


def test_the_controller_of_adaptive_steps_is_named_with_its_reference():
    integrator = {"name": "dopri5", "adaptive": True, "step_control": {"name": "h211b", "b": 6.0}}
    found = methods([load_spec("knee", integrator=integrator, time={"end": 1.0}).model_dump(mode="json")])
    assert any("h211b" in text and text.endswith("b 6.") for text in found.paragraphs)
    assert any("Drift: only accelerations" in text for text in found.paragraphs)
    assert any("{soderlind2003," in entry for entry in found.bibtex)


def test_a_method_that_is_not_installed_is_named_as_missing():
    found = methods([{"model": {"name": "acme:crane"}, "integrator": {"name": "rk4"}}])
    assert any("acme:crane is not installed here" in paragraph for paragraph in found.paragraphs)


def test_the_verdict_names_the_worst_joint_and_the_size_of_its_gap(make_run):
    def pull(data):
        data["joints/misalignment"][:, 1] = 2.5e-6 * data["time"] / data["time"][-1]

    verdict = run_verdict(make_run(change=pull))
    assert "The largest misalignment is 2.5 \u00b5m, of joint J2" in verdict.sentence
    assert "it grows in proportion to time" in verdict.sentence
    assert [claim.answer for claim in verdict.claims] == [Answer.OPEN, *[Answer.YES] * 3]


def test_laws_of_growth_that_cannot_be_told_apart_are_not_named(make_run, monkeypatch):
    def pull(data):
        data["joints/misalignment"][:, 1] = 2.5e-6 * data["time"] / data["time"][-1]

    run = make_run(change=pull)
    candidates = SimpleNamespace(candidates=("exponential", "quadratic", "linear"))
    monkeypatch.setattr(module, "growth_law", lambda time, values: candidates)
    assert "grows" not in run_verdict(run).sentence


@pytest.mark.parametrize(
    ("path", "values", "name", "words"),
    [
        ("joints/misalignment", 0.05, "misalignment", "too large for reliable forces"),
        ("joints/misalignment", np.inf, "misalignment", "is not finite"),
        ("energy/balance", 0.2, "energy", "This is too large"),
        ("energy/balance", np.nan, "energy", "energy is not finite"),
    ],
)
def test_what_cannot_be_trusted_is_called_so(make_run, path, values, name, words):
    def spoil(data):
        data[path][-1] = values

    verdict = run_verdict(make_run(change=spoil))
    assert verdict.claim(name).answer is Answer.NO
    assert words in verdict.sentence


def test_reactions_that_are_not_unique_are_called_so():
    # expected: of a rod that hangs on two pins in one place, each pin may carry any part
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    for name in ("pin", "bolt"):
        m.revolute(name, m.ground, "rod", at=(0.0, 0.0))
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.01}) as run:
        (note,) = run_verdict(run).notes
        assert "2 redundant rows: joints pin and bolt" in note
        assert "The reactions of pin, bolt are not unique" in note
        assert note in run_report(run).html()


def test_a_run_that_failed_says_when_and_why(make_run):
    verdict = run_verdict(make_run(status="failed", reason="singular: the mechanism is at a dead centre"))
    assert verdict.claim("completion").answer is Answer.NO
    assert "failed at t = 3 s" in verdict.sentence
    assert "singular: the mechanism is at a dead centre." in verdict.sentence


def test_what_was_not_recorded_is_left_out(make_run):
    document = run_report(make_run(quantities=frozenset()))
    assert [figure.name for figure in document.verdict.figures] == ["trajectory"]
    assert document.html()


@pytest.mark.parametrize("rods", [1, 60])
def test_mechanisms_small_and_large_can_be_reported(make_run, rods):
    document = run_report(make_run(rods=rods))
    assert len(document.verdict.table("misalignment").rows) == min(rods, 50)
    assert len(document.sections[0].tables[0].rows) == rods
    assert all(len(figure.lines) <= 6 for figure in document.verdict.figures)
    assert len(document.html()) < 4_000_000


def test_a_run_that_flew_apart_can_be_reported(make_run):
    def spoil(data):
        for values in data.values():
            if values is not data["time"]:
                values[-3:] = np.array([1e300, np.inf, np.nan]).reshape(3, *[1] * (values.ndim - 1))

    text = run_report(make_run(change=spoil, status="failed", reason="not-finite: the state is not finite")).html()
    assert "NaN" not in text.split('id="figure-data">')[1].split("</script>")[0]


@pytest.fixture
def archive(tmp_path):
    path = tmp_path / "swing.h5"
    mbdkit.run("pendulum", archive=path).close()
    return path


def test_the_page_goes_beside_the_archive_and_the_figures_where_they_are_wanted(archive):
    target = report(archive, figures=archive.parent / "pictures")
    assert target == archive.with_name("swing-report.html")
    names = {path.name for path in (archive.parent / "pictures").iterdir()}
    assert {"misalignment.png", "misalignment.svg", "energy.png", "trajectory.svg"} <= names
    assert len(names) % 2 == 0


def test_the_command_writes_a_page_and_replaces_it_only_when_told(archive, mbdkit_command):
    assert mbdkit_command("report", str(archive)).stdout == f"{archive.with_name('swing-report.html')}\n"
    again = mbdkit_command("report", str(archive))
    assert (again.exit_code, again.stdout) == (2, "")
    assert "this file exists already; choose another name, or replace it with --overwrite" in again.stderr
    assert mbdkit_command("report", str(archive), "--overwrite", "--quiet").stdout == ""


def test_an_archive_is_not_replaced_by_its_own_report(archive):
    page = archive.rename(archive.with_suffix(".html"))
    before = page.read_bytes()
    with pytest.raises(SpecError, match="this file is the input"):
        report(page, page, overwrite=True)
    assert page.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.h5"], "missing.h5: there is no run archive, and no folder of a study or design, of this name"),
        (["text.h5"], "text.h5: this is not an HDF5 file"),
        (["cut.h5"], "cut.h5: this archive is truncated"),
        (["swing.h5", "-o", "page.pdf"], "its name must end in .html, .htm or .md"),
        (["swing.h5", "-o", "nowhere/page.html"], "nowhere does not exist; create it first"),
        (["swing.h5", "-o", "folder.html"], "this is a folder; name a file"),
        (["swing.h5", "--figures", "text.h5"], "this is not a folder"),
        (["swing.h5", "--figures", "."], "this folder is not empty"),
        (["swing.h5", "--figures", "a/b"], "a/b: the folder a does not exist; create it first"),
    ],
)
def test_wrong_input_is_a_sentence_and_leaves_nothing(archive, arguments, words, mbdkit_command, monkeypatch):
    monkeypatch.chdir(archive.parent)
    archive.with_name("text.h5").write_text("no archive")
    archive.with_name("cut.h5").write_bytes(archive.read_bytes()[:-1000])
    archive.with_name("folder.html").mkdir()
    before = sorted(archive.parent.iterdir())
    result = mbdkit_command("report", *arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert sorted(archive.parent.iterdir()) == before


def test_events_are_listed_and_marked_in_figures_over_time():
    events = {"low <b>": {"when": "rod1.angle + pi/2"}, "never": {"when": "t - 9"}}
    time = {"end": 2.0, "step": 0.01}
    with mbdkit.run("pendulum", time=time, events=events) as run:
        verdict = run_verdict(run)
        table, figure = verdict.table("events"), verdict.figure("reactions")
        assert [row[0] for row in table.rows] == ["low <b>", "low <b>", "never"]
        assert table.rows[0][3].startswith("0.48333")
        assert [mark.label for mark in figure.marks] == ["low <b>", ""]
        assert [mark.x for mark in figure.marks] == run.events.time.tolist()
        assert verdict.figure("trajectory").marks == ()
        page = run_report(run).html()
        assert "low &lt;b&gt;" in page
        assert "low <b>" not in page


def test_too_many_events_to_tell_apart_are_listed_in_part_and_not_marked():
    with mbdkit.run("pendulum", time={"end": 2.0, "step": 0.01}, events={"often": {"when": "sin(100*t)"}}) as run:
        verdict = run_verdict(run)
        assert len(run.events) == 63
        assert verdict.figure("energy").marks == ()
        assert verdict.table("events").note == "The first 50 of 63 crossings."


def test_rounding_errors_of_a_held_arm_are_no_errors_of_its_energy():
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    arm = m.body("arm", mass=1.5, inertia=0.02, position=(0.15, 0.0))
    m.revolute("elbow", m.ground, arm, at=(0, 0))
    m.driver("hold", m.ground, arm, coordinate="angle", motion=0.0)
    m.torque("load", arm, value=50.0)
    with mbdkit.run(m, integrator={"name": "radau-iia"}, time={"end": 0.5, "step": 0.002}) as run:
        assert 0.0 < run.energy.kinetic.max() < 1e-25  # so that shares of it say nothing
        claim = run_verdict(run).claim("energy")
        assert claim.answer is Answer.YES
        assert claim.sentence.endswith(" J.")


def test_a_run_that_an_event_ended_completed():
    with mbdkit.run("pendulum", events={"low": {"when": "rod1.angle + pi/2", "action": "stop"}}) as run:
        claim = run_verdict(run).claim("completion")
        assert claim.answer is Answer.YES
        assert "It ended at an event: 'low' crossed zero downwards at t = 0.4833" in claim.sentence


SHOWN = Table(
    "shown", "What it is for", (Column("method"), Column("drift", "m")), (("RK4", 1.23456e-5), ("a | b", None)),
    "A note.", headline=True,
)  # fmt: skip
OTHER = Table("other", "All runs", (Column("run"),), ((1,),))
CLAIM = Claim("held", "Joints hold.", "below 1e-12", "2e-5 m", Answer.NO, "They do not.")


def verdict(*tables: Table) -> Verdict:
    return Verdict("any", "Any", "They do not.", (CLAIM,), tables)


def test_the_terminal_gets_headline_tables_and_claims_alone() -> None:
    assert headlines(verdict(OTHER, SHOWN)) == (SHOWN,)
    assert terminal_text(verdict(OTHER, SHOWN)).splitlines() == [
        "What it is for", "  method  drift [m]", "  RK4     1.235e-05", "  a | b", "A note.",
        "no     Joints hold. Found: 2e-5 m.",
    ]  # fmt: skip
    assert terminal_text(verdict(OTHER)) == ""
    assert json_values(verdict(OTHER)) == {}
    values = json.loads(json.dumps(json_values(verdict(OTHER, SHOWN))))
    assert [table["name"] for table in values["tables"]] == ["shown"]
    assert values["claims"][0]["answer"] == "no"


def test_a_study_is_reported_in_markdown_with_every_cell_in_its_column(study_folder, tmp_path) -> None:
    target = report(study_folder, tmp_path / "page.md")
    text = target.read_text(encoding="utf-8")
    assert text.startswith("# ")
    assert "## All runs" in text
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table[-7:]}) == 1
    assert list(tmp_path.iterdir()) == [target]


DOUBLE, RK4 = {"name": "double-pendulum"}, {"name": "rk4"}


def test_a_complete_run_that_is_bad_has_an_alarm() -> None:
    with mbdkit.run(spec(DOUBLE, {"name": "rk-gill"}, 2.0, 0.05)) as run:
        assert (run.status, run.verdict) == ("complete", "bad")
        assert run_report(run).alarm == "VERDICT: BAD"


def test_energy_is_conserved_to_rounding_errors_of_the_sizes_of_bodies() -> None:
    # the potential energy is zero, so that only the lengths of the rod give the level of rounding errors
    rod = {"mass": 10, "inertia": 0.1, "position": [0, 0], "angle": -1.2}
    pin = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0, 0.5]}
    model = {"name": "mechanism", "bodies": {"rod": rod}, "joints": {"pin": pin}}
    run = mbdkit.run(spec(model, {"name": "gauss", "stages": 2}, 0.5, 0.001), check=True)
    assert [claim.answer for claim in run_verdict(run).claims if claim.name == "energy"] == [Answer.YES]


def test_an_archive_without_verdict_is_reported_as_that(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    mbdkit.run(spec(DOUBLE, RK4, 0.1, 0.01), archive=path).close()
    with h5py.File(path, "r+") as file:
        del file.attrs["warnings"], file.attrs["verdict"], file.attrs["verdict_reasons"]
        seal(file)
    with mbdkit.load(path) as run:
        assert "The archive contains no verdict" in run_report(run).verdict.sentence


ESCAPE = "red \x1b[31m\x00\x07\u202egnp \ufffe"
"""Colours of a terminal, a null character, a bell, reversed text, and a character that XML does not allow."""

HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\ufffe]")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Run:
    """A run whose title has control characters."""
    archive = tmp_path_factory.mktemp("run") / "run.h5"
    return mbdkit.run("double-pendulum", title=ESCAPE, time={"end": 0.1, "step": 0.01}, archive=archive)


@pytest.mark.parametrize("kind", plot_kinds())
def test_pictures_are_valid_xml(kind: str, run: mbdkit.Run, tmp_path: Path) -> None:
    try:
        plot(run, kind, tmp_path / "one.svg")
    except mbdkit.MbdkitError:
        pytest.skip("the double pendulum has none of these quantities")
    text = "".join(ElementTree.parse(tmp_path / "one.svg").getroot().itertext())
    assert "\\u001b[31m" in text
    assert not HARMFUL.search(text)


def test_pages_show_them_escaped(run: mbdkit.Run, tmp_path: Path) -> None:
    page = report(run.path, tmp_path / "run.html").read_text(encoding="utf-8")
    assert "\\u001b[31m" in page
    assert not HARMFUL.search(page)


@pytest.mark.usefixtures("pictures")
def test_reports_of_studies_and_their_pictures_show_them_escaped(tmp_path: Path) -> None:
    labels = [
        {"label": f"{ESCAPE[:9]}{number}", "value": {"name": name}} for number, name in enumerate(["rk4", "gauss"])
    ]
    base = {"model": {"name": "double-pendulum"}, "time": {"end": 0.1, "step": 0.01}}
    axes = [{"integrator": labels}, {"time.step": [0.01, 0.02]}]
    mbdkit.study({"mbdkit_study": 1, "title": ESCAPE, "base": base, "axes": axes}, out=tmp_path / "s")
    page = report(tmp_path / "s", tmp_path / "page.html", figures=tmp_path / "figures")
    assert not HARMFUL.search(page.read_text(encoding="utf-8"))
    pictures = list((tmp_path / "figures").glob("*.svg"))
    assert pictures
    for picture in pictures:
        ElementTree.parse(picture)


def test_inputs_and_states_have_a_chart_for_each_unit() -> None:
    m = mbdkit.Mechanism()
    m.body("arm", mass=1.0, inertia=0.08, position=(0.0, -0.5), angle=-1.57)
    m.revolute("hub", "ground", "arm", at=(0.0, 0.0))
    m.input("torque", unit="N*m")
    m.input("gain")
    m.state("filtered", rate="(inputs.torque - states.filtered)/0.1", unit="N*m")
    m.torque("motor", "arm", value="inputs.gain*states.filtered")
    tables = {"torque": {"table": [[0.0, 0.1], [1.0, 2.0]]}, "gain": {"table": [[0.0], [0.5]]}}
    run = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.2, "step": 0.01}, inputs=tables)
    charts = {chart.name: chart for chart in run_charts(run)}
    assert (charts["inputs-1"].y.unit, charts["inputs-2"].y.unit, charts["states"].y.unit) == ("N*m", "", "N*m")
    assert [line.label for line in charts["inputs-2"].lines] == ["gain"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a|b", r"a\|b"),
        ("two\nlines\n# heading", r"two lines \# heading"),
        ("<script>x</script>", "&lt;script&gt;x&lt;/script&gt;"),
        ("[x](javascript:y)", r"\[x\](javascript:y)"),
        ("=cmd()", r"\=cmd()"),
        ("-1.5e-3", "-1.5e-3"),
    ],
)
def test_markdown_obeys_no_text(text: str, words: str) -> None:
    assert markdown(text) == words
