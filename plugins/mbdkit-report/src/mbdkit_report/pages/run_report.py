"""The report of one run."""

from __future__ import annotations

from collections.abc import Mapping

from mbdkit.archive.headlines import headline_texts
from mbdkit.archive.run import Run
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_report.figures.curves import require_rows
from mbdkit_report.figures.drawing_geometry import mechanism_of
from mbdkit_report.figures.page_model import Cell, Table, columns_of
from mbdkit_report.figures.player_data import film_data
from mbdkit_report.pages.methods_used import methods
from mbdkit_report.pages.model_section import model_sections
from mbdkit_report.pages.report_page import ReportPage
from mbdkit_report.pages.run_charts import DRIFT
from mbdkit_report.pages.run_verdict import run_verdict
from mbdkit_report.pages.section_items import added_sections, with_additions
from mbdkit_report.plot.caption import caption

#: Name of the colour of the first headline (`ReportPage.tone`) for each verdict.
TONES = {"good": "good", "doubtful": "warn", "bad": "alarm"}
_NUMBERS = 240_000  # approximate number of pose values of the animation; they take about 1.5 megabytes


def run_report(run: Run) -> ReportPage:
    """Return the report of a run.

    Raises
    ------
    SpecError
        If the run has no rows.
    """
    require_rows(run)
    head = caption(run)
    mechanism = mechanism_of(run)
    glance, model = model_sections(run, mechanism)
    return ReportPage(
        title=head.title,
        settings=head.settings,
        alarm=_alarm(run, head.alarm),
        headline=(("verdict", run.verdict), *headline_texts(run, "\u00b1")),
        tone=TONES.get(run.verdict, ""),
        verdict=run_verdict(run),
        films=(film_of(run, _NUMBERS),),
        methods=methods([run.spec]),
        environment=environment(run.provenance, {"run": run.run_id, "created (UTC)": run.created_utc}),
        reproduce="Save the spec below as run.yaml. With the same versions on the same machine the arrays are "
        f"identical bit for bit; their SHA-256 is {run.data_sha256 or 'unknown, because the run did not finish'}.",
        commands=f"{run.spec_kind.command} run.yaml\nmbdkit rerun {run.path.name if run.path else 'run.h5'}",
        spec=yaml_text(run.spec),
        spec_file="run.yaml",
        glance=glance,
        sections=(model, *added_sections(run, mechanism)),
        beside_verdict=("misalignment", "contacts", "errors", *DRIFT),
    )


def film_of(run: Run, numbers: int, label: str = "") -> dict[str, object]:
    """Return the data of the player, with what plugins add to them; see `film_data` for the arguments."""
    return with_additions(run, film_data(run, numbers, label))


def _alarm(run: Run, ending: str) -> str:
    """Return the warning at the top of the page: that the run stopped early, or that its results must not be trusted;
    empty if there is none.
    """
    questioned = f"VERDICT: {run.verdict.upper()}" if run.verdict in ("doubtful", "bad") else ""
    return ending.partition(": ")[0] or questioned  # without the reason, which the section "Verdict" gives


def environment(provenance: Mapping[str, object], first: Mapping[str, str]) -> Table:
    """Return the table of the provenance of a run; the rows `first` come first."""
    rows: list[tuple[Cell, ...]] = [(name, str(value)) for name, value in first.items()]
    rows += [(name.replace("_", " "), str(value)) for name, value in sorted(provenance.items())]
    return Table("environment", "Environment", columns_of("item; value"), tuple(rows))


def yaml_text(spec: Mapping[str, object]) -> str:
    """Return a run spec as YAML with its keys in the usual order."""
    return write_yaml({key: spec[key] for key in dict.fromkeys((*_ORDER, *spec)) if key in spec})


_ORDER = ["mbdkit", "title", "parameters", "model", "formulation", "stabilization", "integrator", "time", "output"]
_ORDER += ["events", "limits"]
