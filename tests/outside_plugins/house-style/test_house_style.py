"""Tests of the items."""

import subprocess
import sys

import mbdkit


def command(*words):
    subprocess.run([sys.executable, "-m", "mbdkit", *words], check=True)


def test_a_run_has_the_section_the_plot_and_the_tables(tmp_path):
    path, page, tables = tmp_path / "run.h5", tmp_path / "page.html", tmp_path / "tables"
    with mbdkit.run("pendulum", time={"end": 0.1, "steps": None, "step": 0.01}, archive=path) as run:
        assert len(run.plot.house_speeds().lines) == 1
    command("report", str(path), "-o", str(page))
    assert "Speeds of the bodies." in page.read_text(encoding="utf-8")
    command("archive", "export", str(path), "--to", "markdown", "-o", str(tables))
    assert next(tables.glob("*.md")).read_text(encoding="utf-8").startswith("| time")
