"""The packaged notebooks run as scripts and as notebooks, and are copied by the command."""

from __future__ import annotations

import json
import runpy
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib import pyplot
from typer.testing import CliRunner

from mbdkit.cli import app
from mbdkit.guide.pages import find_page
from mbdkit.spec import example_names
from mbdkit.spec.loading import jupyter_text, notebook_names, notebook_text, notebook_title
from tests.first_party import PARTS

FOLDER = PARTS["mbdkit_report"] / "examples"
KERNEL = "a notebook is executed by nbclient and ipykernel"


@pytest.fixture
def without_windows() -> Iterator[None]:
    """Draw into memory, and close all figures afterwards."""
    with mpl.rc_context({"backend": "agg", "figure.max_open_warning": 0}):
        yield
        pyplot.close("all")


@pytest.mark.usefixtures("without_windows")
@pytest.mark.parametrize("name", notebook_names())
def test_a_notebook_runs_as_a_script(name: str, in_tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(FOLDER / f"{name}.py"))
    assert capsys.readouterr().out
    assert not [path for path in FOLDER.iterdir() if path.suffix not in (".py", ".yaml", ".csv", ".md", "")]


def test_the_guide_and_the_list_of_examples_name_every_notebook() -> None:
    listed = CliRunner().invoke(app, ["examples"], prog_name="mbdkit").stdout
    assert len(notebook_names()) == 4
    assert not set(notebook_names()) & set(example_names())
    for name in notebook_names():
        assert f"{name}  " in listed
        assert notebook_title(name) in listed
        assert f"| `{name}` |" in find_page("notebooks").text


@pytest.mark.end_to_end
@pytest.mark.parametrize("name", notebook_names())
def test_the_jupyter_file_has_the_code_of_the_script(name: str) -> None:
    nbformat = pytest.importorskip("nbformat", reason="Jupyter files are validated by nbformat")
    notebook = nbformat.reads(jupyter_text(notebook_text(name)), as_version=4)
    nbformat.validate(notebook)
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    script = [line for line in notebook_text(name).splitlines() if line and not line.startswith("#")]
    assert [line for cell in code for line in cell.splitlines() if line and not line.startswith("#")] == script
    assert notebook.cells[0].source.startswith(f"# {notebook_title(name)}\n")


def test_the_command_copies_a_notebook_for_jupyter_or_as_a_script(in_tmp_path: Path) -> None:
    for arguments in (["first-run"], ["first-run", "-o", "mine.py"]):
        done = CliRunner().invoke(app, ["examples", "copy", *arguments], prog_name="mbdkit")
        assert done.exit_code == 0
    assert json.loads(Path("first-run.ipynb").read_text("utf-8"))["nbformat"] == 4
    assert Path("mine.py").read_text("utf-8") == notebook_text("first-run")
    before = Path("first-run.ipynb").read_bytes()
    for arguments, said in (
        (["first-run"], "exists already"),
        (["first-run", "-o", "mine.txt"], "must end in .ipynb or .py"),
        (["first-rum"], "did you mean 'first-run'?"),
    ):
        done = CliRunner().invoke(app, ["examples", "copy", *arguments], prog_name="mbdkit")
        assert done.exit_code == 2
        assert said in done.stderr
    assert Path("first-run.ipynb").read_bytes() == before
    assert {path.name for path in in_tmp_path.iterdir()} == {"first-run.ipynb", "mine.py"}


@pytest.mark.end_to_end
def test_a_kernel_shows_results_and_progress(in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient", reason=KERNEL)
    nbformat = pytest.importorskip("nbformat", reason=KERNEL)
    pytest.importorskip("ipykernel", reason=KERNEL)
    for variable in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(variable, str(in_tmp_path / "jupyter"))
    notebook = nbformat.reads(jupyter_text(notebook_text("first-run")), as_version=4)
    bars = "from mbdkit.base import progress_bars as bars; bars.PATIENCE = bars._PAUSE = 0.0"
    notebook.cells.insert(0, nbformat.v4.new_code_cell(bars))
    told = []
    client = nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3")
    process = client.process_message

    def listen(message, *rest):
        told.append((message["msg_type"], message["content"].get("data", {}).get("text/html", "")))
        return process(message, *rest)

    monkeypatch.setattr(client, "process_message", listen)
    client.execute(cwd=str(in_tmp_path))
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    (result,) = [one for one in code[1].outputs if one.output_type == "execute_result"]
    assert "Verdict good" in result.data["text/html"]
    (film,) = code[2].outputs
    assert "<iframe" in film.data["text/html"]
    assert "srcdoc=" in film.data["text/html"]
    drawn = [html for kind, html in told if kind in ("display_data", "update_display_data") and "<progress" in html]
    assert any("Seated knee, released from rest t = 4 of 4 s" in html for html in drawn)
    assert not any("<progress" in str(cell.outputs) for cell in code)  # the bar vanishes at the end
    assert (in_tmp_path / "knee.h5").exists()
