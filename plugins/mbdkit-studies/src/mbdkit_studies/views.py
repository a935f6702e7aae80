"""What notebooks show of studies."""

from __future__ import annotations

from mbdkit_report.notebook.result_views import View
from mbdkit_studies.study import Study
from mbdkit_studies.study_headlines import headlines
from mbdkit_studies.study_notes import notes
from mbdkit_studies.study_report import runs_table, settings


def study_view(study: Study) -> View:
    """Return the view of a study."""
    title = " ".join(study.spec.title.split()) or study.folder.resolve().name
    answers = [f"{name}: {told}" for name, told in (*headlines(study, "±"), *notes(study))]
    return View(f"Study: {title}", (settings(study), *answers), tables=(runs_table(study),))
