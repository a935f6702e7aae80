"""Tests of the files."""

import pytest


@pytest.mark.parametrize(("levels", "status"), [("[0.5, -0.25]", 0), ("[0.5, 1e9]", 2)])
def test_archive_check_examines_them(tmp_path, levels, status):
    from typer.testing import CliRunner

    from mbdkit.cli import app

    (tmp_path / "week.tides").write_text(f'{{"level": {levels}}}')
    outcome = CliRunner().invoke(app, ["archive", "check", str(tmp_path / "week.tides")])
    assert outcome.exit_code == status, outcome.output
