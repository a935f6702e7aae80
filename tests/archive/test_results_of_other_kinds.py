"""A kind of specs from a plugin stores residuals, a covariance and tables in its archives, through the doors alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.result_table import ResultTable, TableColumn
from tests.installing import install_module, python
from tests.margins import assert_within

PLUGIN = """
from pathlib import Path
from typing import Any

import numpy as np
from mbdkit.plugin import Run, RunSpec, SpecKind, Target, hookimpl, loaded, simulate
from mbdkit.plugin.archives import ResultTable, TableColumn
from mbdkit.plugin.seams import computed_run, spec_loader


class FitSpec(RunSpec):
    '''A run, and the speeds of its rod with which the parabola of its amplitude is fitted.'''

    fit: tuple[float, ...]


@spec_loader
def load(source: Any, assignments: Any = (), **sections: Any) -> FitSpec:
    return loaded("fit", FitSpec, source, assignments, sections)


@computed_run
def compute(spec: FitSpec, *, path: Path | None = None, overwrite: bool = False, progress: Any = None) -> Run:
    '''Integrate a run for each speed, fit a line to their energies, and store the line with its covariance.'''
    rates, energies = np.array(spec.fit), []
    for rate in spec.fit:
        data = spec.sections() | {"fit": spec.fit}
        data["model"] = {**data["model"].model_dump(), "rate": rate}
        energies.append(float(simulate(type(spec)(**data)).energy.total[-1]))
    design = np.column_stack([np.ones(len(rates)), rates**2])
    values, *_ = np.linalg.lstsq(design, np.array(energies), rcond=None)
    residual = np.array(energies) - design @ values
    names = np.array(["rest", "half_inertia"])
    line = ResultTable({
        "parameter": TableColumn(names, ("parameter",)),
        "other": TableColumn(names, ("other",)),
        "value": TableColumn(values, ("parameter",), "mixed", "fitted value"),
        "covariance": TableColumn(np.linalg.inv(design.T @ design), ("parameter", "other"), "1", "of unit variance"),
    })
    residuals = ResultTable({
        "rate": TableColumn(rates, ("rate",), "rad/s", "speed at the start"),
        "residual": TableColumn(residual, ("rate",), "J", "energy without that of the fit"),
    })
    return simulate(spec, path=path, overwrite=overwrite, tables={"line": line, "residuals": residuals})


@hookimpl
def mbdkit_items():
    return [SpecKind(name="fit", summary="A fit.", marker="fit", command="fit", load=Target("fit_kit:load"),
                     model=Target("fit_kit:FitSpec"), compute=Target("fit_kit:compute"), run_kind="fit")]
"""
RATES = [0.0, 1.0, 2.0, 3.0]
SPEC = {
    "mbdkit": 1,
    "fit": RATES,
    "model": {"name": "single-pendulum"},
    "integrator": {"name": "gauss", "stages": 3},
    "time": {"end": 0.5, "step": 0.01},
}
COMPUTE = "from pathlib import Path; import fit_kit; fit_kit.compute(fit_kit.load('spec.json'), path=Path('fit.h5'))"


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("fit")
    install_module(here / "site", "fit-kit", PLUGIN)
    (here / "spec.json").write_text(json.dumps(SPEC))
    done = python("-c", COMPUTE, path=(here / "site",), cwd=here)
    assert done.returncode == 0, done.stderr
    return here / "fit.h5"


@pytest.mark.end_to_end
def test_residuals_and_a_covariance_of_another_kind_are_read_without_its_plugin(archive: Path) -> None:
    with mbdkit.load(archive) as run:
        line, residuals = run.tables["line"], run.tables["residuals"]
        assert list(line["parameter"]) == ["rest", "half_inertia"]
        # the energy of a rod of 1 kg and 1 m is m L^2 / 6 times the square of its speed, plus a constant
        assert line["value"][1] == pytest.approx(1 / 6, rel=1e-9)
        square = np.array(RATES) ** 2
        inverse = np.linalg.inv([[4.0, square.sum()], [square.sum(), (square**2).sum()]])
        np.testing.assert_allclose(line["covariance"], inverse, rtol=1e-12)
        assert_within(residuals["residual"], 1e-9)
        assert residuals.columns["rate"].units == "rad/s"


@pytest.mark.end_to_end
def test_its_archive_is_valid_and_computed_again_to_the_bit(archive: Path) -> None:
    assert check(archive) == []
    done = python("-m", "mbdkit", "rerun", "fit.h5", path=(archive.parent / "site",), cwd=archive.parent)
    assert "the same to the bit" in done.stdout, done.stderr


def _pair(values: list[float], axes: tuple[str, ...]) -> ResultTable:
    return ResultTable({"row": TableColumn(np.arange(2), ("row",)), "value": TableColumn(np.array(values), axes)})


@pytest.mark.parametrize(("values", "axes"), [([1.0], ("row",)), ([1.0, 2.0], ("column",)), ([1.0, 2.0], ())])
def test_a_table_whose_axes_do_not_match_is_refused(values: list[float], axes: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="the column value"):
        _pair(values, axes)


def test_the_data_hash_covers_tables_and_names_of_quantities_are_refused() -> None:
    spec = mbdkit.spec.RunSpec(**{key: value for key, value in SPEC.items() if key != "fit"})
    from mbdkit.plugin import simulate

    first, second = (simulate(spec, tables={"pair": _pair([1.0, last], ("row",))}) for last in (2.0, 3.0))
    assert first.data_sha256 != second.data_sha256
    with pytest.raises(ValueError, match="'joints'"):
        simulate(spec, tables={"joints": _pair([1.0, 2.0], ("row",))})
